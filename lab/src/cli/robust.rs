//! `lab robust`: a controller on many random plants of a family.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use serde::Serialize;
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::pid::PidGains;

use crate::args::law::LawArgs;
use crate::args::policy::{PolicyArgs, account, at, check, print as print_account};
use campaign::Campaign;
use host::args::controller::Chosen;
use host::args::gains::format_gains;
use host::args::shards::ShardFolderArgs;
use host::command::bounds::within;
use host::command::{Command, Context, Output, OutputArgs, write};
use laws::policy::account::Account;
use laws::policy::in_turns;
use plant::bench::family::Family;
use plant::prescriptions::{NAMES, Prescriptions};
use progress::Progress;
use show::report::{Cell, Plot, Series, Style, Table};
use trials::robust::rivals::{family_pid, known_pid};
use trials::robust::{Question, Robustness, Summary, Tally};

/// Ratios to the family's PID that the figure shows.
const RATIOS: (f64, f64) = (0.3, 1.5);

/// Run a controller on random plants, beside the best single PID
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  lab robust --plants 1000 --controller out/once/controller.safetensors
  lab robust --plants 100000 --breaths 6 --subset 0 --keep robust.json --json result.json
  lab robust --family my-machines.toml --gains 3,30,0 --save-worst worst
  lab robust --family neonate --controller neonate --prescriptions bedside --plants 200 --subset 0
  lab robust --plants 20 --subset 0 --policy 'pipe:python3 examples/python/policy.py'
  lab robust --plants 10000000 --subset 0 --shard 3/1000 --out out/robust   # each task, then:
  lab robust --plants 10000000 --subset 0 --merge --out out/robust

A family is a bench description with ranges: each plant draws its valve, circuit, sensor and lung
from them, by the seed and its number. Every plant gets one of the family's waveforms (the paper's,
unless the family has its own), or settings that are drawn from --prescriptions, from rest, under
both controllers, with the same sensor noise. Drawn pressure limits are close to PIP: an inspiration
that is ended there counts with its planned rest. The best single PID is that for the prescriptions.
Breaths 1, 6 and 20 are scored in full. For the subset, the first plants, the plant's own best PID
and its reference bound are searched as well, which takes several seconds each, and minutes where
drawn inspirations are long; the bound is then that of the same breath from rest.

A plant counts as worsened if a breath is worse than the first by more than 5 % and by more than
0.3 cmH2O; as unstable if the pressure oscillates on a plateau, from peak to trough, by more than
twice the plateau tolerance (2 cmH2O + 4 % of PIP); as stopped if the ventilator entered its safe
state.

The result does not depend on the number of threads. With --keep, the plants that are done at Ctrl-C
are kept, and the same command continues with the others. To keep the results of a policy, or to
divide its work, name the policy with --policy-id.")]
pub struct Args {
    /// Family of plants: adult, neonate, blower, or a TOML file
    #[arg(long, value_name = "NAME|FILE", default_value = "adult")]
    family: String,
    /// Prescriptions of the plants: paper, the family's own list; bedside, those of its patients; or a TOML file
    #[arg(long, value_name = "NAME|FILE", default_value = NAMES[0])]
    prescriptions: String,
    /// Number of plants
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = within::<u32>(1, 100_000_000))]
    plants: u32,
    /// Number of plants, the first ones, whose own best PID and bound are searched
    #[arg(long, value_name = "N", default_value_t = 100, value_parser = within::<u32>(0, 100_000_000))]
    subset: u32,
    /// Breaths on each plant
    #[arg(long, value_name = "N", default_value_t = 20, value_parser = within::<u32>(1, 100_000))]
    breaths: u32,
    #[command(flatten)]
    law: LawArgs,
    #[command(flatten)]
    policy: PolicyArgs,
    /// Name of the policy in kept results, which only the same name continues or merges: give every version its own
    #[arg(long, value_name = "NAME", requires = "policy")]
    policy_id: Option<String>,
    /// Seed of the plants and of their sensor noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// File that keeps the results; an existing file is continued
    #[arg(long, value_name = "FILE", conflicts_with = "out")]
    keep: Option<PathBuf>,
    #[command(flatten)]
    shards: ShardFolderArgs,
    /// Write the ten worst plants into this folder, as bench descriptions
    #[arg(long, value_name = "DIR")]
    save_worst: Option<PathBuf>,
    /// Write the plots ratios.svg (distribution of the ratios to the family's PID) and breaths.svg (mean score by breath) into
    /// this folder
    #[arg(long, value_name = "DIR")]
    plots: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
}

/// The content of `--json`, and the account of the policy.
#[derive(Serialize)]
pub struct Outcome {
    /// Name of the prescriptions.
    prescriptions: String,
    #[serde(flatten)]
    summary: Summary,
    #[serde(skip)]
    policy: Option<Account>,
}

