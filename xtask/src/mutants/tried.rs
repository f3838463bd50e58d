//! Tries mutants: builds those that can be grafted together, and each of the others alone.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::PathBuf;
use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

use anyhow::{Context, Result, bail, ensure};
use xshell::Shell;

use super::graft::{self, Grafted, graft};
use super::mutant::{Mutant, Outcome, Outcomes};
use super::tree::{Built, Serves, Tree};
use super::trial::Trial;

/// Root of the core, to which [`graft::ROOT`] is added.
const CRATE_ROOT: &str = "shared/src/lib.rs";
/// What this run and those that it resumes have found.
const EARLIER: &str = "target/mutants/earlier.json";
/// Mutants after which that is stored.
const STORED_AFTER: usize = 50;

/// Mutants by their numbers.
type Numbered<'a> = BTreeMap<u32, &'a Mutant>;

/// Tries all mutants; to resume means not to try those again which are caught or do not compile.
pub fn try_all(shell: &Shell, jobs: usize, resume: bool, mutants: &[Mutant]) -> Result<Outcomes> {
    let outcomes = if resume { earlier(shell)? } else { Outcomes::new() };
    let is_done =
        |mutant: &Mutant| outcomes.get(&mutant.name).is_some_and(|outcome| *outcome != Outcome::Survived);
    let mut untried: Numbered = (1..).zip(mutants).filter(|(_, mutant)| !is_done(mutant)).collect();
    let findings = Findings::new(shell, outcomes.clone(), untried.len());
    let core = Core::new(shell, mutants)?;
    let (program, alone) = core.build_together(&mut untried, &findings)?;
    let trial = Trial::new(program, core.tree.folder())?;
    let alone: Numbered = alone.into_iter().filter_map(|number| untried.remove_entry(&number)).collect();
    try_together(&trial, jobs, &untried, &findings)?;
    core.try_alone(&alone, &findings)?;
    findings.store()?;
    Ok(findings.outcomes.into_inner().unwrap_or_default())
}

fn earlier(shell: &Shell) -> Result<Outcomes> {
    if !shell.path_exists(EARLIER) {
        return Ok(Outcomes::new());
    }
    serde_json::from_str(&shell.read_file(EARLIER)?).context(EARLIER)
}

/// Tries the mutants of one program side by side.
fn try_together(trial: &Trial, jobs: usize, mutants: &Numbered, findings: &Findings) -> Result<()> {
    let (mutants, next): (Vec<_>, _) = (mutants.iter().collect(), AtomicUsize::new(0));
    let work = || {
        while let Some((number, mutant)) = mutants.get(next.fetch_add(1, Ordering::Relaxed)) {
            let caught = trial.catches(**number, &mutant.file)?;
            let outcome = if caught { Outcome::Caught } else { Outcome::Survived };
            findings.add(mutant, outcome)?;
        }
        Ok(())
    };
    thread::scope(|scope| {
        let workers: Vec<_> = (0..jobs).map(|_| scope.spawn(work)).collect();
        workers.into_iter().try_for_each(|worker| match worker.join() {
            Ok(result) => result,
            Err(_) => bail!("a worker has panicked"),
        })
    })
}

/// The sources that are mutated, and the tree in which they are built.
struct Core<'a> {
    tree: Tree<'a>,
    sources: BTreeMap<String, String>,
}

impl<'a> Core<'a> {
    fn new(shell: &'a Shell, mutants: &[Mutant]) -> Result<Self> {
        let files: BTreeSet<&str> =
            mutants.iter().map(|mutant| mutant.file.as_str()).chain([CRATE_ROOT]).collect();
        let read = |file: &str| Ok((file.to_owned(), shell.read_file(file)?));
        let sources = files.into_iter().map(read).collect::<Result<_>>()?;
        Ok(Self { tree: Tree::copy(shell)?, sources })
    }

