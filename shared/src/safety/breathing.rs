//! Does breath after breath go as it must? Judged once per phase, from the pressures at its end.

use super::alarms::Fault;
use super::monitors::{Monitors, Times};
use crate::breath::{Breath, Phase};

/// Distance above PEEP at which the expiration has not ended, cmH2O.
const ABOVE_PEEP: f32 = 3.0;
/// Distance below PEEP at which PEEP is lost, cmH2O.
const BELOW_PEEP: f32 = 2.0;
/// Part of the way from PEEP to PIP that an inspiration must reach.
const REACHED: f32 = 0.3;
/// Mean command above which the valve counts as wide open, percent.
const WIDE_OPEN: f32 = 60.0;
/// Command above which an airway cannot stay empty, percent.
const FILLING: f32 = 30.0;
/// Part of the compliance before that is left when the tube is occluded.
const OCCLUDED: f32 = 1.0 / 3.0;
/// Rise that is needed to tell a compliance, cmH2O.
const TELLING_RISE: f32 = 3.0;

/// What breaths so far say.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Breathing {
    pressure: Mean,
    command: Mean,
    gone: u32,
    /// The running inspiration was cut short.
    cut: bool,
    /// Breaths in a row with each complaint.
    high: u32,
    low: u32,
    weak: u32,
    occluded: u32,
    /// Volume per pressure of the last good breath, mL/cmH2O.
    compliance: Option<f32>,
}

/// A mean over the end of a phase.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Mean {
    sum: f32,
    count: u32,
}

impl Mean {
    const EMPTY: Self = Self { sum: 0.0, count: 0 };

    fn add(&mut self, value: f32) {
        self.sum += value;
        self.count += 1;
    }

    /// The mean; starts anew.
    fn take(&mut self) -> f32 {
        let Self { sum, count } = core::mem::take(self);
        sum / count.max(1) as f32
    }
}

impl Breathing {
    /// No breath has been seen yet.
    pub const fn new() -> Self {
        Self {
            pressure: Mean::EMPTY,
            command: Mean::EMPTY,
            gone: 0,
            cut: false,
            high: 0,
            low: 0,
            weak: 0,
            occluded: 0,
            compliance: None,
        }
    }

    /// Takes in a tick: the believed pressure, cmH2O, the last command, percent, and the volume delivered so far, mL. A
    /// breath that is cut short tells of the tube at that moment, and of nothing else.
    #[inline]
    pub fn check(
        &mut self,
        (pressure, command, volume): (f32, f32, f32),
        (breath, tick, cut): (&Breath, u32, bool),
        monitors: Monitors,
        times: &Times,
    ) -> Option<Fault> {
        let peep = breath.settings().peep;
        let inspires = breath.phase(tick) == Phase::Inspiration;
        let end = if inspires { breath.inspiration_ticks() } else { breath.total_ticks() };
        let gone = inspires && !cut && command > FILLING && pressure < peep - BELOW_PEEP;
        self.gone = if gone { self.gone.saturating_add(1) } else { 0 };
        if monitors.has(Fault::Disconnection) && self.gone >= times.disconnected {
            return Some(Fault::Disconnection);
        }
        // Where the baseline stands high another part has failed.
        if inspires && cut && !self.cut && self.high == 0 && self.occluded(pressure - peep, volume, monitors)
        {
            return Some(Fault::Occlusion);
        }
        self.cut = cut;
        if tick + times.end_of_phase >= end {
            self.pressure.add(pressure);
            self.command.add(command);
        }
        if tick + 1 != end {
            return None;
        }
        let (pressure, command) = (self.pressure.take(), self.command.take());
        match (inspires, cut) {
            (true, true) => None,
            (true, false) => self.inspired(pressure, command, volume, breath, monitors),
            (false, cut) => self.expired(pressure - peep, cut, monitors),
        }
    }

    fn inspired(
        &mut self,
        pressure: f32,
        command: f32,
        volume: f32,
        breath: &Breath,
        monitors: Monitors,
    ) -> Option<Fault> {
        let settings = breath.settings();
        let rise = pressure - settings.peep;
        let weak = rise < REACHED * (settings.pip - settings.peep) && command > WIDE_OPEN;
        self.weak = if weak { self.weak.saturating_add(1) } else { 0 };
        let occluded = self.occluded(rise, volume, monitors);
        if monitors.has(Fault::LowPressure) && self.weak >= 2 {
            return Some(Fault::LowPressure);
        }
        occluded.then_some(Fault::Occlusion)
    }

