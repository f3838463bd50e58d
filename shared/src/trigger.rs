//! Detects that the patient starts to inhale, so that the next breath follows the effort and not the clock. Verifies: no-false-triggers.
//!
//! An effort draws gas. In a lung at rest this lowers the airway pressure; in one that is still emptying it first slows the
//! flow, while the open expiratory valve holds the pressure. Either signal can start the breath. In an expiration both have
//! trends of their own, and sensors have offsets. So the mean over the latest 10 ms is compared with a line through the
//! means before it. A passive lung empties ever more slowly, and leaves that line on the other side.
//!
//! Readings that are missing for a moment are replaced by the last one: a line takes longer to draw than most gaps take to
//! return. A step of a coarse sensor is no effort. A leak can look like one; who measures the gas decides that.

use crate::breath::{Moment, Phase};
use crate::math;
use crate::safety::monitors::ticks;
use crate::safety::reading_monitor::MISSING;

/// Time over which a signal is averaged, s.
pub const BLOCK: f32 = 0.01;
/// Blocks between the line and the latest one: an effort must not bend the line at once.
pub const GAP: usize = 5;
/// Smallest and largest number of blocks through which the line is drawn. Fulfils: effort-triggers.
pub const LINE: (usize, usize) = (12, 24);
/// Blocks after the inspiration that belong to no line: the expiratory valve opens.
pub const OPENING: usize = 19;
/// Blocks that are kept.
const KEPT: usize = 32;
/// Multiple of the mean noise of a value below which a deviation of a block of one value can be noise: five standard deviations
/// of the difference between block and line. Longer blocks are quieter by the root of their length. Fulfils: no-false-triggers.
const NOISES: f32 = 7.9;
/// Time constant of the mean noise, s.
const NOISE_TIME: f32 = 0.2;
/// Part of the sensitivity within which a signal follows its line; only a signal that did can leave it. Muscles that relax while
/// the lung empties bend the first lines.
const ON_LINE: f32 = 0.5;
/// Part of the sensitivity by which the signal itself must have risen within [`GAP`]: the end of an earlier effort or cough bends
/// the line, and leaves the signal where it is.
const RISE: f32 = 0.5;
/// Multiple of a sensor's step that is no effort: a slow change shows as steps, and the line through them is off by one more.
const STEPS: f32 = 2.0;
/// Time for which the last value stands for missing ones, s: as long as a pressure sensor counts as sound without readings, so that
/// no line goes on with another sensor. Fulfils: gaps-in-readings.
const HELD: f32 = MISSING;
/// Bias of the inspiratory valve whose flow is less than an effort, percent.
const LITTLE_BIAS: f32 = 6.0;
/// Height above PEEP of a pressure that this flow raises as well, because the outlet resists, cmH2O.
const RESISTED: f32 = 2.0;
/// Litres per second in a litre per minute.
const PER_MINUTE: f32 = 1.0 / 60.0;

const _: () = assert!(LINE.1 + GAP < KEPT);

/// Configuration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Trigger {
    /// [`BLOCK`] in ticks, and [`NOISES`] for such a block.
    block: u32,
    noises: f32,
    noise: f32,
    /// [`HELD`] in ticks.
    held: u32,
}

/// The signal in which an effort shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sign {
    /// The pressure has fallen.
    Pressure,
    /// The flow towards the patient has risen.
    Flow,
}

/// State in an expiration.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TriggerState {
    pressure: Signal,
    flow: Signal,
    /// Whether the fall from PIP has ended.
    expires: bool,
}

/// A signal that rises with an effort.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Signal {
    /// Sum and number of values in the running block.
    sum: f32,
    count: u32,
    /// Means of the last blocks, a ring, and the number of blocks so far.
    means: [f32; KEPT],
    blocks: usize,
    /// Mean distance of the values from the last block.
    noise: f32,
    on_line: bool,
    /// Last value, the ticks since, and the smallest change from value to value: the sensor's step.
    last: f32,
    missing: u32,
    step: f32,
}

