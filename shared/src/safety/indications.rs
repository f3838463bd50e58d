//! Indication of alarms: which are present, and which an operator has yet to acknowledge.
//!
//! An alarm is present while its monitor keeps finding the condition, and for a hold time after. Its indication lasts until the
//! condition is gone *and* an operator has acknowledged it; ventilation does not wait for that. An alarm that begins is an
//! event, kept until it is taken, so that none is lost when several begin at once.

use serde::{Deserialize, Serialize};

use super::alarms::{ALARMS, Action, Fault, Priority};

/// A set of faults. Over the link it is a number with a bit for each fault; bits that this version does not know are kept and
/// ignored.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct FaultSet(u32);

impl FaultSet {
    /// The set with these bits, in the order of [`Fault`].
    pub const fn from_bits(bits: u32) -> Self {
        Self(bits)
    }

    /// A bit for each fault, in the order of [`Fault`].
    pub const fn bits(self) -> u32 {
        self.0
    }

    /// Whether it contains a fault.
    pub const fn has(self, fault: Fault) -> bool {
        self.0 >> fault as u32 & 1 != 0
    }

    /// Whether it contains none.
    pub const fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Its faults, in the order of [`Fault`].
    pub fn faults(self) -> impl Iterator<Item = Fault> {
        Fault::all().filter(move |fault| self.has(*fault))
    }

    /// Adds a fault.
    pub fn add(&mut self, fault: Fault) {
        self.0 |= 1 << fault as u32;
    }

    /// Removes a fault.
    pub fn remove(&mut self, fault: Fault) {
        self.0 &= !(1 << fault as u32);
    }
}

/// The alarms of a ventilator.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Indications {
    present: FaultSet,
    unacknowledged: FaultSet,
    /// Alarms that have begun and have not been taken yet.
    begun: FaultSet,
    /// Ticks since each was found last.
    since: [u32; ALARMS.len()],
}

impl Indications {
    /// Records that a condition holds in this tick.
    pub fn found(&mut self, fault: Fault) {
        if !self.present.has(fault) {
            self.begun.add(fault);
            self.unacknowledged.add(fault);
        }
        self.present.add(fault);
        self.since[fault as usize % ALARMS.len()] = 0;
        debug_assert!(self.indicated().has(fault));
    }

    /// Lets a tick pass; a condition that was last found `hold` ticks ago is gone.
    #[inline]
    pub fn tick(&mut self, hold: u32) {
        if self.present.is_empty() {
            return;
        }
        for fault in self.present.faults() {
            let since = &mut self.since[fault as usize % ALARMS.len()];
            *since = since.saturating_add(1);
            if *since > hold {
                self.present.remove(fault);
            }
        }
        let since = |fault: Fault| self.since[fault as usize % ALARMS.len()];
        debug_assert!(self.present.faults().all(|fault| since(fault) <= hold), "what is gone is not present");
    }

    /// Takes the begun alarm of the highest priority.
    pub fn take_begun(&mut self) -> Option<Fault> {
        if self.begun.is_empty() {
            return None;
        }
        let first = |priority| self.begun.faults().find(|fault| fault.alarm().priority == priority);
        let fault =
            first(Priority::High).or_else(|| first(Priority::Medium)).or_else(|| first(Priority::Low))?;
        self.begun.remove(fault);
        Some(fault)
    }

    /// Acknowledges all alarms; returns whether there was one.
    pub fn acknowledge(&mut self) -> bool {
        let any = !self.unacknowledged.is_empty();
        self.unacknowledged = FaultSet::default();
        any
    }

    /// Alarms whose condition holds.
    pub fn present(&self) -> FaultSet {
        self.present
    }

    /// Alarms that an operator has yet to acknowledge; their condition may be gone.
    pub fn unacknowledged(&self) -> FaultSet {
        self.unacknowledged
    }

    /// The finding that left no pressure reading to control with.
    pub fn cause_of_backup(&self) -> Option<Fault> {
        let mut present = self.present.faults();
        present.find(|fault| fault.alarm().action == Action::Backup)
    }

