//! The ladder of trust: learned controller, its PID, the compiled-in PID with a capped command, backup ventilation.
//!
//! A breath whose gas raises the pressure to its limit is a strike; a cough is none. Strikes lead down to the capped PID; clean
//! breaths lead up again, after each return more of them, and one to which the cap leaves too little gas lifts it. Breaths in a row
//! whose gas stays out of the lung lead to the capped PID as well, and there each halves the cap. Backup ventilation does not
//! depend on strikes: it runs while no pressure reading is sound.

use serde::{Deserialize, Serialize};

use super::alarms::Fault;

/// Highest command of the capped PID, percent. Fulfils: command-capped.
pub const CAP: f32 = 40.0;
/// Halvings of [`CAP`]: in the end 10 %, behind a tube that keeps out the gas of the capped PID as well.
pub const HALVINGS: u8 = 2;
/// Consecutive strikes at which the PID replaces the learned controller, unless one has hardly let any gas in. Fulfils: learned-distrusted.
pub const LEARNED_STRIKES: u32 = 2;
/// Consecutive clean breaths that lead one level up for the first time; each step up doubles their number.
pub const CLEAN_BREATHS: u32 = 5;
/// Doublings of [`CLEAN_BREATHS`]: in the end 80 breaths, so that a controller that fails every time has few chances to.
pub const DOUBLINGS: u32 = 4;

/// Level of the ladder: the controller that commands the inspiratory valve.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Level {
    /// The chosen controller, including a learned residual.
    #[default]
    Learned,
    /// The PID of that controller alone.
    Pid,
    /// The PID compiled into the program, with the command capped at [`CAP`].
    CappedPid,
    /// The mean commands of the last good breaths, without a pressure reading.
    Backup,
}

/// How the inspiration of a breath has ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum End {
    /// After its time, or by the patient: a clean breath.
    InTime,
    /// By its gas, at the pressure limit.
    AtLimit,
    /// There too, by the first of its gas.
    AtLimitByFirstGas,
}

/// Position on the ladder; starts at the top. Fulfils: ladder.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ladder {
    level: Level,
    strikes: u32,
    clean: u32,
    returns: u32,
    /// Halvings of the cap.
    halvings: u8,
}

impl Ladder {
    /// The current level.
    pub fn level(&self) -> Level {
        self.level
    }

    /// Highest command of the capped PID, percent.
    pub fn cap(&self) -> f32 {
        CAP / (1_u32 << self.halvings) as f32
    }

    /// Goes down to `level`, unless already there or below.
    pub fn step_down(&mut self, level: Level) {
        debug_assert!(level < Level::Backup, "backup ventilation is no step of the ladder");
        self.level = self.level.max(level);
        self.clean = 0;
    }

    /// Counts a breath, by how its inspiration ended; returns the fault to raise.
    pub fn breath_ended(&mut self, end: End) -> Option<Fault> {
        let fault = if end == End::InTime { self.clean_breath() } else { self.strike(end) };
        debug_assert!(self.strikes == 0 || self.clean == 0, "one kind of breath ends a row of the other");
        fault
    }

    /// Halves the cap, if there is one, after breaths whose gas has stayed out of the lung. So rare that the ticks need not make room
    /// for it.
    #[cold]
    pub fn chokes(&mut self) {
        if self.level == Level::CappedPid {
            self.halvings = HALVINGS.min(self.halvings + 1);
        }
    }

    /// Raises or lifts the cap under which a breath has hardly raised the pressure: a leak takes what it lets through.
    pub fn falls_short(&mut self) {
        if self.level == Level::CappedPid {
            self.clean = 0;
            self.raise_cap();
        }
    }

    /// One step up from the capped PID.
    fn raise_cap(&mut self) {
        match self.halvings.checked_sub(1) {
            Some(fewer) => self.halvings = fewer,
            None => self.level = Level::Pid,
        }
    }

    fn strike(&mut self, end: End) -> Option<Fault> {
        (self.strikes, self.clean) = (self.strikes + 1, 0);
        match self.level {
            Level::Learned if self.strikes < LEARNED_STRIKES && end != End::AtLimitByFirstGas => None,
            Level::Learned => {
                self.level = Level::Pid;
                Some(Fault::LearnedDistrusted)
            }
            Level::Pid => {
                self.level = Level::CappedPid;
                Some(Fault::CommandCapped)
            }
            Level::CappedPid | Level::Backup => Some(Fault::HighPressure),
        }
    }