impl Signal {
    /// Forgets all values. The means stay in memory, out of use.
    fn restart(&mut self) {
        (self.sum, self.count, self.blocks, self.noise, self.on_line) = (0.0, 0, 0, 0.0, false);
        (self.last, self.missing, self.step) = (f32::NAN, 0, f32::INFINITY);
    }

    /// Draws a new line after a change of its own.
    fn redraw(&mut self) {
        let Self { blocks, last, missing, step, .. } = *self;
        self.restart();
        (self.blocks, self.last, self.missing, self.step) = (blocks.min(OPENING), last, missing, step);
    }

    /// The value that counts in a tick: in place of a missing one the last one, for some ticks.
    fn hold(&mut self, value: f32, held: u32) -> f32 {
        if value.is_nan() {
            self.missing += 1;
            return if self.missing <= held { self.last } else { f32::NAN };
        }
        let change = (value - self.last).abs();
        // A first value has none before it.
        if change > 0.0 && change < self.step {
            self.step = change;
        }
        (self.last, self.missing) = (value, 0);
        value
    }

    /// Mean of the block that ended `ago` blocks before the last one.
    fn mean(&self, ago: usize) -> f32 {
        self.means[(self.blocks + KEPT - 1 - ago) % KEPT]
    }

    /// Distance of the last block from the line through the blocks before it; none while these are too few.
    fn deviation(&self) -> Option<f32> {
        let count = self.blocks.checked_sub(OPENING + GAP + 1).filter(|count| *count >= LINE.0)?.min(LINE.1);
        let middle = 0.5 * (count - 1) as f32;
        let (mut level, mut slope) = (0.0, 0.0);
        for place in 0..count {
            let mean = self.mean(GAP + count - place);
            level += mean;
            slope += (place as f32 - middle) * mean;
        }
        let n = count as f32;
        let (level, slope) = (level / n, slope * 12.0 / (n * (n * n - 1.0)));
        Some(self.mean(0) - level - slope * (middle + 1.0 + GAP as f32))
    }
}

impl Trigger {
    /// For a control period in microseconds.
    pub fn new(period_us: u32) -> Self {
        let noise = math::lag_factor(NOISE_TIME, crate::breath::period_s(period_us));
        let block = ticks(BLOCK, period_us);
        Self {
            block,
            noises: NOISES / math::square_root(block as f32),
            noise,
            held: ticks(HELD, period_us) - 1,
        }
    }

    /// The sign that the patient starts to inhale in this tick of a breath, after the inspiration. `pressure` is a reliable
    /// reading, cmH2O, and `flow` that of the flow sensor towards the patient, L/s; NaN where there is none.
    #[inline]
    pub fn check(&self, state: &mut TriggerState, moment: &Moment, pressure: f32, flow: f32) -> Option<Sign> {
        if moment.inspires() {
            if moment.tick == 0 {
                state.pressure.restart();
                state.flow.restart();
            }
            state.expires = false;
            return None;
        }
        let settings = moment.settings();
        let expires = moment.phase == Phase::Expiration;
        // The inspiratory valve opens to its bias.
        if expires && !state.expires && settings.expiratory_bias > LITTLE_BIAS {
            state.flow.redraw();
            if pressure > settings.peep + RESISTED {
                state.pressure.redraw();
            }
        }
        state.expires = expires;
        let by_pressure = self.follow(&mut state.pressure, -pressure, settings.trigger_pressure);
        let by_flow = self.follow(&mut state.flow, flow, settings.trigger_flow * PER_MINUTE);
        // A fall of the pressure is the sign that a leak explains too.
        by_pressure.then_some(Sign::Pressure).or(by_flow.then_some(Sign::Flow))
    }

