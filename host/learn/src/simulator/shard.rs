//! Episodes of a recording in parallel, as the lanes of a rollout.

use super::episode::Episode;
use super::{BreathStart, CommandLog, Timing, USUAL_LUNG};
use engine::{LANES, Lane};

/// Weight of an error in an expiration, relative to an inspiration: simulators are not used in expirations.
const EXPIRATION_WEIGHT: f32 = 0.5;

/// Up to [`LANES`] episodes in parallel.
#[derive(Clone, Debug)]
pub struct Shard<'a> {
    /// The episodes; excess lanes repeat the last one with weight zero.
    pub episodes: Vec<&'a Episode>,
}

impl<'a> Shard<'a> {
    /// Divides episodes into shards.
    pub fn cut(episodes: &[&'a Episode]) -> Vec<Self> {
        episodes.chunks(LANES).map(|chunk| Self { episodes: chunk.to_vec() }).collect()
    }

    /// Longest episode, ticks.
    pub fn ticks(&self) -> usize {
        self.episodes.iter().map(|episode| episode.ticks()).max().unwrap_or(0)
    }

    /// The episode in a lane.
    fn episode(&self, l: usize) -> &'a Episode {
        self.episodes[l.min(self.episodes.len() - 1)]
    }

    fn lane(&self, mut value: impl FnMut(&Episode) -> f32) -> Lane {
        Lane::from_fn(|l| value(self.episode(l)))
    }

    /// The starts of the breaths.
    pub fn start(&self) -> BreathStart {
        BreathStart {
            pressure: self.lane(|episode| episode.start),
            peep: self.lane(|episode| episode.peep),
            plateau: self.lane(|episode| episode.plateau),
            phases: Some([0, 1].map(|phase| self.lane(|episode| episode.phases[phase]))),
            drawn: Lane::ZERO,
            rest: self.lane(|episode| episode.rest[0]),
            group: std::array::from_fn(|l| self.episode(l).group),
            ventilator: std::array::from_fn(|l| self.episode(l).ventilator),
            plateau_command: self.lane(|episode| episode.plateau_command),
            resistance: self.lane(|episode| episode.lung.unwrap_or(USUAL_LUNG).resistance),
            compliance: self.lane(|episode| episode.lung.unwrap_or(USUAL_LUNG).compliance),
        }
    }

    /// The recorded commands.
    pub fn log(&self, timing: &Timing) -> CommandLog {
        let width = timing.width();
        let rest = (0..width).map(|place| self.lane(|episode| episode.rest[place])).collect();
        let blocks = timing.blocks(self.ticks());
        let mut log = CommandLog::new(blocks, rest);
        for block in 0..blocks {
            for (place, lane) in log.block_mut(block).iter_mut().enumerate() {
                *lane = self.lane(|e| e.commands.get(block * width + place).copied().unwrap_or(0.0));
            }
        }
        log
    }

    /// Measured pressure at a tick, cmH2O; after an episode's end, its last pressure.
    pub fn pressure(&self, tick: usize) -> Lane {
        self.lane(|episode| episode.pressure[tick.min(episode.ticks() - 1)])
    }

    /// Weight of an error at this tick: one in an inspiration, less after it, zero where an episode has no such tick.
    pub fn weight(&self, tick: usize) -> Lane {
        let weight = |episode: &Episode| match tick {
            tick if tick < episode.rows.len() => 1.0,
            tick if tick < episode.ticks() => EXPIRATION_WEIGHT,
            _ => 0.0,
        };
        Lane::from_fn(|l| self.episodes.get(l).map_or(0.0, |episode| weight(episode)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::simulator::tests_support::episode;

    #[test]
    fn shards_weigh_ticks_and_rollouts_that_exist() {
        let episodes = [episode(25), episode(25)];
        let shard = &Shard::cut(&episodes.each_ref())[0];
        assert!((shard.weight(24).sum() - 2.0).abs() < 1e-6);
        assert!(shard.weight(25).sum().abs() < 1e-6);
    }
}
