//! Whether the pressure answers to the gas, and what follows if it does not.

use super::super::alarms::Fault;
use super::super::breath_monitor::{ABOVE_PEEP, COMES_BACK, may_be_open};
use super::state::Cut;
use super::{EFFORT, RESPONSE, Supervisor, SupervisorState};
use crate::sensor::Readings;
use crate::settings::Settings;

/// Share of the valve's flow that the flow sensor shows if the gas reaches the patient.
const REACHES: f32 = 0.5;
/// Modelled flow below which no flow need reach the patient, L/s.
const LITTLE_FLOW: f32 = 0.1;

impl SupervisorState {
    /// Whether the flow towards the patient, L/s, is that of the valve's gas, as far as its curve is that of the model; not so if a patient
    /// presses, or the valve hardly gives any.
    pub(super) fn shows_gas(&self, flow: f32) -> bool {
        let modelled = self.lung.flow();
        modelled >= LITTLE_FLOW && flow >= REACHES * self.flow.usual_share() * modelled
    }
}

impl Supervisor {
    /// Finds why the pressure does not respond to the gas. If the gas reaches the patient, and two sound sensors agree, a
    /// patient draws it in: either the pressure stays up all the same, or no more is missing than an effort takes away. Efforts
    /// falsify single estimates of the lung easily, so that these prove nothing then.
    pub(super) fn unresponsive(
        &self,
        state: &mut SupervisorState,
        pressure: f32,
        readings: &Readings,
        settings: &Settings,
        still: bool,
    ) {
        if self.other_responds(state, readings) {
            return;
        }
        let flow = state.lung.flow();
        let rise = pressure - settings.peep;
        let stays_up = rise >= RESPONSE * (settings.pip - settings.peep);
        let drawn_in = stays_up || !state.lung.is_known() || state.lung.predicted_rise() - rise < EFFORT;
        // A flow sensor that is out of use denies nothing.
        let reaches = flow < LITTLE_FLOW || state.shows_gas(readings.flow) || state.flow.is_lost();
        // A pressure that falls is that of a patient who relaxes after a strain.
        let falls = state.standing.highest() - pressure > ABOVE_PEEP;
        let refills = state.lung.volume() < state.volumes.deficit();
        let agree = !still && state.source.are_both_sound();
        if agree && (falls || (reaches && (drawn_in || refills))) {
            return;
        }
        let moves = agree && state.standing.has_moved();
        let escapes = moves || (reaches && may_be_open(pressure, settings.peep));
        if !(readings.flow >= LITTLE_FLOW && escapes) || state.unresponsive.is_some() {
            self.lose_response(state);
        } else if !state.leaks_away {
            state.cut = Cut::InDoubt;
            state.breath.doubt();
        }
    }

    /// Ends a breath that was ended in doubt: if its gas has come out of the lung, the pressure should have answered. If not, a leak has
    /// taken it, and the next breaths go on.
    pub(super) fn end_doubt(&self, state: &mut SupervisorState) {
        let comes_back = state.volumes.expired_share().is_none_or(|share| share >= COMES_BACK);
        state.leaks_away = !comes_back;
        if comes_back && !state.breath.is_disconnected() {
            self.lose_response(state);
        }
    }

    /// The gas denies the believed pressure: uses the other sensor, if they differ, or backup ventilation.
    pub(super) fn disbelieve(&self, state: &mut SupervisorState, readings: &Readings) {
        if self.source.deny(&mut state.source, readings) {
            self.report(state, Fault::SensorsDisagree);
        } else {
            self.lose_response(state);
        }
    }

    /// No sensor responds: backup ventilation.
    pub(super) fn lose_response(&self, state: &mut SupervisorState) {
        if self.report(state, Fault::NoResponse) {
            state.unresponsive = state.unresponsive.or(Some(0));
        }
    }

    /// Whether the sensors differ: then the one that has responded is used.
    pub(super) fn other_responds(&self, state: &mut SupervisorState, readings: &Readings) -> bool {
        let flow = state.lung.flow();
        let differ = self.source.unresponsive(&mut state.source, readings, flow);
        if differ {
            self.report(state, Fault::SensorsDisagree);
        }
        differ
    }
}
