//! The stay of one patient: the device as on the chip, the bench, an operator who changes the settings.

use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::device::prescription::PrescriptionMemory;
use shared::safety::alarms::Fault;
use shared::safety::ladder::Level;
use shared::safety::monitors::Monitors;
use shared::safety::supervisor::JUDGED;
use shared::settings::Settings;
use shared::ventilator::{Mode, VentilatorState};

use super::deserved::{Verdict, judge};
use super::efforts::{EffortTick, EffortWatch};
use super::missed::{Condition, MissedWatch};
use super::patient::Patient;
use super::tally::PatientResult;
use super::truth::{BreathTruth, History, Moment};
use super::ward;
use crate::faults::rig::Attended;
use crate::faults::volume::VolumeMeter;
use plant::bench::{BenchConfig, BenchPlant};
use ventilator::SourceError;

/// Share of a passive breath's volume from which a breath counts as delivered.
const DELIVERED: f64 = 0.25;
/// Time between two requests of the host, ms; it changes settings and restarts a stopped device.
const HOST_ASKS_EVERY: u32 = 1000;
/// Time after which the operator restarts a device that has stopped, ms.
const RESTARTED_AFTER: u32 = 10_000;
/// Longest gap without a delivered breath that is no interruption, s.
const APNOEA: f64 = 20.0;
/// Breaths of the passive patient per setting: to settle, and in all.
const SOUND_BREATHS: (f64, f64) = (6.0, 10.0);

/// What happens in a stay.
#[derive(Clone, Debug)]
pub enum Event {
    /// An alarm begins.
    Alarm(Fault, Verdict),
    /// A condition has lasted without an alarm.
    Missed(Condition),
    /// Ventilation stops.
    Interrupted(Mode),
    /// The operator enters settings.
    Settings(Settings),
}

/// When it happened, and what the bench knew.
#[derive(Clone, Copy, Debug)]
pub struct Scene<'a> {
    /// Time since the start, ms.
    pub ms: u32,
    /// Number and tick of the device's breath.
    pub breath: u32,
    /// See `breath`.
    pub tick: u32,
    /// Level of the ladder that commands.
    pub level: Level,
    /// The running breath and those before it.
    pub history: &'a History,
}

impl<'a> Scene<'a> {
    /// The breath that tells most: the running one at its end, otherwise the last complete one.
    pub fn telling(&self) -> &'a BreathTruth {
        let running = self.history.running();
        if running.baseline.is_some() { running } else { self.history.last().unwrap_or(running) }
    }
}

