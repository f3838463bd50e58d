//! Shared by the simulators' tests: gradients against finite differences, and a breath.

use super::episode::Episode;
use super::model::{Architecture, Model};
use super::{BreathStart, CommandLog, Timing, USUAL_LUNG};
use engine::{LANES, Lane};

/// An inspiration of a lung with R 20 and C 20, for a simulator with one command per block.
pub(super) fn episode(ticks: usize) -> Episode {
    Episode {
        pressure: (0..ticks).map(|tick| 5.0 + 0.5 * tick as f32).collect(),
        truth: None,
        commands: vec![0.5; ticks],
        rest: vec![0.1],
        start: 5.0,
        plateau: 15.0,
        phases: [1.0, 2.0],
        plateau_command: 0.3,
        pip: 15.0,
        peep: 5.0,
        group: None,
        ventilator: None,
        rows: 0..ticks,
        lung: Some(USUAL_LUNG),
    }
}

const BLOCKS: usize = 8;

fn start() -> BreathStart {
    BreathStart {
        pressure: Lane::from_fn(|l| 5.0 + 0.1 * l as f32),
        peep: Lane::from_fn(|l| 4.0 + 0.05 * l as f32),
        plateau: Lane::from_fn(|l| 10.0 + l as f32),
        drawn: Lane::from_fn(|l| 0.05 * l as f32),
        phases: Some([1.0, 0.8].map(|longest| Lane::from_fn(|l| longest - 0.02 * l as f32))),
        rest: Lane::from_fn(|l| 0.2 + 0.02 * l as f32),
        plateau_command: Lane::from_fn(|l| 1.2 - 0.05 * l as f32),
        group: std::array::from_fn(|l| (l as u32 % 4).checked_sub(1)),
        ventilator: std::array::from_fn(|l| (l as u32 % 3).checked_sub(1)),
        resistance: Lane::from_fn(|l| 5.0 + 3.0 * l as f32),
        compliance: Lane::from_fn(|l| 50.0 - 2.5 * l as f32),
    }
}

fn commands(width: usize) -> CommandLog {
    let mut log = CommandLog::new(BLOCKS, vec![Lane::splat(0.1); width]);
    for block in 0..BLOCKS {
        for (part, lane) in log.block_mut(block).iter_mut().enumerate() {
            *lane = Lane::from_fn(|l| 0.5 + 0.5 * ((3 * block + part + l) as f32).sin());
        }
    }
    log
}

/// Weights of the sum over blocks, points and rollouts of `weight * pressure`; all differ.
fn weight(block: usize, point: usize, l: usize) -> f32 {
    0.1 * ((block * 31 + point * 17 + l * 7) as f32).cos()
}

fn loss(model: &Model, log: &CommandLog) -> f64 {
    let (mut dynamics, mut points) =
        (model.dynamics(BLOCKS), vec![Lane::ZERO; model.architecture().timing().points]);
    dynamics.begin(&start());
    let mut total = 0.0;
    for block in 0..BLOCKS {
        dynamics.step(block, log, &mut points);
        for (n, point) in points.iter().enumerate() {
            total += (0..LANES).map(|l| f64::from(weight(block, n, l) * point[l])).sum::<f64>();
        }
    }
    total
}

/// Compares analytic gradients with respect to commands and a sample of the parameters with central differences.
pub(super) fn check_gradients(architecture: Architecture, parameters: &[f32]) {
    let some = (0..parameters.len()).step_by((parameters.len() / 150).max(1));
    check_gradients_by(some, architecture, parameters);
}

/// Compares analytic gradients with respect to commands and the parameters of these indices with central differences.
pub(super) fn check_gradients_by(
    indices: impl Iterator<Item = usize>,
    architecture: Architecture,
    parameters: &[f32],
) {
    check_gradients_in_steps(5e-3, indices, architecture, parameters);
}

/// Like [`check_gradients_by`], with central differences of this width: a narrow one for a model with kinks.
pub(super) fn check_gradients_in_steps(
    step: f32,
    indices: impl Iterator<Item = usize>,
    architecture: Architecture,
    parameters: &[f32],
) {
    let Timing { points, .. } = *architecture.timing();
    let width = architecture.timing().width();
    let model = Model::new(architecture, parameters);
    let mut log = commands(width);
    let (mut dynamics, mut pressures) = (model.dynamics(BLOCKS), vec![Lane::ZERO; points]);
    dynamics.begin(&start());
    for block in 0..BLOCKS {
        dynamics.step(block, &log, &mut pressures);
    }
    let mut d_log = CommandLog::new(BLOCKS, vec![Lane::ZERO; width]);
    for block in (0..BLOCKS).rev() {
        let d: Vec<Lane> = (0..points).map(|n| Lane::from_fn(|l| weight(block, n, l))).collect();
        dynamics.step_back(block, &d, &mut d_log);
    }
    let mut gradient = vec![0.0; parameters.len()];
    dynamics.finish(&mut gradient);

    let agree = |numeric: f64, analytic: f32, what: &str| {
        let tolerance = 0.02 * f64::from(analytic.abs()) + 0.02;
        assert!((numeric - f64::from(analytic)).abs() < tolerance, "{what}: {numeric} against {analytic}");
    };
    let mut varied = parameters.to_vec();
    for n in indices {
        varied[n] = parameters[n] + step;
        let above = loss(&Model::new(architecture, &varied), &log);
        varied[n] = parameters[n] - step;
        let below = loss(&Model::new(architecture, &varied), &log);
        varied[n] = parameters[n];
        agree((above - below) / f64::from(2.0 * step), gradient[n], &format!("parameter {n}"));
    }
    for (block, part, l) in [(0, 0, 0), (3, width - 1, 9), (5, 0, 15)] {
        let kept = log.block(Some(block))[part][l];
        log.block_mut(block)[part][l] = kept + step;
        let above = loss(&model, &log);
        log.block_mut(block)[part][l] = kept - step;
        let below = loss(&model, &log);
        log.block_mut(block)[part][l] = kept;
        let analytic = d_log.block(Some(block))[part][l];
        agree((above - below) / f64::from(2.0 * step), analytic, &format!("command of block {block}"));
    }
}
