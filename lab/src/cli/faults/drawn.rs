//! Drawn faults: many cases, or one that a file describes.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use serde::Serialize;
use shared::safety::monitors::Monitors;

use campaign::Campaign;
use host::args::shards::ShardFolderArgs;
use host::command::Context;
use host::command::bounds::within;
use show::report::{Cell, Table};
use trials::draw::case::Case;
use trials::draw::needs::{Need, Needing, Needs, is_out_of_reach};
use trials::draw::promise::{Promise, broken};
use trials::draw::shrink::shrink;
use trials::draw::tally::{Drawn, Tally};
use trials::faults::parts::Part;

/// Classes of failures that the table shows.
const SHOWN: usize = 40;

/// Which cases are drawn, and where the results go.
#[derive(Debug, clap::Args)]
pub struct DrawArgs {
    /// Draw this many cases from all that is allowed, and hold each to the four promises
    #[arg(long, value_name = "N", conflicts_with_all = ["bench", "seeds", "limit", "nominal", "report"], value_parser = within::<u64>(1, 1_000_000_000))]
    pub draw: Option<u64>,
    /// Seed of the drawn cases
    #[arg(long, requires = "draw", default_value_t = 1)]
    pub seed: u64,
    /// File that keeps the results of drawn cases; an existing file is continued
    #[arg(long, value_name = "FILE", requires = "draw", conflicts_with = "out")]
    pub keep: Option<PathBuf>,
    /// Write the smallest case of each class that fails into this folder
    #[arg(long, value_name = "DIR", requires = "draw")]
    pub save_failures: Option<PathBuf>,
    /// Run the case in this file, as --save-failures writes it
    #[arg(long, value_name = "FILE.toml", conflicts_with_all = ["draw", "bench", "seeds", "limit", "nominal", "report", "mutate"])]
    pub case: Option<PathBuf>,
    #[command(flatten)]
    pub shards: ShardFolderArgs,
}

/// The content of `--json` for drawn cases.
#[derive(Debug, Serialize)]
pub struct DrawnSummary {
    seed: u64,
    #[serde(flatten)]
    tally: Tally,
}

impl DrawnSummary {
    /// Fails if a promise was broken.
    pub fn conclude(&self, context: &Context<'_>) -> anyhow::Result<()> {
        let Tally { cases, failed, .. } = self.tally;
        if failed > 0 {
            bail!("{failed} of {cases} cases broke a promise");
        }
        context.line(&format!("all {cases} cases kept every promise"));
        Ok(())
    }
}

impl DrawArgs {
    /// Runs drawn cases; none after a shard.
    pub fn run(
        &self,
        cases: u64,
        without: Option<Part>,
        context: &Context<'_>,
    ) -> anyhow::Result<Option<DrawnSummary>> {
        let drawn = Drawn::new(self.seed, without)?;
        let Some(found) = self.shards.run(&drawn, cases, self.keep.as_deref(), context)? else {
            return Ok(None);
        };
        let tally = found.sums().clone();
        context.table(&promises(&tally));
        context.table(&classes(&drawn, &tally));
        if context.stopped() {
            context.line("stopped; if started with --keep, the same command continues from here");
        } else {
            self.show_failures(&drawn, &tally, context)?;
        }
        Ok(Some(DrawnSummary { seed: self.seed, tally }))
    }

    /// Runs each case with all parts of the supervisor and without each; fails if no case needs one of them.
    pub fn mutate(&self, cases: u64, context: &Context<'_>) -> anyhow::Result<()> {
        let needing = Needing::new(self.seed)?;
        let mut campaign = Campaign::new(&needing);
        context.progress(|progress| campaign.advance(&needing, cases, None, progress))?;
        let found = campaign.sums();
        context.table(&needs(found));
        let Needs { cases, failed, .. } = found;
        context.line(&format!("with all of them {failed} of {cases} cases break a promise"));
        let names =
            |parts: &mut dyn Iterator<Item = Part>| parts.map(Part::name).collect::<Vec<_>>().join(", ");
        let out_of_reach = names(&mut Part::all().filter(|part| is_out_of_reach(*part)));
        context.line(&format!("no drawn case can need {out_of_reach}: their proof is `lab faults --mutate`"));
        let idle = names(&mut found.idle());
        if !idle.is_empty() && !context.stopped() {
            bail!("no case needs {idle}: draw more cases");
        }
        Ok(())
    }

