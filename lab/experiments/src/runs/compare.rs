//! What differs between runs: where they come from, their options and their figures.

use std::collections::BTreeSet;

use serde::Serialize;

use super::Run;

/// Options that say where a run writes.
const PLACES: [&str; 2] = ["out", "json"];

/// An option, or a fact about the origin, that differs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct OptionDifference {
    /// Its name.
    pub name: String,
    /// Its value in each run; none if the run does not have it.
    pub values: Vec<Option<String>>,
}

/// A figure that differs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FigureDifference {
    /// Its name.
    pub name: String,
    /// Its value in each run; none if the run does not have it.
    pub values: Vec<Option<f64>>,
    /// Difference of each further run from the first, percent of the first; none if one of them is missing or the first is zero.
    pub percent: Vec<Option<f64>>,
}

/// All that differs between runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Comparison {
    /// Names of the runs.
    pub runs: Vec<String>,
    /// Command, revision, build, machine and number of threads.
    pub origin: Vec<OptionDifference>,
    /// Options of the command, without those that say where it writes.
    pub options: Vec<OptionDifference>,
    /// Figures that are not options too; of a curve the last value.
    pub figures: Vec<FigureDifference>,
}

impl Comparison {
    /// Compares runs.
    pub fn of(runs: &[Run]) -> Self {
        let options: BTreeSet<_> = runs.iter().flat_map(|run| run.record.options.keys()).collect();
        let is_option = |name: &str| options.iter().any(|option| *option == name);
        let option = |name: &&String| different(runs, name, |run| run.option(name).map(str::to_owned));
        let results = || runs.iter().map(|run| &run.record.results);
        let figures = results().flat_map(|results| results.figures.keys());
        let names: BTreeSet<_> = figures.chain(results().flat_map(|results| results.curves.keys())).collect();
        Self {
            runs: runs.iter().map(|run| run.name.clone()).collect(),
            origin: origin(runs),
            options: options
                .iter()
                .filter(|name| !PLACES.contains(&name.as_str()))
                .filter_map(option)
                .collect(),
            figures: names
                .into_iter()
                .filter(|name| !is_option(name))
                .filter_map(|name| figure(runs, name))
                .collect(),
        }
    }
}

/// A fact about the origin of a run.
type Fact = fn(&Run) -> String;

/// The facts about the origin that differ.
fn origin(runs: &[Run]) -> Vec<OptionDifference> {
    let facts: [(&str, Fact); 5] = [
        ("command", |run| run.command().to_owned()),
        ("revision", |run| run.record.revision.clone()),
        ("build", |run| run.record.build.clone()),
        ("machine", Run::place),
        ("threads", |run| run.record.threads.to_string()),
    ];
    facts.iter().filter_map(|(name, fact)| different(runs, name, |run| Some(fact(run)))).collect()
}

fn different(runs: &[Run], name: &str, value: impl Fn(&Run) -> Option<String>) -> Option<OptionDifference> {
    let values: Vec<_> = runs.iter().map(value).collect();
    values
        .windows(2)
        .any(|pair| pair[0] != pair[1])
        .then(|| OptionDifference { name: name.to_owned(), values })
}

fn figure(runs: &[Run], name: &str) -> Option<FigureDifference> {
    let values: Vec<_> = runs.iter().map(|run| run.figure(name)).collect();
    let first = values.first().copied().flatten().filter(|first| *first != 0.0);
    let percent = |value: &Option<f64>| Some(100.0 * ((*value)? - first?) / first?.abs());
    values.windows(2).any(|pair| pair[0] != pair[1]).then(|| FigureDifference {
        name: name.to_owned(),
        percent: values.iter().skip(1).map(percent).collect(),
        values,
    })
}
