//! The courses of a shard: consecutive breaths on one unit in each lane, and the memory of these breaths.

use std::f32::consts::TAU;

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use shared::breath::period_s;
use shared::math;
use shared::settings::Settings;

use super::config::FamilyConfig;
use super::memory::LaneMemory;
use super::rollout::ClosedLoopTape;
use super::scenario::{Prescribed, Scenario, Strain, settled};
use crate::simulator::{BreathStart, COMMAND_SCALE};
use engine::{LANES, Lane};

/// Score below which the errors of a course weigh no more, cmH2O.
const LEAST_SCORE: f32 = 0.3;
/// Share of the courses with the usual waveforms whose PIP is any that can be set.
const ANY_PIP_SHARE: f32 = 0.6;
/// Overshoot that costs no more than any other error: a share of the driving pressure, and at least this, cmH2O.
const OVERSHOOT_SHARE: f32 = 0.1;
const LEAST_OVERSHOOT: f32 = 1.5;
/// Smallest and largest gain of a strained loop.
const STRAIN_GAINS: (f32, f32) = (0.5, 2.0);
/// Time after its rise from which a pressure should have settled, s.
const AFTER_RISE_S: f32 = 0.2;

/// A machine with a lung in each lane, its prescription and noise, and what was learned of it.
#[derive(Debug)]
pub(super) struct Courses {
    /// Number of units to draw from.
    units: u32,
    /// Control period, microseconds.
    period_us: u32,
    /// Whether the courses have the usual waveforms.
    usual: bool,
    /// Inspiratory time, the same in all lanes, s.
    inspiratory_time: f32,
    machine: [Option<u32>; LANES],
    lung: [Option<u32>; LANES],
    settings: [Settings; LANES],
    /// Standard deviation of the sensor noise, cmH2O.
    noise: Lane,
    /// What is done to the loop in the present breath.
    strain: Strain,
    /// Breaths run.
    breath: [u32; LANES],
    /// Pressure at the end of the last inspiration, cmH2O; PEEP before the first.
    plateau: Lane,
    /// Command at the end of the last inspiration, percent.
    plateau_command: Lane,
    /// Lowest score on this lung, cmH2O.
    best: Lane,
    memory: LaneMemory,
}

impl Courses {
    /// New courses in all lanes, on some of `units` units; with the usual waveforms if their share of the shards reaches to this place
    /// among them, 0 to 1.
    pub fn new(units: u32, period_us: u32, place: f32, config: &FamilyConfig, rng: &mut ChaCha8Rng) -> Self {
        let usual = place < config.usual_share || config.prescriptions.are_listed();
        let mut courses = Self {
            units,
            period_us,
            usual,
            inspiratory_time: prescription(usual, config, rng).inspiratory_time,
            machine: [None; LANES],
            lung: [None; LANES],
            settings: [Settings::default(); LANES],
            noise: Lane::ZERO,
            strain: Strain::NONE,
            breath: [0; LANES],
            plateau: Lane::ZERO,
            plateau_command: Lane::ZERO,
            best: Lane::ZERO,
            memory: LaneMemory::new(period_us),
        };
        (0..LANES).for_each(|l| courses.begin(l, config, rng));
        courses
    }

    /// Ticks of an inspiration.
    pub fn ticks(&self) -> usize {
        self.ticks_in(self.inspiratory_time)
    }

    /// Whole ticks in this time, s.
    fn ticks_in(&self, time: f32) -> usize {
        math::ticks(time, self.period_us) as usize
    }

    /// Starts a new course in a lane.
    fn begin(&mut self, l: usize, config: &FamilyConfig, rng: &mut ChaCha8Rng) {
        self.machine[l] = Some(rng.random_range(0..self.units));
        self.lung[l] = Some(rng.random_range(0..self.units));
        let drawn = prescription(self.usual, config, rng);
        // The shard's inspiration, with the phases in the proportion that was drawn.
        let rate = drawn.rate * drawn.inspiratory_time / self.inspiratory_time;
        self.settings[l] = Settings { inspiratory_time: self.inspiratory_time, rate, ..drawn };
        self.noise[l] = rng.random_range(config.noise.0..config.noise.1);
        (self.breath[l], self.plateau[l], self.best[l]) = (0, drawn.peep, f32::INFINITY);
        self.memory.forget(l);
    }

