//! Checks that the airway pressure is within its limits.
//!
//! Above the limit an inspiration ends after 3 ms: inspiratory valve closed, expiratory valve open. That is enough for a
//! cough; the ladder handles breaths that repeatedly end so. Only proof that the valves do not obey latches the safe state: the
//! pressure stays up although they are commanded safe, and the flow sensor shows that no gas comes out. A patient who strains
//! holds the pressure up too, but his gas comes out. Without a sound flow sensor a pressure that does not fall for longer is the
//! proof. Waiting for it costs nothing: above the limit the valves are commanded safe anyway.

use super::alarms::Fault;
use super::monitors::{Monitors, in_a_row, reads_quickly, ticks};
use crate::breath::period_s;

/// Pressure above PEEP below which it counts as returned to PEEP, cmH2O.
pub const BACK_AT_PEEP: f32 = 3.0;
/// Ticks by which the pressure is extrapolated: at 1 kHz the valve's dead time, in which no command has an effect.
pub const AHEAD: f32 = 12.0;
/// Extrapolated pressure above the limit that ends an inspiration, cmH2O: more than noise and a normal rise cause. Fulfils: breath-cut.
pub const AHEAD_ABOVE: f32 = 5.0;
/// Weight of a new change in the mean slope.
pub const SLOPE_SHARE: f32 = 0.2;

/// Time above the limit that counts as a spike of noise, s.
pub const SPIKE: f32 = 0.003;
/// Time that the pressure may stay above the limit with the expiratory valve open, s: longer than a cough. By then gas has come out
/// if the valves obey. Fulfils: hard-limit.
pub const VENTING: f32 = 0.7;
/// That gas, mL: at pressures above the limit an open valve lets out a multiple, a closed or clogged one less.
pub const OUTFLOW: f32 = 20.0;
/// Share of that time in which the flow sensor must give numbers.
const SEEN: f32 = 0.5;
/// Time above the limit with the expiratory valve open after which the valves do not obey, whatever the flow sensor shows, s: no
/// patient strains for so long.
pub const STRAIN: f32 = 6.0;
/// Time that the pressure may stay above PEEP without falling in expirations, s. Fulfils: sustained-pressure.
pub const SUSTAINED: f32 = 15.0;
/// Time after the expiratory valve opens in which the pressure must fall, and for which it may not have fallen after that, s: a cough
/// is over by then.
pub const FALL: f32 = 0.5;
/// Fraction of the pressure above PEEP by which it must fall in that time: a PEEP valve that is stuck just below PIP, and a soft lung
/// behind a resistance, let it fall by little.
pub const FALLS: f32 = 0.1;
/// Time for which it may not have fallen without a sound flow sensor, s.
pub const FALL_UNSEEN: f32 = 1.5;

/// Compares the pressure with the limit and with PEEP.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PressureMonitor {
    /// Whether the control period is short enough to extrapolate the pressure.
    quick: bool,
    period: f32,
    /// [`SPIKE`] in ticks.
    above: u32,
    /// [`VENTING`], [`STRAIN`], [`SUSTAINED`], [`FALL`] and [`FALL_UNSEEN`] in ticks.
    venting: u32,
    strain: u32,
    sustained: u32,
    fall: u32,
    fall_unseen: u32,
}

/// Where the gas of the last breath went, by the flow sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Gas {
    /// The flow sensor does not show it.
    #[default]
    Unseen,
    /// Hardly any came out.
    Stays,
    /// It came out: the expiratory valve obeys.
    ComesOut,
}

/// State of the pressure monitor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PressureState {
    last: Option<f32>,
    /// Mean change per tick, cmH2O.
    slope: f32,
    above: u32,
    ahead_above: u32,
    /// Ticks with the expiratory valve open since the pressure crossed the limit; inspirations in between, which end at once, do not
    /// count.
    vented_above: u32,
    /// Gas that came out in the first of them, mL, and the number of those with a flow reading.
    outflow: f32,
    seen: u32,
    away: u32,
    /// Ticks for which the expiratory valve has been open, and the pressure when it opened.
    open: u32,
    opened_at: f32,
    /// Ticks for which the pressure has not fallen, in one expiration or several.
    stays: u32,
}