impl Command for Args {
    type Outcome = Outcome;

    fn output(&self) -> Output<'_> {
        self.output.makes(self.shards.makes())
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Outcome>> {
        let family = Family::find(&self.family)?;
        let chosen = chosen(self, &family)?;
        if chosen.period_us != DEFAULT_PERIOD_US {
            bail!(
                "{} has a control period of {} us: choose one for {DEFAULT_PERIOD_US} us",
                chosen.name,
                chosen.period_us
            );
        }
        let test = match self.policy.policy {
            Some(_) => in_turns(|| test(self, &family, &chosen, context))??,
            None => test(self, &family, &chosen, context)?,
        };
        let policy = account(&chosen.controller);
        print_account(context, policy.as_ref());
        let Some(test) = test else { return check(policy.as_ref()).map(|()| None) };
        let prescriptions = test.question().prescriptions.name.clone();
        let summary = shown(self, &family, &test, context)?;
        Ok(Some(Outcome { prescriptions, summary, policy }))
    }

    fn conclude(&self, outcome: Outcome, _context: &Context<'_>) -> anyhow::Result<()> {
        check(outcome.policy.as_ref())
    }
}

/// Whether results are kept, so that a later run continues with them.
fn kept(args: &Args) -> bool {
    args.keep.is_some() || args.shards.folder().is_some()
}

/// The controller. The results of a policy are kept under a name only: at its address another policy may answer later.
fn chosen(args: &Args, family: &Family) -> anyhow::Result<Chosen> {
    if args.policy.policy.is_some() && args.policy_id.is_none() && kept(args) {
        bail!(
            "kept results need a name for the policy, because another one may answer at its address later: add --policy-id NAME, \
             with a new name for every version of the policy"
        );
    }
    let Some(policy) = args.policy.connect()? else { return args.law.chosen_for(family) };
    let chosen = args.law.chosen_with(policy, None)?;
    Ok(match &args.policy_id {
        Some(name) => chosen.known_as(name),
        None => chosen,
    })
}

/// Prints and saves the results of all plants.
fn shown(
    args: &Args,
    family: &Family,
    test: &Campaign<Question, Tally>,
    context: &Context<'_>,
) -> anyhow::Result<Summary> {
    let summary = Summary::of(test);
    context.table(&table(&summary));
    context.table(&failures(&summary));
    context.table(&worst(&summary));
    if summary.cut + summary.family_cut > 0 {
        context.line(&format!(
            "the pressure limit ended inspirations on {} plants, under the family's PID on {}",
            summary.cut, summary.family_cut
        ));
    }
    if context.stopped() {
        context.line("stopped: the results are those of the plants so far");
    }
    if let Some(folder) = &args.save_worst {
        save_worst(args, folder, family, &summary, context)?;
    }
    if let Some(folder) = &args.plots {
        create(folder)?;
        write(&folder.join("ratios.svg"), ratios(&summary, test.sums()).to_svg()?.as_bytes())?;
        write(&folder.join("breaths.svg"), by_breath(&summary).to_svg()?.as_bytes())?;
        context.saved(folder);
    }
    Ok(summary)
}

/// Runs the plants or a shard of them, or merges shards; none after a shard.
fn test(
    args: &Args,
    family: &Family,
    chosen: &Chosen,
    context: &Context<'_>,
) -> anyhow::Result<Option<Campaign<Question, Tally>>> {
    let prescriptions = family.prescriptions(&args.prescriptions)?;
    let Some(family_pid) = best_pid(args, family, &prescriptions, context)? else {
        bail!("stopped before the family's PID was found; nothing was kept");
    };
    let question = Question {
        family: family.name.clone(),
        first_plant: family.draw(args.seed, 0),
        controller: chosen.id.clone(),
        family_pid,
        seed: args.seed,
        prescriptions,
        breaths: args.breaths,
        subset: args.subset,
    };
    context.line(&format!("best single PID of the family: {}", format_gains(&question.family_pid)));
    let failure = || {
        let failure = account(&chosen.controller)?.failure.filter(|_| kept(args))?;
        Some(format!(
            "the policy failed {}; start it again and repeat the command, which continues",
            at(&failure)
        ))
    };
    let work = Robustness { question, family, controller: &chosen.controller, failure: &failure };
    args.shards.run(&work, args.plants.into(), args.keep.as_deref(), context)
}

/// The family's PID; none if its search was stopped. Tasks that share a folder search it once.
fn best_pid(
    args: &Args,
    family: &Family,
    prescriptions: &Prescriptions,
    context: &Context<'_>,
) -> anyhow::Result<Option<PidGains>> {
    let known = known_pid(family, prescriptions);
    if known.is_some() {
        return Ok(known);
    }
    let question = (&family.name, family.draw(args.seed, 0), prescriptions);
    let search = |progress: &Progress<'_>| family_pid(family, prescriptions, progress);
    Ok(args.shards.once("family-pid", &question, search, context)?)
}

