//! The start of a search: block by block, the command with the smallest error over a short horizon.

use super::bench_breath::BenchBreath;
use plant::bench::Bench;

/// Candidates on each level of the search for a block's command.
const CANDIDATES: usize = 7;
/// Number of levels; each narrows the range to a third around its best candidate.
const LEVELS: usize = 5;

/// The sequence found by holding a command for `horizon` ticks ahead, chosen again every `block` ticks.
pub(super) fn look_ahead(breath: &BenchBreath, start: &Bench, block: usize, horizon: usize) -> Vec<f32> {
    let ticks = breath.ticks();
    let mut bench = start.clone();
    let mut commands = Vec::with_capacity(ticks);
    while commands.len() < ticks {
        let from = commands.len();
        let target = &breath.target[from..(from + horizon).min(ticks)];
        let u_in = best_held(breath, &bench, target);
        for _ in from..(from + block).min(ticks) {
            breath.tick(&mut bench, u_in);
            commands.push(u_in);
        }
    }
    commands
}

/// The command that, when held, keeps the pressure closest to `target`.
fn best_held(breath: &BenchBreath, bench: &Bench, target: &[f64]) -> f32 {
    let (mut low, mut high, mut best) = (0.0_f32, 100.0_f32, 0.0_f32);
    for _ in 0..LEVELS {
        let width = (high - low) / (CANDIDATES - 1) as f32;
        let distance = |u_in: f32| {
            let mut bench = bench.clone();
            target.iter().map(|target| (breath.tick(&mut bench, u_in) - target).abs()).sum::<f64>()
        };
        let candidates = (0..CANDIDATES).map(|n| low + n as f32 * width);
        let scored = candidates.map(|u_in| (distance(u_in), u_in));
        best = scored.min_by(|one, other| one.0.total_cmp(&other.0)).map_or(best, |(_, u_in)| u_in);
        (low, high) = ((best - width).max(0.0), (best + width).min(100.0));
    }
    best
}
