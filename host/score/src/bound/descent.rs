//! Gauss-Newton steps for the mean absolute error: the response of the pressure to every node is measured on the bench
//! itself, and reweighted least squares gives the best step within the valve's range.

use std::ops::Range;

use shared::control::COMMAND_MAX;

use super::bench_breath::BenchBreath;
use super::shape::CommandShape;
use plant::bench::Bench;

/// Displacement of a node for measuring its response, percent.
const PROBE_PERCENT: f64 = 1.0;
/// Rounds of reweighting per step.
const REWEIGHTINGS: usize = 6;
/// Sweeps over all nodes per round.
const SWEEPS: usize = 60;
/// Error below which a sample's weight stops growing, cmH2O: first and last round.
const SOFTNESS_CMH2O: (f64, f64) = (0.3, 0.01);
/// Weight of a node's own movement relative to its response; keeps nodes of equal effect from drifting apart.
const DAMPING: f64 = 1e-4;
/// Shares of a step that are tried on the bench.
const SHARES: [f64; 5] = [1.0, 0.6, 0.3, 0.1, 0.03];
/// Factors on the reach after a step without gain, and after a step that was best in full.
const SHRINK: f64 = 0.4;
const GROW: f64 = 1.6;
/// Largest displacement of a node in the first step, percent.
const FIRST_REACH_PERCENT: f64 = 20.0;
/// Bounds of the largest displacement of a node in a step, percent.
const REACH_PERCENT: (f64, f64) = (0.05, 50.0);

/// A command sequence that is being improved.
#[derive(Clone, Debug)]
pub(super) struct Descent<'a> {
    breath: &'a BenchBreath,
    start: Bench,
    /// The command sequence.
    pub(super) shape: CommandShape,
    /// Its score from `start`, cmH2O.
    pub(super) score: f64,
    /// Largest displacement of a node in a step, percent.
    reach: f64,
    /// Direction in which the next responses are measured; they differ because of the valve's backlash.
    probe: f64,
}

/// Change of the pressure when a node moves by one percent: first tick, and cmH2O per tick.
struct StepResponse {
    first: usize,
    change: Vec<f64>,
}

impl<'a> Descent<'a> {
    pub(super) fn new(breath: &'a BenchBreath, start: Bench, shape: CommandShape) -> Self {
        let mut descent =
            Self { breath, start, shape, score: 0.0, reach: FIRST_REACH_PERCENT, probe: PROBE_PERCENT };
        descent.score = descent.score_of(&descent.shape);
        descent
    }

    fn score_of(&self, shape: &CommandShape) -> f64 {
        let pressure = self.breath.inspire(&self.start, &shape.commands());
        self.breath.score(&pressure).score
    }

    /// Adds nodes where the sequence bends by more than `bend`.
    pub(super) fn refine(&mut self, bend: f64) {
        self.shape = self.shape.refined(bend);
        self.reach = FIRST_REACH_PERCENT;
    }

    /// Continues from the periodic state of the present sequence.
    pub(super) fn settle(&mut self) {
        self.start = self.breath.periodic(&self.shape.commands());
        self.score = self.score_of(&self.shape);
    }

    /// Moves some nodes by `distance` percent, within the valve's range.
    pub(super) fn displace(&mut self, nodes: Range<usize>, distance: f64) {
        let step: Vec<f64> =
            (0..self.shape.nodes.len()).map(|n| if nodes.contains(&n) { distance } else { 0.0 }).collect();
        self.shape = self.moved(&step, 1.0);
        self.reach = FIRST_REACH_PERCENT;
    }

    /// Makes one step; returns its gain, cmH2O.
    pub(super) fn step(&mut self) -> f64 {
        let (errors, responses) = self.measure();
        let step = self.solve(&errors, &responses);
        self.probe = -self.probe;
        let candidates = SHARES.iter().map(|share| self.moved(&step, *share));
        let scored = candidates.map(|shape| (self.score_of(&shape), shape));
        let best = scored.enumerate().min_by(|one, other| one.1.0.total_cmp(&other.1.0));
        let Some((tried, (score, shape))) = best else { return 0.0 };
        let factor = match tried {
            _ if score >= self.score => SHRINK,
            0 => GROW,
            _ => SHARES[tried].max(SHRINK),
        };
        self.reach = (self.reach * factor).clamp(REACH_PERCENT.0, REACH_PERCENT.1);
        let gain = self.score - score;
        if gain > 0.0 {
            (self.shape, self.score) = (shape, score);
        }
        gain.max(0.0)
    }

    fn moved(&self, step: &[f64], share: f64) -> CommandShape {
        let limit = f64::from(COMMAND_MAX);
        let values = self.shape.values.iter().zip(step).map(|(v, d)| (v + share * d).clamp(0.0, limit));
        CommandShape { nodes: self.shape.nodes.clone(), values: values.collect() }
    }