    /// Prepares the next breath: ends some courses and starts new ones in their lanes, and gives others a different lung. A course
    /// with a different lung keeps its memory.
    pub fn pass(&mut self, config: &FamilyConfig, rng: &mut ChaCha8Rng) {
        for l in 0..LANES {
            let [restarts, changes]: [f32; 2] = std::array::from_fn(|_| rng.random_range(0.0..1.0));
            let restarts = config.told.is_some() || restarts < config.restart_probability;
            if self.breath[l] > 0 && restarts {
                self.begin(l, config, rng);
            } else if self.breath[l] > 0 && changes < config.lung_change_probability {
                self.lung[l] = Some(rng.random_range(0..self.units));
                self.best[l] = f32::INFINITY;
            }
            self.strain(l, config, rng);
        }
    }

    /// Draws what is done to the loop of a lane in the next breath.
    fn strain(&mut self, l: usize, config: &FamilyConfig, rng: &mut ChaCha8Rng) {
        let delay = self.ticks_in(config.strain_delay);
        (self.strain.gain[l], self.strain.delay[l]) = strain(config.strain_share, delay, rng);
    }

    /// The next breath of every course. A course begins in standby, with the valve closed.
    pub fn scenario(&self, config: &FamilyConfig, rng: &mut ChaCha8Rng) -> Scenario {
        let (settings, ticks) = (&self.settings, self.ticks());
        let of = |value: fn(&Settings) -> f32| Lane::from_fn(|l| value(&settings[l]));
        let peep = of(|settings| settings.peep);
        let mut normal = || -> f32 { rng.sample(StandardNormal) };
        let start = BreathStart {
            pressure: peep.map(|peep| peep + config.start_spread * normal()),
            peep,
            plateau: self.plateau,
            plateau_command: self.plateau_command.map(|command| command / COMMAND_SCALE),
            phases: Some([of(|s| s.inspiratory_time), of(|s| 60.0 / s.rate - s.inspiratory_time)]),
            ventilator: self.machine,
            group: self.lung,
            ..BreathStart::default()
        };
        let mut noise: Vec<Lane> = (0..ticks).map(|_| self.noise.map(|sd| sd * normal())).collect();
        let rise_ticks = settings.map(|s| self.ticks_in(s.rise_time).min(ticks) as u32);
        let settled = rise_ticks.map(|rise| settled(ticks, rise, self.ticks_in(AFTER_RISE_S)));
        let (mut pull, period) = (vec![Lane::ZERO; ticks], period_s(self.period_us));
        for (l, first) in settled.into_iter().enumerate() {
            let ripple = Ripple::draw(config, rng);
            let disturbed = if ripple.in_pressure { &mut pull } else { &mut noise };
            for (n, disturbed) in disturbed.iter_mut().enumerate().skip(first) {
                disturbed[l] += ripple.at(n as f32 * period);
            }
        }
        Scenario {
            ticks,
            scored_from: 0,
            held_tick: ticks,
            probe: None,
            prescribed: Prescribed::new(ticks, of(|s| s.pip), peep, rise_ticks),
            start,
            rest: Lane::from_fn(|l| if self.breath[l] == 0 { 0.0 } else { settings[l].expiratory_bias }),
            noise,
            pull,
            weight: Lane::splat(1.0),
            overshoot_weight: config.overshoot_weight,
            overshoot_from: of(|s| (OVERSHOOT_SHARE * (s.pip - s.peep)).max(LEAST_OVERSHOOT)),
            memory: Some(self.memory.recall()),
            settled,
            strain: self.strain.clone(),
            effort_price: config.effort_price,
            restraint_price: config.restraint_price,
        }
    }

    /// Weights of the lanes after a breath with these scores: errors count in relation to the best breath of the course, which shows
    /// what machine and lung allow.
    pub fn weights(&mut self, score: &Lane, config: &FamilyConfig) -> Lane {
        self.best = self.best.zip(score, f32::min);
        Lane::from_fn(|l| {
            let early = config.early_weights.get(self.breath[l] as usize).copied().unwrap_or(1.0);
            early / self.best[l].max(LEAST_SCORE)
        })
    }

    /// Ends the breath, and offers it to the memory of every lane whose loop was not strained.
    pub fn end(&mut self, tape: &ClosedLoopTape) {
        let ticks = self.ticks();
        self.memory.adopt(tape.signals(), ticks, |l| self.strain.is_on(l));
        (self.plateau, self.plateau_command) = tape.plateau(ticks);
        for breath in &mut self.breath {
            *breath += 1;
        }
    }
}

/// Gain and additional dead time of a loop, ticks: in this share of the loops one of three kinds of strain, with this dead time.
pub(super) fn strain(share: f32, delay: usize, rng: &mut ChaCha8Rng) -> (f32, usize) {
    let kind: f32 = rng.random_range(0.0..1.0);
    let kinds = [(STRAIN_GAINS.1, 0), (1.0, delay), (STRAIN_GAINS.0, 0)];
    let place = (kind / share.max(f32::EPSILON) * kinds.len() as f32) as usize;
    kinds.get(place).copied().unwrap_or((1.0, 0))
}

