//! Runs a case on the device as on the chip, and notes what the promises are about.

use shared::device::prescription::PrescriptionMemory;
use shared::safety::alarms::Fault;
use shared::safety::indications::FaultSet;
use shared::safety::monitors::Monitors;
use shared::settings::Settings;
use shared::ventilator::Mode;

use super::case::{Case, Stalls};
use super::names::is_of_knowledge;
use crate::endure::deserved::{Verdict, judge};
use crate::endure::patient::Patient;
use crate::endure::truth::{BreathTruth, History, Moment};
use crate::faults::rig::Attended;
use plant::bench::BenchPlant;
use ventilator::SourceError;

/// Pressure above the limit that no patient may feel for long, cmH2O.
const ABOVE_LIMIT: f64 = 15.0;
/// Muscle pressure with which a patient raises the pressure himself, cmH2O, and the time for which it still shows, ms.
const PRESSES: f64 = -2.0;
const PRESSED_MS: u32 = 500;
/// Pressure above PEEP at the end of an expiration that is a high baseline, less a sensor's tolerance, cmH2O.
const HIGH: f64 = 2.0;
/// Least duration of a window, s; it is at least two breaths.
const WINDOW_S: f64 = 15.0;

/// What a run showed.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Observed {
    /// Alarms in the order of their beginning: when, s, and whether the bench's truth deserves them.
    pub alarms: Vec<(Fault, f64, Verdict)>,
    /// Alarms that were ever indicated.
    pub indicated: FaultSet,
    /// Windows from the first fault on, in their order.
    pub windows: Vec<Window>,
    /// Longest time far above the limit that the patient did not cause, ms.
    pub above_ms: u32,
    /// Highest true airway pressure, cmH2O.
    pub peak: f64,
    /// The latched fault, and when, s.
    pub latched: Option<(Fault, f64)>,
}

/// A stretch of a run.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Window {
    /// Gas that went into the lung, mL.
    pub volume_ml: f64,
    /// Breaths that began.
    pub breaths: u32,
    /// Alarms that were indicated: present, or not yet acknowledged.
    pub indicated: FaultSet,
}

/// Duration of a window of a case, s: what is promised within two breaths or 15 s is promised within one.
pub fn window_s(case: &Case) -> f64 {
    WINDOW_S.max(2.0 * case.breath_s())
}

/// The case without any fault; the host's settings are no fault.
pub fn sound(case: &Case) -> Case {
    Case { stalls: None, ..case.with_faults(Vec::new()) }
}

/// The case with those faults alone that limit what the machine can do: it knows all and misses nothing.
pub fn all_known(case: &Case) -> Case {
    let able = case.bench.faults.iter().filter(|fault| !is_of_knowledge(&fault.what)).copied();
    Case { stalls: None, ..case.with_faults(able.collect()) }
}

/// A run in progress.
struct Run<'a> {
    case: &'a Case,
    device: Attended<'a>,
    history: History,
    sent: Settings,
    missed: u32,
    above: u32,
    /// Ticks since the patient pressed.
    pressed: u32,
    onset_s: f64,
    window_s: f64,
    tick: u32,
    /// Whether a breath has begun in this tick.
    begins: bool,
    observed: Observed,
}

/// Runs a case.
///
/// # Errors
/// A bench, settings or controller that are refused.
pub fn run(case: &Case, onset_s: f64, monitors: Monitors) -> Result<Observed, SourceError> {
    let controller = case.controller.controller().map_err(|_| SourceError::Stopped)?;
    let plant = BenchPlant::at_rest(&case.bench, case.settings.peep, case.seed)?;
    let memory = PrescriptionMemory::new();
    let patient = Patient {
        number: 0,
        newborn: false,
        bench: case.bench.clone(),
        settings: case.settings,
        changes: Vec::new(),
        seed: case.seed,
        failure: None,
    };
    let mut run = Run {
        device: Attended::started(&memory, plant, &controller, &case.settings, monitors, None),
        history: History::new(&patient),
        sent: case.settings,
        missed: 0,
        above: 0,
        pressed: PRESSED_MS,
        onset_s,
        window_s: window_s(case),
        tick: 0,
        begins: false,
        observed: Observed::default(),
        case,
    };
    for ms in 0..(case.seconds * 1e3) as u32 {
        run.tick(ms);
    }
    Ok(run.observed)
}