/// Who watches a stay.
pub trait Observer {
    /// Something has happened.
    fn event(&mut self, _event: &Event, _scene: &Scene<'_>) {}

    /// A minute has passed; false ends the stay without a result.
    fn minute(&mut self) -> bool {
        true
    }
}

impl Observer for () {}

/// Runs a patient's stay of some hours; none if the observer ends it. The controller is that of adults.
///
/// # Errors
/// A bench or settings that are refused.
pub fn run(
    patient: &Patient,
    controller: &Controller,
    hours: f64,
    observer: &mut dyn Observer,
) -> Result<Option<PatientResult>, SourceError> {
    let controller = &ward::controller(controller, patient.newborn);
    let end_ms = (hours * 3.6e6).round() as u32;
    let seconds = f64::from(end_ms) * 1e-3;
    let threshold = DELIVERED * patient.least_volume_ml(seconds);
    let memory = PrescriptionMemory::new();
    let mut stay = Stay::new(&memory, patient, &patient.bench, controller, threshold)?;
    for ms in 0..end_ms {
        if ms % 60_000 == 0 && ms > 0 && !observer.minute() {
            return Ok(None);
        }
        stay.host(ms, observer);
        if let Some((at_ms, failure)) = patient.failure
            && ms == at_ms
        {
            stay.device.rig.plant.bench.fail(failure);
        }
        stay.tick(ms, observer);
    }
    let ventilation = stay.volume.finish(end_ms);
    let mut result = stay.result;
    result.longest_gap_s = f64::from(ventilation.longest_gap_ms) * 1e-3;
    if result.interruptions == 0 && result.longest_gap_s > APNOEA {
        result.interruptions = 1;
    }
    result.efforts = stay.efforts.result().clone();
    result.breaths = u64::from(ventilation.breaths);
    result.seconds = seconds;
    result.minute_volume_share = ventilation.volume / sound_volume(patient, controller, seconds)?;
    Ok(Some(result))
}

/// Volume that the passive patient without a leak gets in these seconds, mL: a few breaths at each of the settings.
fn sound_volume(patient: &Patient, controller: &Controller, seconds: f64) -> Result<f64, SourceError> {
    let bench = patient.passive_bench();
    let mut volume = 0.0;
    for (settings, span_s) in times(patient.spans(seconds)) {
        let alone = Patient { settings, changes: Vec::new(), ..patient.clone() };
        let threshold = DELIVERED * patient.passive_volume_ml(&settings);
        let memory = PrescriptionMemory::new();
        let mut stay = Stay::new(&memory, &alone, &bench, controller, threshold)?;
        let [from_ms, to_ms] = [SOUND_BREATHS.0, SOUND_BREATHS.1]
            .map(|breaths| (breaths * 60_000.0 / f64::from(settings.rate)).round() as u32);
        for ms in 0..to_ms {
            if ms == from_ms {
                let volume_ml = stay.device.rig.plant.bench.truth().lung_volume_ml;
                stay.volume = VolumeMeter::new(threshold, volume_ml, ms);
            }
            stay.tick(ms, &mut ());
        }
        let measured = stay.volume.finish(to_ms).volume;
        volume += measured * span_s * 1e3 / f64::from(to_ms - from_ms);
    }
    Ok(volume)
}

/// The different settings, each with all its time, s: a recruitment returns to earlier ones.
fn times(spans: impl Iterator<Item = (Settings, f64)>) -> Vec<(Settings, f64)> {
    let mut times: Vec<(Settings, f64)> = Vec::new();
    for (settings, span_s) in spans {
        match times.iter_mut().find(|(other, _)| *other == settings) {
            Some((_, sum_s)) => *sum_s += span_s,
            None => times.push((settings, span_s)),
        }
    }
    times
}

/// A stay in progress.
struct Stay<'a> {
    patient: &'a Patient,
    device: Attended<'a>,
    history: History,
    watch: MissedWatch,
    efforts: EffortWatch,
    volume: VolumeMeter,
    /// Number of settings changes made.
    changes: usize,
    /// Number and tick of the breath in the last step.
    at: (u32, u32),
    /// When ventilation stopped.
    stopped_ms: Option<u32>,
    result: PatientResult,
}

impl<'a> Stay<'a> {
    fn new(
        memory: &'a PrescriptionMemory,
        patient: &'a Patient,
        bench: &BenchConfig,
        controller: &Controller,
        threshold: f64,
    ) -> Result<Self, SourceError> {
        let settings = &patient.settings;
        let plant = BenchPlant::at_rest(bench, settings.peep, patient.seed)?;
        let volume_ml = plant.bench.truth().lung_volume_ml;
        Ok(Self {
            device: Attended::started(memory, plant, controller, settings, Monitors::ALL, None),
            history: History::new(patient),
            watch: MissedWatch::default(),
            efforts: EffortWatch::default(),
            volume: VolumeMeter::new(threshold, volume_ml, 0),
            changes: 0,
            at: (0, 0),
            stopped_ms: None,
            result: PatientResult {
                patient: patient.number,
                peak_above_limit: f64::NEG_INFINITY,
                ..PatientResult::default()
            },
            patient,
        })
    }