    /// Errors of the present sequence, and the response to every node.
    fn measure(&self) -> (Vec<f64>, Vec<StepResponse>) {
        let commands = self.shape.commands();
        let mut bench = self.start.clone();
        let mut pressure = Vec::with_capacity(commands.len());
        // The bench at the tick where each node begins to act.
        let mut begins = Vec::with_capacity(self.shape.nodes.len());
        let firsts: Vec<usize> = (0..self.shape.nodes.len())
            .map(|node| self.shape.reach(node).next().map_or(0, |(tick, _)| tick))
            .collect();
        for (tick, u_in) in commands.iter().enumerate() {
            while firsts.get(begins.len()) == Some(&tick) {
                begins.push(bench.clone());
            }
            pressure.push(self.breath.tick(&mut bench, *u_in));
        }
        let responses = begins.into_iter().enumerate();
        let responses =
            responses.map(|(node, bench)| self.response(node, bench, firsts[node], &commands, &pressure));
        let errors = |(p, target): (&f64, &f64)| p - target;
        (pressure.iter().zip(&self.breath.target).map(errors).collect(), responses.collect())
    }

    fn response(
        &self,
        node: usize,
        mut bench: Bench,
        first: usize,
        commands: &[f32],
        pressure: &[f64],
    ) -> StepResponse {
        let value = self.shape.values[node];
        let inside = (0.0..=f64::from(COMMAND_MAX)).contains(&(value + self.probe));
        let probe = if inside { self.probe } else { -self.probe };
        let mut commands = commands[first..].to_vec();
        for (tick, share) in self.shape.reach(node) {
            commands[tick - first] += (probe * share) as f32;
        }
        let moved = commands.iter().zip(&pressure[first..]);
        let change = moved.map(|(u_in, p)| (self.breath.tick(&mut bench, *u_in) - p) / probe).collect();
        StepResponse { first, change }
    }

    /// The step that minimises the mean absolute error, if responses add up.
    fn solve(&self, errors: &[f64], responses: &[StepResponse]) -> Vec<f64> {
        let mut step = vec![0.0; responses.len()];
        let mut left = errors.to_vec();
        let ratio = SOFTNESS_CMH2O.1 / SOFTNESS_CMH2O.0;
        for round in 0..REWEIGHTINGS {
            let soft = SOFTNESS_CMH2O.0 * ratio.powf(round as f64 / (REWEIGHTINGS - 1) as f64);
            let weights: Vec<f64> = left.iter().map(|e| 1.0 / e.abs().max(soft)).collect();
            self.least_squares(errors, &weights, responses, &mut step);
            left.copy_from_slice(errors);
            for (response, d) in responses.iter().zip(&step) {
                for (left, change) in left[response.first..].iter_mut().zip(&response.change) {
                    *left += d * change;
                }
            }
        }
        step
    }

    /// Weighted least squares within the valve's range and the reach, node by node.
    fn least_squares(&self, errors: &[f64], weights: &[f64], responses: &[StepResponse], step: &mut [f64]) {
        let count = responses.len();
        let mut normal = vec![0.0; count * count];
        let mut slope = vec![0.0; count];
        for (row, response) in responses.iter().enumerate() {
            let weighted: Vec<f64> =
                response.change.iter().zip(&weights[response.first..]).map(|(c, w)| c * w).collect();
            slope[row] = dot(&weighted, &errors[response.first..]);
            for (column, other) in responses[..=row].iter().enumerate() {
                // Nodes are in the order of their ticks: an earlier node's response covers at least the later one's.
                let overlap = &other.change[response.first - other.first..];
                let product = dot(&weighted, overlap);
                normal[row * count + column] = product;
                normal[column * count + row] = product;
            }
        }
        let mean: f64 = (0..count).map(|n| normal[n * count + n]).sum::<f64>() / count.max(1) as f64;
        for _ in 0..SWEEPS {
            for n in 0..count {
                let row = &normal[n * count..(n + 1) * count];
                let own = row[n] + DAMPING * mean;
                let pull = dot(row, step) + slope[n];
                let (low, high) = self.range(n);
                step[n] = (step[n] - (pull + DAMPING * mean * step[n]) / own).clamp(low, high);
            }
        }
    }

    /// How far a node may move down and up, percent.
    fn range(&self, node: usize) -> (f64, f64) {
        let value = self.shape.values[node];
        ((-value).max(-self.reach), (f64::from(COMMAND_MAX) - value).min(self.reach))
    }
}

/// Dot product of two rows of equal length, in four parallel sums: a single sum is four times as slow.
fn dot(one: &[f64], other: &[f64]) -> f64 {
    let (ones, others) = (one.as_chunks::<4>(), other.as_chunks::<4>());
    let mut sums = [0.0; 4];
    for (a, b) in ones.0.iter().zip(others.0) {
        for lane in 0..4 {
            sums[lane] += a[lane] * b[lane];
        }
    }
    let rest: f64 = ones.1.iter().zip(others.1).map(|(a, b)| a * b).sum();
    (sums[0] + sums[1]) + (sums[2] + sums[3]) + rest
}
