//! The signals against what is remembered of IEC 60601-1-8. Verifies: lamps-and-sounder.

use std::vec::Vec;

use super::*;
use crate::safety::alarms::Fault;

const PERIOD_US: u32 = 1000;

/// The alarms and their signals.
struct Ward {
    alarms: Indications,
    annunciator: Annunciator,
    present: Vec<Fault>,
}

impl Ward {
    fn new(present: &[Fault]) -> Self {
        let alarms = Indications::default();
        Self { alarms, annunciator: Annunciator::new(PERIOD_US), present: present.to_vec() }
    }

    fn tick(&mut self) -> Signals {
        self.present.iter().for_each(|fault| self.alarms.found(*fault));
        self.alarms.tick(1);
        self.annunciator.step(&self.alarms);
        self.annunciator.signals()
    }

    fn run(&mut self, ms: usize) -> Vec<Signals> {
        (0..ms).map(|_| self.tick()).collect()
    }

    /// Whether the sounder sounds within a time, ms.
    fn sounds(&mut self, ms: usize) -> bool {
        self.run(ms).iter().any(|signals| signals.sounder)
    }
}

/// Lengths of equal levels, ms, beginning with an `on`; the last one is cut off and left out.
fn lengths(levels: impl Iterator<Item = bool>) -> Vec<usize> {
    let levels: Vec<bool> = levels.collect();
    assert!(levels[0], "a signal begins at once");
    let mut runs: Vec<usize> = levels.chunk_by(|a, b| a == b).map(<[bool]>::len).collect();
    runs.pop();
    runs
}

const HIGH: Fault = Fault::Disconnection;
const HIGH_TOO: Fault = Fault::Occlusion;
const MEDIUM: Fault = Fault::BaselineLow;
const LOW: Fault = Fault::HostSilent;

fn sound(fault: Fault, ms: usize) -> Vec<usize> {
    lengths(Ward::new(&[fault]).run(ms).into_iter().map(|signals| signals.sounder))
}

#[test]
fn without_an_alarm_nothing_sounds_and_nothing_is_lit() {
    assert!(Ward::new(&[]).run(30_000).iter().all(|signals| *signals == Signals::default()));
}

#[test]
fn a_high_priority_alarm_sounds_ten_pulses_three_and_two_twice() {
    let runs = sound(HIGH, 20_000);
    let (pulses, gaps): (Vec<_>, Vec<_>) =
        (runs.iter().step_by(2).collect(), runs.iter().skip(1).step_by(2).copied().collect::<Vec<_>>());
    assert!(pulses.iter().all(|pulse| (75..=200).contains(*pulse)), "{pulses:?}");
    let x = gaps[0];
    assert!((50..=125).contains(&x));
    assert_eq!([gaps[1], gaps[3], gaps[5], gaps[6], gaps[8]], [x; 5]);
    assert_eq!([gaps[2], gaps[7]], [2 * x + pulses[0]; 2], "3 + 2");
    assert!((350..=1300).contains(&gaps[4]), "between the halves");
    assert!((2_500..=15_000).contains(&gaps[9]), "between bursts");
    assert_eq!(gaps[10], x, "the second burst is like the first");
}

#[test]
fn a_medium_priority_alarm_sounds_three_pulses() {
    let runs = sound(MEDIUM, 30_000);
    assert!(runs[..6].iter().step_by(2).all(|pulse| (125..=250).contains(pulse)));
    assert!((125..=250).contains(&runs[1]) && runs[1] == runs[3]);
    assert!((2_500..=30_000).contains(&runs[5]));
    assert_eq!(runs[6..9], runs[..3]);
}

#[test]
fn a_low_priority_alarm_sounds_two_pulses_seldom() {
    let runs = sound(LOW, 45_000);
    assert!([runs[0], runs[1], runs[2]].iter().all(|length| (125..=250).contains(length)));
    assert!(runs[3] > 15_000);
    assert_eq!(runs[4..7], runs[..3]);
}

#[test]
fn the_lamp_has_the_colour_and_the_rate_of_the_priority() {
    let lamps = |fault| Ward::new(&[fault]).run(20_000);
    let red = lamps(HIGH);
    assert!(red.iter().all(|signals| !signals.yellow));
    // From 1.4 to 2.8 Hz, lit for 20 to 60 % of the period.
    let flashes = lengths(red.iter().map(|signals| signals.red));
    assert!(flashes.len() == 79 && flashes.chunks_exact(2).all(|flash| flash == [250, 250]), "2 Hz");
    let yellow = lamps(MEDIUM);
    assert!(yellow.iter().all(|signals| !signals.red));
    // From 0.4 to 0.8 Hz.
    let flashes = lengths(yellow.iter().map(|signals| signals.yellow));
    assert!(flashes.len() == 19 && flashes.chunks_exact(2).all(|flash| flash == [1000, 1000]), "0.5 Hz");
    assert!(lamps(LOW).iter().all(|signals| signals.yellow && !signals.red), "steady");
}

#[test]
fn at_another_control_period_the_times_are_the_same() {
    let mut ward = Ward::new(&[HIGH]);
    ward.annunciator = Annunciator::new(2 * PERIOD_US);
    let runs = lengths(ward.run(3000).into_iter().map(|signals| signals.sounder));
    assert_eq!(runs[..6], [75, 50, 75, 50, 75, 175]);
}