    /// Whether a signal leaves its line upwards by more than the sensitivity; a sensitivity of zero is off.
    fn follow(self, signal: &mut Signal, value: f32, sensitivity: f32) -> bool {
        let value = signal.hold(value, self.held);
        if value.is_nan() || sensitivity <= 0.0 {
            signal.restart();
            return false;
        }
        if signal.blocks > 0 {
            signal.noise += self.noise * ((value - signal.mean(0)).abs() - signal.noise);
        }
        signal.sum += value;
        signal.count += 1;
        debug_assert!(signal.count <= self.block, "a block ends after its length");
        if signal.count < self.block {
            return false;
        }
        signal.means[signal.blocks % KEPT] = signal.sum / signal.count as f32;
        (signal.blocks, signal.sum, signal.count) = (signal.blocks + 1, 0.0, 0);
        let Some(deviation) = signal.deviation() else { return false };
        let bound = sensitivity.max(self.noises * signal.noise).max(STEPS * signal.step);
        signal.on_line |= deviation < ON_LINE * bound;
        let rise = signal.mean(0) - signal.mean(GAP);
        debug_assert!(signal.blocks > OPENING + GAP + LINE.0, "no line without its blocks");
        signal.on_line && deviation > bound && rise > RISE * bound
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{Breath, DEFAULT_PERIOD_US, paper_settings};
    use crate::settings::Settings;
    use proptest::prelude::*;

    const PEEP: f32 = 5.0;
    /// End of the inspiration of the paper's breath, and the end of the first block that is compared with a line: 19 for the
    /// valve that opens, 12 for the line, 5 for the gap, and itself.
    const EXPIRES: u32 = 1000;
    const EARLIEST: u32 = EXPIRES + 370;

    fn breath(trigger_pressure: f32, trigger_flow: f32) -> Breath {
        let settings = Settings { trigger_pressure, trigger_flow, ..paper_settings(25.0) };
        Breath::new(&settings, DEFAULT_PERIOD_US).unwrap()
    }

    /// The first tick of the paper's breath at which an effort is found, by pressure and flow at each tick.
    fn found(breath: &Breath, signals: impl Fn(u32) -> (f32, f32)) -> Option<u32> {
        found_coarse(breath, |tick| {
            let (pressure, flow) = signals(tick);
            // The least step of a fine sensor.
            let dither = if tick.is_multiple_of(2) { 0.0 } else { 1.0 / 1024.0 };
            (pressure + dither, flow + dither)
        })
    }

    /// The same for sensors without steps between these signals.
    fn found_coarse(breath: &Breath, signals: impl Fn(u32) -> (f32, f32)) -> Option<u32> {
        let (trigger, mut state) = (Trigger::new(DEFAULT_PERIOD_US), TriggerState::default());
        (0..breath.total_ticks()).find(|tick| {
            let (pressure, flow) = signals(*tick);
            trigger.check(&mut state, &breath.at(*tick), pressure, flow).is_some()
        })
    }

    /// A value in steps of a coarse sensor.
    fn in_steps(value: f32, step: f32) -> f32 {
        (value / step + 0.5).floor() * step
    }

    /// The fall of the pressure by an effort of 3 cmH2O that begins at a tick and lasts 1 s.
    fn effort(tick: u32, begins: u32) -> f32 {
        let since = tick.wrapping_sub(begins);
        if since < 1000 { 3.0 * (core::f32::consts::PI * since as f32 * 1e-3).sin() } else { 0.0 }
    }

    /// Noise of a standard deviation, the same in each run.
    fn noise(tick: u32, sd: f32) -> f32 {
        let bits = tick.wrapping_add(1).wrapping_mul(2_654_435_761);
        let uniform =
            |shift: u32| (bits.rotate_left(shift).wrapping_mul(0x9e37_79b9) >> 8) as f32 / 16_777_216.0 - 0.5;
        sd * (uniform(3) + uniform(9) + uniform(17) + uniform(26)) * 1.73
    }

    #[test]
    fn an_effort_at_rest_is_found_by_its_pressure_within_100_ms() {
        for begins in [EARLIEST, 1500, 2000, 2345, 2800] {
            let at =
                found(&breath(0.4, 0.0), |tick| (PEEP - effort(tick, begins) + noise(tick, 0.1), f32::NAN));
            let delay = at.expect("found") - begins;
            assert!((20..=100).contains(&delay), "{delay} ms");
        }
    }

    #[test]
    fn an_effort_in_a_lung_that_still_empties_is_found_by_its_flow() {
        for (resistance, time_constant) in [(5.0, 250.0), (20.0, 400.0), (20.0, 1000.0), (50.0, 2500.0)] {
            let flow = |tick: u32| {
                let emptying = -0.5 * (-(tick.saturating_sub(EXPIRES) as f32) / time_constant).exp();
                emptying + effort(tick, 2000) / resistance + noise(tick, 0.003)
            };
            let at = found(&breath(0.0, 0.6), |tick| (PEEP, flow(tick))).expect("found");
            assert!((2010..=2100).contains(&at), "R {resistance}, {time_constant} ms: {at}");
        }
    }

    #[test]
    fn nothing_is_found_before_the_valve_has_opened_and_a_line_is_drawn() {
        for begins in EXPIRES..EARLIEST {
            let at = found(&breath(0.4, 0.0), |tick| (PEEP - effort(tick, begins), f32::NAN));
            assert!(at.is_none_or(|at| at >= EARLIEST + 9), "{at:?}");
        }
    }

    #[test]
    fn a_trend_is_no_effort_and_neither_is_a_lung_that_empties() {
        let drift = |tick: u32| (9.0 - 0.002 * (tick.saturating_sub(EXPIRES)) as f32, f32::NAN);
        assert_eq!(found(&breath(0.4, 0.6), drift), None);
        for time_constant in [60.0, 100.0, 250.0, 400.0, 1000.0, 2500.0] {
            let share = |tick: u32| (-(tick.saturating_sub(EXPIRES) as f32) / time_constant).exp();
            let signals = |tick| (PEEP + 15.0 * share(tick), -1.5 * share(tick));
            assert_eq!(found(&breath(0.2, 0.5), signals), None, "{time_constant} ms");
        }
    }

    #[test]
    fn a_change_counts_from_the_sensitivity_on() {
        let step = |by: f32| move |tick: u32| (if tick < 2000 { PEEP } else { PEEP - by }, f32::NAN);
        assert_eq!(found(&breath(1.0, 0.0), step(0.99)), None);
        assert_eq!(found(&breath(1.0, 0.0), step(1.01)), Some(2009), "at the end of the block");
        let flow = |by: f32| move |tick: u32| (PEEP, if tick < 2000 { 0.0 } else { by / 60.0 });
        assert_eq!(found(&breath(0.0, 2.0), flow(1.99)), None);
        assert_eq!(found(&breath(0.0, 2.0), flow(2.01)), Some(2009));
        assert_eq!(found(&breath(1.0, 0.0), step(-3.0)), None, "a cough");
    }

    #[test]
    fn a_change_by_the_sensitivity_itself_is_no_effort() {
        let step = |tick: u32| (if tick < 2000 { 0.0 } else { -1.0 }, f32::NAN);
        assert_eq!(found(&breath(1.0, 0.0), step), None);
    }

    #[test]
    fn the_blocks_in_which_the_valve_opens_belong_to_no_line_and_the_next_one_does() {
        // By the number of the block that differs from all others.
        let deviation = |blocks: usize, odd: usize| {
            let mut signal = Signal { blocks, ..Signal::default() };
            signal.means[odd % KEPT] = 100.0;
            signal.deviation()
        };
        let (line, gap, last) = (OPENING, OPENING + LINE.0, OPENING + LINE.0 + GAP);
        assert_eq!((line, last), (19, 36));
        assert_eq!(deviation(last, last), None, "too few for a line");
        let unseen = (last + 1 - KEPT..line).chain(gap..last);
        unseen.for_each(|odd| assert_eq!(deviation(last + 1, odd), Some(0.0), "block {odd}"));
        (line..gap).for_each(|odd| assert!(deviation(last + 1, odd).unwrap().abs() > 1.0, "block {odd}"));
        assert_eq!(deviation(last + 1, last), Some(100.0));
    }

    #[test]
    fn a_line_of_any_slope_is_followed_exactly() {
        for blocks in [LINE.0 + OPENING + GAP + 1, LINE.1 + OPENING + GAP + 1, 100] {
            let mut signal = Signal { blocks, ..Signal::default() };
            (blocks - KEPT..blocks).for_each(|block| signal.means[block % KEPT] = 0.5 * block as f32);
            assert!(signal.deviation().unwrap().abs() < 1e-3, "{:?}", signal.deviation());
        }
    }

    #[test]
    fn half_the_sensitivity_away_from_the_line_a_signal_does_not_follow_it() {
        // The line is drawn at the end of block 37, which is off it by this much; the effort is in the next one.
        let after = |by: f32| {
            found(&breath(1.0, 0.0), |tick| {
                let pressure = match tick.saturating_sub(EXPIRES) / 10 {
                    ..36 => 0.0,
                    36 => -by,
                    37.. => -2.0,
                };
                (pressure, f32::NAN)
            })
        };
        assert_eq!((after(0.5), after(0.49)), (None, Some(EARLIEST + 9)));
    }

    #[test]
    fn a_signal_that_rises_by_half_the_sensitivity_itself_is_no_effort() {
        // A signal that falls by 0.125 cmH2O in each block, until one that is higher than five blocks before.
        let rises = |by: f32| {
            found(&breath(1.0, 0.0), |tick| {
                let block = tick.saturating_sub(EXPIRES) / 10;
                let line = |block: u32| -0.125 * block as f32;
                let signal = if block == 100 { line(95) + by } else { line(block) };
                (-signal, f32::NAN)
            })
        };
        assert_eq!((rises(0.5), rises(0.625)), (None, Some(2009)));
    }

    #[test]
    fn a_sensitivity_of_zero_is_off() {
        let signals = |tick| (PEEP - effort(tick, 2000), effort(tick, 2000));
        assert_eq!(found(&breath(0.0, 0.0), signals), None);
        let step = |tick| if tick < 2000 { (PEEP, 0.0) } else { (PEEP - 3.0, 1.0) };
        assert_eq!(found(&breath(0.0, 0.0), step), None);
    }

    #[test]
    fn muscles_that_relax_while_the_lung_empties_are_no_effort() {
        let flow = |tick: u32| {
            let relaxed = tick.saturating_sub(EXPIRES + 300) as f32;
            (PEEP, -0.6 * (-relaxed / 250.0).exp())
        };
        assert_eq!(found(&breath(0.0, 0.6), flow), None);
    }

    #[test]
    fn the_end_of_an_effort_or_a_cough_is_no_effort() {
        for peak in [1.0, 3.0] {
            let effort = |tick| (PEEP - peak * effort(tick, 700), f32::NAN);
            assert_eq!(found(&breath(0.4, 0.0), effort), None);
        }
        let cough = |tick: u32| (if (1800..2000).contains(&tick) { PEEP + 8.0 } else { PEEP }, f32::NAN);
        assert!(found(&breath(0.4, 0.0), cough).is_none_or(|at| at >= 2000));
    }

    #[test]
    fn a_noisy_sensor_is_less_sensitive_but_starts_no_breath() {
        let quiet = |tick| (PEEP + noise(tick, 0.6), noise(tick, 0.03));
        assert_eq!(found(&breath(0.2, 0.5), quiet), None);
        let strong = |tick| (PEEP - 4.0 * effort(tick, 2000) + noise(tick, 0.6), f32::NAN);
        assert!((2000..2200).contains(&found(&breath(0.2, 0.0), strong).expect("found")));
    }

    #[test]
    fn at_a_long_control_period_noise_starts_no_breath() {
        for period_us in [1000, 2000, 7000, 30_000] {
            let settings = Settings { trigger_pressure: 0.2, trigger_flow: 0.5, ..paper_settings(25.0) };
            let (trigger, breath) = (Trigger::new(period_us), Breath::new(&settings, period_us).unwrap());
            let mut state = TriggerState::default();
            for tick in 0..20 * breath.total_ticks() {
                let (pressure, flow) = (PEEP + noise(tick, 0.2), noise(tick + 7, 0.01));
                let found =
                    trigger.check(&mut state, &breath.at(tick % breath.total_ticks()), pressure, flow);
                assert_eq!(found, None, "{period_us} us, tick {tick}");
            }
        }
    }

    /// A gap in readings, at each tick.
    type Gap = fn(u32) -> bool;

    /// Verifies: gaps-in-readings.
    #[test]
    fn single_missing_readings_and_short_gaps_hide_no_effort() {
        let gaps: [Gap; 4] = [
            |_| false,
            |tick| tick.is_multiple_of(400),
            |tick| tick.is_multiple_of(100),
            |tick| tick % 50 < 4,
        ];
        for gap in gaps {
            let missing = |tick, value: f32| if gap(tick) { f32::NAN } else { value };
            let by_pressure = |tick| (missing(tick, PEEP - effort(tick, 2000) + noise(tick, 0.1)), f32::NAN);
            assert!(found(&breath(0.4, 0.0), by_pressure).is_some_and(|at| (2000..2100).contains(&at)));
            let by_flow = |tick| (PEEP, missing(tick, effort(tick, 2000) / 20.0 + noise(tick, 0.003)));
            assert!(found(&breath(0.0, 0.6), by_flow).is_some_and(|at| (2000..2100).contains(&at)));
        }
    }

    #[test]
    fn a_value_that_stands_for_missing_ones_is_no_effort() {
        // The lung empties fast at first: the flow rises by 2 L/s in a second.
        for time_constant in [60.0, 250.0, 1000.0] {
            let share = |tick: u32| (-(tick.saturating_sub(EXPIRES) as f32) / time_constant).exp();
            let signals = |tick| {
                let missing = if tick % 50 < 4 { f32::NAN } else { 0.0 };
                (PEEP + 15.0 * share(tick) + missing, -1.5 * share(tick) + missing)
            };
            assert_eq!(found(&breath(0.2, 0.5), signals), None, "{time_constant} ms");
        }
    }

    #[test]
    fn after_a_longer_gap_a_line_is_drawn_first() {
        // A reading that returns after so long may be that of another sensor.
        let after = |gap: u32| {
            let step = |tick| match tick {
                1950.. if tick < 1950 + gap => f32::NAN,
                ..2250 => PEEP,
                _ => PEEP - 3.0,
            };
            found(&breath(0.4, 0.0), |tick| (step(tick), f32::NAN))
        };
        assert_eq!((after(4), after(5)), (Some(2259), None), "no line yet to leave");
    }

    #[test]
    fn a_step_of_a_coarse_sensor_is_no_effort_and_a_real_one_is_found_in_its_steps() {
        for step in [0.3, 0.5, 1.0, 2.0] {
            for time_constant in [100.0, 250.0, 400.0, 1000.0, 2500.0] {
                let empties = |tick: u32| {
                    let share = (-(tick.saturating_sub(EXPIRES) as f32) / time_constant).exp();
                    (in_steps(PEEP + 0.1 + 15.0 * share, step), in_steps(-60.0 * share, step) / 60.0)
                };
                assert_eq!(found_coarse(&breath(0.4, 0.6), empties), None, "{step}, {time_constant} ms");
            }
        }
        for step in [0.3, 0.5, 0.7] {
            let inhales = |tick| (in_steps(PEEP + 0.1 - 2.0 * effort(tick, 2000), step), f32::NAN);
            let at = found_coarse(&breath(0.4, 0.0), inhales);
            assert!(at.is_some_and(|at| (2000..2400).contains(&at)), "{step}: {at:?}");
        }
    }

    #[test]
    fn a_little_bias_bends_no_line_and_a_larger_one_that_of_the_pressure_only_well_above_peep() {
        // The expiration begins at 1500: a line that starts again there is not drawn yet when the effort comes.
        let at = |sensitivity: (f32, f32), bias: f32, above: f32| {
            let settings = *breath(sensitivity.0, sensitivity.1).settings();
            let settings = Settings { expiratory_bias: bias, ..settings };
            let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
            let effort = |tick| effort(tick, 1550);
            let at = found_coarse(&breath, |tick| (PEEP + above - effort(tick), effort(tick) / 20.0));
            at.is_some_and(|at| (1550..1650).contains(&at))
        };
        assert_eq!([0.0, LITTLE_BIAS, 6.25].map(|bias| at((0.0, 0.6), bias, 0.0)), [true, true, false]);
        assert_eq!([0.0, RESISTED, 2.25].map(|above| at((0.4, 0.0), 10.0, above)), [true, true, false]);
        assert!(at((0.4, 0.0), LITTLE_BIAS, 2.25));
    }

    #[test]
    fn the_flow_of_a_valve_that_opens_to_its_bias_is_no_effort() {
        let at = |bias: f32, begins: u32| {
            let settings = Settings { expiratory_bias: bias, ..*breath(0.0, 0.6).settings() };
            let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
            let flow = |tick: u32| {
                let opens = if breath.phase(tick) == Phase::Expiration { 0.002 * bias } else { 0.0 };
                opens + effort(tick, begins) / 20.0
            };
            found(&breath, |tick| (PEEP, flow(tick)))
        };
        assert_eq!(at(20.0, 5000), None);
        assert!(at(20.0, 2000).is_some_and(|at| (2000..2100).contains(&at)), "the line is drawn again");
        assert!(at(5.0, 1550).is_some_and(|at| at < 1650), "the usual bias takes no time");
    }

    #[test]
    fn the_pressure_that_a_bias_raises_behind_a_narrowed_outlet_is_no_effort() {
        // The fall halts while the valve opens, and goes on 4 cmH2O higher: that bends the line, unless it starts again.
        let at = |begins: u32| {
            let settings = Settings { fall_time: 0.4, expiratory_bias: 10.0, ..*breath(0.4, 0.0).settings() };
            let breath = Breath::new(&settings, DEFAULT_PERIOD_US).unwrap();
            found(&breath, |tick| {
                let opened = tick.saturating_sub(EXPIRES + 400).min(80) as f32 / 80.0;
                let falls = 30.0 + 4.0 * opened - 0.01 * tick.saturating_sub(EXPIRES) as f32;
                (PEEP + falls - effort(tick, begins), f32::NAN)
            })
        };
        assert_eq!(at(u32::MAX), None);
        assert!(at(1800).is_some_and(|at| (1800..1900).contains(&at)), "an effort shows as before");
    }

    #[test]
    fn a_fall_of_the_pressure_is_the_sign_where_both_show_an_effort() {
        let sign = |by_pressure: f32, by_flow: f32| {
            let (trigger, mut state) = (Trigger::new(DEFAULT_PERIOD_US), TriggerState::default());
            let breath = breath(by_pressure, by_flow);
            (0..breath.total_ticks()).find_map(|tick| {
                let (effort, dither) = (effort(tick, 2000), noise(tick, 0.001));
                trigger.check(&mut state, &breath.at(tick), PEEP - effort + dither, effort + dither)
            })
        };
        assert_eq!((sign(0.4, 0.0), sign(0.0, 0.6)), (Some(Sign::Pressure), Some(Sign::Flow)));
        assert_eq!(sign(0.4, 20.0), Some(Sign::Pressure));
    }

    #[test]
    fn each_expiration_begins_with_a_new_line() {
        let (trigger, breath) = (Trigger::new(DEFAULT_PERIOD_US), breath(0.4, 0.6));
        let mut state = TriggerState::default();
        let mut breathe = |pressure: f32| {
            (0..breath.total_ticks())
                .any(|tick| trigger.check(&mut state, &breath.at(tick), pressure, 0.0).is_some())
        };
        assert!(!breathe(20.0) && !breathe(PEEP), "a new PEEP is no effort");
        for signal in [state.pressure, state.flow] {
            assert!(signal.blocks == 200 && signal.noise < 1e-6);
        }
    }

    proptest! {
        #[test]
        fn no_reading_panics_or_starts_an_inspiration_of_its_own(
            readings in prop::collection::vec((prop::num::f32::ANY, prop::num::f32::ANY), 1..200),
            period_us in 250u32..50_000,
        ) {
            let settings = paper_settings(25.0);
            let (trigger, mut state) = (Trigger::new(period_us), TriggerState::default());
            let breath = Breath::new(&settings, period_us).unwrap();
            for tick in 0..breath.total_ticks().min(5000) {
                let (pressure, flow) = readings[tick as usize % readings.len()];
                let found = trigger.check(&mut state, &breath.at(tick), pressure, flow);
                prop_assert!(found.is_none() || breath.phase(tick) != Phase::Inspiration);
            }
        }
    }
}
