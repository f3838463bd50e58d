//! A trial: one device on one lung, with one fault.

use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;
use serde::Serialize;
use shared::control::Controller;
use shared::device::prescription::PrescriptionMemory;
use shared::explore::Exploration;
use shared::reset::ResetCause;
use shared::safety::alarms::{Action, Fault};
use shared::safety::ladder::Level;
use shared::safety::monitors::Monitors;
use shared::settings::Settings;
use shared::ventilator::Mode;

use super::injection::{Injection, SensorFault, Task};
use super::rig::Attended;
use super::volume::{Ventilation, VolumeMeter};
use plant::bench::{BenchConfig, BenchPlant, Failure};
use ventilator::SourceError;

/// Distance from PEEP at which the pressure counts as returned, cmH2O.
pub const BACK: f64 = 2.0;

/// Smallest share of a normal breath's volume that counts as a delivered breath.
const DELIVERED: f64 = 0.25;

/// Tick of the breath in which a coughing patient coughs.
const COUGH_TICK: u32 = 700;

/// Configuration of a trial.
#[derive(Clone, Debug)]
pub struct Trial<'a> {
    /// The lung.
    pub bench: &'a BenchConfig,
    /// Settings, including the alarm limit.
    pub settings: Settings,
    /// The controller.
    pub controller: &'a Controller,
    /// The active monitors.
    pub monitors: Monitors,
    /// The injected fault.
    pub injection: Injection,
    /// Time of the fault, ms.
    pub onset_ms: u32,
    /// Duration of the trial after the fault, ms.
    pub watched_ms: u32,
    /// Time after the fault from which ventilation is measured, ms.
    pub judged_after_ms: u32,
    /// Seed of all noise.
    pub seed: u64,
}

/// Result of a trial. Times count from the fault, in ms.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct TrialOutcome {
    /// Alarms in order, with their times.
    pub alarms: Vec<(Fault, u32)>,
    /// Time of the first venting command that ended an inspiration or ventilation.
    pub vented_ms: Option<u32>,
    /// Longest time for which readings were above the limit without a command to vent.
    pub limit_to_vent_ms: Option<u32>,
    /// Time when the safe state was latched.
    pub latched_ms: Option<u32>,
    /// Lowest level of control reached.
    pub level: Level,
    /// Highest true airway pressure, cmH2O.
    pub peak_true: f64,
    /// Time from venting to a true pressure near PEEP.
    pub back_at_peep_ms: Option<u32>,
    /// Whether every request of another host was refused because of the lease.
    #[serde(skip)]
    pub refused: bool,
    /// What the lung got since the fault.
    #[serde(skip)]
    pub ventilation: Ventilation,
}

impl TrialOutcome {
    /// Time of this alarm.
    pub fn time_to(&self, fault: Fault) -> Option<u32> {
        self.alarms.iter().find(|(found, _)| *found == fault).map(|(_, ms)| *ms)
    }

    /// The last action taken.
    pub fn action(&self) -> Option<Action> {
        match (self.latched_ms, self.level) {
            (Some(_), _) => Some(Action::Vent),
            (None, Level::Backup) => Some(Action::Backup),
            (None, Level::CappedPid) => Some(Action::CappedPid),
            (None, Level::Pid) => Some(Action::Pid),
            (None, Level::Learned) => (!self.alarms.is_empty()).then_some(Action::Report),
        }
    }
}

/// A running trial.
struct Run<'a> {
    trial: &'a Trial<'a>,
    device: Attended<'a>,
    sensor: SensorFault,
    /// For damage to the flash.
    rng: ChaCha8Rng,
    volume: VolumeMeter,
    /// Smallest volume of a delivered breath, mL.
    delivered_ml: f64,
    missed: u32,
    above_limit: Option<u32>,
    outcome: TrialOutcome,
}

/// Runs a trial.
///
/// # Errors
/// A bench or settings that are refused.
pub fn run(trial: &Trial<'_>) -> Result<TrialOutcome, SourceError> {
    // Exploration is what must end when the host is silent.
    let exploration = (trial.injection == Injection::HostSilent).then(Exploration::default);
    let rng = ChaCha8Rng::seed_from_u64(trial.seed);
    let plant = BenchPlant::at_rest(trial.bench, trial.settings.peep, trial.seed)?;
    let memory = PrescriptionMemory::new();
    let (settings, monitors) = (&trial.settings, trial.monitors);
    let mut run = Run {
        device: Attended::started(&memory, plant, trial.controller, settings, monitors, exploration),
        delivered_ml: DELIVERED * tidal_volume_ml(trial.bench, &trial.injection.settings(trial.settings)),
        volume: VolumeMeter::new(0.0, 0.0, 0),
        sensor: SensorFault::new(trial.injection, rng.clone()),
        rng,
        missed: 0,
        above_limit: None,
        outcome: TrialOutcome::default(),
        trial,
    };
    let end_ms = trial.onset_ms + trial.watched_ms;
    for ms in 0..end_ms {
        run.tick(ms)?;
    }
    run.outcome.ventilation = run.volume.finish(end_ms);
    Ok(run.outcome)
}

