//! Whether the pressure answers to the gas, and what follows if it does not.

use super::super::alarms::Fault;
use super::super::breath_monitor::may_be_open;
use super::state::Cut;
use super::{EFFORT, RESPONSE, Supervisor, SupervisorState};
use crate::sensor::Readings;
use crate::settings::Settings;

/// Share of the valve's flow that the flow sensor shows if the gas reaches the patient.
const REACHES: f32 = 0.5;
/// Modelled flow below which no flow need reach the patient, L/s.
const LITTLE_FLOW: f32 = 0.1;

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
        let reaches = flow < LITTLE_FLOW || readings.flow >= REACHES * flow;
        if reaches && drawn_in && !still && state.source.are_both_sound() {
            return;
        }
        if readings.flow >= LITTLE_FLOW && reaches && may_be_open(pressure, settings.peep) {
            state.cut = Cut::InDoubt;
            state.breath.doubt();
        } else {
            self.lose_response(state);
        }
    }

    /// The believed pressure does not respond to the gas: uses the other sensor, if they differ, or backup ventilation.
    pub(super) fn disbelieve(&self, state: &mut SupervisorState, readings: &Readings) {
        if !self.other_responds(state, readings) {
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