    /// Builds a program of all mutants that compile and need no build of their own; returns it and the numbers of those.
    fn build_together(&self, mutants: &mut Numbered, findings: &Findings) -> Result<(PathBuf, Vec<u32>)> {
        loop {
            let grafted = self.write_grafted(mutants)?;
            eprintln!("building {} mutants together", mutants.len());
            let places = match self.tree.build(Serves::Many)? {
                Built::Program(program) => {
                    return Ok((program, grafted.into_values().flat_map(|grafted| grafted.alone).collect()));
                }
                Built::Errors(places) => places,
            };
            let at = |(file, line): &(String, usize)| grafted.get(file.as_str())?.at(*line);
            let broken: BTreeSet<u32> = places.iter().filter_map(at).collect();
            ensure!(!broken.is_empty(), "this does not compile, and no mutant is to blame: {places:?}");
            for mutant in broken.iter().filter_map(|number| mutants.remove(number)) {
                findings.add(mutant, Outcome::DoesNotCompile)?;
            }
        }
    }

    /// Grafts the mutants onto their files.
    fn write_grafted(&self, mutants: &Numbered) -> Result<BTreeMap<&str, Grafted>> {
        let mut all = BTreeMap::new();
        for (file, source) in &self.sources {
            let here = mutants.iter().filter(|(_, mutant)| mutant.file == *file);
            let mutations: Vec<_> = here.map(|(number, mutant)| mutant.mutation(*number)).collect();
            let grafted = graft(source, &mutations).with_context(|| file.clone())?;
            let root = if file == CRATE_ROOT { graft::ROOT } else { "" };
            self.tree.write(file, &[grafted.text.as_str(), root].concat())?;
            all.insert(file.as_str(), grafted);
        }
        Ok(all)
    }

    /// Tries each mutant in a build of its own.
    fn try_alone(&self, mutants: &Numbered, findings: &Findings) -> Result<()> {
        if mutants.is_empty() {
            return Ok(());
        }
        self.sources.iter().try_for_each(|(file, source)| self.tree.write(file, source))?;
        let Built::Program(program) = self.tree.build(Serves::One)? else {
            bail!("the tests of shared do not compile")
        };
        let trial = Trial::new(program, self.tree.folder())?;
        for mutant in mutants.values() {
            let source = &self.sources[&mutant.file];
            self.tree.write(&mutant.file, &mutant.mutation(0).applied(source))?;
            let outcome = match self.tree.build(Serves::One)? {
                Built::Errors(_) => Outcome::DoesNotCompile,
                Built::Program(_) if trial.catches(0, &mutant.file)? => Outcome::Caught,
                Built::Program(_) => Outcome::Survived,
            };
            self.tree.write(&mutant.file, source)?;
            findings.add(mutant, outcome)?;
        }
        Ok(())
    }
}

/// What has been found; stored now and then, so that an interruption loses little.
struct Findings {
    file: PathBuf,
    outcomes: Mutex<Outcomes>,
    done: AtomicUsize,
    all: usize,
}

impl Findings {
    fn new(shell: &Shell, outcomes: Outcomes, all: usize) -> Self {
        let file = shell.current_dir().join(EARLIER);
        Self { file, outcomes: Mutex::new(outcomes), done: AtomicUsize::new(0), all }
    }

    fn add(&self, mutant: &Mutant, outcome: Outcome) -> Result<()> {
        if outcome == Outcome::Survived {
            eprintln!("survived: {}", mutant.name);
        }
        if let Ok(mut outcomes) = self.outcomes.lock() {
            outcomes.insert(mutant.name.clone(), outcome);
        }
        let done = self.done.fetch_add(1, Ordering::Relaxed) + 1;
        if done.is_multiple_of(STORED_AFTER) {
            eprintln!("{done} of {} mutants tried", self.all);
            self.store()?;
        }
        Ok(())
    }

    fn store(&self) -> Result<()> {
        let Ok(outcomes) = self.outcomes.lock() else { bail!("a worker has panicked") };
        Ok(fs::write(&self.file, serde_json::to_string(&*outcomes)?)?)
    }
}
