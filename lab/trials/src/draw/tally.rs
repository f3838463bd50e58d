//! Many drawn cases: which promises they break, by class.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shared::safety::monitors::Monitors;
use thiserror::Error;

use super::generator::Generator;
use super::promise::{Broken, Promise, broken};
use crate::faults::parts::Part;
use campaign::{Sums, Work, WorkspaceError};
use progress::{Stage, Task};
use ventilator::SourceError;

/// Running drawn cases: cases.
pub const CASES: Stage = Stage("draw faults");
/// Numbers of cases that are kept for each class, the lowest ones.
const KEPT: usize = 3;

/// Why drawn cases cannot be run.
#[derive(Debug, Error)]
pub enum DrawError {
    /// A case failed to run.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// The results cannot be kept or continued.
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
}

/// Which cases: those of a seed, without a monitor or response or with all.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Question {
    /// Seed of the cases.
    pub seed: u64,
    /// Name of what is left out.
    pub without: Option<String>,
}

/// Drawn cases; its units are the cases.
#[derive(Debug)]
pub struct Drawn {
    question: Question,
    monitors: Monitors,
    generator: Generator,
}

impl Drawn {
    /// The cases of a seed, run without this part of the supervisor if one is given.
    ///
    /// # Errors
    /// A family that cannot be read.
    pub fn new(seed: u64, without: Option<Part>) -> Result<Self, SourceError> {
        let question = Question { seed, without: without.map(|part| part.name().to_owned()) };
        let monitors = without.map_or(Monitors::ALL, Part::others);
        Ok(Self { question, monitors, generator: Generator::new(seed)? })
    }

    /// The generator.
    pub fn generator(&self) -> &Generator {
        &self.generator
    }
}

impl Work for Drawn {
    type Question = Question;
    type Sums = Tally;
    type Error = DrawError;

    fn question(&self) -> Question {
        self.question.clone()
    }

    fn nothing(&self) -> Tally {
        Tally::default()
    }

    fn stage(&self) -> (Stage, f64) {
        (CASES, 1.0)
    }

    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<CaseResult>, DrawError> {
        let case = self.generator.draw(number);
        let named = |broken: Broken| match broken.alarm {
            Some(alarm) => (broken.promise, format!("{}: {}", alarm.alarm().id, case.class())),
            None => (broken.promise, case.class()),
        };
        let broken = broken(&case, self.monitors)?.into_iter().map(named).collect();
        task.advance(1);
        Ok(Some(CaseResult { broken }))
    }
}

/// Result of a case: the promises that it broke, each with its class, which is an alarm that should not be there and the faults.
#[derive(Clone, Debug, PartialEq)]
pub struct CaseResult {
    broken: Vec<(Promise, String)>,
}

/// The results of all cases so far.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Tally {
    /// Cases.
    pub cases: u64,
    /// Cases that broke a promise.
    pub failed: u64,
    /// The broken promises, by class.
    pub broken: BTreeMap<Promise, BTreeMap<String, Class>>,
}

/// Cases of a class that broke a promise.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Class {
    /// How many.
    pub cases: u64,
    /// The lowest of their numbers.
    pub first: Vec<u64>,
}

impl Tally {
    /// Cases that broke a promise.
    pub fn that_broke(&self, promise: Promise) -> u64 {
        self.broken.get(&promise).map_or(0, |classes| classes.values().map(|class| class.cases).sum())
    }
}

impl Class {
    fn absorb(&mut self, other: Self) {
        self.cases += other.cases;
        self.first.extend(other.first);
        self.first.sort_unstable();
        self.first.truncate(KEPT);
    }
}

impl Sums for Tally {
    type Unit = CaseResult;

    fn add(&mut self, number: u64, result: CaseResult) {
        let CaseResult { broken } = result;
        let one = || Class { cases: 1, first: vec![number] };
        let failed = u64::from(!broken.is_empty());
        let broken =
            broken.into_iter().map(|(promise, class)| (promise, BTreeMap::from([(class, one())]))).collect();
        self.absorb(Self { cases: 1, failed, broken });
    }

    fn absorb(&mut self, other: Self) {
        self.cases += other.cases;
        self.failed += other.failed;
        for (promise, classes) in other.broken {
            let known = self.broken.entry(promise).or_default();
            for (name, class) in classes {
                known.entry(name).or_default().absorb(class);
            }
        }
    }
}