impl PressureState {
    /// The next reading does not continue the last one: another sensor is believed, or readings are missing between them. A step
    /// from one to the other is no slope.
    pub fn interrupted(&mut self) {
        self.last = None;
    }
}

/// Input of the monitor in one tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PressureInput {
    /// Believed pressure, cmH2O.
    pub pressure: f32,
    /// Pressure limit, cmH2O.
    pub limit: f32,
    /// PEEP, cmH2O.
    pub peep: f32,
    /// Whether the expiratory valve is open.
    pub venting: bool,
    /// Flow towards the patient, L/s; NaN without a sound flow sensor.
    pub flow: f32,
    /// What became of the last breath's gas.
    pub gas: Gas,
}

/// Result of a check.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PressureFinding {
    /// No action.
    Normal,
    /// End the inspiration.
    EndInspiration,
    /// Raise an alarm.
    Alarm(Fault),
}

impl PressureMonitor {
    /// A monitor for a control period in microseconds that reports the enabled findings only.
    pub fn new(period_us: u32, enabled: Monitors) -> Self {
        let limit = |fault, seconds| enabled.limit(fault, ticks(seconds, period_us));
        Self {
            quick: reads_quickly(period_us),
            period: period_s(period_us),
            above: limit(Fault::HighPressure, SPIKE),
            venting: limit(Fault::HardLimit, VENTING),
            strain: limit(Fault::HardLimit, STRAIN),
            sustained: limit(Fault::SustainedPressure, SUSTAINED),
            fall: ticks(FALL, period_us),
            fall_unseen: ticks(FALL_UNSEEN, period_us),
        }
    }

    /// Whether the pressure has stayed above PEEP for so long that gas that stays in the lung is a fault.
    pub fn is_sustained(&self, state: &PressureState) -> bool {
        state.away >= self.sustained
    }

    /// Checks one tick.
    #[inline]
    pub fn check(&self, state: &mut PressureState, input: &PressureInput) -> PressureFinding {
        let PressureInput { pressure, limit, peep, venting, .. } = *input;
        let last = state.last.replace(pressure).unwrap_or(pressure);
        state.slope += SLOPE_SHARE * (pressure - last - state.slope);
        state.above = in_a_row(state.above, pressure > limit);
        let ahead = pressure + AHEAD * state.slope;
        state.ahead_above = in_a_row(state.ahead_above, self.quick && ahead > limit + AHEAD_ABOVE);
        state.away = in_a_row(state.away, pressure > peep + BACK_AT_PEEP);
        state.open = in_a_row(state.open, venting);
        debug_assert!((state.open > 0) == venting);
        if state.open <= 1 {
            state.opened_at = pressure;
        }
        if state.above == 0 {
            (state.vented_above, state.outflow, state.seen) = (0, 0.0, 0);
        } else if let Some(fault) = self.stays_above(state, venting, input.flow) {
            return PressureFinding::Alarm(fault);
        }
        if self.stays_up(state, pressure, peep, input.gas) {
            return PressureFinding::Alarm(Fault::SustainedPressure);
        }
        let ends = state.above >= self.above || state.ahead_above >= self.above;
        if ends { PressureFinding::EndInspiration } else { PressureFinding::Normal }
    }

    /// Checks a tick above the limit. Once the expiratory valve has been open for longer than a cough, the pressure is an alarm; it is
    /// latched if no gas came out by then, or if it stays for longer than any patient strains.
    fn stays_above(&self, state: &mut PressureState, venting: bool, flow: f32) -> Option<Fault> {
        if !venting {
            return None;
        }
        state.vented_above = state.vented_above.saturating_add(1);
        debug_assert!(state.vented_above <= state.above, "the shorter of two rows");
        if state.vented_above <= self.venting && !flow.is_nan() {
            state.outflow -= 1000.0 * flow * self.period;
            state.seen += 1;
        }
        if state.vented_above < self.venting {
            return None;
        }
        let is_seen = state.seen as f32 >= SEEN * self.venting as f32;
        let disobey = (is_seen && state.outflow < OUTFLOW) || state.vented_above >= self.strain;
        Some(if disobey { Fault::HardLimit } else { Fault::HighPressure })
    }

