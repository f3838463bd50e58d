//! Compares a learned controller with its PID, waveform by waveform, under the same noise.

use serde::Serialize;
use shared::settings::Settings;
use thiserror::Error;

use super::{EVALUATE, Ground, Plan, Score, waveform_name, waveform_title};
use progress::Progress;
use ventilator::SourceError;

/// Scores under the same noise.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pair {
    /// The PID alone.
    pub pid: Score,
    /// The learned controller, if there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub learned: Option<Score>,
}

/// Scores of one waveform.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WaveformPair {
    /// PIP, cmH2O.
    pub pip: f32,
    /// All settings, if the waveforms differ in more than their PIPs.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub settings: Option<Settings>,
    /// Scores of PID and learned controller.
    #[serde(flatten)]
    pub pair: Pair,
}

impl WaveformPair {
    /// Name of the waveform in reports.
    pub fn name(&self) -> String {
        waveform_name(self.pip, self.settings.as_ref())
    }

    /// The name with its unit.
    pub fn title(&self) -> String {
        waveform_title(self.pip, self.settings.as_ref())
    }
}

/// A comparison over all waveforms.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Scores by waveform, in the plan's order; only the completed ones if the comparison was stopped.
    pub waveforms: Vec<WaveformPair>,
    /// Mean over the waveforms.
    pub mean: Pair,
}

impl Comparison {
    /// Adds the mean over the waveforms; it has a learned controller if all waveforms have one.
    pub fn new(waveforms: Vec<WaveformPair>) -> Self {
        let pid: Vec<Score> = waveforms.iter().map(|w| w.pair.pid).collect();
        let learned: Option<Vec<Score>> = waveforms.iter().map(|w| w.pair.learned).collect();
        let learned = learned.filter(|scores| !scores.is_empty()).map(|scores| Score::mean(&scores));
        Self { waveforms, mean: Pair { pid: Score::mean(&pid), learned } }
    }
}

/// A waveform that could not be run.
#[derive(Debug, Error)]
#[error("{controller}, {waveform}: {source}")]
pub struct CompareError {
    controller: &'static str,
    waveform: Box<str>,
    source: SourceError,
}

/// Scores a PID and, if given, a learned controller waveform by waveform. A stopped comparison keeps the completed
/// waveforms.
///
/// # Errors
/// The error of the first waveform that could not be run.
pub fn compare<C>(
    ground: &dyn Ground<C>,
    pid: &C,
    learned: Option<&C>,
    plan: &Plan,
    progress: &Progress<'_>,
) -> Result<Comparison, CompareError> {
    let controllers = 1 + usize::from(learned.is_some());
    let task = progress.task(EVALUATE, controllers * plan.waveforms.len() * plan.seeds.len());
    let one = |waveform: &Settings| -> Result<WaveformPair, CompareError> {
        let (pip, settings) = (waveform.pip, plan.beside_pip(waveform));
        let plan = Plan { waveforms: vec![*waveform], ..plan.clone() };
        let score = |name, controller| match ground.evaluate(controller, &plan, &task.part()) {
            Ok(evaluation) => Ok(evaluation.mean),
            Err(source) => {
                let waveform = waveform_title(pip, settings.as_ref()).into();
                Err(CompareError { controller: name, waveform, source })
            }
        };
        let pid = score("PID", pid)?;
        let learned = learned.map(|controller| score("learned controller", controller)).transpose()?;
        Ok(WaveformPair { pip, settings, pair: Pair { pid, learned } })
    };
    let mut waveforms = Vec::with_capacity(plan.waveforms.len());
    for waveform in &plan.waveforms {
        match one(waveform) {
            Ok(pair) => waveforms.push(pair),
            Err(CompareError { source: SourceError::Stopped, .. }) => break,
            Err(error) => return Err(error),
        }
    }
    Ok(Comparison::new(waveforms))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::atomic::{AtomicBool, Ordering};

    use crate::evaluate::at_pips;
    use plant::bench::BenchConfig;
    use progress::Event;
    use shared::control::Controller;
    use shared::control::pid::Pid;
    use shared::device::KNOWN_GOOD;

    fn comparison(pid: f64, learned: Option<f64>) -> Comparison {
        let score = |score| Score { score, rise_ms: 90.0, ..Score::default() };
        let pair = Pair { pid: score(pid), learned: learned.map(score) };
        Comparison::new([15.0, 20.0].map(|pip| WaveformPair { pip, settings: None, pair }).to_vec())
    }

    #[test]
    fn an_entry_holds_pid_and_learned_side_by_side() {
        let json = serde_json::to_value(comparison(2.0, Some(1.5))).unwrap();
        let entry = &json["waveforms"][0];
        assert_eq!((&entry["pip"], &entry["pid"]["score"]), (&15.0.into(), &2.0.into()));
        assert_eq!(entry["learned"]["score"], 1.5);
        assert_eq!(json["mean"]["learned"]["rise_ms"], 90.0);
    }

    #[test]
    fn a_pid_alone_has_no_learned_figures() {
        let alone = serde_json::to_value(comparison(2.0, None)).unwrap();
        assert!(alone["waveforms"][0].get("learned").is_none());
    }

    #[test]
    fn a_comparison_that_is_stopped_keeps_the_waveforms_that_are_done() {
        let plan = Plan {
            waveforms: at_pips(&[15.0, 30.0], &Settings::default()),
            breaths: 1,
            ..Plan::evaluation(0)
        };
        let bench = BenchConfig::paper(20.0, 20.0);
        let pid = Controller::Pid(Pid::new(KNOWN_GOOD, plan.period_us).unwrap());
        let whole = compare(&bench, &pid, None, &plan, &Progress::silent()).unwrap();
        assert_eq!(whole.waveforms.len(), 2);
        let stop = AtomicBool::new(false);
        let after_the_first = |event: &Event<'_>| {
            assert_eq!(event.total, 2 * plan.seeds.len());
            stop.fetch_or(event.done >= plan.seeds.len(), Ordering::Relaxed);
        };
        let half = compare(&bench, &pid, None, &plan, &Progress::new(&after_the_first, &stop)).unwrap();
        assert_eq!(half.waveforms, whole.waveforms[..1]);
    }
}
