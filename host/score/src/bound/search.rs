//! The search for one waveform: descents from several starts, then from perturbed copies of the best.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::BoundConfig;
use super::bench_breath::BenchBreath;
use super::descent::Descent;
use super::shape::CommandShape;
use super::start::look_ahead;
use plant::bench::ValveConfig;
use progress::Task;

/// Horizons of the starts, relative to the time that the valve needs to act.
const HORIZONS: [f64; 3] = [0.8, 1.2, 1.6];
/// Horizon of the breaths before a breath from rest.
const EARLIER_HORIZON: f64 = 1.2;
/// Shortest horizon, for a valve that acts immediately, ms.
const LEAST_HORIZON_MS: f64 = 5.0;
/// Block length of the starts, ms.
const BLOCK_MS: f64 = 5.0;
/// Spacing of the first nodes, ms; each level halves it where the command bends.
const SPACING_MS: f64 = 8.0;
/// Time from which on only every fourth of the first nodes stays, ms: by then, the command of a long inspiration hardly bends, and
/// the time of a step grows with the third power of the nodes.
const DENSE_MS: f64 = 1000.0;
const THINNED: usize = 4;
/// Levels of refinement of every start, down to 2 ms; the best start gets one more.
const LEVELS: usize = 3;
/// Bend of the command above which nodes are added, percent.
const BEND_PERCENT: f64 = 0.5;
/// Largest number of steps on a level.
const STEPS: usize = 15;
/// Number of perturbed copies of the best.
const SHAKES: usize = 4;
/// Displacement of the nodes in a perturbation, percent.
const SHAKE_PERCENT: f64 = 40.0;
/// Largest number of neighbouring nodes that a perturbation moves.
const SHAKEN_NODES: usize = 8;
/// A level is done when both probing directions gained less than this share of the score.
const ENOUGH: f64 = 1e-4;
/// Command of the breaths before the first start, percent: any value that fills the lung somewhat.
const BEFORE_PERCENT: f32 = 20.0;

/// The best sequence found.
pub(super) struct Found {
    /// Command of every tick, percent.
    pub(super) commands: Vec<f32>,
    /// Score of the second-best start minus that of the best, cmH2O.
    pub(super) spread: f64,
}

/// Number of progress stages of a search.
pub(super) fn stages(config: &BoundConfig) -> usize {
    HORIZONS.len() * LEVELS + 1 + shakes(config)
}

fn shakes(config: &BoundConfig) -> usize {
    SHAKES * config.effort.max(1) as usize
}

fn steps(config: &BoundConfig) -> usize {
    STEPS * config.effort.max(1) as usize
}

/// The breath with the bench of the one with this number from rest, after breaths whose commands look ahead.
pub(super) fn at_breath(breath: &BenchBreath, valve: &ValveConfig, number: u32) -> BenchBreath {
    let horizon = horizon_ticks(breath, valve, EARLIER_HORIZON);
    breath.at_breath(number, |bench| look_ahead(breath, bench, ticks(breath, BLOCK_MS), horizon))
}

/// Horizon of a start, in ticks, for one that is relative to the time that the valve needs to act.
fn horizon_ticks(breath: &BenchBreath, valve: &ValveConfig, horizon: f64) -> usize {
    ticks(breath, (horizon * (valve.dead_time_ms + valve.lag_ms)).max(LEAST_HORIZON_MS))
}

fn ticks(breath: &BenchBreath, ms: f64) -> usize {
    ((ms / breath.tick_ms()).round() as usize).max(1)
}

/// Searches the best sequence; `None` if stopped. `number` gives each waveform its own random perturbations.
pub(super) fn search(
    breath: &BenchBreath,
    valve: &ValveConfig,
    config: &BoundConfig,
    number: u64,
    task: &Task<'_>,
) -> Option<Found> {
    let ticks = |ms: f64| ticks(breath, ms);
    let mut ends = Vec::with_capacity(HORIZONS.len());
    for horizon in HORIZONS {
        let horizon = horizon_ticks(breath, valve, horizon);
        let start = breath.periodic(&vec![BEFORE_PERCENT; breath.ticks()]);
        let commands = look_ahead(breath, &start, ticks(BLOCK_MS), horizon);
        let shape = CommandShape::through(&commands, ticks(SPACING_MS)).thinned(ticks(DENSE_MS), THINNED);
        let mut descent = Descent::new(breath, breath.periodic(&commands), shape);
        for level in 0..LEVELS {
            if level > 0 {
                descent.refine(BEND_PERCENT);
            }
            go_down(&mut descent, steps(config), task)?;
            task.advance(1);
        }
        ends.push(descent);
    }
    ends.sort_by(|one, other| one.score.total_cmp(&other.score));
    let spread = ends[1].score - ends[0].score;
    let mut best = ends.swap_remove(0);
    best.refine(BEND_PERCENT);
    go_down(&mut best, steps(config), task)?;
    task.advance(1);
    let best = shake(best, config, number, task)?;
    Some(Found { commands: best.shape.commands(), spread })
}

/// Steps until there is no further gain; the periodic state is updated once in between.
fn go_down(descent: &mut Descent<'_>, steps: usize, task: &Task<'_>) -> Option<()> {
    descent.settle();
    let mut idle = 0;
    for _ in 0..steps {
        if task.stopped() {
            return None;
        }
        let gain = descent.step();
        idle = if gain < ENOUGH * descent.score { idle + 1 } else { 0 };
        if idle >= 2 {
            break;
        }
    }
    descent.settle();
    Some(())
}

/// Moves a few neighbouring nodes of the best sequence, descends again and keeps the better result.
fn shake<'a>(
    mut best: Descent<'a>,
    config: &BoundConfig,
    number: u64,
    task: &Task<'_>,
) -> Option<Descent<'a>> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    rng.set_stream(number);
    for _ in 0..shakes(config) {
        let mut shaken = best.clone();
        // Nodes are dense where the command bends, so most perturbations are there.
        let first = rng.random_range(0..shaken.shape.nodes.len());
        let moved = first..first + rng.random_range(1..=SHAKEN_NODES);
        shaken.displace(moved, SHAKE_PERCENT * rng.random_range(-1.0..1.0));
        go_down(&mut shaken, steps(config), task)?;
        if shaken.score < best.score {
            best = shaken;
        }
        task.advance(1);
    }
    Some(best)
}