    /// Alarms that are indicated: present, or not yet acknowledged.
    pub fn indicated(&self) -> FaultSet {
        FaultSet(self.present.0 | self.unacknowledged.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const HOLD: u32 = 100;

    #[test]
    fn an_alarm_that_is_found_again_and_again_begins_once() {
        let mut alarms = Indications::default();
        for _ in 0..10 {
            alarms.found(Fault::BaselineLow);
            alarms.tick(HOLD);
        }
        assert_eq!((alarms.take_begun(), alarms.take_begun()), (Some(Fault::BaselineLow), None));
    }

    #[test]
    fn it_is_indicated_until_its_condition_is_gone_and_it_is_acknowledged() {
        let mut alarms = Indications::default();
        alarms.found(Fault::Disconnection);
        assert!(alarms.indicated().has(Fault::Disconnection) && alarms.acknowledge());
        assert!(alarms.indicated().has(Fault::Disconnection), "still present");
        (0..=HOLD).for_each(|_| alarms.tick(HOLD));
        assert!(alarms.indicated().is_empty());
        alarms.found(Fault::Disconnection);
        (0..=HOLD).for_each(|_| alarms.tick(HOLD));
        assert!(
            alarms.present().is_empty() && alarms.indicated().has(Fault::Disconnection),
            "not acknowledged"
        );
        assert!(alarms.acknowledge() && alarms.indicated().is_empty() && !alarms.acknowledge());
    }

    #[test]
    fn each_has_a_hold_of_its_own_from_when_it_was_found_last() {
        let (early, late) = (Fault::BaselineLow, Fault::Leak);
        let mut alarms = Indications::default();
        let mut pass = |ticks: u32, found: &[Fault]| {
            (0..ticks).for_each(|_| alarms.tick(HOLD));
            let present = [early, late].map(|fault| alarms.present().has(fault));
            for fault in found {
                alarms.found(*fault);
            }
            present
        };
        pass(0, &[early, late]);
        assert_eq!(pass(60, &[late]), [true, true]);
        assert_eq!(pass(HOLD - 60, &[]), [true, true]);
        assert_eq!(pass(1, &[]), [false, true]);
        assert_eq!(pass(59, &[]), [false, true]);
        assert_eq!(pass(1, &[]), [false, false]);
    }

    #[test]
    fn the_cause_of_backup_ventilation_is_what_is_wrong_with_the_reading() {
        let mut alarms = Indications::default();
        assert_eq!(alarms.cause_of_backup(), None);
        alarms.found(Fault::HighPressure);
        assert_eq!(alarms.cause_of_backup(), None);
        alarms.found(Fault::ReadingFrozen);
        alarms.found(Fault::BackupVentilation);
        assert_eq!(alarms.cause_of_backup(), Some(Fault::ReadingFrozen));
    }

    #[test]
    fn one_that_returns_after_its_hold_begins_again() {
        let mut alarms = Indications::default();
        alarms.found(Fault::Occlusion);
        alarms.take_begun();
        (0..=HOLD).for_each(|_| alarms.tick(HOLD));
        alarms.found(Fault::Occlusion);
        assert_eq!(alarms.take_begun(), Some(Fault::Occlusion));
    }

    #[test]
    fn of_several_the_most_urgent_is_taken_first_and_none_is_lost() {
        let mut alarms = Indications::default();
        for fault in [Fault::LearnedDistrusted, Fault::BaselineLow, Fault::BaselineHigh, Fault::HardLimit] {
            alarms.found(fault);
        }
        let taken = core::array::from_fn(|_| alarms.take_begun());
        let expected = [Fault::HardLimit, Fault::BaselineHigh, Fault::BaselineLow, Fault::LearnedDistrusted];
        assert_eq!(taken, expected.map(Some));
        assert_eq!(alarms.take_begun(), None);
    }

    proptest! {
        #[test]
        fn a_set_has_what_its_bits_say(bits: u32) {
            let set = FaultSet::from_bits(bits);
            let known = u32::MAX >> (u32::BITS as usize - ALARMS.len());
            prop_assert_eq!(set.faults().count() as u32, (bits & known).count_ones());
            prop_assert_eq!(set.bits(), bits);
        }
    }
}