#[test]
fn of_several_alarms_the_most_urgent_is_signalled_at_once() {
    let mut ward = Ward::new(&[LOW]);
    assert!(ward.sounds(700) && !ward.sounds(5000));
    ward.present.push(MEDIUM);
    assert_eq!(ward.tick(), Signals { sounder: true, red: false, yellow: true });
    ward.run(5000);
    ward.present.push(HIGH);
    assert_eq!(ward.tick(), Signals { sounder: true, red: true, yellow: false });
    let runs = lengths(ward.run(1000).into_iter().map(|signals| signals.sounder));
    assert_eq!(runs[1..3], [100, 150], "the pattern of the high priority");
}

#[test]
fn an_acknowledged_alarm_is_silent_but_shown_until_its_condition_is_gone() {
    let mut ward = Ward::new(&[HIGH]);
    ward.run(1000);
    ward.alarms.acknowledge();
    let after = ward.run(20_000);
    assert!(after.iter().all(|signals| !signals.sounder) && after.iter().any(|signals| signals.red));
    ward.present.clear();
    assert!(ward.run(3)[2] == Signals::default());
}

#[test]
fn an_alarm_whose_condition_is_gone_sounds_and_shows_until_it_is_acknowledged() {
    let mut ward = Ward::new(&[MEDIUM]);
    ward.tick();
    ward.present.clear();
    ward.run(3000);
    let after = ward.run(20_000);
    assert!(after.iter().any(|signals| signals.sounder) && after.iter().any(|signals| signals.yellow));
    ward.alarms.acknowledge();
    assert_eq!(ward.run(2)[1], Signals::default());
}

#[test]
fn an_alarm_that_returns_begins_with_its_first_pulse() {
    let mut ward = Ward::new(&[HIGH]);
    ward.run(1100);
    ward.present.clear();
    ward.run(2);
    ward.alarms.acknowledge();
    ward.run(2);
    ward.present.push(HIGH);
    assert_eq!(
        lengths(ward.run(700).into_iter().map(|signals| signals.sounder))[..3],
        [150, 100, 150],
        "the whole burst"
    );
}

#[test]
fn an_audio_pause_silences_the_sounder_for_its_time_and_leaves_the_lamp() {
    let mut ward = Ward::new(&[HIGH]);
    ward.run(1000);
    let status = ward.annunciator.pause(AUDIO_PAUSE_MAX).unwrap();
    assert_eq!(status, AudioStatus { priority: Some(Priority::High), pause_left: 120 });
    let paused = ward.run(120_000);
    assert!(paused.iter().all(|signals| !signals.sounder) && paused.iter().any(|signals| signals.red));
    assert_eq!(ward.annunciator.status().pause_left, 0);
    assert!(ward.tick().sounder, "with a pulse of a new burst");
}

#[test]
fn the_rest_of_a_pause_is_rounded_up() {
    let mut ward = Ward::new(&[HIGH]);
    ward.run(10);
    ward.annunciator.pause(60).unwrap();
    let left = [1, 999, 1, 58_998, 1].map(|ms| {
        ward.run(ms);
        ward.annunciator.status().pause_left
    });
    assert_eq!(left, [60, 59, 59, 1, 0]);
}

#[test]
fn a_pause_of_0_s_ends_it() {
    let mut ward = Ward::new(&[HIGH]);
    ward.tick();
    ward.annunciator.pause(60).unwrap();
    assert!(!ward.sounds(5000));
    assert_eq!(ward.annunciator.pause(0).unwrap().pause_left, 0);
    assert!(ward.sounds(2));
    Ward::new(&[]).annunciator.pause(0).unwrap();
}

#[test]
fn a_pause_that_is_too_long_or_has_nothing_to_silence_is_refused() {
    let mut ward = Ward::new(&[HIGH]);
    ward.tick();
    ward.annunciator.pause(60).unwrap();
    assert_eq!(ward.annunciator.pause(AUDIO_PAUSE_MAX + 1), Err(Refusal::PauseTooLong));
    assert_eq!(ward.annunciator.status().pause_left, 60, "the running pause goes on");
    ward.alarms.acknowledge();
    ward.run(2);
    assert_eq!(ward.annunciator.pause(10), Err(Refusal::NothingSounds));
    assert_eq!(Ward::new(&[]).annunciator.pause(1), Err(Refusal::NothingSounds));
}

/// Whether an alarm sounds that begins while others are paused.
fn breaks_the_pause(paused: &[Fault], new: Fault) -> bool {
    let mut ward = Ward::new(paused);
    ward.run(10);
    ward.annunciator.pause(100).unwrap();
    assert!(!ward.sounds(1000));
    ward.present.push(new);
    ward.sounds(30_000)
}

#[test]
fn a_new_alarm_of_high_priority_or_of_a_higher_one_than_the_paused_ends_the_pause() {
    assert!(breaks_the_pause(&[MEDIUM], HIGH));
    assert!(breaks_the_pause(&[HIGH], HIGH_TOO));
    assert!(breaks_the_pause(&[LOW], MEDIUM));
    assert!(!breaks_the_pause(&[HIGH], MEDIUM));
    assert!(!breaks_the_pause(&[MEDIUM], Fault::CommandCapped));
    assert!(!breaks_the_pause(&[MEDIUM], LOW));
    assert!(!breaks_the_pause(&[HIGH], HIGH), "the same alarm, which goes on");
}

#[test]
fn a_pause_ends_when_everything_is_acknowledged() {
    let mut ward = Ward::new(&[HIGH]);
    ward.run(10);
    ward.annunciator.pause(100).unwrap();
    ward.alarms.acknowledge();
    ward.run(10);
    assert_eq!(ward.annunciator.status(), AudioStatus::default());
    ward.present.push(LOW);
    assert!(ward.sounds(10), "the next alarm is not paused by the old request");
}