/// The scored breaths.
fn table(summary: &Summary) -> Table {
    let mut table = Table::new(
        format!(
            "{} plants: scores and overshoot in cmH2O, shares in %, valve effort in % per second",
            summary.plants
        ),
        &[
            "breath",
            "score",
            "family's PID",
            "not worse",
            "not worse than own PID",
            "ratio to bound",
            "overshoot, median",
            "99 %",
            "effort",
            "family's PID",
        ],
    );
    let known = |value: Option<f64>, digits| {
        value.map_or_else(|| Cell::right("-"), |value| Cell::number(value, digits))
    };
    for (place, breath) in summary.breaths.iter().enumerate() {
        table.row(vec![
            Cell::right(breath.to_string()),
            Cell::number(summary.mean[place], 3),
            Cell::number(summary.family_pid[place], 3),
            Cell::number(100.0 * summary.share_not_worse[place], 1),
            known(summary.own_not_worse[place].map(|share| 100.0 * share), 1),
            known(summary.bound_ratio[place], 3),
            Cell::number(summary.overshoot_median[place], 2),
            Cell::number(summary.overshoot_p99[place], 2),
            Cell::number(summary.effort[place].total_variation, 0),
            Cell::number(summary.family_effort[place].total_variation, 0),
        ]);
    }
    table
}

fn failures(summary: &Summary) -> Table {
    let mut table = Table::new("Plants that failed", &["", "worsened, %", "unstable", "stopped"]);
    let mut row = |name: &str, worsened: f64, unstable: u64, stopped: u64| {
        table.row(vec![
            Cell::text(name),
            Cell::number(100.0 * worsened, 2),
            Cell::right(unstable.to_string()),
            Cell::right(stopped.to_string()),
        ]);
    };
    row("controller", summary.worsened, summary.unstable, summary.stopped);
    row("family's PID", summary.family_worsened, summary.family_unstable, summary.family_stopped);
    table
}

fn worst(summary: &Summary) -> Table {
    let mut table = Table::new(
        "The worst plants, by their last scored breath",
        &["plant", "score", "family's PID", "ratio"],
    );
    for plant in &summary.worst {
        table.row(vec![
            Cell::right(plant.number.to_string()),
            Cell::number(plant.score, 3),
            Cell::number(plant.family_pid, 3),
            Cell::number(plant.ratio, 2),
        ]);
    }
    table
}

/// Writes the worst plants as bench descriptions, which other commands accept as `--bench`.
fn save_worst(
    args: &Args,
    folder: &Path,
    family: &Family,
    summary: &Summary,
    context: &Context<'_>,
) -> anyhow::Result<()> {
    create(folder)?;
    for plant in &summary.worst {
        let bench = family.draw(args.seed, plant.number);
        write(&folder.join(format!("{}.toml", bench.name)), bench.to_toml().as_bytes())?;
    }
    context.saved(folder);
    Ok(())
}

fn create(folder: &Path) -> anyhow::Result<()> {
    std::fs::create_dir_all(folder).with_context(|| format!("cannot create {}", folder.display()))
}

/// Share of the plants up to each ratio to the family's PID, by breath.
fn ratios(summary: &Summary, tally: &Tally) -> Plot {
    let breaths = summary.breaths.iter().zip(tally.ratio_distributions());
    let curve =
        |points: Vec<(f64, f64)>| points.into_iter().map(|(ratio, share)| (ratio, 100.0 * share)).collect();
    let mut series = vec![Series::new("equal", Style::Dashed, vec![(1.0, 0.0), (1.0, 100.0)])];
    series.extend(
        breaths.map(|(breath, points)| Series::new(format!("breath {breath}"), Style::Step, curve(points))),
    );
    Plot {
        x_range: Some(RATIOS),
        y_range: Some((0.0, 100.0)),
        ..Plot::new(
            "Ratio to the family's PID",
            "score / score of the family's PID",
            "plants up to it, %",
            series,
        )
    }
}

/// Mean scores of every breath.
fn by_breath(summary: &Summary) -> Plot {
    let points = |scores: &[f64]| (1..).map(f64::from).zip(scores.iter().copied()).collect();
    Plot::new(
        "Mean score by breath",
        "breath",
        "mean absolute error, cmH2O",
        vec![
            Series::new("family's PID", Style::Dashed, points(&summary.family_pid_by_breath)),
            Series::new("controller", Style::Line, points(&summary.mean_by_breath)),
        ],
    )
}
