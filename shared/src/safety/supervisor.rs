//! The supervisor: all checks and limits between a controller's output and the valves.
//!
//! In each tick the monitors check the readings, the pressure, the breath and the response to the delivered gas. A finding
//! raises an alarm and has the response of its row in [`super::alarms::ALARMS`]: none, a step down the [`super::ladder`],
//! another sensor or backup ventilation, and only where ventilating on would harm the latched safe state, which an operator
//! ends ([`SupervisorState::clear`]). The learned part of a command is applied only in ticks with a fresh, plausible reading,
//! and changes no faster than [`RESIDUAL_SLEW`].

mod state;

use super::alarms::{Action, Fault};
use super::backup::Backup;
use super::breath_monitor::{BreathInput, BreathMonitor, BreathState};
use super::expected::Expected;
use super::expiration::{Expiration, ExpirationState, TIGHT};
use super::filter::ValveCommand;
use super::indications::Indications;
use super::ladder::{CAP, Ladder, Level};
use super::lung_estimator::{LungEstimator, LungState};
use super::monitors::{Monitors, in_a_row, ticks};
use super::pressure_monitor::{PressureFinding, PressureInput, PressureMonitor, PressureState};
use super::responses::{Response, Responses};
use super::source::{PressureSource, SourceState};
use super::volume_monitor::{VolumeMonitor, VolumeState};
use super::volumes::{BreathVolumes, Volumes};
use crate::breath::{Breath, Phase, period_s};
use crate::control::{COMMAND_MAX, ControlOutput};
use crate::math;
use crate::sensor::Readings;
use crate::settings::{LIMIT_MARGIN, Settings};

/// Fastest change of the learned part of a command, percent per second: the whole range takes 4 ms.
pub const RESIDUAL_SLEW: f32 = 25_000.0;
/// Missed ticks within a breath that raise an alarm.
pub const MISSED_MAX: u32 = 5;
/// Breaths in a row that end at the pressure limit and raise an alarm, whatever raised the pressure.
pub const CUTS_MAX: u32 = 3;
/// Fraction of the rise from PEEP to PIP that a good inspiration reaches.
const GOOD_RISE: f32 = 0.7;
/// Fraction of that rise from which a reading responds to the gas.
const RESPONSE: f32 = 0.3;
/// Inspirations in a row with such a rise that end backup ventilation.
pub const RESPONSES: u32 = 2;
/// Share of the inspired volume that comes out below which the expiratory path is blocked.
pub const BLOCKED: f32 = 0.2;
/// The same without the gas of a known leak.
pub const BLOCKED_WITHOUT_LEAK: f32 = 0.3;
/// Share of the valve's flow that the flow sensor shows if the gas reaches the patient.
const REACHES: f32 = 0.5;
/// Recent rise of the flow to the patient that an effort causes, L/s: in a passive lung the flow falls with the pressure.
const INHALES: f32 = 0.05;
/// Modelled flow below which no flow need reach the patient, L/s.
const LITTLE_FLOW: f32 = 0.1;
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
    /// Largest change of the learned part in a tick, percent.
    slew: f32,
    /// [`OPENED`] and [`EMPTIED`] in ticks.
    opened: u32,
    emptied: u32,
}

/// State of the monitors, of the responses and of the latched fault.
#[derive(Clone, Debug, PartialEq)]
#[expect(clippy::struct_excessive_bools, reason = "independent findings, each with a name of its own")]
pub struct SupervisorState {
    fault: Option<Fault>,
    indications: Indications,
    source: SourceState,
    pressure: PressureState,
    breath: BreathState,
    lung: LungState,
    expiration: ExpirationState,
    volumes: Volumes,
    volume: VolumeState,
    backup: Backup,
    ladder: Ladder,
    /// Settings of the running breath.
    settings: Option<Settings>,
    /// Whether no pressure sensor is sound, whether the one in use is too noisy, and whether two sound ones differ.
    lost: bool,
    noisy: bool,
    doubtful: bool,
    /// While the reading does not respond to the gas: inspirations in a row to which it did.
    unresponsive: Option<u32>,
    /// Whether an effort has started the running breath, or starts the next one.
    triggered: bool,
    triggers: bool,
    /// Whether the inspiration was ended at the pressure limit, and whether by the gas, not by the patient.
    cut: bool,
    strike: bool,
    /// Breaths in a row that were.
    cuts: u32,
    missed: u32,
    proven: bool,
    /// Learned part of the last command, percent.
    learned: f32,
    applied: f32,
    /// Ticks for which the expiratory valve has been commanded open.
    open: u32,
}