impl Run<'_> {
    fn tick(&mut self, ms: u32) {
        let time_s = f64::from(ms) * 1e-3;
        let settings = self.case.settings_at(time_s);
        if settings != self.sent {
            self.sent = settings;
            self.device.apply(settings);
        }
        self.device.rig.follow();
        if self.case.stalls.is_some_and(|stalls| misses(&stalls, ms)) {
            self.missed += 1;
        } else {
            self.step(time_s);
        }
        self.device.rig.run_plant();
        self.watch(time_s);
    }

    fn step(&mut self, time_s: f64) {
        let state = self.device.rig.control.state();
        let begins = state.mode() == Mode::Ventilating && state.tick() == 0;
        let readings = self.device.rig.readings();
        let output = self.device.step(readings, std::mem::take(&mut self.missed));
        let state = self.device.rig.control.state();
        if begins {
            self.history.start_breath(state.breath().settings());
            self.begins = true;
        }
        self.tick = output.sample.map_or(0, |sample| sample.tick);
        if let Some(fault) = output.alarm {
            self.observed.alarms.push((fault, time_s, self.verdict(fault)));
        }
        if let Mode::Fault(fault) = state.mode() {
            self.observed.latched.get_or_insert((fault, time_s));
        }
    }

    /// Whether an alarm that begins now is deserved. A baseline that is high already in the first breaths is one.
    fn verdict(&self, fault: Fault) -> Verdict {
        let high =
            |breath: &BreathTruth| breath.baseline.is_some_and(|baseline| baseline > breath.peep() + HIGH);
        if fault == Fault::BaselineHigh && self.history.window().any(high) {
            return Verdict::Deserved;
        }
        judge(fault, &self.history)
    }

    /// Notes the truth at the end of a tick.
    fn watch(&mut self, time_s: f64) {
        let rig = &self.device.rig;
        let (truth, breath) = (rig.plant.bench.truth(), rig.control.state().breath());
        self.history.add(&Moment {
            truth: &truth,
            leak: rig.plant.bench.leak(),
            readings: &rig.readings(),
            command: (rig.command.u_in(), rig.command.u_out()),
            tick: self.tick,
            inspiration: breath.inspiration_ticks(),
            total: breath.total_ticks(),
        });
        let observed = &mut self.observed;
        observed.peak = observed.peak.max(truth.airway_pressure);
        self.pressed = if truth.muscle_pressure < PRESSES { 0 } else { self.pressed.saturating_add(1) };
        let far = truth.airway_pressure > f64::from(breath.settings().pressure_limit) + ABOVE_LIMIT;
        self.above = if far && self.pressed >= PRESSED_MS { self.above + 1 } else { 0 };
        observed.above_ms = observed.above_ms.max(self.above);
        let indicated = rig.control.state().indications().indicated();
        observed.indicated = both(observed.indicated, indicated);
        if time_s >= self.onset_s {
            let place = ((time_s - self.onset_s) / self.window_s) as usize;
            observed.windows.resize(observed.windows.len().max(place + 1), Window::default());
            let window = &mut observed.windows[place];
            window.breaths += u32::from(std::mem::take(&mut self.begins));
            window.volume_ml += truth.flow_lung.max(0.0);
            window.indicated = both(window.indicated, indicated);
        }
    }
}

fn both(one: FaultSet, other: FaultSet) -> FaultSet {
    FaultSet::from_bits(one.bits() | other.bits())
}

/// Whether a tick is missed.
fn misses(stalls: &Stalls, ms: u32) -> bool {
    let from_ms = (stalls.from_s * 1e3) as u32;
    ms.checked_sub(from_ms).is_some_and(|since| since % stalls.every_ms < stalls.ticks)
}
