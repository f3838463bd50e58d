//! How lung and breaths settle after a change of the settings, and how long monitors wait for it.
//!
//! A monitor waits only for a change that concerns what it compares: an alarm limit or a tenth of a breath a minute concerns
//! nothing. And it does not wait again before the settings have rested, so that settings which change in every breath switch no
//! monitor off. Where the effect of new settings can be calculated, no monitor waits.

use crate::settings::Settings;

/// Breaths after a change of the settings whose baseline raises no alarm.
pub const UNCHECKED_BREATHS: u32 = 2;
/// Breaths without a change after which the next one is waited for.
pub const RESTED_BREATHS: u32 = 6;
/// Change of PEEP that breaths have to settle to, cmH2O: much less than the bounds of a baseline.
pub const NEW_PEEP: f32 = 0.5;
/// Change of the driving pressure, the rate or the inspiratory time that breaths have to settle to, as a share of the larger value.
pub const NEW_BREATH: f32 = 0.1;

/// Whether breaths have to settle to a change of the settings.
pub fn moves_breaths(before: &Settings, now: &Settings) -> bool {
    let of = |settings: &Settings| {
        let filling = filling_time(settings.inspiratory_time, settings.rise_time);
        [settings.pip - settings.peep, settings.rate, filling]
    };
    let moves = |(before, now): (f32, f32)| (now - before).abs() > NEW_BREATH * before.max(now);
    moves_peep(before, now) || of(before).into_iter().zip(of(now)).any(moves)
}

/// Whether the baseline has to settle to another PEEP.
pub fn moves_peep(before: &Settings, now: &Settings) -> bool {
    (now.peep - before.peep).abs() > NEW_PEEP
}

/// Compliance of a lung that may take several breaths to fill, mL/cmH2O. A leak that matters loses more in each breath.
const SLOW_LUNG: f32 = 50.0;

/// Time at PIP that fills a lung as an inspiration with this rise does, s: half of the rise is lost.
pub fn filling_time(inspiratory_time: f32, rise_time: f32) -> f32 {
    inspiratory_time - 0.5 * rise_time.min(inspiratory_time)
}

/// Time that governs the volume of the slowest lung, s: that lung fills in proportion to `filling`, and keeps what `emptying`
/// does not let out. The volume of a faster lung depends less on either.
pub fn exchange_time(filling: f32, emptying: f32) -> f32 {
    filling * emptying / (filling + emptying)
}

/// Gas that the lung takes in, and does not give out again, until breath follows breath evenly at new settings.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Filling {
    /// mL.
    gas: f32,
    /// Breaths in which the lung takes it.
    breaths: u8,
}

impl Filling {
    /// The settings have changed. A fast lung then keeps the gas of a higher PEEP, a slow one that of a higher mean pressure.
    pub fn begin(&mut self, before: Pressures, now: Pressures) {
        let rise = (now.peep - before.peep).max(now.mean - before.mean);
        self.gas = (self.gas + SLOW_LUNG * rise).max(0.0);
        self.breaths = RESTED_BREATHS as u8;
    }

    /// Whether it explains the gas that a breath has lost, mL, and then takes it off. A smaller lung never takes the rest.
    pub fn explains(&mut self, lost: f32) -> bool {
        let explains = self.gas > 0.0 && lost <= self.gas;
        self.breaths = self.breaths.saturating_sub(1);
        let rest = (self.gas - lost.max(0.0)).max(0.0);
        self.gas = if self.breaths > 0 { rest } else { 0.0 };
        explains
    }
}

/// Pressures of breaths that follow each other evenly, cmH2O.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pressures {
    peep: f32,
    /// Mean over a breath.
    mean: f32,
}

impl Pressures {
    /// Those that the settings ask for.
    pub fn of(settings: &Settings) -> Self {
        let Settings { pip, peep, rate, inspiratory_time, rise_time, .. } = *settings;
        let filled = filling_time(inspiratory_time, rise_time) * rate / 60.0;
        Self { peep, mean: peep + (pip - peep) * filled }
    }

    /// The higher one of their PEEP and this one, cmH2O: a lung may still empty to it.
    pub fn highest_peep(&self, peep: f32) -> f32 {
        self.peep.max(peep)
    }
}

/// A monitor's wait after changes that concern it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Settling {
    /// Breaths that are still not judged.
    left: u8,
    /// Breaths until the settings have rested.
    restless: u8,
}

impl Settling {
    /// The settings have changed: waits for some breaths, unless they have not rested since the last change. Whether it waits.
    pub fn begin(&mut self, breaths: u32) -> bool {
        let waits = self.restless == 0;
        if waits {
            self.left = breaths as u8;
        }
        self.restless = RESTED_BREATHS as u8;
        waits
    }

    /// Counts a breath; whether it is judged.
    pub fn judges(&mut self) -> bool {
        let judged = self.left == 0;
        self.left = self.left.saturating_sub(1);
        self.restless = self.restless.saturating_sub(1);
        judged
    }

    /// Whether the settings have changed for the running breath, which has not been counted yet.
    pub fn is_new(&self) -> bool {
        self.restless == RESTED_BREATHS as u8
    }