/// A prescription of a new course.
pub(super) fn prescription(usual: bool, config: &FamilyConfig, rng: &mut ChaCha8Rng) -> Settings {
    let (seed, number) = (rng.random(), rng.random_range(0..u32::MAX));
    if !usual {
        return config.prescriptions.draw(seed, number);
    }
    let settings = config.usual.draw(seed, number);
    let any = rng.random_range(0.0..1.0) < ANY_PIP_SHARE;
    let (low, high) = config.usual.any_pip();
    let pip = if any { rng.random_range(low..high) } else { settings.pip };
    Settings { pip, ..settings }
}

/// A sine in the pressure or in its reading.
struct Ripple {
    /// cmH2O.
    amplitude: f32,
    /// Radians per second.
    speed: f32,
    /// Radians at the start of the inspiration.
    phase: f32,
    /// Whether it is in the pressure itself.
    in_pressure: bool,
}

impl Ripple {
    fn draw(config: &FamilyConfig, rng: &mut ChaCha8Rng) -> Self {
        let [height, frequency, phase]: [f32; 3] = std::array::from_fn(|_| rng.random_range(0.0..1.0));
        let share = config.pressure_ripple_share;
        let in_pressure = share > 0.0 && rng.random_range(0.0..1.0) < share;
        let (low, high) = if in_pressure { config.pressure_ripple_hz } else { config.ripple_hz };
        Self {
            amplitude: config.ripple * height,
            speed: TAU * low * (high / low).powf(frequency),
            phase: TAU * phase,
            in_pressure,
        }
    }

