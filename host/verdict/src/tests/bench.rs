//! Recordings of the virtual bench with its flow sensor, which `collect` does not record.

use super::*;
use data::recording::phase_number;
use plant::bench::{BenchConfig, FlowSensorConfig};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::settings::Settings;
use ventilator::{BenchSource, Source, Tick};

/// Breaths of a PID on a bench. The true pressure is recorded if `truth`.
pub fn recorded(
    bench: &BenchConfig,
    settings: &Settings,
    gains: PidGains,
    breaths: u32,
    seed: u64,
    truth: bool,
) -> Recording {
    let bench =
        BenchConfig { flow_sensor: FlowSensorConfig { present: true, ..bench.flow_sensor }, ..bench.clone() };
    let pid = Controller::Pid(Pid::new(gains, 1_000).unwrap());
    let mut source = BenchSource::new(&bench, pid, settings, 1_000, seed).unwrap();
    let extras = [Extra::FlowIn, Extra::FlowOut, Extra::PressureTrue];
    let extras = if truth { &extras[..] } else { &extras[..2] };
    let mut recording = Recording::with_extras(Provenance::new(1_000, "bench"), extras);
    for breath in 0..breaths {
        let mut sink = |tick: &Tick| recording.push(row(tick, breath, settings));
        source.breath(settings, &mut sink).unwrap();
    }
    recording
}

fn row(tick: &Tick, breath: u32, settings: &Settings) -> Row {
    let sample = &tick.sample;
    let flow = sample.flow.unwrap_or_default();
    Row {
        breath,
        tick: sample.tick,
        phase: phase_number(sample.phase),
        target: sample.target,
        pressure: sample.pressure,
        u_in: sample.u_in,
        u_out: if sample.u_out { 100.0 } else { 0.0 },
        pip: settings.pip,
        peep: settings.peep,
        pressure_true: tick.truth.map(|truth| truth.airway_pressure),
        flow_in: Some(flow.max(0.0)),
        flow_out: Some((-flow).max(0.0)),
        ..Row::default()
    }
}
