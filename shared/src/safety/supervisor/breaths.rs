//! What the supervisor does once per breath: it starts the breath and judges the last one in its first ticks, and judges an
//! inspiration in the ticks after it. Each of these ticks has one task, so that none takes much longer than the others.

use super::super::alarms::Fault;
use super::super::expiration::{IN_A_ROW, Missing};
use super::super::ladder::{End, Level};
use super::super::monitors::in_a_row;
use super::super::pressure_monitor::Gas;
use super::super::settling::{Pressures, moves_breaths, moves_peep};
use super::super::source::Reading;
use super::state::{Cut, Start};
use super::{CUTS_MAX, RESPONSE, RESPONSES, Supervisor, SupervisorState};
use crate::breath::{Breath, Moment};
use crate::sensor::Readings;
use crate::settings::Settings;

/// Fraction of the rise from PEEP to PIP that a good inspiration reaches.
const GOOD_RISE: f32 = 0.7;
/// Fraction of that rise from which the valve gives what it is commanded to: a supply that falls leaves less.
const FULL_RISE: f32 = 0.85;
/// Least gas that comes out of a lung through an open expiratory valve, mL.
const COMES_OUT: f32 = 10.0;
/// The same after an effort, which moves gas to and fro between lung and circuit, mL.
const COMES_OUT_AFTER_EFFORT: f32 = 50.0;
/// Share of its gas from which a breath fills the lung: what a leak takes does not.
pub const FILLS: f32 = 0.5;
/// Breaths in a row that do so without a fall of the pressure and prove that no valve opens, if an effort has ended the last one early.
pub const FILLED: u32 = 2;

impl Supervisor {
    /// Updates the ladder with the breath that has ended, and starts the next one.
    pub(super) fn start_breath(
        &self,
        state: &mut SupervisorState,
        pressure: Option<f32>,
        settings: &Settings,
    ) {
        // Behind a tube that has narrowed, the first gas is too much for the pressure.
        let end = match state.cut {
            Cut::ByFirstGas => End::AtLimitByFirstGas,
            Cut::ByGas => End::AtLimit,
            _ => End::InTime,
        };
        if let Some(fault) = state.ladder.breath_ended(end) {
            self.report(state, fault);
        }
        let in_doubt = state.cut == Cut::InDoubt;
        state.cuts = in_a_row(state.cuts, state.cut() && !in_doubt);
        if state.cuts >= CUTS_MAX {
            let one_sensor = state.cut == Cut::Denied;
            self.report(state, if one_sensor { Fault::SensorsDisagree } else { Fault::HighPressure });
            // No cough keeps out the gas of three breaths in a row: a tube has narrowed.
            if matches!(state.cut, Cut::KeptOut | Cut::ByFirstGas) {
                state.ladder.chokes();
                self.report(state, Fault::CommandCapped);
            }
        }
        if state.missed == 0 {
            state.misses = 0;
        }
        let before = state.settings.replace(*settings).filter(|before| before != settings);
        state.pressures_before = before.as_ref().map(Pressures::of);
        if let Some(before) = before {
            Self::settings_changed(state, &before, settings);
        }
        let shown = state.cut() || state.backup.is_flow_sound();
        state.flow_sound = shown && !state.breath.is_disconnected();
        (state.cut, state.missed, state.learned) = (Cut::None, 0, 0.0);
        match pressure {
            Some(_) => state.lung.forget_gas(),
            None => state.lung.keep_gas(self.flow.expiration(&state.flow)),
        }
        let pressure = pressure.filter(|_| !state.breath.is_disconnected());
        state.lung.start_inspiration(pressure.unwrap_or(settings.peep), settings.peep);
        state.backup.start_breath();
        state.volumes.start_breath();
        state.volumes.limit_exchange(self.flow.swing(&state.flow));
        if in_doubt {
            self.end_doubt(state);
        }
        let expired = state.volumes.expired_share();
        // PIP follows no baseline that the gas denies.
        let swings = state.standing.swings() && !state.lies;
        self.expiration.start_breath(&mut state.expiration, expired, swings);
    }

