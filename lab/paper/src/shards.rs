//! A reproduction divided among tasks that share its folder.
//!
//! The units are the experiments' pieces. A piece needs the results of all earlier groups. So before a task runs its own piece, it runs
//! whatever is open in those groups, and waits for what other tasks are running, as their [`Claims`] show.

use std::collections::BTreeSet;

use campaign::claims::{Claims, State};
use campaign::shards::RunFolder;
use campaign::{Sums, Work};
use serde::{Deserialize, Serialize};

use super::study::Study;
use super::{Budget, Experiment, Reproduction};
use plant::bench::BenchConfig;
use progress::{Progress, Stage, Task};
use study::{Result, StudyError};

/// The paper's experiments, divided among tasks: pieces.
pub const PIECES: Stage = Stage("run experiments");

/// A reproduction as the work of a campaign.
#[derive(Clone, Debug)]
pub struct Shards<'a>(pub &'a Reproduction);

/// What the pieces are about.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Question {
    seed: u64,
    budget: Budget,
    lungs: Vec<BenchConfig>,
    only: Vec<Experiment>,
}

/// The pieces that are done; their results are in the reproduction's folder.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Pieces(BTreeSet<u64>);

impl Sums for Pieces {
    type Unit = ();

    fn add(&mut self, number: u64, (): ()) {
        self.0.insert(number);
    }

    fn absorb(&mut self, other: Self) {
        self.0.extend(other.0);
    }
}

impl Shards<'_> {
    /// Number of pieces.
    pub fn pieces(&self) -> u64 {
        self.places(&Study::unclaimed(self.0, &Progress::silent())).len() as u64
    }

    /// Group, experiment and number within the experiment of every piece, in order.
    fn places(&self, study: &Study<'_>) -> Vec<(usize, Experiment, usize)> {
        let groups = Experiment::GROUPS.iter().enumerate();
        let experiments =
            groups.flat_map(|(group, list)| list.iter().map(move |experiment| (group, *experiment)));
        let chosen = experiments.filter(|(_, experiment)| experiment.runs_for(&self.0.only));
        chosen
            .flat_map(|(group, experiment)| {
                (0..experiment.count(study)).map(move |number| (group, experiment, number))
            })
            .collect()
    }

    /// Runs a piece, unless it is done, once all earlier groups are done.
    fn run(&self, number: usize, study: &Study<'_>, claims: &Claims) -> Result<()> {
        let places = self.places(study);
        let (own_group, ..) = places[number];
        let earlier = |group: usize| (0..places.len()).filter(|other| places[*other].0 == group).collect();
        for group in 0..own_group {
            complete(earlier(group), &places, study, claims)?;
        }
        complete(vec![number], &places, study, claims)
    }
}

/// Runs the pieces with these numbers, and waits for those that others run.
fn complete(
    mut open: Vec<usize>,
    places: &[(usize, Experiment, usize)],
    study: &Study<'_>,
    claims: &Claims,
) -> Result<()> {
    loop {
        let mut waiting = Vec::new();
        for number in open {
            if study.progress.stopped() {
                return Err(StudyError::Stopped);
            }
            let (_, experiment, place) = places[number];
            let name = format!("{experiment:?}-{place}").to_lowercase();
            match claims.take(&name)? {
                State::Done => {}
                State::Elsewhere => waiting.push(number),
                State::Mine => {
                    let outcome = experiment.pieces(study).and_then(|pieces| pieces[place]());
                    claims.release(&name, outcome.is_ok())?;
                    outcome?;
                }
            }
        }
        if waiting.is_empty() {
            return Ok(());
        }
        open = waiting;
        std::thread::sleep(Claims::LOOK_EVERY);
    }
}

impl Work for Shards<'_> {
    type Question = Question;
    type Sums = Pieces;
    type Error = StudyError;

    fn question(&self) -> Question {
        let Reproduction { seed, budget, lungs, only, .. } = self.0;
        Question { seed: *seed, budget: budget.clone(), lungs: lungs.clone(), only: only.clone() }
    }

    fn nothing(&self) -> Pieces {
        Pieces::default()
    }

    fn stage(&self) -> (Stage, f64) {
        (PIECES, 1.0)
    }

    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<()>> {
        let progress = task.quiet();
        let study = Study::new(self.0, &progress)?;
        let claims = Claims::new(&RunFolder::new(&self.0.out).claims_folder());
        let outcome = claims.renewed(|| self.run(number as usize, &study, &claims));
        match outcome {
            Err(StudyError::Stopped) => Ok(None),
            outcome => {
                outcome?;
                task.advance(1);
                Ok(Some(()))
            }
        }
    }
}