    /// Its value this long after the start of the inspiration, s.
    fn at(&self, time: f32) -> f32 {
        self.amplitude * (self.phase + self.speed * time).sin()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::prescriptions::Prescriptions;
    use rand_chacha::rand_core::SeedableRng;

    fn courses(config: &FamilyConfig) -> Courses {
        Courses::new(50, 1000, 0.9, config, &mut ChaCha8Rng::seed_from_u64(4))
    }

    #[test]
    fn a_course_stays_on_its_machine_with_its_waveform_and_noise() {
        let config = FamilyConfig {
            restart_probability: 0.0,
            lung_change_probability: 0.0,
            ..FamilyConfig::default()
        };
        let (mut courses, rng) = (courses(&config), &mut ChaCha8Rng::seed_from_u64(5));
        let before = (courses.machine, courses.lung, courses.settings, courses.noise);
        courses.breath = [1; LANES];
        (0..100).for_each(|_| courses.pass(&config, rng));
        assert_eq!((courses.machine, courses.lung, courses.settings, courses.noise), before);
    }

    #[test]
    fn courses_start_again_and_lungs_change_as_often_as_configured() {
        let config = FamilyConfig {
            restart_probability: 0.2,
            lung_change_probability: 0.1,
            ..FamilyConfig::default()
        };
        let (mut courses, rng) = (courses(&config), &mut ChaCha8Rng::seed_from_u64(5));
        let (mut restarted, mut changed) = (0, 0);
        for _ in 0..1000 {
            (courses.breath, courses.best) = ([1; LANES], Lane::ZERO);
            courses.pass(&config, rng);
            restarted += courses.breath.iter().filter(|breath| **breath == 0).count();
            changed += (0..LANES).filter(|l| courses.breath[*l] > 0 && courses.best[*l] > 0.0).count();
        }
        let share = |count: usize| count as f32 / (1000 * LANES) as f32;
        assert!(
            (share(restarted) - 0.2).abs() < 0.02 && (share(changed) - 0.08).abs() < 0.02,
            "{restarted} {changed}"
        );
    }

    #[test]
    fn the_courses_of_a_shard_share_their_inspiratory_time_and_differ_in_all_else_that_is_drawn() {
        let prescriptions = Prescriptions::find("bedside").unwrap();
        let config = FamilyConfig { prescriptions, usual_share: 0.5, ..FamilyConfig::default() };
        let rng = &mut ChaCha8Rng::seed_from_u64(5);
        let mut of = |place| Courses::new(50, 1000, place, &config, rng);
        let (usual, drawn) = (of(0.4), of(0.6));
        assert!(usual.settings.iter().all(|s| Settings { pip: 20.0, ..*s } == Settings::default()));
        let times = drawn.settings.map(|s| s.inspiratory_time.to_bits());
        assert!(
            times.iter().all(|time| *time == times[0]) && drawn.settings.iter().all(|s| s.validate().is_ok())
        );
        for value in [|s: &Settings| s.peep, |s: &Settings| s.rate, |s: &Settings| s.expiratory_bias] {
            assert_ne!(value(&drawn.settings[0]).to_bits(), value(&drawn.settings[1]).to_bits());
        }
        let scenario = drawn.scenario(&config, &mut ChaCha8Rng::seed_from_u64(5));
        assert_eq!(scenario.ticks, (1000.0 * drawn.inspiratory_time).round() as usize);
        assert_eq!(scenario.prescribed.peep, Lane(drawn.settings.map(|s| s.peep)));
        for (from, settings) in scenario.overshoot_from.0.iter().zip(drawn.settings) {
            let driving = settings.pip - settings.peep;
            assert!((from - (0.1 * driving).max(1.5)).abs() < 1e-6, "a tenth of the driving pressure");
        }
    }

    #[test]
    fn most_of_the_usual_courses_have_any_pip_that_can_be_set() {
        let config = FamilyConfig::default();
        let rng = &mut ChaCha8Rng::seed_from_u64(5);
        let pips: Vec<f32> = (0..4000).map(|_| prescription(true, &config, rng).pip).collect();
        let beyond = pips.iter().filter(|pip| **pip > 37.0).count() as f32 / 4000.0;
        assert!((beyond - ANY_PIP_SHARE * 23.0 / 53.0).abs() < 0.03, "{beyond}");
        assert!(pips.iter().all(|pip| (7.0..=60.0).contains(pip)));
    }

    #[test]
    fn loops_are_strained_as_often_as_configured() {
        let config = FamilyConfig { strain_share: 0.3, ..FamilyConfig::default() };
        let (mut courses, rng) = (courses(&config), &mut ChaCha8Rng::seed_from_u64(5));
        let mut counts = [0; 4];
        for _ in 0..1000 {
            courses.pass(&config, rng);
            for l in 0..LANES {
                let kind = match (courses.strain.gain[l], courses.strain.delay[l]) {
                    (gain, 0) if gain > 1.5 => 0,
                    (gain, 0) if gain < 0.8 => 1,
                    (_, 10) => 2,
                    (_, _) => 3,
                };
                counts[kind] += 1;
            }
        }
        for (count, share) in counts.iter().zip([0.1, 0.1, 0.1, 0.7]) {
            assert!((*count as f32 / (1000 * LANES) as f32 - share).abs() < 0.02, "{counts:?}");
        }
    }

    #[test]
    fn a_first_breath_begins_with_a_closed_valve_and_early_breaths_weigh_more() {
        let config = FamilyConfig { early_weights: [3.0, 2.0], ..FamilyConfig::default() };
        let mut courses = courses(&config);
        (courses.breath[1], courses.breath[2]) = (4, 1);
        let scenario = courses.scenario(&config, &mut ChaCha8Rng::seed_from_u64(5));
        assert_eq!(
            [scenario.rest[0], scenario.rest[1]].map(f32::to_bits),
            [0.0, courses.settings[1].expiratory_bias].map(f32::to_bits)
        );
        let mut weights = |score: f32| {
            let weights = courses.weights(&Lane::splat(score), &config);
            [weights[0], weights[1], weights[2]].map(|weight| (10.0 * weight).round() as i32)
        };
        assert_eq!(weights(2.0), [15, 5, 10]);
        assert_eq!(weights(4.0)[1], 5, "the best breath counts");
        assert_eq!(weights(1e-3)[1], 33, "but not without limit");
    }

    #[test]
    fn a_ripple_begins_late_in_the_inspiration_with_each_lane_s_own_frequency() {
        let config = FamilyConfig { noise: (1e-6, 2e-6), ripple: 0.5, ..FamilyConfig::default() };
        let scenario = courses(&config).scenario(&config, &mut ChaCha8Rng::seed_from_u64(5));
        let largest = |part: &[Lane], l: usize| part.iter().map(|noise| noise[l].abs()).fold(0.0, f32::max);
        let rippled = [&scenario.noise, &scenario.pull].map(|disturbance| {
            let (before, after) = disturbance.split_at(settled(1000, 0, 200));
            assert!((0..LANES).all(|l| largest(before, l) < 1e-4 && largest(after, l) <= 0.5 + 1e-4));
            (0..LANES).filter(|l| largest(after, *l) > 1e-3).count()
        });
        assert!(
            rippled.iter().all(|lanes| *lanes > 0) && rippled.iter().sum::<usize>() <= LANES,
            "{rippled:?}"
        );
        let after = scenario.noise.split_at(settled(1000, 0, 200)).1;
        let crossings = |l: usize| after.windows(2).filter(|pair| pair[0][l] * pair[1][l] < 0.0).count();
        let counts: Vec<usize> = (0..LANES).map(crossings).collect();
        assert_ne!(counts.iter().min(), counts.iter().max(), "{counts:?}");
    }
}