    /// Compares volume and rise with those of the last good breath; whether the tube is occluded.
    fn occluded(&mut self, rise: f32, volume: f32, monitors: Monitors) -> bool {
        if rise <= TELLING_RISE {
            return false;
        }
        let compliance = volume / rise;
        if self.compliance.is_some_and(|before| compliance < OCCLUDED * before) {
            self.occluded = self.occluded.saturating_add(1);
        } else {
            (self.occluded, self.compliance) = (0, Some(compliance));
        }
        monitors.has(Fault::Occlusion) && self.occluded >= 2
    }

    fn expired(&mut self, above_peep: f32, cut: bool, monitors: Monitors) -> Option<Fault> {
        self.high = if above_peep > ABOVE_PEEP { self.high + 1 } else { 0 };
        // After a cough the lung holds less than at PEEP.
        self.low = if above_peep < -BELOW_PEEP && !cut { self.low + 1 } else { 0 };
        if monitors.has(Fault::BaselineHigh) && self.high >= 2 {
            return Some(Fault::BaselineHigh);
        }
        (monitors.has(Fault::BaselineLow) && self.low >= 3).then_some(Fault::BaselineLow)
    }
}

impl Default for Breathing {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{DEFAULT_PERIOD_US, paper_settings};

    /// A breath as the monitors see it: pressure and volume at the end of the inspiration, pressure at the end of the
    /// expiration, command throughout.
    #[derive(Clone, Copy)]
    struct Seen {
        plateau: f32,
        volume: f32,
        baseline: f32,
        command: f32,
    }

    const GOOD: Seen = Seen { plateau: 25.0, volume: 400.0, baseline: 5.1, command: 10.0 };

    /// The first complaint about breaths one after the other, and in which of them.
    fn complaint(breaths: &[Seen]) -> Option<(usize, Fault)> {
        let breath = Breath::new(&paper_settings(25.0), DEFAULT_PERIOD_US).unwrap();
        let (mut monitor, times) = (Breathing::new(), Times::new(DEFAULT_PERIOD_US));
        for (number, seen) in breaths.iter().enumerate() {
            for tick in 0..breath.total_ticks() {
                let inspires = breath.phase(tick) == Phase::Inspiration;
                let pressure = if inspires { seen.plateau } else { seen.baseline };
                let seen = (pressure, seen.command, seen.volume);
                if let Some(fault) = monitor.check(seen, (&breath, tick, false), Monitors::ALL, &times) {
                    return Some((number, fault));
                }
            }
        }
        None
    }

    #[test]
    fn good_breaths_give_no_complaint() {
        assert_eq!(complaint(&[GOOD; 10]), None);
        let soft = Seen { volume: 800.0, ..GOOD };
        let stiff = Seen { volume: 300.0, ..GOOD };
        assert_eq!(complaint(&[GOOD, soft, stiff, soft, GOOD]), None);
    }

    #[test]
    fn an_expiration_that_stays_high_is_found_in_its_second_breath() {
        let high = Seen { baseline: 8.5, ..GOOD };
        assert_eq!(complaint(&[GOOD, high, high, GOOD]), Some((2, Fault::BaselineHigh)));
        assert_eq!(complaint(&[high, GOOD, high, GOOD]), None, "never twice in a row");
    }

    #[test]
    fn a_lost_peep_is_found_in_its_third_breath() {
        let low = Seen { baseline: 2.5, ..GOOD };
        assert_eq!(complaint(&[GOOD, low, low, low]), Some((3, Fault::BaselineLow)));
        assert_eq!(complaint(&[low, low, GOOD, low, low]), None);
    }

    #[test]
    fn a_weak_inspiration_is_found_only_with_the_valve_wide_open() {
        let weak = Seen { plateau: 9.0, command: 100.0, ..GOOD };
        assert_eq!(complaint(&[GOOD, weak, weak]), Some((2, Fault::LowPressure)));
        assert_eq!(
            complaint(&[Seen { command: 20.0, ..weak }; 4]),
            None,
            "a controller that asks for little"
        );
    }

    #[test]
    fn a_pressure_that_is_gone_is_found_within_the_inspiration() {
        let gone = Seen { plateau: 1.0, command: 100.0, ..GOOD };
        assert_eq!(complaint(&[GOOD, gone]), Some((1, Fault::Disconnection)));
    }

    #[test]
    fn a_tube_that_takes_no_volume_is_found_in_its_second_breath() {
        let occluded = Seen { volume: 40.0, ..GOOD };
        assert_eq!(complaint(&[GOOD, GOOD, occluded, occluded]), Some((3, Fault::Occlusion)));
        assert_eq!(complaint(&[GOOD, occluded, GOOD, occluded]), None);
    }
}