    /// Whether the settings have rested.
    pub fn has_rested(&self) -> bool {
        self.restless == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::paper_settings;
    use std::vec::Vec;

    /// Whether breaths and baseline have to settle to a change, which is the same in both directions.
    fn moves(change: impl Fn(&mut Settings)) -> (bool, bool) {
        let before = Settings { rise_time: 0.2, ..paper_settings(25.0) };
        let mut now = before;
        change(&mut now);
        let moves = |before, now| (moves_breaths(before, now), moves_peep(before, now));
        assert_eq!(moves(&before, &now), moves(&now, &before));
        moves(&before, &now)
    }

    #[test]
    fn breaths_do_not_settle_to_a_limit_or_a_small_change() {
        assert_eq!(moves(|_| {}), (false, false));
        assert_eq!(moves(|now| now.rate = 20.1), (false, false));
        assert_eq!(moves(|now| (now.pip, now.peep) = (25.4, 5.4)), (false, false));
        assert_eq!(
            moves(|now| (now.tidal_volume_low, now.minute_volume_high) = (300.0, 9.0)),
            (false, false)
        );
        assert_eq!(moves(|now| (now.pressure_limit, now.trigger_flow) = (40.0, 0.0)), (false, false));
        assert_eq!(moves(|now| (now.fall_time, now.expiratory_bias) = (0.2, 0.0)), (false, false));
    }

    #[test]
    fn breaths_settle_to_another_pressure_and_another_time() {
        assert_eq!(moves(|now| (now.peep, now.pip) = (5.6, 25.6)), (true, true));
        assert_eq!(moves(|now| now.pip = 28.0), (true, false));
        assert_eq!(moves(|now| now.rate = 23.0), (true, false));
        assert_eq!(moves(|now| now.inspiratory_time = 0.8), (true, false));
        assert_eq!(moves(|now| now.rise_time = 0.5), (true, false));
    }

    /// Gas that a lung takes after a change from PIP 25, PEEP 5, 1 s of 3 s, mL.
    fn filling(now: Settings) -> Filling {
        let mut filling = Filling::default();
        filling.begin(Pressures::of(&paper_settings(25.0)), Pressures::of(&now));
        filling
    }

    #[test]
    fn a_lung_keeps_the_gas_of_a_higher_peep_or_of_a_higher_mean_pressure() {
        let before = paper_settings(25.0);
        let near =
            |now: Settings, gas: f32| assert!((filling(now).gas - gas).abs() < 0.1, "{:?}", filling(now));
        near(Settings { peep: 15.0, pip: 30.0, ..before }, 500.0);
        near(Settings { pip: 40.0, ..before }, 250.0);
        near(Settings { rate: 30.0, ..before }, 20.0 / 6.0 * 50.0);
        near(Settings { rise_time: 1.0, ..before }, 0.0);
        near(Settings { tidal_volume_low: 300.0, ..before }, 0.0);
        near(Settings { peep: 0.0, pip: 20.0, ..before }, 0.0);
    }

    #[test]
    fn gas_is_explained_once_and_a_leak_takes_more() {
        let mut lung = filling(Settings { peep: 15.0, pip: 30.0, ..paper_settings(25.0) });
        assert!(lung.explains(300.0) && lung.explains(-50.0) && lung.explains(200.0) && !lung.explains(1.0));
        let mut leaks = filling(Settings { peep: 15.0, pip: 30.0, ..paper_settings(25.0) });
        assert!(!leaks.explains(501.0) && !leaks.explains(10.0));
        assert!(!Filling::default().explains(0.0), "nothing has changed");
        let mut small = filling(Settings { peep: 15.0, pip: 30.0, ..paper_settings(25.0) });
        assert!(
            [(); 6].iter().all(|()| small.explains(10.0)) && !small.explains(10.0),
            "a small lung is full"
        );
    }

    /// Whether each of 40 breaths is judged, if the settings change before every breath of a period.
    fn judged(period: usize) -> Vec<bool> {
        let mut settling = Settling::default();
        let breath = |number: usize| {
            if number.is_multiple_of(period) {
                settling.begin(UNCHECKED_BREATHS);
            }
            settling.judges()
        };
        (0..40).map(breath).collect()
    }

    #[test]
    fn two_breaths_after_a_change_are_not_judged() {
        assert_eq!(judged(40)[..5], [false, false, true, true, true]);
    }

    #[test]
    fn settings_that_never_rest_are_waited_for_once() {
        for period in 1..RESTED_BREATHS as usize {
            assert!(judged(period)[UNCHECKED_BREATHS as usize..].iter().all(|judged| *judged), "{period}");
        }
        for period in 1..40 {
            let waits = judged(period)
                .windows(6)
                .filter(|breaths| breaths.iter().filter(|judged| **judged).count() < 4)
                .count();
            assert_eq!(waits, 0, "of any six breaths four are judged, at a change every {period}");
        }
    }

    #[test]
    fn the_slowest_lung_takes_what_both_times_allow() {
        // A lung of 20 s at 1 s in and 2 s out, against half as long an inspiration.
        let takes = |filling: f32, emptying: f32| {
            let [full, kept] = [filling, emptying].map(|time| 1.0 - (-time / 20.0).exp());
            full * kept / (1.0 - (1.0 - full) * (1.0 - kept))
        };
        let ratio = takes(0.5, 2.5) / takes(1.0, 2.0);
        assert!((ratio - exchange_time(0.5, 2.5) / exchange_time(1.0, 2.0)).abs() < 0.01, "{ratio}");
        assert!((filling_time(1.0, 0.4) - 0.8).abs() < 1e-6 && (filling_time(0.5, 1.0) - 0.25).abs() < 1e-6);
    }
}
