//! The paper's experiments on the virtual bench, and further ones (Suo et al. 2021, section 6).
//!
//! [`run`] divides the experiments into pieces, which run side by side, in three groups: what the others need comes first. Each piece
//! keeps its result as JSON in the folder, so that a stopped run can continue and pieces can use earlier results. At the end, all
//! results in the folder are combined into `results.json` and one report.
#![forbid(unsafe_code)]

mod ablations;
pub mod authors;
mod balloon;
mod changes;
mod generalist;
mod iso;
mod learning;
mod limits;
mod lungs;
mod report;
mod reproduction;
mod results;
mod rivals;
pub mod shards;
mod study;
#[cfg(test)]
mod tests;
mod tracking;
mod unseen;

use campaign::on_threads;
use progress::Progress;

use self::study::{Piece, Study, piece};
use ::study::Result;
pub use ablations::Ablation;
pub use report::{headline, lungs_table};
pub use reproduction::{Budget, Experiment, Reproduction};
pub use results::{
    BalloonFigures, EffortFigures, IsoFigures, LungFigures, LungMeans, Results, RlFigure, RlFigures,
    UnseenFigures,
};
pub use rivals::{Contender, Contest};

impl Experiment {
    /// The experiments in groups: those of a group need only earlier groups. Within a group, long pieces come first.
    const GROUPS: [&[Self]; 3] = [
        &[Self::Tuning],
        &[Self::Generalist, Self::Lungs, Self::Balloon, Self::Ablations, Self::Bound],
        &[Self::Rl, Self::Unseen, Self::Rivals, Self::Tracking, Self::Iso, Self::Changes],
    ];

    /// The experiments that this one needs.
    fn needs(self) -> &'static [Self] {
        match self {
            Self::Tuning | Self::Bound | Self::Balloon | Self::Rivals => &[],
            Self::Lungs | Self::Generalist | Self::Ablations => &[Self::Tuning],
            Self::Unseen | Self::Changes | Self::Iso => &[Self::Tuning, Self::Generalist],
            Self::Rl => &[Self::Tuning, Self::Lungs],
            Self::Tracking => &[Self::Tuning, Self::Lungs, Self::Generalist],
        }
    }

    /// Whether a run of `only` includes this one.
    fn runs_for(self, only: &[Self]) -> bool {
        only.iter().any(|chosen| *chosen == self || chosen.needs().contains(&self))
    }

    /// Number of its pieces, which is known before earlier groups are done.
    fn count(self, study: &Study<'_>) -> usize {
        match self {
            Self::Tuning
            | Self::Generalist
            | Self::Bound
            | Self::Tracking
            | Self::Changes
            | Self::Iso
            | Self::Balloon => 1,
            Self::Lungs => study.lungs().len(),
            Self::Unseen => unseen::plants().len(),
            Self::Rivals => study.lungs().len() + unseen::plants().len(),
            Self::Rl => learning::PIECES,
            Self::Ablations => ablations::count(study),
        }
    }

    /// Its pieces of work.
    fn pieces<'a>(self, study: &'a Study<'_>) -> Result<Vec<Piece<'a>>> {
        Ok(match self {
            Self::Tuning => vec![piece(|| lungs::tuned(study))],
            Self::Lungs => lungs::pieces(study)?,
            Self::Generalist => vec![piece(|| generalist::generalist(study))],
            Self::Bound => vec![piece(|| limits::limits(study))],
            Self::Tracking => vec![piece(|| tracking::tracking(study))],
            Self::Unseen => unseen::pieces(study)?,
            Self::Rivals => rivals::pieces(study)?,
            Self::Changes => vec![piece(|| changes::changes(study))],
            Self::Iso => vec![piece(|| iso::iso(study))],
            Self::Balloon => vec![piece(|| balloon::balloon(study))],
            Self::Rl => learning::pieces(study)?,
            Self::Ablations => ablations::pieces(study)?,
        })
    }
}

/// Runs the experiments, then writes all results in the folder as `results.json`, `report.html` and `results.md`.
///
/// # Errors
/// The error of the first experiment that fails; results of earlier ones stay.
pub fn run(reproduction: &Reproduction, progress: &Progress<'_>) -> Result<Results> {
    let study = Study::new(reproduction, progress)?;
    for group in Experiment::GROUPS {
        let mut pieces = Vec::new();
        for experiment in group.iter().filter(|experiment| experiment.runs_for(&reproduction.only)) {
            pieces.extend(experiment.pieces(&study)?);
        }
        on_threads(rayon::current_num_threads(), pieces.iter(), |piece| piece())?;
    }
    let results = Results::gather(&study)?;
    study.folder.save_indented("results.json", &results)?;
    let report = report::report(&study, &results)?;
    report.save(study.folder.path("report.html"))?;
    report.save_markdown(&reproduction.out, "results")?;
    Ok(results)
}
