//! The breaths of a shard in training: prescriptions, starting states, sensor noise, efforts, and what is done to the loop late in
//! the inspiration.

use engine::{LANES, Lane};
use plant::prescriptions::Prescriptions;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;
use shared::breath::rising;
use shared::control::features::TAP_MAX;
use shared::settings::Settings;

use super::config::TrainConfig;
use super::memory::Recall;
use super::probe::Probe;
use crate::simulator::BreathStart;

/// Share of the inspiration after which the pressure should have settled.
const SETTLED: f32 = 0.4;

/// The waveforms of a shard's inspirations.
#[derive(Clone, Debug)]
pub struct Prescribed {
    /// PIP of each rollout, cmH2O.
    pub pip: Lane,
    /// PEEP of each rollout, cmH2O.
    pub peep: Lane,
    /// Length of the rise from PEEP to PIP, ticks.
    pub rise_ticks: [u32; LANES],
    /// Target at each tick, also beyond the end of the inspiration as far as a feature looks ahead, cmH2O.
    target: Vec<Lane>,
}

impl Prescribed {
    /// Waveforms of this many ticks.
    pub fn new(ticks: usize, pip: Lane, peep: Lane, rise_ticks: [u32; LANES]) -> Self {
        let at = |tick: usize| Lane::from_fn(|l| rising(pip[l], peep[l], rise_ticks[l], tick as u32));
        Self { pip, peep, rise_ticks, target: (0..=ticks + usize::from(TAP_MAX)).map(at).collect() }
    }

    /// Square waveforms from the same PEEP, cmH2O.
    pub fn square(ticks: usize, pip: Lane, peep: f32) -> Self {
        Self::new(ticks, pip, Lane::splat(peep), [0; LANES])
    }

    /// Rise of the target from the tick before, cmH2O; none at the first.
    pub fn rise(&self, tick: usize) -> Lane {
        let before = &self.target[tick.saturating_sub(1)];
        self.target[tick].zip(before, |now, before| now - before)
    }

    /// Target at a tick, cmH2O.
    #[inline]
    pub fn target(&self, tick: usize) -> &Lane {
        &self.target[tick]
    }
}

/// What is done to the loop of each rollout from its settled tick on: the plant gets the change of the command since then late, and
/// larger or smaller than it is. So a margin of the loop becomes an error.
#[derive(Clone, Debug)]
pub struct Strain {
    /// Factor on the change of the command.
    pub gain: Lane,
    /// Additional dead time, ticks.
    pub delay: [usize; LANES],
}

impl Strain {
    /// The loop as it is.
    pub const NONE: Self = Self { gain: Lane([1.0; LANES]), delay: [0; LANES] };

    /// Whether something is done to the loop of a rollout.
    pub fn is_on(&self, l: usize) -> bool {
        self.delay[l] > 0 || self.gain[l].to_bits() != 1.0_f32.to_bits()
    }
}

/// The breaths of a shard.
#[derive(Clone, Debug)]
pub struct Scenario {
    /// Number of ticks of the inspiration.
    pub ticks: usize,
    /// Tick from which the error counts.
    pub scored_from: usize,
    /// Last tick that the controller's clock shows.
    pub held_tick: usize,
    /// What measures the margins of the loops, if anything does.
    pub probe: Option<Probe>,
    /// What each rollout is to follow.
    pub prescribed: Prescribed,
    /// Starting states of the breaths.
    pub start: BreathStart,
    /// Command before the inspiration, percent.
    pub rest: Lane,
    /// What earlier breaths taught; none if every breath is the first.
    pub memory: Option<Recall>,
    /// Tick from which the pressure of each rollout should have settled: moving the valve has a price, and the loop is strained.
    pub settled: [usize; LANES],
    /// What is done to the loop from then on.
    pub strain: Strain,
    /// Price of moving the valve late in the inspiration, cmH2O of error per percent of change per tick.
    pub effort_price: f32,
    /// Price of holding the valve back while the pressure is far below its target, long after it should have reached it, cmH2O of error per
    /// percent.
    pub restraint_price: f32,
    /// Sensor noise of each tick, cmH2O.
    pub noise: Vec<Lane>,
    /// Fall of the pressure by the patient's efforts at each tick, cmH2O; empty without any.
    pub pull: Vec<Lane>,
    /// Weight of each rollout in the loss.
    pub weight: Lane,
    /// Factor on errors above the target, 1 for the plain L1.
    pub overshoot_weight: f32,
    /// Error above which this factor applies, cmH2O.
    pub overshoot_from: Lane,
}

impl Scenario {
    /// Inspirations from a PEEP of 5 cmH2O, without noise.
    #[cfg(test)]
    pub fn plain(ticks: usize, pip: Lane) -> Self {
        Self {
            ticks,
            scored_from: 0,
            held_tick: ticks,
            probe: None,
            prescribed: Prescribed::square(ticks, pip, 5.0),
            settled: [settled(ticks, 0, 0); LANES],
            strain: Strain::NONE,
            start: BreathStart { pressure: Lane::splat(5.0), plateau: pip, ..BreathStart::default() },
            rest: Lane::splat(5.0),
            memory: None,
            effort_price: 0.0,
            restraint_price: 0.0,
            noise: vec![Lane::ZERO; ticks],
            pull: Vec::new(),
            weight: Lane::splat(1.0),
            overshoot_weight: 1.0,
            overshoot_from: Lane::ZERO,
        }
    }

