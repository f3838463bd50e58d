//! The course that the samples of a device must take, so that a recording of them is sound.

use std::time::Duration;

use monitoring::words::impossible;
use shared::breath::{Breath, Phase};
use shared::link::messages::DeviceKind;
use shared::ventilator::Sample;

/// Longest time by which an expiration may exceed its settings, s: a lung that empties slowly delays the next breath.
const LONGEST_DELAY: f32 = 30.0;
/// Largest factor between the device's time and this computer's.
const PACE: f64 = 2.0;
/// Time in which the pace is not judged, s: of a start, and of samples that wait on the line.
const ALLOWANCE: f64 = 2.0;

/// What a sample is, after those before it.
#[derive(Clone, Debug, PartialEq)]
pub(super) enum Step {
    /// The next one of the breath.
    Next,
    /// The first one of the next breath.
    NextBreath,
    /// One that follows a gap.
    Gap,
    /// The pressure limit has ended the inspiration.
    Cut,
    /// One that no sound device sends, in words.
    Impossible(String),
}

/// A breath whose samples come in.
#[derive(Clone, Debug)]
pub(super) struct Course {
    inspiration: u32,
    /// Ticks after which even a delayed breath has ended.
    latest: u32,
    /// Its number, once a sample has come.
    pub(super) breath: Option<u32>,
    /// Number of samples so far.
    pub(super) ticks: u32,
    phase: Phase,
}

impl Course {
    /// Of a breath that was asked for.
    pub(super) fn new(asked: &Breath) -> Self {
        let delay = shared::math::ticks(LONGEST_DELAY, asked.period_us());
        let latest = asked.total_ticks().saturating_add(delay);
        let inspiration = asked.inspiration_ticks();
        Self { inspiration, latest, breath: None, ticks: 0, phase: Phase::Inspiration }
    }

    /// Judges the next sample; only after [`Step::Next`] the breath goes on.
    pub(super) fn take(&mut self, sample: &Sample) -> Step {
        let first = self.breath.is_none();
        let breath = *self.breath.get_or_insert(sample.breath);
        let place = (sample.breath, sample.tick);
        if !first && Some(place) == breath.checked_add(1).map(|next| (next, 0)) {
            return self.end();
        }
        if place < (breath, self.ticks) {
            let (breath, tick) = place;
            return Step::Impossible(format!("ticks that go backwards, to tick {tick} of breath {breath}"));
        }
        if sample.u_out && place.1 < self.inspiration {
            return Step::Cut;
        }
        if place != (breath, self.ticks) {
            return Step::Gap;
        }
        self.check(sample).map_or_else(|| self.go_on(sample), Step::Impossible)
    }

    fn go_on(&mut self, sample: &Sample) -> Step {
        self.ticks += 1;
        self.phase = sample.phase;
        Step::Next
    }

    fn end(&self) -> Step {
        // Settings may leave no time for an expiration.
        if self.ticks >= self.inspiration {
            Step::NextBreath
        } else {
            let Self { ticks, inspiration, .. } = self;
            Step::Impossible(format!("a breath of {ticks} ticks, whose inspiration alone has {inspiration}"))
        }
    }

    fn check(&self, sample: &Sample) -> Option<String> {
        if !sample.pressure.is_finite() {
            Some(format!("a pressure of {} cmH2O", sample.pressure))
        } else if (sample.phase as u8) < self.phase as u8 {
            Some(format!("phase {:?} after {:?}", sample.phase, self.phase))
        } else if sample.phase == Phase::Inspiration && self.ticks >= self.inspiration {
            Some(format!("an inspiration of more than its {} ticks", self.inspiration))
        } else if self.ticks >= self.latest {
            Some(format!("a breath without an end: {} ticks so far", self.ticks))
        } else {
            impossible(sample)
        }
    }
}