    /// Tells the monitors of the baseline that the settings have changed, if it concerns them.
    fn settings_changed(state: &mut SupervisorState, before: &Settings, now: &Settings) {
        if moves_breaths(before, now) {
            state.breath.settings_changed(before.peep);
        }
        if moves_peep(before, now) {
            state.expiration.peep_changed(now.peep - before.peep);
        }
    }

    /// Judges an inspiration in the two ticks after it, which have less to do than its last one.
    #[inline]
    pub(super) fn judge_inspiration(&self, state: &mut SupervisorState, moment: &Moment) {
        let Some(pressure) = state.reached else { return };
        match moment.tick.checked_sub(moment.breath.inspiration_ticks()) {
            Some(0) => self.inspired(state, pressure, moment.breath),
            Some(1) => {
                let (peep, volume) = (moment.settings().peep, state.lung.volume());
                if self.source.at_plateau(&mut state.source, peep, volume) {
                    self.report(state, Fault::SensorsDisagree);
                }
            }
            // A breath that starts has not ended its inspiration.
            _ => state.reached = None,
        }
    }

    /// Judges an inspiration that has ended at this pressure, cmH2O, and was not cut at the limit.
    fn inspired(&self, state: &mut SupervisorState, pressure: f32, breath: &Breath) {
        self.lung.end_inspiration(&mut state.lung, state.start == Start::Effort);
        if let Some(shown) = state.backup.gas_shown() {
            state.flow.inspired(shown);
        }
        let settings = breath.settings();
        let (rise, whole) = (pressure - settings.peep, settings.pip - settings.peep);
        let has_room = !state.leaves_no_room(breath, settings.peep);
        if let Some(responses) = &mut state.unresponsive {
            debug_assert!(*responses < RESPONSES, "so many end backup ventilation");
            // From where it was: a reading that stands still above PEEP has not responded.
            let rise = rise.min(pressure - state.standing.start());
            let responds = rise >= RESPONSE * whole && has_room;
            *responses = in_a_row(*responses, responds);
            if *responses >= RESPONSES {
                state.unresponsive = None;
                state.ladder.step_down(Level::Pid);
            }
        } else if rise >= GOOD_RISE * whole && state.standing.has_moved() {
            state.leaks_away = false;
            state.lung.forget_false(pressure);
            state.backup.accept(breath);
            if rise >= FULL_RISE * whole {
                state.flow.rose(rise);
            }
        } else if rise < RESPONSE * whole {
            state.ladder.falls_short();
        }
    }

    /// Compares the sensors at the end of an expiration, before a start of the next breath.
    pub(super) fn compare_sensors(&self, state: &mut SupervisorState, next: Start) {
        let flow = state.lung.valve_flow();
        if self.source.compare(&mut state.source, flow, next == Start::Effort) {
            self.report(state, Fault::SensorsDisagree);
        }
    }

    /// Checks the flow sensor by the last breath.
    pub(super) fn check_flow(&self, state: &mut SupervisorState) {
        let blind = state.reading == Reading::Lost;
        if let Some(fault) = self.flow.judge(&mut state.flow, blind) {
            self.report(state, fault);
        }
    }

    /// Learns the leak from the gas that the last breath lost, unless the flow sensor is in doubt.
    pub(super) fn learn_leak(&self, state: &mut SupervisorState, settings: &Settings) {
        // Gas that is missing while the lung fills, or of which hardly any comes out above PEEP, is in the lung.
        let blocked = state.expiration.incomplete() > 0 && state.volumes.hardly_any_comes_out();
        let shown = state.expiration.is_even()
            && !blocked
            && !state.flow.is_doubtful()
            && !state.breath.is_disconnected();
        let Some(loss) = state.volumes.loss().filter(|_| shown) else { return };
        let Settings { peep, expiratory_bias, .. } = *settings;
        if self.expiration.learn_leak(&mut state.expiration, (peep, expiratory_bias), loss) {
            state.volume.leak_changed();
            state.reference.leak_changed();
        }
    }