    /// Draws a shard's inspirations of these waveforms, with starting pressures around those of `waveforms`, and sensor noise with the
    /// standard deviation `noise`, cmH2O.
    pub(super) fn draw(
        config: &TrainConfig,
        waveforms: &Waveforms,
        noise: f32,
        rng: &mut ChaCha8Rng,
    ) -> Self {
        let Waveforms { settings, start, period_s } = waveforms;
        let of = |value: fn(&Settings) -> f32| Lane::from_fn(|l| value(&settings[l]));
        let (pip, peep) = (of(|s| s.pip), of(|s| s.peep));
        let ticks = waveforms.ticks();
        let rise_ticks = settings.map(|s| ((s.rise_time / period_s).round() as u32).min(ticks as u32));
        let mut normal = |sd: f32| -> f32 { sd * rng.sample::<f32, _>(StandardNormal) };
        let mut scenario = Self {
            ticks,
            scored_from: 0,
            held_tick: ticks,
            probe: None,
            prescribed: Prescribed::new(ticks, pip, peep, rise_ticks),
            settled: rise_ticks.map(|rise| settled(ticks, rise, 0)),
            strain: Strain::NONE,
            start: BreathStart {
                pressure: start.map(|start| start + normal(config.start_spread)),
                peep,
                plateau: pip,
                ..BreathStart::default()
            },
            rest: of(|s| s.expiratory_bias),
            memory: None,
            effort_price: config.effort_price,
            restraint_price: 0.0,
            noise: (0..ticks).map(|_| Lane::from_fn(|_| normal(noise))).collect(),
            pull: Vec::new(),
            weight: Lane::splat(1.0),
            overshoot_weight: config.overshoot_weight,
            overshoot_from: Lane::ZERO,
        };
        // Last, so that efforts change no other draw.
        if let Some(efforts) = &config.efforts {
            scenario.pull = efforts.draw(ticks, *period_s, rng);
        }
        scenario
    }
}

/// Tick from which the pressure should have settled in an inspiration of this many ticks, `after` ticks after the rise at the
/// earliest; its end if that comes first.
pub(super) fn settled(ticks: usize, rise_ticks: u32, after: usize) -> usize {
    ((SETTLED * ticks as f32) as usize).max(rise_ticks as usize + after).min(ticks)
}

/// What the inspirations of a shard are drawn with.
#[derive(Clone, Debug)]
pub(super) struct Waveforms {
    /// Settings of every lane; they share the inspiratory time.
    pub settings: [Settings; LANES],
    /// Pressure before the inspirations, cmH2O.
    pub start: Lane,
    /// Control period, s.
    pub period_s: f32,
}

impl Waveforms {
    /// The usual waveforms of a training, which start at this pressure, cmH2O: the listed PIPs first, then random ones.
    pub fn usual(config: &TrainConfig, start: f32, period_s: f32, rng: &mut ChaCha8Rng) -> Self {
        let settings = std::array::from_fn(|l| Settings {
            pip: match config.pips.get(l) {
                Some(pip) => *pip,
                None => rng.random_range(config.pip_range.0..config.pip_range.1),
            },
            peep: config.peep,
            expiratory_bias: config.rest,
            inspiratory_time: config.inspiratory_time,
            ..Settings::default()
        });
        Self { settings, start: Lane::splat(start), period_s }
    }

    /// Drawn prescriptions with the inspiratory time of the first one.
    pub fn drawn(prescriptions: &Prescriptions, period_s: f32, rng: &mut ChaCha8Rng) -> Self {
        let (seed, first) = (rng.random(), rng.random_range(0..u32::MAX / 2));
        let inspiratory_time = prescriptions.draw(seed, first).inspiratory_time;
        let settings = std::array::from_fn(|l| Settings {
            inspiratory_time,
            ..prescriptions.draw(seed, first + l as u32)
        });
        Self { settings, start: Lane::from_fn(|l| settings[l].peep), period_s }
    }

    /// Ticks of an inspiration.
    pub fn ticks(&self) -> usize {
        (self.settings[0].inspiratory_time / self.period_s).round() as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::controller::EffortConfig;
    use rand_chacha::rand_core::SeedableRng;

    #[test]
    fn the_price_of_moving_the_valve_is_that_of_the_training() {
        let config = TrainConfig { effort_price: 0.03, ..TrainConfig::default() };
        let rng = &mut ChaCha8Rng::seed_from_u64(7);
        let waveforms = Waveforms::usual(&config, 5.0, 1e-3, rng);
        let drawn = Scenario::draw(&config, &waveforms, 0.1, rng);
        assert_eq!(drawn.effort_price.to_bits(), 0.03_f32.to_bits());
    }

    #[test]
    fn efforts_change_no_other_draw() {
        let passive = TrainConfig::default();
        let breathing = TrainConfig { efforts: Some(EffortConfig::default()), ..passive.clone() };
        let drawn = |config: &TrainConfig| {
            let rng = &mut ChaCha8Rng::seed_from_u64(7);
            let waveforms = Waveforms::usual(config, 5.0, 1e-3, rng);
            Scenario::draw(config, &waveforms, 0.1, rng)
        };
        let (passive, breathing) = (drawn(&passive), drawn(&breathing));
        assert!(passive.pull.is_empty() && breathing.pull.len() == 1000);
        let bits = |lane: &Lane| lane.0.map(f32::to_bits);
        assert_eq!(bits(&passive.prescribed.pip), bits(&breathing.prescribed.pip));
        assert_eq!(bits(&passive.start.pressure), bits(&breathing.start.pressure));
        assert!(passive.noise.iter().zip(&breathing.noise).all(|(one, other)| bits(one) == bits(other)));
    }
}
