//! The supervisor: all checks and limits between a controller's output and the valves.
//!
//! In each tick the monitors check the readings, the pressure, the breath and the response to the delivered gas. A finding
//! raises an alarm and has the response of its row in [`super::alarms::ALARMS`]: none, a step down the [`super::ladder`],
//! another sensor or backup ventilation, and only where ventilating on would harm the latched safe state, which an operator
//! ends ([`SupervisorState::clear`]). The learned part of a command is applied only in ticks with a fresh, plausible reading,
//! and changes no faster than [`RESIDUAL_SLEW`](super::slew::RESIDUAL_SLEW).
//!
//! A tick of a breath is [`Supervisor::check`], whose [`Belief`] contains all that the tick may use;
//! [`Supervisor::command`], which takes it back with a controller's output; and [`Supervisor::end_tick`]. Outside a
//! breath it is [`Supervisor::watch`] and [`Supervisor::rest`].

mod answer;
mod breaths;
mod state;

pub use breaths::{FILLED, FILLS};
pub use state::{LEAST_BASELINE, ROOM};

use super::alarms::{Action, Fault};
use super::backup::Backup;
use super::breath_monitor::{ABOVE_PEEP, BreathInput, BreathMonitor, BreathState, Cap};
use super::expected::Expected;
use super::expiration::{Expiration, ExpirationState, TIGHT};
use super::filter::ValveCommand;
use super::flow_monitor::{FlowMonitor, FlowState};
use super::indications::Indications;
use super::ladder::{Ladder, Level};
use super::lung_estimator::{LungEstimator, LungState};
use super::monitors::{Monitors, in_a_row, ticks};
use super::plateau::DOUBTFUL;
use super::pressure_monitor::{Gas, PressureFinding, PressureInput, PressureMonitor, PressureState};
use super::reference_volume::ReferenceVolume;
use super::responses::{Response, Responses};
use super::settling::{Filling, Pressures};
use super::slew::Slew;
use super::source::{FAR_APART, Follows, PressureSource, Reading, SourceState};
use super::standing::Standing;
use super::volume_monitor::{VolumeMonitor, VolumeState};
use super::volumes::Volumes;
use crate::breath::{Breath, Moment, period_s};
use crate::control::{COMMAND_MAX, ControlOutput};
use crate::sensor::Readings;
use crate::settings::{LIMIT_MARGIN, Settings};
use core::cmp::Ordering;
use state::{Cut, Start};

/// Tick of a breath in which the last of the judgements about the breath before is made.
pub const JUDGED: u32 = 6;
/// Missed ticks within a breath that raise an alarm. Fulfils: missed-ticks.
pub const MISSED_MAX: u32 = 5;
/// Breaths in a row that miss a tick at which the alarm is raised: the PID would control all of them in silence.
pub const MISSED_BREATHS: u32 = 3;
/// Breaths in a row that end at the pressure limit and raise an alarm, whatever raised the pressure. Fulfils: high-pressure.
pub const CUTS_MAX: u32 = 3;
/// Fraction of that rise from which a reading responds to the gas.
pub const RESPONSE: f32 = 0.3;
/// Inspirations in a row with such a rise that end backup ventilation.
pub const RESPONSES: u32 = 2;
/// Recent rise of the flow to the patient that an effort causes, L/s: in a passive lung the flow falls with the pressure.
const INHALES: f32 = 0.05;
/// Predicted rise that a patient takes away, cmH2O: an effort of 20, which the estimates of the lung contain as well.
pub const EFFORT: f32 = 40.0;
/// Time after which an open expiratory valve lets gas out, s: its lag of 15 ms, and the sensor's.
const OPENED: f32 = 0.04;
/// Time after an inspiration from which a pressure above PEEP is a baseline, not that of a lung which still empties, s.
const EMPTIED: f32 = 1.0;
/// Breaths without a finding after which its condition counts as gone.
const HOLD_BREATHS: u32 = 2;

