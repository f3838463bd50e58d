//! A patient and what happens to it, in words.

use std::mem::discriminant;

use shared::safety::ladder::Level;
use shared::settings::Settings;

use host::command::Context;
use plant::bench::FaultConfig;
use trials::endure::course::{Event, Observer, Scene};
use trials::endure::deserved::Verdict;
use trials::endure::patient::Patient;
use trials::endure::truth::BreathTruth;

/// Prints who the patient is.
pub fn describe(patient: &Patient, context: &Context<'_>) {
    let (bench, breathing) = (&patient.bench, &patient.bench.patient);
    let lung = &bench.lung.first;
    context.line(&format!(
        "patient {}: R {:.1}, C {:.1}, resistance grows by {:.0} %/h; unit {}, noise {:.3} and {:.3} cmH2O, quantum {:.3} and \
         {:.3} cmH2O (airway, outlet); flow sensor off by {:.1} %",
        patient.number,
        lung.resistance_cmh2o_per_l_s,
        lung.compliance_ml_per_cmh2o,
        breathing.resistance_growth_percent_per_hour,
        bench.unit.number,
        bench.sensor.noise_sd_cmh2o,
        bench.outlet_sensor.noise_sd_cmh2o,
        bench.sensor.quantum_cmh2o,
        bench.outlet_sensor.quantum_cmh2o,
        bench.flow_sensor.gain_error_percent,
    ));
    context.line(&format!(
        "efforts of {:.1} cmH2O, {:.1} a minute, {:.2} s long, varying by {:.0} %, {:.0} % double, waning by {:.0} % every \
         {:.0} s; {:.0} coughs of {:.0} cmH2O an hour",
        breathing.effort_cmh2o,
        breathing.effort_rate_per_min,
        breathing.effort_duration_s,
        breathing.effort_variability_percent,
        breathing.double_efforts_percent,
        breathing.effort_wanes_percent,
        breathing.effort_wanes_every_s,
        breathing.coughs_per_hour,
        breathing.cough_cmh2o,
    ));
    let change = |at_s: f64, leak: f64| format!("{leak:.2} from {at_s:.0} s");
    let first = change(0.0, bench.circuit.leak_l_per_s_at_30_cmh2o);
    let later = bench.circuit.leak_changes.iter().map(|c| change(c.at_s, c.leak_l_per_s_at_30_cmh2o));
    let leaks: Vec<_> = std::iter::once(first).chain(later).collect();
    context.line(&format!("leak in L/s at 30 cmH2O: {}", leaks.join(", ")));
    for line in faults(&bench.faults) {
        context.line(&line);
    }
    context.line(&format!("settings: {}\n", entered(&patient.settings)));
}

/// What fails and what the patient does again and again. Steps of one change share a line.
fn faults(faults: &[FaultConfig]) -> Vec<String> {
    let same = |a: &FaultConfig, b: &FaultConfig| discriminant(&a.what) == discriminant(&b.what);
    let line = |steps: &[FaultConfig]| {
        let (FaultConfig { from_s, repeats, what, .. }, last) = (steps[0], steps[steps.len() - 1]);
        match (repeats, steps.len()) {
            (Some(repeats), _) => format!("from {from_s:.0} s on, every {:.0} s: {what:?}", repeats.every_s),
            (None, 1) => format!("from {from_s:.0} s on: {what:?}"),
            (None, count) => {
                format!("{count} steps from {from_s:.0} to {:.0} s: {what:?} to {:?}", last.from_s, last.what)
            }
        }
    };
    faults.chunk_by(|a, b| a.repeats.is_none() && b.repeats.is_none() && same(a, b)).map(line).collect()
}

fn entered(settings: &Settings) -> String {
    let Settings { pip, peep, rate, inspiratory_time, rise_time, pressure_limit, .. } = settings;
    format!(
        "PIP {pip:.1}, PEEP {peep:.1}, {rate:.1} a minute, inspiration {inspiratory_time:.2} s, rise {rise_time:.2} s, limit \
         {pressure_limit:.1}"
    )
}

/// Prints the events of a stay.
pub struct Diary<'a>(pub &'a Context<'a>);

impl Observer for Diary<'_> {
    fn event(&mut self, event: &Event, scene: &Scene<'_>) {
        let text = match event {
            Event::Alarm(fault, verdict) => {
                let verdict = match verdict {
                    Verdict::Deserved => "deserved",
                    Verdict::Undeserved => "UNDESERVED",
                    Verdict::Counted => "counted",
                };
                format!("{} {verdict}: {}", fault.alarm().id, state(scene.telling()))
            }
            Event::Missed(condition) => format!("MISSED {}: {}", condition.name(), state(scene.telling())),
            Event::Interrupted(mode) => format!("INTERRUPTED, {mode:?}: {}", state(scene.telling())),
            Event::Settings(settings) => format!("settings: {}", entered(settings)),
        };
        let seconds = f64::from(scene.ms) * 1e-3;
        let Scene { breath, tick, level, .. } = scene;
        self.0
            .line(&format!("{seconds:10.3} s, breath {breath}, tick {tick}, {}: {text}", level_name(*level)));
    }

    fn minute(&mut self) -> bool {
        !self.0.stopped()
    }
}

fn level_name(level: Level) -> &'static str {
    match level {
        Level::Learned => "chosen controller",
        Level::Pid => "PID",
        Level::CappedPid => "capped PID",
        Level::Backup => "backup",
    }
}

/// The truth about a breath, in words.
fn state(breath: &BreathTruth) -> String {
    let known = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |value| format!("{value:.1}"));
    let Settings { pip, peep, pressure_limit, .. } = breath.settings;
    format!(
        "peak {:.1} (PIP {pip:.1}, limit {pressure_limit:.1}), plateau {}, baseline {} (PEEP {peep:.1}), lowest {:.1}, \
         trapped {:.1}, {:.0} mL in and {:.0} mL out ({:.0} to {:.0}), {} L/min ({:.1} to {:.1}), effort {:.1} ({:.1} at the end), cough {:.1}, leak {:.2} ({:.3} L/s at the end, {:.0} % of the gas), R {}, \
         sensors off by {:.2} and {:.2}{}",
        breath.peak,
        known(breath.plateau),
        known(breath.baseline),
        breath.lowest,
        breath.trapped,
        breath.inspired,
        breath.expired,
        breath.settings.tidal_volume_low,
        breath.settings.tidal_volume_high,
        known(breath.minute_volume),
        breath.settings.minute_volume_low,
        breath.settings.minute_volume_high,
        breath.effort,
        breath.effort_at_end,
        breath.cough,
        breath.leak,
        breath.leak_at_end,
        100.0 * breath.leak_share,
        known(breath.resistance),
        breath.airway.offset(),
        breath.outlet.offset(),
        if breath.settled { "" } else { ", settings are new" },
    )
}