    fn clean_breath(&mut self) -> Option<Fault> {
        (self.strikes, self.clean) = (0, self.clean.saturating_add(1));
        let wanted = CLEAN_BREATHS << self.returns.min(DOUBLINGS);
        if self.level != Level::Learned && self.clean >= wanted {
            match self.level {
                Level::CappedPid => self.raise_cap(),
                _ => self.level = Level::Learned,
            }
            (self.clean, self.returns) = (0, self.returns.saturating_add(1));
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::End::{AtLimit, AtLimitByFirstGas, InTime};
    use super::*;
    use proptest::prelude::*;
    use std::vec;
    use std::vec::Vec;

    fn after(ends: &[End]) -> (Ladder, Vec<Fault>) {
        let mut ladder = Ladder::default();
        let told = ends.iter().filter_map(|end| ladder.breath_ended(*end)).collect();
        (ladder, told)
    }

    #[test]
    fn a_single_breath_at_the_limit_is_a_cough() {
        let (ladder, told) = after(&[InTime, AtLimit, InTime, AtLimit, InTime]);
        assert_eq!((ladder.level(), told), (Level::Learned, vec![]));
    }

    #[test]
    fn strikes_in_a_row_lead_all_the_way_down() {
        let (ladder, told) = after(&[AtLimit; 4]);
        assert_eq!(ladder.level(), Level::CappedPid);
        assert_eq!(told, [Fault::LearnedDistrusted, Fault::CommandCapped, Fault::HighPressure]);
    }

    #[test]
    fn one_breath_at_the_limit_with_little_gas_is_enough() {
        let told = |end| Ladder::default().breath_ended(end);
        assert_eq!((told(AtLimit), told(AtLimitByFirstGas)), (None, Some(Fault::LearnedDistrusted)));
    }

    #[test]
    fn clean_breaths_lead_up_again_each_time_after_twice_as_many() {
        let mut ladder = Ladder::default();
        for wanted in [5, 10, 20, 40, 80, 80] {
            ladder.breath_ended(AtLimit);
            ladder.breath_ended(AtLimit);
            for _ in 1..wanted {
                ladder.breath_ended(InTime);
            }
            assert_eq!(ladder.level(), Level::Pid, "before {wanted}");
            ladder.breath_ended(InTime);
            assert_eq!(ladder.level(), Level::Learned, "after {wanted}");
        }
    }

    #[test]
    fn a_breath_that_falls_short_lifts_the_cap_alone() {
        let levels = [2, 3, 5].map(|strikes| {
            let mut ladder = after(&vec![AtLimit; strikes]).0;
            ladder.falls_short();
            (ladder.level(), ladder.breath_ended(AtLimit))
        });
        let capped = (Level::Pid, Some(Fault::CommandCapped));
        assert_eq!(levels, [capped; 3]);
        let mut ladder = Ladder::default();
        ladder.falls_short();
        assert_eq!(ladder, Ladder::default());
    }

    #[test]
    fn breaths_that_choke_cap_the_command_and_halve_the_cap_and_the_way_back_is_the_same() {
        let now = |ladder: &Ladder| (ladder.level(), ladder.cap());
        let choked = || {
            let mut ladder = Ladder::default();
            let down = [(); 4].map(|()| {
                ladder.chokes();
                ladder.step_down(Level::CappedPid);
                now(&ladder)
            });
            assert_eq!(down, [40.0, 20.0, 10.0, 10.0].map(|cap| (Level::CappedPid, cap)));
            ladder
        };
        let up = [(Level::CappedPid, 20.0), (Level::CappedPid, 40.0), (Level::Pid, 40.0)];
        let mut ladder = choked();
        let short = [(); 3].map(|()| {
            ladder.falls_short();
            now(&ladder)
        });
        assert_eq!(short, up);
        let mut ladder = choked();
        let clean = [5, 10, 20].map(|breaths| {
            (0..breaths).for_each(|_| assert_eq!(ladder.breath_ended(InTime), None));
            now(&ladder)
        });
        assert_eq!(clean, up);
    }

    proptest! {
        #[test]
        fn strikes_lead_down_only(ends in prop::collection::vec(any::<bool>(), 0..200)) {
            let mut ladder = Ladder::default();
            for cut in ends {
                let before = ladder.level();
                ladder.breath_ended(if cut { AtLimit } else { InTime });
                prop_assert!(!cut || ladder.level() >= before);
            }
        }
    }
}