/// Volume of a breath at these settings, mL: what the first compartment takes at a square pressure.
fn tidal_volume_ml(bench: &BenchConfig, settings: &Settings) -> f64 {
    let lung = &bench.lung.first;
    let time_constant_s = lung.resistance_cmh2o_per_l_s * lung.compliance_ml_per_cmh2o * 1e-3;
    let filled = 1.0 - (-f64::from(settings.inspiratory_time) / time_constant_s).exp();
    lung.compliance_ml_per_cmh2o * f64::from(settings.pip - settings.peep) * filled
}

impl Run<'_> {
    fn tick(&mut self, ms: u32) -> Result<(), SourceError> {
        let since = ms.checked_sub(self.trial.onset_ms);
        let mut readings = self.device.rig.readings();
        let task = match since {
            Some(since) => {
                self.inject(since);
                readings = self.sensor.readings(readings);
                self.trial.injection.task(since)
            }
            None => Task::Runs,
        };
        let alarm = match task {
            Task::Runs => self.device.step(readings, std::mem::take(&mut self.missed)).alarm,
            Task::Misses => {
                self.missed += 1;
                None
            }
            Task::Reset(cause) => {
                self.reset(cause)?;
                None
            }
            Task::Boots => None,
        };
        // An alarm before the fault counts too.
        self.outcome.alarms.extend(alarm.map(|fault| (fault, since.unwrap_or(0))));
        self.device.rig.run_plant();
        let volume = f64::from(self.device.rig.plant.bench.pressures().lung_volume);
        match since {
            Some(since) if since > self.trial.judged_after_ms => self.volume.add(volume, ms),
            _ => self.volume = VolumeMeter::new(self.delivered_ml, volume, ms),
        }
        if let Some(since) = since {
            self.watch(since);
        }
        Ok(())
    }

    /// Injects the fault.
    fn inject(&mut self, since: u32) {
        let bench = &mut self.device.rig.plant.bench;
        match (self.trial.injection, since) {
            (
                Injection::Part(failure)
                | Injection::BothLostAndPart(failure)
                | Injection::FlowReadsAndPart(_, failure),
                0,
            ) => bench.fail(failure),
            (Injection::HostSilent, 0) => self.device.host_speaks = false,
            (Injection::OtherHost, 0) => self.outcome.refused = self.device.other_host(),
            (Injection::Reconnected(_), 0) => bench.fail(Failure::Disconnected),
            (Injection::Reconnected(after), since) if since == after => bench.restore(),
            (Injection::Coughs(peak), _) if self.device.rig.control.state().tick() == COUGH_TICK => {
                bench.cough(peak);
            }
            (Injection::CoughTrains(peak), since) if Injection::coughs(since) => bench.cough(peak),
            (Injection::NewLung(resistance, compliance), 0) => bench.change_lung(resistance, compliance),
            (Injection::NewTiming(..), 0) => {
                self.device.apply(self.trial.injection.settings(self.trial.settings));
            }
            _ => {}
        }
    }

    fn reset(&mut self, cause: ResetCause) -> Result<(), SourceError> {
        self.missed = 0;
        match self.trial.injection {
            Injection::Weights(damage) => self.device.reset_with(damage, &mut self.rng)?,
            Injection::PowerCut(away_s) => self.device.reset(cause, away_s),
            _ => self.device.reset(cause, 0),
        }
        Ok(())
    }

    /// Records the effects of the fault.
    fn watch(&mut self, since: u32) {
        let (outcome, rig) = (&mut self.outcome, &self.device.rig);
        let (state, pressure) = (rig.control.state(), rig.plant.bench.airway_pressure());
        outcome.peak_true = outcome.peak_true.max(pressure);
        outcome.level = outcome.level.max(state.level());
        if let Mode::Fault(_) = state.mode() {
            outcome.latched_ms.get_or_insert(since);
        }
        let breath = state.breath();
        let vents = rig.command.u_out();
        if vents && (state.cut() || state.mode() != Mode::Ventilating) {
            outcome.vented_ms.get_or_insert(since);
        }
        // Of the sensors, as the ventilator sees them; without any the limit cannot be seen.
        let reading = rig.reading.pressure;
        if reading.is_nan() || reading <= breath.settings().pressure_limit {
            self.above_limit = None;
        } else if !vents {
            self.above_limit.get_or_insert(since);
        }
        // Counted from tick to tick, so that a command that never comes counts as well.
        outcome.limit_to_vent_ms = outcome.limit_to_vent_ms.max(self.above_limit.map(|from| since - from));
        if vents {
            self.above_limit = None;
        }
        let near_peep = pressure < f64::from(breath.settings().peep) + BACK;
        if let (Some(vented), true, None) = (outcome.vented_ms, near_peep, outcome.back_at_peep_ms) {
            outcome.back_at_peep_ms = Some(since - vented);
        }
    }
}