    /// Prints the first failing case of the largest class as TOML, and saves those of all classes if asked to.
    fn show_failures(&self, drawn: &Drawn, tally: &Tally, context: &Context<'_>) -> anyhow::Result<()> {
        let mut firsts: Vec<_> =
            ordered(tally).filter_map(|(promise, _, class)| Some((promise, *class.first.first()?))).collect();
        if self.save_failures.is_none() {
            firsts.truncate(1);
        }
        for (promise, number) in firsts {
            let small = shrink(&drawn.generator().draw(number), promise)?;
            let text =
                format!("# {}: case {number} of seed {}\n{}", promise.name(), self.seed, small.to_toml());
            match &self.save_failures {
                Some(folder) => {
                    std::fs::create_dir_all(folder)
                        .with_context(|| format!("cannot make {}", folder.display()))?;
                    let file = folder.join(format!("{}-{number}.toml", promise.name().replace(' ', "-")));
                    std::fs::write(&file, text)
                        .with_context(|| format!("cannot write {}", file.display()))?;
                }
                None => {
                    context.line(&format!("the first failure, made small; run it with --case FILE:\n{text}"));
                }
            }
        }
        Ok(())
    }
}

/// Runs the case in a file, and says what it shows.
pub fn one(file: &Path, without: Option<Part>, context: &Context<'_>) -> anyhow::Result<()> {
    let case = Case::load(file)?;
    let monitors = without.map_or(Monitors::ALL, Part::others);
    let found = broken(&case, monitors)?;
    for broken in &found {
        context.line(&format!("{}: {}", broken.promise.name(), broken.how));
    }
    if let Some(broken) = found.first() {
        bail!("the case broke a promise: {}", broken.promise.name());
    }
    context.line("the case kept every promise");
    Ok(())
}

fn needs(found: &Needs) -> Table {
    let header = ["without", "break a promise", "keep one", "have no alarm that names the cause"];
    let mut table = Table::new("Cases that change without a monitor or a response", &header);
    for (part, Need { broken, kept, unnamed }) in found.each() {
        let counts = [broken, kept, unnamed].map(|count| Cell::right(count.to_string()));
        table.row([Cell::text(part.name())].into_iter().chain(counts).collect());
    }
    table
}

fn promises(tally: &Tally) -> Table {
    let mut table = Table::new("Promises", &["promise", "cases", "broken", "kept, %"]);
    for promise in Promise::ALL {
        let broken = tally.that_broke(promise);
        let kept = 100.0 * (1.0 - broken as f64 / tally.cases.max(1) as f64);
        table.row(vec![
            Cell::text(promise.name()),
            Cell::right(tally.cases.to_string()),
            Cell::right(broken.to_string()),
            Cell::number(kept, 2),
        ]);
    }
    table
}

/// The classes that failed, and whether they have one cause in all pressure sensors, which fails by design (SAFETY.md).
fn classes(drawn: &Drawn, tally: &Tally) -> Table {
    let header = ["promise", "alarm: faults", "common cause", "cases", "first"];
    let mut table = Table::new("Failures by class", &header);
    for (promise, name, class) in ordered(tally).take(SHOWN) {
        let common =
            class.first.first().is_some_and(|number| drawn.generator().draw(*number).is_of_a_common_cause());
        let first = class.first.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
        table.row(vec![
            Cell::text(promise.name()),
            Cell::text(name),
            Cell::text(if common { "yes" } else { "" }),
            Cell::right(class.cases.to_string()),
            Cell::right(first),
        ]);
    }
    table
}

/// The classes of failures, the largest first.
fn ordered(tally: &Tally) -> impl Iterator<Item = (Promise, &String, &trials::draw::tally::Class)> {
    let mut classes: Vec<_> = tally
        .broken
        .iter()
        .flat_map(|(promise, classes)| classes.iter().map(|(name, class)| (*promise, name, class)))
        .collect();
    classes.sort_by_key(|(promise, name, class)| (u64::MAX - class.cases, *promise, (*name).clone()));
    classes.into_iter()
}