    /// Whether the pressure has stayed above PEEP for long, does not fall in expirations, and the flow sensor does not show that the
    /// gas comes out.
    fn stays_up(&self, state: &mut PressureState, pressure: f32, peep: f32, gas: Gas) -> bool {
        let fallen = state.opened_at - pressure;
        if state.open >= self.fall {
            state.stays = in_a_row(state.stays, fallen < FALLS * (state.opened_at - peep));
        }
        let longest = if gas == Gas::Unseen { self.fall_unseen } else { self.fall };
        gas != Gas::ComesOut && self.is_sustained(state) && state.stays >= longest
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMIT: f32 = 40.0;

    /// A tick in which the flow sensor shows neither flow nor breaths.
    fn input(pressure: f32, venting: bool) -> PressureInput {
        PressureInput { pressure, limit: LIMIT, peep: 5.0, venting, flow: 0.0, gas: Gas::Stays }
    }

    /// A monitor and its state before the first reading.
    fn new() -> (PressureMonitor, PressureState) {
        (PressureMonitor::new(1000, Monitors::ALL), PressureState::default())
    }

    /// Results for a sequence of pressures.
    fn findings(
        pressures: impl IntoIterator<Item = f32>,
        venting: bool,
    ) -> impl Iterator<Item = PressureFinding> {
        let (monitor, mut state) = new();
        pressures.into_iter().map(move |pressure| monitor.check(&mut state, &input(pressure, venting)))
    }

    /// The first result other than normal, with the index of the pressure.
    fn first(pressures: impl IntoIterator<Item = f32>, venting: bool) -> Option<(usize, PressureFinding)> {
        findings(pressures, venting).enumerate().find(|(_, finding)| *finding != PressureFinding::Normal)
    }

    /// Verifies: breath-cut.
    #[test]
    fn three_milliseconds_above_the_limit_end_the_breath_and_a_spike_does_not() {
        let slow = |n: usize| 30.0 + 0.1 * n as f32;
        assert_eq!(first((0..400).map(slow), false), Some((103, PressureFinding::EndInspiration)));
        let spikes = (0..400).map(|n| if u32::is_multiple_of(n, 10) { 40.5 } else { 39.5 });
        assert_eq!(first((0..200).map(|n| 39.5_f32.min(slow(n))).chain(spikes), false), None);
    }

    /// Verifies: breath-cut.
    #[test]
    fn a_pressure_that_rises_fast_ends_the_breath_before_it_has_crossed_the_limit() {
        let (at, finding) = first((0..60).map(|n| 5.0 + 1.2 * n as f32), false).unwrap();
        assert_eq!(finding, PressureFinding::EndInspiration);
        assert!(5.0 + 1.2 * (at as f32) < 36.0, "tick {at}");
    }

    #[test]
    fn a_pressure_at_its_bounds_is_within_them() {
        let constant = |pressure| first([pressure; 800], true);
        assert_eq!((constant(LIMIT), constant(LIMIT + 0.1).map(|found| found.0)), (None, Some(2)));
        assert_eq!(first((0..20_000).map(|_| 5.0 + BACK_AT_PEEP), true), None, "back at PEEP");
    }

    #[test]
    fn the_slope_is_that_of_a_steady_rise_and_looks_ahead_by_the_dead_time() {
        let (monitor, mut state) = new();
        let tick = |pressure| input(pressure, false);
        for n in 0..100 {
            monitor.check(&mut state, &tick(0.125 * n as f32));
            assert!((0.0..0.126).contains(&state.slope));
        }
        assert!((state.slope - 0.125).abs() < 1e-3);
        // The third tick in a row: to exactly so far above the limit a pressure may be on its way.
        let third = |slope: f32| {
            let last = LIMIT + AHEAD_ABOVE - AHEAD * slope - slope;
            let mut state =
                PressureState { last: Some(last), slope, ahead_above: 2, ..PressureState::default() };
            monitor.check(&mut state, &tick(last + slope))
        };
        assert_eq!((third(1.0), third(1.25)), (PressureFinding::Normal, PressureFinding::Normal));
        let mut state =
            PressureState { last: Some(32.1), slope: 1.0, ahead_above: 2, ..PressureState::default() };
        assert_eq!(monitor.check(&mut state, &tick(33.1)), PressureFinding::EndInspiration);
    }

    #[test]
    fn a_step_from_one_sensor_to_another_is_no_slope() {
        let (monitor, mut state) = (PressureMonitor::new(1000, Monitors::ALL), PressureState::default());
        let mut ends = |pressure, interrupted| {
            if interrupted {
                state.interrupted();
            }
            monitor.check(&mut state, &input(pressure, false)) == PressureFinding::EndInspiration
        };
        assert!(!(0..100).any(|_| ends(10.0, false)));
        assert!(!ends(26.0, true) && !(0..100).any(|_| ends(26.0, false)));
        assert!(!ends(10.0, true) && !(0..100).any(|_| ends(10.0, false)));
        assert!(!ends(26.0, false) && !ends(26.0, false) && ends(26.0, false), "one sensor alone has risen");
    }

    #[test]
    fn readings_that_come_slowly_say_nothing_of_where_the_pressure_goes() {
        let (monitor, mut state) = (PressureMonitor::new(50_000, Monitors::ALL), PressureState::default());
        for pressure in [5.0, 20.0, 35.0, 39.0] {
            assert_eq!(monitor.check(&mut state, &input(pressure, false)), PressureFinding::Normal);
        }
    }

    /// When breaths of 1 s at 25 cmH2O, with expirations of so many milliseconds at a baseline, are latched.
    fn stuck_above_peep(baseline: f32, expiration: u32, gas: Gas) -> Option<u32> {
        let (monitor, mut state) = new();
        (0..40_000).find(|n| {
            let since = n % (1000 + expiration);
            // The valve opens before the pressure falls.
            let pressure = if since > 1000 { baseline } else { 25.0 };
            let input = PressureInput { gas, ..input(pressure, since >= 1000) };
            matches!(monitor.check(&mut state, &input), PressureFinding::Alarm(_))
        })
    }

    #[test]
    fn gas_that_comes_out_forbids_latching_whatever_the_pressure_does() {
        assert_eq!(stuck_above_peep(25.0, 2000, Gas::Stays), Some(14_999));
        assert_eq!(stuck_above_peep(25.0, 2000, Gas::ComesOut), None);
    }

    #[test]
    fn without_a_flow_sensor_the_pressure_must_not_fall_for_longer() {
        // Half a second of each expiration does not count; the rest of it adds up.
        let found = |gas| stuck_above_peep(25.0, 600, gas).unwrap();
        assert_eq!(found(Gas::Stays), 14_999);
        assert!((23_900..24_000).contains(&found(Gas::Unseen)), "15 expirations: {}", found(Gas::Unseen));
        assert_eq!(stuck_above_peep(25.0, 400, Gas::Unseen), None);
    }

    /// The alarms of a pressure above the limit, with the ticks at which they begin, by the flow and whether the valve is open.
    fn above(ticks: u32, flow: impl Fn(u32) -> f32, venting: impl Fn(u32) -> bool) -> [Option<u32>; 2] {
        let (monitor, mut state) = new();
        let mut at = [None; 2];
        for n in 0..ticks {
            let input = PressureInput { flow: flow(n), gas: Gas::ComesOut, ..input(50.0, venting(n)) };
            match monitor.check(&mut state, &input) {
                PressureFinding::Alarm(Fault::HighPressure) => at[0] = at[0].or(Some(n)),
                PressureFinding::Alarm(Fault::HardLimit) => at[1] = at[1].or(Some(n)),
                _ => {}
            }
        }
        at
    }

    #[test]
    fn a_patient_who_strains_is_an_alarm_and_is_not_latched() {
        // 1 L/s through the open valve, or the little that proves that it is open.
        assert_eq!(above(5900, |_| -1.0, |_| true), [Some(699), None]);
        assert_eq!(above(5900, |_| -0.0287, |_| true), [Some(699), None]);
        assert_eq!(above(5900, |_| -0.0285, |_| true), [None, Some(699)], "less than 20 mL");
        assert_eq!(above(5900, |n| if n < 100 { -1.0 } else { 0.2 }, |_| true), [None, Some(699)]);
        assert_eq!(
            above(7000, |_| -1.0, |_| true),
            [Some(699), Some(5999)],
            "no patient strains for so long"
        );
    }

    #[test]
    fn without_flow_readings_only_the_time_proves_that_the_valves_do_not_obey() {
        assert_eq!(above(7000, |_| f32::NAN, |_| true), [Some(699), Some(5999)]);
        let gaps = |nth: u32| move |n: u32| if n.is_multiple_of(nth) { 0.0 } else { f32::NAN };
        assert_eq!(above(7000, gaps(2), |_| true), [None, Some(699)], "half of them are enough");
        assert_eq!(above(7000, gaps(3), |_| true), [Some(699), Some(5999)]);
    }

    #[test]
    fn inspirations_that_end_at_once_neither_count_nor_start_the_time_again() {
        let venting = |n: u32| n % 500 >= 3;
        assert_eq!(above(7000, |_| -1.0, venting), [Some(699 + 2 * 3), Some(5999 + 13 * 3)]);
        assert_eq!(above(7000, |_| -1.0, |_| false), [None, None], "the expiratory valve has yet to open");
    }

    /// Verifies: hard-limit.
    #[test]
    fn above_the_limit_with_an_open_valve_for_longer_than_a_cough_a_valve_does_not_obey() {
        let stays = (0..1200).map(|n| if n < 400 { 30.0 + 0.05 * n as f32 } else { 45.0 });
        let found = findings(stays, true).position(|finding| matches!(finding, PressureFinding::Alarm(_)));
        assert!((890..910).contains(&found.unwrap()), "{found:?}");
        let cough = (0..3000).map(|n| if n % 1000 < 690 { 60.0 } else { 5.0 });
        assert!(!findings(cough, true).any(|finding| matches!(finding, PressureFinding::Alarm(_))));
        let closed = findings([45.0; 1400], false).last();
        assert_eq!(closed, Some(PressureFinding::EndInspiration), "the expiratory valve has yet to open");
    }

    /// Verifies: sustained-pressure.
    #[test]
    fn a_pressure_that_never_comes_down_is_found_after_a_quarter_of_a_minute() {
        let mut slow = 5.0;
        let breathing = (0..60_000).map(|n| {
            slow += 0.01 * (if n % 3000 < 1000 { 25.0 } else { 5.2 } - slow);
            slow
        });
        assert_eq!(first(breathing, false), None);
        let stuck = first((0..16_000).map(|_| 12.0), true);
        assert_eq!(stuck, Some((14_999, PressureFinding::Alarm(Fault::SustainedPressure))));
    }

    #[test]
    fn a_cough_in_an_expiration_is_no_stuck_valve_and_short_expirations_add_up() {
        let found = |stuck: u32, then_falls: bool| {
            let (monitor, mut state) = new();
            let mut tick = |pressure: f32, venting: bool| {
                matches!(monitor.check(&mut state, &input(pressure, venting)), PressureFinding::Alarm(_))
            };
            (0..15_000).for_each(|_| assert!(!tick(25.0, false)));
            // Three expirations, each in two parts: half a second without a fall, and the time that counts.
            (0..3).any(|_| {
                let stays = (0..499 + stuck).any(|_| tick(24.0, true));
                let falls = then_falls && (0..10).any(|_| tick(20.0, true));
                stays || falls || (0..100).any(|_| tick(25.0, false))
            })
        };
        assert!(found(167, false) && !found(166, false), "500 ms in all");
        assert!(!found(499, true) && found(500, true), "a pressure that falls has not been stuck");
    }

    #[test]
    fn a_pressure_that_falls_in_each_expiration_is_not_stuck_however_high_its_baseline() {
        let found = |baseline: f32, gas: Gas| stuck_above_peep(baseline, 2000, gas).is_some();
        assert!(!found(15.0, Gas::Stays) && !found(23.0, Gas::Stays), "a PEEP valve that is stuck");
        assert!(found(23.1, Gas::Stays), "gas that does not get out");
    }
}