    /// The operator at the host.
    fn host(&mut self, ms: u32, observer: &mut dyn Observer) {
        if !ms.is_multiple_of(HOST_ASKS_EVERY) {
            return;
        }
        if let Some(change) = self.patient.changes.get(self.changes)
            && f64::from(ms) >= change.at_s * 1e3
        {
            self.changes += 1;
            self.device.apply(change.settings);
            self.tell(&Event::Settings(change.settings), ms, observer);
        }
        if self.stopped_ms.is_some_and(|stopped| ms - stopped >= RESTARTED_AFTER) {
            self.device.restart();
            self.stopped_ms = None;
        }
    }

    fn state(&self) -> &VentilatorState {
        self.device.rig.control.state()
    }

    fn tell(&self, event: &Event, ms: u32, observer: &mut dyn Observer) {
        let ((breath, tick), level) = (self.at, self.state().level());
        observer.event(event, &Scene { ms, breath, tick, level, history: &self.history });
    }

    fn tick(&mut self, ms: u32, observer: &mut dyn Observer) {
        self.device.rig.follow();
        let begins = self.state().mode() == Mode::Ventilating && self.state().tick() == 0;
        let output = self.device.step(self.device.rig.readings(), 0);
        self.at = output.sample.map_or(self.at, |sample| (sample.breath, sample.tick));
        if begins {
            self.history.start_breath(self.device.rig.control.state().breath().settings());
        }
        if let Some(fault) = output.alarm {
            let verdict = judge(fault, &self.history);
            self.result.count(fault, verdict);
            self.tell(&Event::Alarm(fault, verdict), ms, observer);
        }
        if output.sample.is_some() && self.at.1 == JUDGED {
            self.find_missed(ms, observer);
        }
        if output.mode == Mode::Ventilating {
            self.stopped_ms = None;
        } else if self.stopped_ms.is_none() {
            self.stopped_ms = Some(ms);
            self.result.interruptions += 1;
            self.tell(&Event::Interrupted(output.mode), ms, observer);
        }
        self.device.rig.run_plant();
        // Outside a breath no phase ends.
        self.record(output.sample.map_or(0, |_| self.at.1));
        if output.sample.is_some() {
            self.follow_effort();
        }
        self.volume.add(self.device.rig.plant.bench.truth().lung_volume_ml, ms);
    }

    /// Finds the alarms that the last breath should have raised.
    fn find_missed(&mut self, ms: u32, observer: &mut dyn Observer) {
        let present = self.state().indications().present();
        if let Some(last) = self.history.last() {
            let missed: Vec<_> = self.watch.add(last, present).collect();
            for condition in missed {
                *self.result.missed.entry(condition.name().to_owned()).or_insert(0) += 1;
                self.tell(&Event::Missed(condition), ms, observer);
            }
        }
    }

    fn follow_effort(&mut self) {
        let (truth, state) = (self.device.rig.plant.bench.truth(), self.device.rig.control.state());
        self.efforts.add(&EffortTick {
            muscle_pressure: truth.muscle_pressure,
            efforts: truth.efforts,
            tick: self.at.1,
            inspiration: state.breath().inspiration_ticks(),
            triggered: state.triggered(),
        });
    }

    fn record(&mut self, tick: u32) {
        let rig = &self.device.rig;
        let (breath, truth) = (rig.control.state().breath(), rig.plant.bench.truth());
        let limit = f64::from(breath.settings().pressure_limit);
        self.result.peak_true = self.result.peak_true.max(truth.airway_pressure);
        self.result.peak_above_limit = self.result.peak_above_limit.max(truth.airway_pressure - limit);
        self.history.add(&Moment {
            truth: &truth,
            leak: rig.plant.bench.leak(),
            readings: &rig.readings(),
            command: (rig.command.u_in(), rig.command.u_out()),
            tick,
            inspiration: breath.inspiration_ticks(),
            total: breath.total_ticks(),
        });
    }
}

const _: () =
    assert!(DEFAULT_PERIOD_US == plant::bench::STEP_US, "a tick of the device is a step of the bench");