    /// Judges the gas that the last breath lost.
    pub(super) fn judge_leak(&self, state: &mut SupervisorState, settings: &Settings) {
        // Gas that a leak takes is more than a lung has room for.
        let explained =
            state.volumes.loss().is_some_and(|loss| loss.refills() || state.filling.explains(loss.gas));
        // The breath that has ended had the settings before.
        if let Some(before) = state.pressures_before.take() {
            state.filling.begin(before, Pressures::of(settings));
        }
        let missing = if explained || state.reference.takes_little() {
            Missing::Explained
        } else if state.volumes.lung_keeps(self.period) {
            Missing::Kept
        } else {
            Missing::Lost
        };
        let expired = state.volumes.expired_share();
        if let Some(fault) = self.expiration.judge_last(&mut state.expiration, expired, missing) {
            self.report(state, fault);
        }
    }

    pub(super) fn check_volumes(&self, state: &mut SupervisorState, settings: &Settings) {
        let findings = self.volume.check(&mut state.volume, &state.volumes, settings);
        for fault in findings.into_iter().flatten() {
            self.report(state, fault);
        }
    }

    /// Judges what became of the last breath's gas, and whether the pressure has answered to it.
    pub(super) fn judge_gas(&self, state: &mut SupervisorState, readings: &Readings, breath: &Breath) {
        let peep = breath.settings().peep;
        let peep = state.pressures_before.map_or(peep, |before| before.highest_peep(peep));
        let balance = state.volumes.balance().filter(|_| !state.flow.hides_gas());
        let Some(balance) = balance else {
            (state.gas, state.lies) = (Gas::Unseen, false);
            return;
        };
        let effort = state.start == Start::Effort;
        let least = if effort { COMES_OUT_AFTER_EFFORT } else { COMES_OUT };
        let expired = balance.expired - state.standing.expired_before();
        let stays = expired < least || state.volumes.are_blocked();
        state.gas = if stays { Gas::Stays } else { Gas::ComesOut };
        let baselines = state.expiration.incomplete();
        let kept = state.standing.add(balance.kept, baselines);
        let fills = state.volumes.are_blocked() && kept > FILLS * balance.inspired;
        state.filled = in_a_row(state.filled, fills && !state.standing.falls());
        if state.filled > 0 {
            self.fills_up(state, effort);
        }
        let Some(elastance) = state.backup.elastance() else { return };
        let at_rest = state.expiration.has_emptied() && !state.volumes.ended_with_outflow();
        // Small errors add up in a balance over many breaths.
        let denied = if state.lies { !fills } else { at_rest && state.standing.lacks_gas(peep, elastance) };
        state.lies = denied && state.leaves_no_room(breath, peep);
        // Of a breath that the limit has ended, the gas comes out earlier.
        let judged = state.cuts == 0 && state.level() != Level::Backup && !state.breath.is_disconnected();
        let stands = baselines == IN_A_ROW && state.standing.denies_balance(peep, elastance);
        let denied = stands || state.lies || state.standing.denies_outflow(expired, elastance);
        if judged && denied {
            self.disbelieve(state, readings);
        }
    }

    /// Gas has gone in that does not come out again, and the pressure has hardly fallen; `effort` ends the expiration.
    #[cold]
    fn fills_up(&self, state: &mut SupervisorState, effort: bool) {
        let stuck = state.filled >= if effort { FILLED } else { 1 };
        if stuck && self.pressure.is_sustained(&state.pressure) && state.unresponsive.is_none() {
            self.report(state, Fault::SustainedPressure);
        }
    }

    /// Compares the volume of the last breath with those before.
    pub(super) fn check_reference(&self, state: &mut SupervisorState, settings: &Settings) {
        let sound = state.flow_sound && state.flow.is_comparable();
        let SupervisorState { reference, volumes, .. } = state;
        if let Some(fault) = reference.check(volumes, sound, self.period, settings) {
            self.report(state, fault);
        }
    }
}
