//! Open-loop errors of a simulator: its inputs are the start of a breath and the recorded commands.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::episode::Episode;
use super::model::Simulator;
use super::rollout::Rollout;
use super::shard::Shard;
use super::{COMMAND_SCALE, Timing};
use engine::Lane;

/// Errors of a simulator on held-out episodes: mean absolute errors in cmH2O.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct OpenLoop {
    /// Error of the predicted change of pressure over one simulator step, against the measured change.
    pub one_step: f64,
    /// Open-loop distance to the measured pressure, noise included.
    pub measured: f64,
    /// Open-loop distance to the true airway pressure, if the recording contains it.
    pub truth: Option<f64>,
}

/// Open-loop errors of one waveform.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct ByWaveform {
    /// PIP, cmH2O.
    pub pip: f32,
    /// Number of episodes with this PIP.
    pub episodes: usize,
    /// Errors on them.
    pub open_loop: OpenLoop,
}

/// Pressures that a simulator predicts open loop for each episode, cmH2O per control tick.
pub fn predict(simulator: &Simulator, episodes: &[&Episode]) -> Vec<Vec<f32>> {
    let model = simulator.model();
    Shard::cut(episodes)
        .par_iter()
        .flat_map_iter(|shard| {
            let rollout = Rollout::replay(&model, shard, false);
            let lanes: Vec<Lane> = (0..shard.ticks()).map(|tick| rollout.pressure_at(tick)).collect();
            let own = |l: usize, e: &Episode| lanes[..e.ticks()].iter().map(|p| p[l]).collect();
            shard.episodes.iter().enumerate().map(|(l, e)| own(l, e)).collect::<Vec<Vec<f32>>>()
        })
        .collect()
}

/// Errors of a simulator on episodes.
pub fn open_loop(simulator: &Simulator, episodes: &[&Episode]) -> OpenLoop {
    let predictions = predict(simulator, episodes);
    let timing = simulator.architecture.timing();
    let distance = |actual: &dyn Fn(&Episode) -> Option<Vec<f32>>| {
        mean(episodes.iter().zip(&predictions).flat_map(|(episode, predicted)| {
            let actual = actual(episode).unwrap_or_default();
            predicted.iter().zip(actual).map(|(p, a)| f64::from((p - a).abs())).collect::<Vec<_>>()
        }))
    };
    let has_truth = episodes.iter().all(|e| e.truth.is_some()) && !episodes.is_empty();
    OpenLoop {
        one_step: one_step(timing, episodes, &predictions),
        measured: distance(&|e| Some(e.pressure.clone())),
        truth: has_truth.then(|| distance(&|e| e.truth.clone())),
    }
}

/// Increase of the command that tests whether a simulator responds like a plant, percent.
const PROBE: f32 = 5.0;

/// Mean rise of the predicted pressure at these times (s) when every command of the inspiratory valve is higher by five
/// percent of full opening and the commands before the breath are unchanged; cmH2O.
///
/// A plant responds with a rise. A simulator that infers the pressure from the commands of the recording's controller
/// responds with a fall, because that controller opens the valve when the pressure is low.
pub fn response(simulator: &Simulator, episodes: &[&Episode], times: &[f32]) -> Vec<f64> {
    let timing = simulator.architecture.timing();
    let raised: Vec<Episode> = episodes
        .iter()
        .map(|episode| {
            let mut raised = (*episode).clone();
            let inspiratory = raised.commands.iter_mut().step_by(timing.channels);
            inspiratory.for_each(|command| *command += PROBE / COMMAND_SCALE);
            raised
        })
        .collect();
    let before = predict(simulator, episodes);
    let after = predict(simulator, &raised.iter().collect::<Vec<_>>());
    let rise =
        |time: &f32| {
            let tick = shared::math::ticks(*time, timing.period_us) as usize;
            mean(before.iter().zip(&after).filter_map(|(before, after)| {
                Some(f64::from(*after.get(tick)?) - f64::from(*before.get(tick)?))
            }))
        };
    times.iter().map(rise).collect()
}

/// Errors by PIP, in ascending order.
pub fn by_waveform(simulator: &Simulator, episodes: &[&Episode]) -> Vec<ByWaveform> {
    let mut pips: Vec<f32> = episodes.iter().map(|e| e.pip).collect();
    pips.sort_by(f32::total_cmp);
    pips.dedup();
    pips.into_iter()
        .map(|pip| {
            let own: Vec<&Episode> =
                episodes.iter().copied().filter(|e| e.pip.total_cmp(&pip).is_eq()).collect();
            ByWaveform { pip, episodes: own.len(), open_loop: open_loop(simulator, &own) }
        })
        .collect()
}

fn one_step(timing: &Timing, episodes: &[&Episode], predictions: &[Vec<f32>]) -> f64 {
    let step = timing.block_ticks;
    mean(episodes.iter().zip(predictions).flat_map(|(episode, predicted)| {
        (step..predicted.len()).step_by(step).map(move |tick| {
            let change = |p: &[f32]| p[tick] - p[tick - step];
            f64::from((change(predicted) - change(&episode.pressure)).abs())
        })
    }))
}

pub(super) fn mean(values: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = values.fold((0.0, 0_usize), |(sum, count), value| (sum + value, count + 1));
    sum / count.max(1) as f64
}
