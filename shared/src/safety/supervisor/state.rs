//! The supervisor's state as others see it: the alarms, the level of the ladder, and what the trigger and the control half ask.

use super::SupervisorState;
use crate::breath::Breath;
use crate::safety::alarms::Fault;
use crate::safety::indications::Indications;
use crate::safety::ladder::Level;
use crate::sensor::Readings;

impl SupervisorState {
    /// The latched fault.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// The most urgent alarm that has begun and has not been taken yet.
    pub fn take_begun(&mut self) -> Option<Fault> {
        self.indications.take_begun()
    }

    /// The alarms.
    pub fn indications(&self) -> &Indications {
        &self.indications
    }

    /// Acknowledges all alarms; returns whether there was one. A latched fault stays.
    pub fn acknowledge(&mut self) -> bool {
        self.indications.acknowledge()
    }

    /// Level of the ladder that commands the inspiratory valve.
    pub fn level(&self) -> Level {
        if self.lost || self.unresponsive.is_some() {
            Level::Backup
        } else if self.missed > 0 || self.breath.is_disconnected() {
            self.ladder.level().max(Level::Pid)
        } else {
            self.ladder.level()
        }
    }

    /// The reading to record: that of the sensor in use, `pressure`, unless it stands in for a missing one.
    pub fn reading(&self, readings: &Readings, pressure: f32) -> f32 {
        if self.proven { pressure } else { readings.airway }
    }

    /// The pressure in which an effort shows, cmH2O: NaN unless it is a reading of this tick from a connected patient.
    pub fn pressure_of_effort(&self, pressure: f32) -> f32 {
        if self.proven && !self.breath.is_disconnected() { pressure } else { f32::NAN }
    }

    /// Whether a pressure sensor is sound.
    pub fn has_sensor(&self) -> bool {
        self.source.is_sound()
    }

    /// Whether the running inspiration was ended at the pressure limit.
    pub fn cut(&self) -> bool {
        self.cut
    }

    /// Command that holds PEEP against a leak, percent.
    pub fn leak_compensation(&self) -> f32 {
        self.expiration.compensation()
    }

    /// Leak that the breaths so far have shown, L/s at 1 cmH2O; none unless the flow of the last breath was measured.
    pub fn leak(&self) -> Option<f32> {
        self.volumes.breath().and(self.expiration.known_leak())
    }

    /// Rise of PIP with a baseline that stays above PEEP, cmH2O.
    pub fn pip_shift(&self, breath: &Breath) -> f32 {
        self.expiration.shift(breath)
    }

    /// Starts ventilation: resets everything except the sensors' state, the alarms and a latched fault.
    pub fn begin(&mut self) {
        let (source, indications, fault) = (self.source, self.indications, self.fault);
        *self = Self { fault, indications, source, ..Self::default() };
    }

    /// Lets the PID alone control, until clean breaths lead up again.
    pub fn distrust(&mut self) {
        self.ladder.step_down(Level::Pid);
    }

    /// Clears the latched fault and all other state, when an operator acknowledges the fault.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}