/// Configuration: the monitors, and the slew of the learned part.
#[derive(Clone, Debug, PartialEq)]
pub struct Supervisor {
    monitors: Monitors,
    source: PressureSource,
    pressure: PressureMonitor,
    breath: BreathMonitor,
    lung: LungEstimator,
    expiration: Expiration,
    volume: VolumeMonitor,
    flow: FlowMonitor,
    /// Control period, s.
    period: f32,
    slew: Slew,
    /// [`OPENED`] and [`EMPTIED`] in ticks.
    opened: u32,
    emptied: u32,
}

/// State of the monitors, of the responses and of the latched fault; at first without findings, and with safe valves.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SupervisorState {
    fault: Option<Fault>,
    indications: Indications,
    source: SourceState,
    pressure: PressureState,
    breath: BreathState,
    lung: LungState,
    expiration: ExpirationState,
    standing: Standing,
    volumes: Volumes,
    volume: VolumeState,
    /// Pressure at the end of an inspiration that is still to be judged, cmH2O.
    reached: Option<f32>,
    /// What became of the last breath's gas.
    gas: Gas,
    /// Whether the gas in the lung does not explain a pressure that leaves no room for a breath.
    lies: bool,
    flow: FlowState,
    reference: ReferenceVolume,
    filling: Filling,
    /// Pressures of the last breath, if the running one has other settings.
    pressures_before: Option<Pressures>,
    /// Whether the flow sensor was sound in the last breath of a connected patient.
    flow_sound: bool,
    backup: Backup,
    ladder: Ladder,
    /// Settings of the running breath.
    settings: Option<Settings>,
    /// What the sensor in use read in the last tick.
    reading: Reading,
    /// While the reading does not respond to the gas: inspirations in a row to which it did.
    unresponsive: Option<u32>,
    /// Breaths in a row that have filled the lung, from which no pressure fell.
    filled: u32,
    /// Whether the last breath that was ended in doubt has lost its gas to a leak, and none has reached its pressure since.
    leaks_away: bool,
    /// What has started the running breath or, at its end, the next one.
    start: Start,
    cut: Cut,
    /// Breaths in a row that were cut.
    cuts: u32,
    /// Ticks missed in the running breath, and breaths in a row that missed some.
    missed: u32,
    misses: u32,
    /// Learned part of the last command, percent.
    learned: f32,
    applied: f32,
    /// Ticks for which the expiratory valve has been commanded open; none before the first command.
    open: Option<u32>,
}

/// What a tick of a breath may use: the pressure, and the responses to the findings so far.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Belief<'a> {
    /// The tick.
    pub moment: Moment<'a>,
    /// The pressure to control with, cmH2O; PEEP without a sound sensor.
    pub pressure: f32,
    /// The reading to record, cmH2O: that of the sensor in use; where another pressure stands in, the airway's.
    pub reading: f32,
    /// The pressure in which an effort shows, cmH2O: NaN unless read in this tick from a connected patient.
    pub effort: f32,
    /// The flow towards the patient, L/s: NaN unless a sound sensor has read it.
    pub flow: f32,
    /// Level of the ladder that commands the inspiratory valve.
    pub level: Level,
    /// Whether the inspiration was ended at the pressure limit.
    pub cut: bool,
    /// Rise of PIP with a baseline that stays above PEEP, cmH2O.
    pub pip_shift: f32,
    /// Command beyond the bias that holds PEEP against a leak, percent.
    pub compensation: f32,
    /// Command of backup ventilation, percent; 0 outside its inspirations.
    pub backup: f32,
    /// Whether the learned part of a command is trusted.
    proven: bool,
}

impl Supervisor {
    /// A supervisor with these monitors for a control period in microseconds.
    pub fn new(period_us: u32, monitors: Monitors) -> Self {
        Self {
            monitors,
            source: PressureSource::new(period_us, monitors),
            pressure: PressureMonitor::new(period_us, monitors),
            breath: BreathMonitor::new(period_us, monitors),
            lung: LungEstimator::new(period_us),
            expiration: Expiration::new(period_us, monitors),
            volume: VolumeMonitor::new(period_us),
            flow: FlowMonitor::new(period_us, monitors),
            period: period_s(period_us),
            slew: Slew::new(period_us),
            opened: ticks(OPENED, period_us),
            emptied: ticks(EMPTIED, period_us),
        }
    }