/// What the supervisor knows about the pressure of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Belief {
    /// Nothing yet, or a fault is latched: the valves stay safe.
    Nothing,
    /// The pressure to control with, cmH2O.
    Pressure(f32),
    /// No sensor is sound: backup ventilation.
    Lost,
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
            slew: RESIDUAL_SLEW * period_s(period_us),
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
    pub fn level(&self, state: &SupervisorState) -> Level {
        self.responses().level(state.level())
    }

    /// Reports ticks missed since the last one.
    pub fn missed(&self, state: &mut SupervisorState, ticks: u32) {
        state.missed = state.missed.saturating_add(ticks);
        if state.missed >= MISSED_MAX {
            self.found(state, Fault::MissedTicks);
        }
    }

    /// Raises an alarm that another part of the device has found.
    pub fn raise(&self, state: &mut SupervisorState, fault: Fault) {
        self.found(state, fault);
    }

    /// Checks the readings of one tick. `tick` is that of the running breath, none while no breath runs.
    #[inline]
    pub fn check(
        &self,
        state: &mut SupervisorState,
        readings: &Readings,
        breath: &Breath,
        tick: Option<u32>,
    ) -> Belief {
        state.indications.tick(HOLD_BREATHS * breath.total_ticks());
        let expected = self.expected(state, readings.flow, breath, tick);
        let flow = state.lung.valve_flow();
        let chosen = self.source.check(&mut state.source, readings, expected, flow);
        (state.proven, state.lost) = (chosen.fresh, chosen.lost);
        (state.noisy, state.doubtful) = (chosen.noisy, chosen.doubtful);
        for fault in chosen.findings.into_iter().flatten() {
            self.found(state, fault);
        }
        if let (Some(pressure), true) = (chosen.pressure, chosen.fresh) {
            self.check_pressure(state, pressure, breath);
        }
        if let Some(tick) = tick {
            self.check_tick(state, chosen.pressure, readings, breath, tick);
        }
        match chosen.pressure {
            _ if state.fault.is_some() => Belief::Nothing,
            Some(pressure) => Belief::Pressure(pressure),
            None if chosen.lost => Belief::Lost,
            None => Belief::Nothing,
        }
    }

    /// The course of the pressure that the commands of the last ticks predict.
    fn expected(&self, state: &SupervisorState, flow: f32, breath: &Breath, tick: Option<u32>) -> Expected {
        let Some(tick) = tick else { return Expected::Rest };
        if state.open >= self.opened {
            return Expected::expiration(breath.settings().peep, flow);
        }
        // Until the lung estimate has begun with the inspiration, it tells of the last one.
        let inspires = tick > 0 && breath.phase(tick) == Phase::Inspiration && !state.cut;
        if inspires { Expected::inspiration(breath.target(tick), state.lung.growth()) } else { Expected::Any }
    }

    fn check_pressure(&self, state: &mut SupervisorState, pressure: f32, breath: &Breath) {
        let settings = breath.settings();
        let (limit, peep) = (settings.pressure_limit, settings.peep);
        let input = PressureInput { pressure, limit, peep, venting: state.open > 0 };
        match self.pressure.check(&mut state.pressure, &input) {
            PressureFinding::Normal => {}
            PressureFinding::EndInspiration => {
                if !state.cut {
                    state.strike = state.lung.explains(0.5 * (limit + settings.pip));
                    if state.open == 0 {
                        self.lung.end_inspiration(&mut state.lung, state.triggered);
                    }
                }
                state.cut = true;
            }
            PressureFinding::Alarm(fault) => self.found(state, fault),
        }
    }

    /// Checks a tick of a breath; without a pressure the lung estimate goes on alone.
    fn check_tick(
        &self,
        state: &mut SupervisorState,
        pressure: Option<f32>,
        readings: &Readings,
        breath: &Breath,
        tick: u32,
    ) {
        // The first tick has enough to do.
        match tick {
            0 => self.start_breath(state, pressure, breath.settings()),
            1 => self.learn_leak(state, breath.settings()),
            2 => self.check_volumes(state, breath.settings()),
            _ => {}
        }
        let leak = state.expiration.leak();
        state.volumes.add(readings.flow, pressure.unwrap_or(f32::NAN), leak, breath.period_s());
        if state.level() == Level::Backup {
            self.found(state, Fault::BackupVentilation);
        }
        let inspires = breath.phase(tick) == Phase::Inspiration;
        if inspires {
            state.backup.count(readings.flow, state.lung.valve_flow(), breath.period_s());
        }
        match pressure {
            Some(pressure) => self.check_breath(state, pressure, readings, breath, tick),
            None if inspires => {
                let by_flow = self.responses().has(Response::BackupByFlow) && state.backup.is_flow_sound();
                self.lung.deliver(&mut state.lung, by_flow.then_some(readings.flow));
            }
            None => {}
        }
        self.source.record(&mut state.source, breath, tick, self.breath.end_of_phase(), readings);
        if tick + 1 == breath.total_ticks() {
            self.compare_sensors(state, breath, false);
        }
    }

    /// Learns the leak from the last breath.
    fn learn_leak(&self, state: &mut SupervisorState, settings: &Settings) {
        let Some(loss) = state.volumes.loss().filter(|_| !state.breath.is_disconnected()) else { return };
        if self.expiration.learn_leak(&mut state.expiration, settings.peep, loss) {
            state.volume.leak_changed();
        }
    }

    fn check_volumes(&self, state: &mut SupervisorState, settings: &Settings) {
        let findings = self.volume.check(&mut state.volume, &state.volumes, settings);
        for fault in findings.into_iter().flatten() {
            self.found(state, fault);
        }
    }

    fn compare_sensors(&self, state: &mut SupervisorState, breath: &Breath, triggered: bool) {
        let (peep, flow) = (breath.settings().peep, state.lung.valve_flow());
        if self.source.compare(&mut state.source, peep, flow, triggered) {
            self.found(state, Fault::SensorsDisagree);
        }
    }

    /// Ends an expiration at a tick, before the next breath is due, because the patient inhales.
    pub fn triggered(&self, state: &mut SupervisorState, breath: &Breath, tick: u32) {
        state.triggers = true;
        if tick + 1 >= breath.total_ticks() {
            return;
        }
        self.compare_sensors(state, breath, true);
        let emptied = tick.saturating_sub(breath.inspiration_ticks()) >= self.emptied;
        let inhales = state.volumes.surge() > INHALES;
        self.expiration.triggered(&mut state.expiration, breath.settings().peep, emptied, inhales);
        if let Some(fault) = self.breath.triggered(&mut state.breath, breath, emptied, state.cut) {
            self.found(state, fault);
        }
    }

    fn check_breath(
        &self,
        state: &mut SupervisorState,
        pressure: f32,
        readings: &Readings,
        breath: &Breath,
        tick: u32,
    ) {
        let inspires = breath.phase(tick) == Phase::Inspiration;
        if inspires && !state.cut && self.lung.check(&mut state.lung, pressure) {
            self.unresponsive(state, pressure, readings, breath.settings());
        }
        let (command, volume) = (state.applied, state.lung.volume());
        let leaks = state.volumes.expired_share().is_some_and(|share| share < TIGHT);
        let last = state.volumes.breath();
        let (cut, reached) = (state.cut, state.volumes.inspired());
        let capped = self.level(state) == Level::CappedPid;
        let input =
            BreathInput { breath, tick, cut, pressure, command, capped, volume, reached, leaks, last };
        if let Some(fault) = self.breath.check(&mut state.breath, &input) {
            self.found(state, fault);
        }
        let unsure = state.doubtful || state.breath.is_disconnected();
        self.expiration.observe(&mut state.expiration, breath, tick, pressure, unsure);
        if tick + 1 == breath.inspiration_ticks() && !state.cut {
            self.source.at_plateau(&mut state.source, readings);
            self.inspired(state, pressure, breath);
        }
    }

    /// Finds why the pressure does not respond to the gas. If the gas reaches the patient, and two sound sensors agree, a
    /// patient draws it in: either the pressure stays up all the same, or no more is missing than an effort takes away. Efforts
    /// falsify single estimates of the lung easily, so that these prove nothing then.
    fn unresponsive(
        &self,
        state: &mut SupervisorState,
        pressure: f32,
        readings: &Readings,
        settings: &Settings,
    ) {
        let flow = state.lung.flow();
        if self.source.unresponsive(&mut state.source, readings, flow) {
            return self.found(state, Fault::SensorsDisagree);
        }
        let rise = pressure - settings.peep;
        let stays_up = rise >= RESPONSE * (settings.pip - settings.peep);
        let drawn_in = stays_up || !state.lung.is_known() || state.lung.predicted_rise() - rise < EFFORT;
        let reaches = flow < LITTLE_FLOW || readings.flow >= REACHES * flow;
        if !(reaches && drawn_in && state.source.are_both_sound()) {
            self.found(state, Fault::NoResponse);
        }
    }

    /// Ends an inspiration that was not cut at the limit.
    fn inspired(&self, state: &mut SupervisorState, pressure: f32, breath: &Breath) {
        self.lung.end_inspiration(&mut state.lung, state.triggered);
        let settings = breath.settings();
        let (rise, wanted) = (pressure - settings.peep, settings.pip - settings.peep);
        if let Some(responses) = &mut state.unresponsive {
            *responses = if rise >= RESPONSE * wanted { *responses + 1 } else { 0 };
            if *responses >= RESPONSES {
                state.unresponsive = None;
                state.ladder.step_down(Level::Pid);
            }
        } else if rise >= GOOD_RISE * wanted {
            state.lung.forget_false(pressure);
            state.backup.accept(breath);
        }
    }

    /// Updates the ladder with the breath that has ended, and starts the next one.
    fn start_breath(&self, state: &mut SupervisorState, pressure: Option<f32>, settings: &Settings) {
        if let Some(fault) = state.ladder.breath_ended(state.cut && state.strike) {
            self.found(state, fault);
        }
        state.cuts = in_a_row(state.cuts, state.cut);
        if state.cuts >= CUTS_MAX {
            self.found(state, Fault::HighPressure);
        }
        if state.settings.replace(*settings).is_some_and(|before| before != *settings) {
            state.breath.settings_changed();
            state.expiration.settings_changed();
            state.volume.settings_changed();
        }
        (state.cut, state.strike, state.missed, state.learned) = (false, true, 0, 0.0);
        state.triggered = core::mem::take(&mut state.triggers);
        let pressure = pressure.filter(|_| !state.breath.is_disconnected());
        state.lung.start_inspiration(pressure.unwrap_or(settings.peep), settings.peep);
        state.backup.start_breath();
        state.volumes.start_breath();
        let expired = state.volumes.expired_share();
        if let Some(fault) = self.expiration.start_breath(&mut state.expiration, expired) {
            self.found(state, fault);
        }
        // Without the gas of a leak, more than that of what a patient takes in comes out again.
        let stays = |breath: BreathVolumes| breath.expired < BLOCKED_WITHOUT_LEAK * breath.inspired;
        let blocked =
            expired.is_some_and(|share| share < BLOCKED) && state.volumes.breath().is_some_and(stays);
        if self.pressure.is_sustained(&state.pressure) && blocked {
            self.found(state, Fault::SustainedPressure);
        }
    }

    /// Raises an alarm, and responds as specified in its row of the alarm table.
    fn found(&self, state: &mut SupervisorState, fault: Fault) {
        if !self.monitors.has(fault) || state.fault.is_some() {
            return;
        }
        state.indications.found(fault);
        match fault.alarm().action {
            Action::Pid => state.ladder.step_down(Level::Pid),
            // A noisy sensor is replaced by the other one, if that is sound.
            Action::CappedPid if fault != Fault::ReadingNoisy || state.noisy => {
                state.ladder.step_down(Level::CappedPid);
            }
            Action::Backup if fault == Fault::NoResponse => {
                state.unresponsive = state.unresponsive.or(Some(0));
            }
            Action::Vent => state.fault = Some(fault),
            // The other findings about sensors have taken them out of use already.
            Action::Tell | Action::CappedPid | Action::Backup => {}
        }
    }

    /// Whether an expiration goes on at a tick at which the next breath is due.
    pub fn expiration_goes_on(&self, state: &SupervisorState, breath: &Breath, tick: u32) -> bool {
        self.expiration.goes_on(&state.expiration, breath, tick)
    }

    /// The command of backup ventilation in a tick of an inspiration, percent: none while the lung estimate predicts a
    /// pressure close to the limit.
    pub fn backup_command(&self, state: &SupervisorState, breath: &Breath, tick: u32) -> f32 {
        let highest = breath.settings().pressure_limit - LIMIT_MARGIN;
        let responds = self.responses().has(Response::Backup);
        let safe = responds && state.lung.predicted_pressure().is_none_or(|pressure| pressure < highest);
        let by_flow = self.responses().has(Response::BackupByFlow);
        if safe { state.backup.command(breath, tick, by_flow) } else { 0.0 }
    }

    /// Records the command of a tick of a pressure-controlled inspiration for backup ventilation.
    #[inline]
    pub fn record(&self, state: &mut SupervisorState, breath: &Breath, tick: u32) {
        state.backup.record(breath, tick, state.applied);
    }

    /// The safety filter: converts the trusted part of a controller's output to a valve command. The command is the safe one
    /// while a fault is latched and for the rest of an inspiration that was ended at the pressure limit.
    #[inline]
    pub fn command(&self, state: &mut SupervisorState, output: ControlOutput, u_out: bool) -> ValveCommand {
        let u_in = self.trusted_part(state, output);
        let vents = state.fault.is_some() || (state.cut && !u_out);
        let command = if vents { ValveCommand::SAFE } else { ValveCommand::limited(u_in, u_out) };
        (state.applied, state.open) = (command.u_in(), in_a_row(state.open, command.u_out()));
        self.lung.applied(&mut state.lung, command.u_in());
        command
    }

    /// The trusted part of the output, percent. The learned part fades in and out at the slew, so that no hand-over is a
    /// larger step; the cap takes effect at once.
    fn trusted_part(&self, state: &mut SupervisorState, output: ControlOutput) -> f32 {
        let level = self.level(state);
        let trusted = state.proven && level == Level::Learned;
        let wanted = if trusted { output.command - output.base } else { 0.0 };
        let change = wanted - state.learned;
        if trusted && change.abs() <= self.slew {
            state.learned = wanted;
            return output.command;
        }
        state.learned += math::limit(change, -self.slew, self.slew);
        let capped = level == Level::CappedPid || state.breath.is_disconnected();
        let cap = if capped { CAP } else { COMMAND_MAX };
        (output.base + state.learned).min(cap)
    }

    /// The safe command, for ticks without a breath.
    pub fn rest(&self, state: &mut SupervisorState) -> ValveCommand {
        self.command(state, ControlOutput::default(), true)
    }
}

impl Default for SupervisorState {
    /// No findings yet; the valves are safe.
    fn default() -> Self {
        Self {
            fault: None,
            indications: Indications::default(),
            source: SourceState::default(),
            pressure: PressureState::default(),
            breath: BreathState::default(),
            lung: LungState::default(),
            expiration: ExpirationState::default(),
            volumes: Volumes::default(),
            volume: VolumeState::default(),
            backup: Backup::new(),
            ladder: Ladder::default(),
            settings: None,
            lost: false,
            noisy: false,
            doubtful: false,
            unresponsive: None,
            triggered: false,
            triggers: false,
            cut: false,
            strike: true,
            cuts: 0,
            missed: 0,
            proven: false,
            learned: 0.0,
            applied: 0.0,
            open: 1,
        }
    }
}

#[cfg(test)]
mod tests;