/// What is impossible about the pace of a device, in words: its samples say that this much time has passed, this computer's clock
/// says how much. A simulated plant has a pace of its own.
pub(super) fn wrong_pace(
    kind: DeviceKind,
    period_us: u32,
    samples: usize,
    passed: Duration,
) -> Option<String> {
    let device = samples as f64 * f64::from(period_us) * 1e-6;
    let here = passed.as_secs_f64();
    let off = device > PACE * here + ALLOWANCE || here > PACE * device + ALLOWANCE;
    (off && !kind.has_simulated_plant()).then(|| {
        format!("{samples} samples of {period_us} us, which is {device:.1} s, in {here:.1} s: correct period_us in its greeting")
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use shared::breath::paper_settings;
    use shared::settings::Settings;

    fn sound(breath: u32, tick: u32, asked: &Breath) -> Sample {
        let phase = asked.phase(tick);
        let (u_in, u_out) = (5.0, phase != Phase::Inspiration);
        let target = asked.target(tick);
        Sample {
            breath,
            tick,
            phase,
            target,
            pressure: 7.0,
            u_in,
            u_out,
            explore: 0.0,
            learned: 0.0,
            flow: None,
        }
    }

    fn breath() -> Breath {
        Breath::new(&paper_settings(20.0), 10_000).unwrap()
    }

    /// The last step of a breath in which `change` has changed the sample of this tick.
    fn changed(at: u32, change: impl Fn(&mut Sample)) -> Step {
        let asked = breath();
        let mut course = Course::new(&asked);
        for tick in 0..at {
            assert_eq!(course.take(&sound(3, tick, &asked)), Step::Next, "{tick}");
        }
        let mut sample = sound(3, at, &asked);
        change(&mut sample);
        course.take(&sample)
    }

    #[test]
    fn a_sound_breath_goes_through_also_with_a_delayed_end() {
        let asked = breath();
        for ticks in [asked.total_ticks(), asked.total_ticks() + 500] {
            let mut course = Course::new(&asked);
            assert!((0..ticks).all(|tick| course.take(&sound(7, tick, &asked)) == Step::Next));
            assert_eq!(course.take(&sound(8, 0, &asked)), Step::NextBreath);
        }
    }

    proptest! {
        #[test]
        fn a_sound_breath_goes_through_whatever_its_settings(
            inspiratory_time in 0.1_f32..4.0,
            rate in 4.0_f32..100.0,
            shortest in proptest::bool::ANY,
            period_us in 1000_u32..10_000,
        ) {
            let paper = paper_settings(20.0);
            let rate = if shortest { 59.99 / inspiratory_time } else { rate };
            let settings = Settings { inspiratory_time, rate, rise_time: 0.0, fall_time: 0.0, ..paper };
            let Ok(asked) = Breath::new(&settings, period_us) else { return Ok(()) };
            let mut course = Course::new(&asked);
            for tick in 0..asked.total_ticks() {
                prop_assert_eq!(course.take(&sound(7, tick, &asked)), Step::Next);
            }
            prop_assert_eq!(course.take(&sound(8, 0, &asked)), Step::NextBreath);
        }
    }

    #[test]
    fn each_thing_that_no_sound_device_sends_is_named() {
        let said = |at, change: fn(&mut Sample)| match changed(at, change) {
            Step::Impossible(what) => what,
            other => panic!("{other:?}"),
        };
        assert!(said(40, |sample| sample.pressure = f32::NAN).contains("pressure of NaN"));
        assert!(said(40, |sample| sample.pressure = 2e6).contains("2000000"));
        assert!(said(40, |sample| sample.u_in = -1.0).contains("valve command of -1"));
        assert!(said(40, |sample| sample.u_in = f32::NAN).contains("valve command of NaN"));
        assert!(said(40, |sample| sample.target = f32::INFINITY).contains("target"));
        assert!(said(40, |sample| sample.explore = f32::NAN).contains("perturbation"));
        assert!(said(40, |sample| sample.flow = Some(f32::NAN)).contains("flow"));
        assert!(said(40, |sample| sample.tick = 39).contains("backwards, to tick 39 of breath 3"));
        assert!(said(40, |sample| sample.breath = 2).contains("backwards"));
        assert!(said(40, |sample| (sample.breath, sample.tick) = (4, 0)).contains("breath of 40 ticks"));
        assert!(
            said(100, |sample| (sample.phase, sample.u_out) = (Phase::Inspiration, false))
                .contains("more than its 100 ticks")
        );
        assert!(said(200, |sample| sample.phase = Phase::Fall).contains("Fall after Expiration"));
        assert_eq!(changed(40, |sample| sample.tick = 41), Step::Gap);
        assert_eq!(changed(40, |sample| sample.breath = 9), Step::Gap);
        assert_eq!(changed(40, |sample| sample.u_out = true), Step::Cut);
    }

    #[test]
    fn a_breath_without_an_end_is_noticed() {
        let asked = breath();
        let mut course = Course::new(&asked);
        let end = (0..10_000).find(|tick| course.take(&sound(0, *tick, &asked)) != Step::Next);
        assert_eq!(end, Some(300 + 3000), "3 s and 30 s");
    }

    #[test]
    fn a_period_that_is_not_the_real_one_is_noticed() {
        let said = |kind, samples, seconds| {
            wrong_pace(kind, 1000, samples, Duration::from_secs_f64(seconds)).is_some()
        };
        let own = DeviceKind::ThirdParty;
        assert!(!said(own, 3000, 3.2) && !said(own, 1000, 0.0) && !said(own, 100, 2.0));
        assert!(said(own, 30_000, 3.0), "ten times as many");
        assert!(said(own, 3000, 30.0), "a tenth");
        assert!(!said(DeviceKind::HardwareInTheLoop, 30_000, 3.0));
    }

    proptest! {
        /// Whatever comes: what goes through is a row of consecutive ticks with finite values.
        #[test]
        fn what_goes_through_is_a_sound_row(
            samples in prop::collection::vec(
                (0u32..3, 0u32..8, 0usize..3, any::<bool>(), prop::array::uniform5(any::<f32>()), any::<Option<f32>>(), any::<bool>()),
                0..40,
            ),
        ) {
            let asked = breath();
            let mut course = Course::new(&asked);
            for (through, drawn) in (0..).zip(samples) {
                let (breath, tick, phase, u_out, [target, pressure, u_in, explore, learned], flow, fits) = drawn;
                let phase = [Phase::Inspiration, Phase::Fall, Phase::Expiration][phase];
                let drawn = Sample { breath, tick, phase, target, pressure, u_in, u_out, explore, learned, flow };
                let sample = if fits { sound(course.breath.unwrap_or(1), course.ticks, &asked) } else { drawn };
                if course.take(&sample) != Step::Next {
                    break;
                }
                prop_assert_eq!(sample.tick, through);
                let values = [sample.target, sample.pressure, sample.u_in, sample.explore, sample.learned];
                prop_assert!(values.iter().all(|value| value.is_finite()));
                prop_assert!((0.0..=100.0).contains(&sample.u_in) && sample.pressure.abs() <= 1000.0);
            }
        }
    }
}