    /// The enabled monitors.
    pub fn monitors(&self) -> Monitors {
        self.monitors
    }

    fn responses(&self) -> Responses {
        self.monitors.responses()
    }

    /// Level of the ladder that commands the inspiratory valve.
    fn level(&self, state: &SupervisorState) -> Level {
        self.responses().level(state.level())
    }

    /// Reports ticks missed since the last one.
    pub fn missed(&self, state: &mut SupervisorState, ticks: u32) {
        if ticks == 0 {
            return;
        }
        state.pressure.interrupted();
        state.misses = state.misses.saturating_add(u32::from(state.missed == 0));
        state.missed = state.missed.saturating_add(ticks);
        if state.missed >= MISSED_MAX || state.misses >= MISSED_BREATHS {
            self.report(state, Fault::MissedTicks);
        }
    }

    /// Checks the readings of a tick of a breath. None before the first reading and while a fault is latched: then
    /// the valves stay safe.
    #[inline]
    pub fn check<'a>(
        &self,
        state: &mut SupervisorState,
        readings: &Readings,
        moment: Moment<'a>,
    ) -> Option<Belief<'a>> {
        let flow = if state.flow.is_lost() { f32::NAN } else { readings.flow };
        let trusted = Readings { flow, ..*readings };
        let expected = self.expected(state, flow, &moment);
        let doubtful = self.check_readings(state, &trusted, moment.breath, expected);
        if moment.tick == 0 {
            state.flow.start_breath();
        }
        let inspires = moment.inspires() && !state.cut();
        self.flow.add(&mut state.flow, readings.flow, state.lung.valve_flow(), inspires);
        self.check_tick(state, &trusted, &moment, doubtful);
        self.belief(state, &trusted, moment)
    }

    /// Checks the readings of a tick in which no breath runs.
    pub fn watch(&self, state: &mut SupervisorState, readings: &Readings, breath: &Breath) {
        // No breath moves gas.
        (state.gas, state.unresponsive) = (Gas::Unseen, None);
        self.check_readings(state, readings, breath, Expected::Rest);
    }

    /// Checks readings; whether the sensor in use is doubtful.
    fn check_readings(
        &self,
        state: &mut SupervisorState,
        readings: &Readings,
        breath: &Breath,
        expected: Expected,
    ) -> bool {
        state.indications.tick(HOLD_BREATHS * breath.total_ticks());
        let chosen = self.source.check(&mut state.source, readings, expected, state.lung.valve_flow());
        state.reading = chosen.reading;
        for fault in chosen.findings.into_iter().flatten() {
            self.report(state, fault);
        }
        if let Some(fault) = chosen.replaced {
            self.indicate(state, fault);
        }
        if let Reading::Fresh(pressure) = chosen.reading {
            if chosen.follows != Follows::Same {
                state.pressure.interrupted();
            }
            if chosen.follows == Follows::Other {
                state.breath.sensor_changed();
                state.expiration.sensor_changed(pressure);
                // What the gas denied was the other sensor's.
                state.standing.unseen();
            }
            // What the gas denies ends no inspiration.
            if state.lies {
                state.pressure = PressureState::default();
            } else {
                self.check_pressure(state, pressure, readings.flow, breath.settings(), chosen.other);
            }
        }
        chosen.doubtful
    }

    /// What a tick may use after its checks. Inlined: it returns many values, and `check` is its only caller.
    #[inline]
    fn belief<'a>(
        &self,
        state: &SupervisorState,
        readings: &Readings,
        moment: Moment<'a>,
    ) -> Option<Belief<'a>> {
        let (pressure, fresh) = match state.reading {
            _ if state.fault.is_some() => return None,
            Reading::None => return None,
            Reading::Fresh(pressure) => (pressure, true),
            Reading::Bridged(pressure) => (pressure, false),
            // No controller sees it: backup ventilation commands.
            Reading::Lost => (moment.settings().peep, false),
        };
        debug_assert!(!pressure.is_nan(), "what is believed is a number");
        let (level, cut) = (self.level(state), state.cut());
        let connected = !state.breath.is_disconnected();
        let backs_up = level == Level::Backup && moment.inspires() && !cut;
        Some(Belief {
            moment,
            pressure,
            reading: if fresh { pressure } else { readings.airway },
            effort: if fresh && connected { pressure } else { f32::NAN },
            flow: readings.flow,
            level,
            cut,
            pip_shift: state.expiration.shift(moment.breath),
            compensation: state.expiration.compensation(),
            backup: if backs_up { self.backup_command(state, &moment) } else { 0.0 },
            proven: fresh && level == Level::Learned,
        })
    }

    /// The course of the pressure that the commands of the last ticks predict.
    fn expected(&self, state: &SupervisorState, flow: f32, moment: &Moment) -> Expected {
        if state.open() >= self.opened {
            return Expected::expiration(moment.settings().peep, flow);
        }
        // Until the lung estimate has begun with the inspiration, it is that of the last one.
        let inspires = moment.tick > 0 && moment.inspires() && !state.cut();
        if inspires { Expected::inspiration(moment.target(), state.lung.growth()) } else { Expected::Any }
    }

    fn check_pressure(
        &self,
        state: &mut SupervisorState,
        pressure: f32,
        flow: f32,
        settings: &Settings,
        other: Option<f32>,
    ) {
        let (limit, peep, venting) = (settings.pressure_limit, settings.peep, state.open() > 0);
        let denied = |bound, by: f32| other.is_some_and(|other: f32| other < bound && pressure - other > by);
        let flow = if state.flow.hides_gas() { f32::NAN } else { flow };
        // A reading that does not respond to the gas proves nothing about the valves.
        let gas = if state.unresponsive.is_some() { Gas::ComesOut } else { state.gas };
        let input = PressureInput { pressure, limit, peep, venting, flow, gas };
        match self.pressure.check(&mut state.pressure, &input) {
            PressureFinding::Normal => {}
            PressureFinding::EndInspiration if state.cut() => {}
            PressureFinding::EndInspiration => {
                if state.backup.lacks_gas() {
                    state.flow.inspired(Ordering::Less);
                }
                let by_first = state.backup.has_given_little() && state.shows_gas(flow);
                state.cut = match (denied(limit, DOUBTFUL), by_first) {
                    (true, _) => Cut::Denied,
                    (_, true) => Cut::ByFirstGas,
                    _ if state.backup.has_let_in_little() => Cut::KeptOut,
                    _ if state.lung.explains(0.5 * (limit + settings.pip)) => Cut::ByGas,
                    _ => Cut::ByPatient,
                };
                if state.open() == 0 {
                    self.lung.end_inspiration(&mut state.lung, state.start == Start::Effort);
                }
            }
            PressureFinding::Alarm(fault) => {
                // A sensor that another one denies proves nothing about the valves.
                let bound = if fault == Fault::SustainedPressure { peep + ABOVE_PEEP } else { limit };
                if !denied(bound, FAR_APART) {
                    self.report(state, fault);
                }
            }
        }
    }

    /// Checks a tick of a breath; without a pressure the lung estimate goes on alone.
    fn check_tick(&self, state: &mut SupervisorState, readings: &Readings, moment: &Moment, doubtful: bool) {
        let (pressure, settings) = (state.reading.pressure(), moment.settings());
        // The first tick has enough to do.
        match moment.tick {
            0 => self.start_breath(state, pressure, settings),
            1 => self.check_flow(state),
            2 => self.learn_leak(state, settings),
            3 => self.check_volumes(state, settings),
            4 => self.judge_gas(state, readings, moment.breath),
            5 => self.check_reference(state, settings),
            JUDGED => self.judge_leak(state, settings),
            _ => {}
        }
        debug_assert!(
            state.settings.is_none_or(|begun| begun == *settings),
            "no breath changes while it runs"
        );
        let (leak, period) = (state.expiration.leak(), moment.breath.period_s());
        state.volumes.add(readings.flow, pressure.unwrap_or(f32::NAN), leak, period);
        if state.level() == Level::Backup {
            self.report(state, Fault::BackupVentilation);
        }
        if moment.inspires() {
            state.backup.count(readings.flow, state.lung.valve_flow(), period);
        }
        self.judge_inspiration(state, moment);
        if let Some(pressure) = pressure {
            self.check_breath(state, pressure, readings, moment, doubtful);
        } else {
            state.standing.unseen();
            self.deliver(state, readings, moment);
        }
        let flow = state.lung.valve_flow();
        self.source.record(&mut state.source, moment, self.breath.end_of_phase(), readings, flow);
        if moment.left() == 1 {
            self.compare_sensors(state, Start::Clock);
        }
    }

    /// Counts the gas of a tick without a pressure.
    fn deliver(&self, state: &mut SupervisorState, readings: &Readings, moment: &Moment) {
        if moment.inspires() {
            let by_flow = self.responses().has(Response::BackupByFlow) && state.backup.is_flow_sound();
            self.lung.deliver(&mut state.lung, by_flow.then_some(readings.flow));
        }
    }

    /// Ends a tick of a breath; whether the next one starts a breath, because it is due or the patient inhales
    /// (`effort`).
    pub fn end_tick(&self, state: &mut SupervisorState, moment: &Moment, effort: bool) -> bool {
        let due = moment.left() <= 1;
        if effort && !due {
            self.triggered(state, moment);
        }
        let ends = effort || (due && !self.expiration.goes_on(&state.expiration, &moment.next()));
        // A lung that has hardly taken gas has nothing to give out: the next controller need not wait.
        let again = || state.open() >= self.emptied && self.level(state) < Level::CappedPid;
        let ends = ends || (state.cut == Cut::ByFirstGas && again());
        if ends {
            state.start = if effort { Start::Effort } else { Start::Clock };
        }
        debug_assert!(!effort || !moment.inspires(), "an effort ends no inspiration");
        ends
    }

    /// Ends an expiration before the next breath is due, because the patient inhales.
    fn triggered(&self, state: &mut SupervisorState, moment: &Moment) {
        let settings = moment.settings();
        self.compare_sensors(state, Start::Effort);
        let emptied = moment.tick.saturating_sub(moment.breath.inspiration_ticks()) >= self.emptied;
        let inhales = state.volumes.surge() > INHALES;
        self.expiration.triggered(&mut state.expiration, settings.peep, emptied, inhales);
        let cut = state.cut();
        if let Some(fault) = self.breath.triggered(&mut state.breath, settings.peep, emptied, cut) {
            self.report(state, fault);
        }
    }

    fn check_breath(
        &self,
        state: &mut SupervisorState,
        pressure: f32,
        readings: &Readings,
        moment: &Moment,
        doubtful: bool,
    ) {
        let cut = state.cut();
        let cap = match self.level(state) {
            Level::CappedPid if state.source.is_noisy() => Cap::ByNoise,
            Level::CappedPid => Cap::ByLimit,
            _ => Cap::None,
        };
        let flow = match state.unresponsive {
            // A reading that does not respond shows no open tube.
            Some(_) => Some(0.0),
            None => (!readings.flow.is_nan() && !state.flow.is_doubtful()).then_some(state.volumes.smooth()),
        };
        let still = state.stands_still(moment.settings().peep);
        if moment.inspires() && !cut && self.lung.check(&mut state.lung, pressure, still) {
            self.unresponsive(state, pressure, readings, moment.settings(), still);
        }
        // In most ticks of an inspiration nothing is judged.
        let telling = cut || !moment.inspires() || moment.ends_inspiration();
        let input = BreathInput {
            moment: *moment,
            cut,
            pressure,
            command: state.applied,
            cap,
            volume: state.lung.volume(),
            share: state.flow.usual_share(),
            reached: if telling { state.reached(moment) } else { None },
            inspired: if telling { state.volumes.inspired() } else { None },
            returned: state.volumes.expired(),
            refill: state.volumes.deficit(),
            leaks: state.volumes.expired_share().is_some_and(|share| share < TIGHT),
            flow,
            doubtful,
            moved: if moment.left() == 1 { state.expiration.moved() } else { 0.0 },
            last: state.volumes.exchange(),
        };
        if let Some(fault) = self.breath.check(&mut state.breath, &input) {
            self.report(state, fault);
        }
        let denied = || state.source.shows_peep(readings, state.lung.valve_flow(), moment.settings().peep);
        let unsure = || doubtful || state.breath.is_disconnected() || denied();
        self.expiration.observe(&mut state.expiration, moment, pressure, state.volumes.smooth(), unsure);
        state.standing.observe(moment, state.expiration.smooth());
        if moment.ends_inspiration() {
            state.standing.inspired(state.volumes.expired());
            if self.source.inspired(&mut state.source, state.lung.valve_flow(), cut) {
                self.report(state, Fault::SensorsDisagree);
            }
        }
        if moment.ends_inspiration() && !cut {
            state.reached = Some(pressure);
        }
    }

    /// Raises an alarm, and responds as its row of the alarm table says; false if its monitor is disabled or a fault
    /// is latched.
    pub fn report(&self, state: &mut SupervisorState, fault: Fault) -> bool {
        if !self.indicate(state, fault) {
            return false;
        }
        match fault.alarm().action {
            Action::Pid => state.ladder.step_down(Level::Pid),
            Action::CappedPid => state.ladder.step_down(Level::CappedPid),
            Action::Vent => state.fault = Some(fault),
            // A finding about a sensor has taken it out of use already.
            _ => {}
        }
        true
    }

    /// Raises an alarm; false as for [`Self::report`].
    fn indicate(&self, state: &mut SupervisorState, fault: Fault) -> bool {
        let counts = self.monitors.has(fault) && state.fault.is_none();
        if counts {
            state.indications.found(fault);
        }
        counts
    }

    /// The command of backup ventilation in a tick of an inspiration, percent: none while the lung estimate predicts a
    /// pressure close to the limit.
    fn backup_command(&self, state: &SupervisorState, moment: &Moment) -> f32 {
        let highest = moment.settings().pressure_limit - LIMIT_MARGIN;
        let responds = self.responses().has(Response::Backup);
        let safe = responds && state.lung.predicted_pressure().is_none_or(|pressure| pressure < highest);
        let by_flow = self.responses().has(Response::BackupByFlow);
        if safe { state.backup.command(moment, by_flow) } else { 0.0 }
    }

    /// The safety filter: converts the trusted part of a controller's output to a valve command. The command is the safe one
    /// while a fault is latched and for the rest of an inspiration that was ended at the pressure limit.
    #[inline]
    pub fn command(
        &self,
        state: &mut SupervisorState,
        belief: &Belief,
        output: ControlOutput,
        u_out: bool,
    ) -> ValveCommand {
        let u_in = self.trusted_part(state, belief, output);
        let vents = state.fault.is_some() || (belief.cut && !u_out);
        let command = if vents { ValveCommand::SAFE } else { ValveCommand::limited(u_in, u_out) };
        self.applied(state, command);
        if !command.u_out() {
            state.backup.record(&belief.moment, command.u_in());
        }
        command
    }

    /// Takes note of a command.
    #[inline]
    fn applied(&self, state: &mut SupervisorState, command: ValveCommand) {
        (state.applied, state.open) = (command.u_in(), Some(in_a_row(state.open(), command.u_out())));
        self.lung.applied(&mut state.lung, command.u_in());
    }

    /// The trusted part of the output, percent. The learned part fades in and out at the slew, so that no hand-over is a
    /// larger step; the cap takes effect at once.
    fn trusted_part(&self, state: &mut SupervisorState, belief: &Belief, output: ControlOutput) -> f32 {
        let (command, complete) = self.slew.step(&mut state.learned, output, belief.proven);
        if complete {
            return command;
        }
        let capped = belief.level == Level::CappedPid || state.breath.is_disconnected();
        let cap = if capped { state.ladder.cap() } else { COMMAND_MAX };
        command.min(cap)
    }

    /// The safe command, for ticks without a breath.
    pub fn rest(&self, state: &mut SupervisorState) -> ValveCommand {
        self.applied(state, ValveCommand::SAFE);
        ValveCommand::SAFE
    }
}

#[cfg(test)]
mod tests;
