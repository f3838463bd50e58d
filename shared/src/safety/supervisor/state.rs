//! The supervisor's state as others see it: the alarms, the level of the ladder, and the running breath.

use super::{Belief, SupervisorState};
use crate::breath::{Breath, Moment};
use crate::safety::alarms::Fault;
use crate::safety::indications::Indications;
use crate::safety::ladder::Level;
use crate::safety::lung_estimator::TELLING_RISE;
use crate::safety::source::Reading;

/// Share of the rise from PEEP to PIP that a baseline must leave for a breath: the gas in the lung must explain a higher one.
pub const ROOM: f32 = 0.5;
/// Height above PEEP of such a baseline, cmH2O: what makes up for a leak, and sound sensors, explain less.
pub const LEAST_BASELINE: f32 = 5.0;

/// Whether the running breath's inspiration was ended early, at the pressure limit by what raised the pressure to it, or because its
/// gas may flow out of an open tube.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Cut {
    /// It has not.
    #[default]
    None,
    /// The gas.
    ByGas,
    /// The first gas: little has gone in, and more flows.
    ByFirstGas,
    /// A pressure that has let in but little of the gas: that of a tube which has narrowed, or of a cough.
    KeptOut,
    /// The patient, who coughs.
    ByPatient,
    /// One pressure sensor alone.
    Denied,
    /// Neither: no pressure answers to the gas, which the expiration must show to come back.
    InDoubt,
}

/// What starts a breath.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Start {
    /// The clock.
    #[default]
    Clock,
    /// An effort of the patient.
    Effort,
}

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
        if self.reading == Reading::Lost || self.unresponsive.is_some() {
            Level::Backup
        } else if self.missed > 0 || self.breath.is_disconnected() {
            self.ladder.level().max(Level::Pid)
        } else {
            self.ladder.level()
        }
    }

    /// Whether a pressure sensor is sound.
    pub fn has_sensor(&self) -> bool {
        self.source.is_sound()
    }

    /// Whether the running inspiration was ended early.
    pub fn cut(&self) -> bool {
        self.cut != Cut::None
    }

    /// Whether the pressure has stood still above PEEP, cmH2O, since the start of the inspiration, although its gas has raised that of
    /// earlier breaths by far.
    pub(super) fn stands_still(&self, peep: f32) -> bool {
        let rise = |elastance| elastance * self.lung.volume() > TELLING_RISE;
        self.standing.stands_above(peep) && self.backup.elastance().is_some_and(rise)
    }

    /// Whether the last expiration has left less than [`ROOM`] for a breath, in a lung that was at this PEEP, cmH2O.
    pub(super) fn leaves_no_room(&self, breath: &Breath, was_at: f32) -> bool {
        let rise = breath.settings().pip - breath.settings().peep;
        let above = ((1.0 - ROOM) * rise).max(LEAST_BASELINE);
        self.standing.start() > was_at + above + self.expiration.shift(breath)
    }

    /// Volume that has reached the patient so far in the breath, mL; none if the flow is not measured.
    pub(super) fn reached(&self, moment: &Moment) -> Option<f32> {
        let most = self.flow.reached(moment.breath.period_s());
        self.volumes.inspired().map(|all| all.min(most))
    }

    /// Ticks for which the expiratory valve has been commanded open; it is open before the first command.
    pub(super) fn open(&self) -> u32 {
        self.open.unwrap_or(1)
    }

    /// Whether an effort of the patient has started the running breath or, at its end, the next one.
    pub fn triggered(&self) -> bool {
        self.start == Start::Effort
    }

    /// Leak that the breaths so far have shown, L/s at 1 cmH2O; none unless the flow of the last breath was measured.
    pub fn leak(&self) -> Option<f32> {
        self.volumes.breath().and(self.expiration.known_leak())
    }

    /// Whether a leak, not the patient, may have given a sign of an effort: the pressure sags, and gas that has gone in does not come
    /// out again, or what flows in is no more than what the known leak takes at this pressure. `by_pressure`: the pressure has given it.
    pub fn leak_explains(&self, by_pressure: bool, belief: &Belief) -> bool {
        // While the PEEP valve is open, flow that rises is the patient's; after a sag it may be what makes up for the leak.
        let sags = by_pressure || self.expiration.has_sagged();
        sags && self.volumes.goes_to_leak(self.expiration.leak(), belief.pressure)
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
