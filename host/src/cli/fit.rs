//! `trainer fit`: learns a simulator from recordings and judges it on breaths held out.

mod report;
#[cfg(test)]
mod tests;

use std::path::PathBuf;

use anyhow::{Context, bail};
use clap::ValueEnum;
use serde::Serialize;

use super::common::{bar, stopped};
use super::output::OutputArgs;
use super::preset::Preset;
use data::identity::{LungParameters, TestRun};
use data::recording::Recording;
use judge::identify;
use learn::pipeline::PAPER_PERIOD_US;
use learn::simulator::episode::{Episode, channels, episodes, split, ventilators, whole_breaths};
use learn::simulator::fit::{Fit, FitConfig};
use learn::simulator::hybrid::HybridConfig;
use learn::simulator::model::{Architecture, Simulator};
use learn::simulator::open_loop::{ByWaveform, OpenLoop, by_waveform, open_loop, response};
use learn::simulator::state_space::StateSpaceConfig;
use learn::simulator::stitched::StitchedConfig;
use show::report::{Cell, Table};
use ventilator::seeds;

/// Learn a differentiable simulator from recordings
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer fit --data first.parquet --out simulator.safetensors
  trainer fit --data first.parquet second.parquet --out simulator.safetensors --report fit.html
  trainer fit --data slow.parquet --out paper.safetensors --architecture stitched
  trainer fit --data slow.parquet --out paper.safetensors --preset paper-30ms
  trainer fit --data air.parquet --hold-out-lung 5:20 --hold-out-lung 50:20 --json -

The open-loop distance replays recorded commands from rest, without pressure feedback: the mean
absolute error over the inspiration. Ctrl-C ends the fit and saves the simulator as it is.

A recording that names R and C of its lungs gets one simulator for all of them; --hold-out-lung
keeps a lung out of the fit, to judge the simulator on a lung it has never seen. Where the recording
has flows, the same breaths are also predicted by classical identification, from the measured flow.")]
pub struct Args {
    /// Recordings of one ventilator; several are joined
    #[arg(long, value_name = "FILE.parquet", num_args = 1.., required = true)]
    data: Vec<PathBuf>,
    /// File to write the simulator to
    #[arg(long, value_name = "FILE.safetensors")]
    out: Option<PathBuf>,
    /// Another's setting, which the recording must be of: paper-30ms is that of the paper's authors
    #[arg(long, value_enum, value_name = "NAME", hide_possible_values = true)]
    preset: Option<Preset>,
    /// Our state-space model or our hybrid of a learned ventilator and a lung of known R and C, both trained on whole
    /// breaths open loop, or the stitched networks of the paper's authors, trained on single steps of about 30 ms
    /// [default: hybrid if the recording names R and C, else state-space; or that of the preset]
    #[arg(long, value_enum)]
    architecture: Option<Kind>,
    /// Passes over the recording [default: enough for 10000 gradient steps, 15000 for hybrid; 500 for stitched]
    #[arg(long, value_name = "N")]
    epochs: Option<usize>,
    /// Breaths per gradient step [default: 16, or 64 for stitched]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    batch: Option<u16>,
    /// State-space, hybrid: states [default: 16, or 8 for hybrid]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=256))]
    states: Option<u16>,
    /// State-space, hybrid: hidden units [default: 64, or 24 for hybrid]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=512))]
    hidden: Option<u16>,
    /// State-space, hybrid: blocks of past commands that a step sees [default: 4, or 8 for hybrid]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=64))]
    history: Option<u16>,
    /// Every N-th breath of each lung or test run is held out of the fit, to judge it
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u16).range(2..))]
    hold_out: u16,
    /// Hold out every breath of the lung with this nominal resistance and compliance; may be given several times
    #[arg(long, value_name = "R:C")]
    hold_out_lung: Vec<LungParameters>,
    /// Seed of initial parameters and order
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Write curves and held-out predictions as an HTML report
    #[arg(long, value_name = "FILE.html")]
    report: Option<PathBuf>,
    #[command(flatten)]
    output: OutputArgs,
}

/// Kinds of models.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum Kind {
    StateSpace,
    Hybrid,
    Stitched,
}

/// Breaths per gradient step of the state-space model: on 160 breaths of the default lung, 16 in place of 64 bring the
/// open-loop distance from 0.26 to 0.18 cmH2O in the same number of epochs.
const BATCH: usize = 16;
/// Decay of the hybrid's weights: of 0.005, 0.02 and 0.05 it did best on lungs left out one by one.
const HYBRID_DECAY: f32 = 0.005;
/// Gradient steps by which that distance has stopped falling fast.
const STEPS: usize = 10_000;
/// The same for the hybrid: a fifth of them for the physics, the others for what test runs have of their own.
const HYBRID_STEPS: usize = 15_000;
/// Least passes over a recording, however large.
const LEAST_EPOCHS: usize = 300;
/// Most passes over a recording, however small.
const MOST_EPOCHS: usize = 3_000;
/// Shortest control period of the stitched architecture, microseconds: it steps one tick at a time, and its
/// history of five has to reach beyond the valve's dead time.
const STITCHED_LEAST_US: u32 = 5_000;

/// What `--json` gives.
#[derive(Debug, Serialize)]
struct Summary {
    seed: u64,
    plant: String,
    #[serde(flatten)]
    architecture: Architecture,
    parameters: usize,
    training_breaths: usize,
    held_out_breaths: usize,
    held_out_lung_breaths: usize,
    epochs: usize,
    stopped: bool,
    training_loss: f64,
    noise: f32,
    /// Mean absolute errors on the held-out breaths, cmH2O: of the change over one step, and open loop.
    one_step: f64,
    open_loop: f64,
    /// Open loop, to the true airway pressure, where a bench knows it.
    open_loop_true: Option<f64>,
    /// Open loop, on the lungs held out altogether.
    open_loop_held_out_lung: Option<f64>,
    /// Classical identification on the same held-out breaths, from measured flows.
    classical_open_loop: Option<f64>,
    /// Rise of the predicted pressure where every command is five percent higher, cmH2O: see [`RESPONSE_S`].
    response: Vec<f64>,
    waveforms: Vec<ByWaveform>,
    groups: Vec<ByGroup>,
    held_out_lungs: Vec<ByGroup>,
}

/// Times after the start of the inspiration at which the response to a higher command is told, s.
const RESPONSE_S: [f32; 3] = [0.1, 0.3, 0.8];

/// Errors on the held-out breaths of one lung or test run.
#[derive(Clone, Debug, Serialize)]
struct ByGroup {
    group: String,
    episodes: usize,
    #[serde(flatten)]
    open_loop: OpenLoop,
}

/// Breaths by what they are for.
struct Parts<'a> {
    training: Vec<&'a Episode>,
    held_out: Vec<&'a Episode>,
    /// Of lungs that are held out altogether.
    other_lungs: Vec<&'a Episode>,
}

impl<'a> Parts<'a> {
    fn new(args: &Args, all: &'a [Episode]) -> anyhow::Result<Self> {
        for lung in &args.hold_out_lung {
            if !all.iter().any(|episode| episode.lung == Some(*lung)) {
                bail!("no breath of the lung {lung} (R:C): the recording has {}", lungs(all));
            }
        }
        let held_out_lung = |e: &&Episode| e.lung.is_some_and(|lung| args.hold_out_lung.contains(&lung));
        // Every breath's place in its group is counted, whether or not its lung is held out.
        let (training, held_out) = split(all, usize::from(args.hold_out));
        let keep = |episodes: Vec<&'a Episode>| -> Vec<&'a Episode> {
            episodes.into_iter().filter(|episode| !held_out_lung(episode)).collect()
        };
        let parts = Self {
            training: keep(training),
            held_out: keep(held_out),
            other_lungs: all.iter().filter(held_out_lung).collect(),
        };
        if parts.training.is_empty() || parts.held_out.is_empty() {
            bail!(
                "{} complete inspirations are too few to fit and to hold out every {}th: record more, or lower \
                 --hold-out",
                all.len() - parts.other_lungs.len(),
                args.hold_out
            );
        }
        Ok(parts)
    }
}

/// What the model is trained on. The hybrid gets whole breaths, since in expiration, too, lung and ventilator show what
/// they are; and each of them twice, once without its group, so that what a group has of its own stays a deviation from
/// a model that is right without it.
fn lessons(architecture: &Architecture, recording: &Recording, training: &[&Episode]) -> Vec<Episode> {
    if !matches!(architecture, Architecture::Hybrid(_)) {
        return training.iter().map(|episode| (*episode).clone()).collect();
    }
    let mut lessons = whole_breaths(recording, architecture.timing());
    lessons.retain(|breath| training.iter().any(|episode| episode.rows == breath.rows));
    let nameless: Vec<_> = lessons.iter().map(|breath| Episode { group: None, ..breath.clone() }).collect();
    lessons.extend(nameless);
    lessons
}

/// The lungs that a recording names.
fn lungs(episodes: &[Episode]) -> String {
    let mut names: Vec<_> = episodes.iter().filter_map(|e| e.lung).map(|lung| lung.to_string()).collect();
    names.dedup();
    names.sort();
    names.dedup();
    if names.is_empty() { "no R and C at all".to_owned() } else { names.join(", ") }
}

/// Runs the command.
pub fn run(args: &Args) -> anyhow::Result<()> {
    let recording = load(&args.data)?;
    args.preset.map_or(Ok(()), |preset| preset.check(&recording))?;
    let architecture = architecture(args, &recording)?;
    let all = episodes(&recording, architecture.timing());
    let parts = Parts::new(args, &all)?;
    let lessons = lessons(&architecture, &recording, &parts.training);
    let lessons: Vec<&Episode> = lessons.iter().collect();
    let (simulator, curve) = fit(args, architecture, &lessons, &recording.provenance.plant)?;
    if let Some(path) = &args.out {
        simulator.save(path)?;
    }
    let summary = summary(args, &simulator, &curve, &parts, &recording);
    args.output.table(&table(&summary));
    for line in remarks(&summary) {
        args.output.line(&line);
    }
    if stopped() {
        args.output.line(&format!("stopped after {} epochs", curve.len()));
    }
    if let Some(path) = &args.out {
        args.output.line(&format!("saved {}", path.display()));
    }
    if let Some(path) = &args.report {
        report::report(&summary, &simulator, &curve, &parts, &recording).save(path)?;
        args.output.line(&format!("saved {}", path.display()));
    }
    args.output.finish(&summary)
}

fn load(files: &[PathBuf]) -> anyhow::Result<Recording> {
    let (first, others) = files.split_first().context("no recording given")?;
    let mut recording = Recording::load(first)?;
    for file in others {
        let more = Recording::load(file)?;
        recording
            .append(&more)
            .with_context(|| format!("{} does not fit {}", file.display(), first.display()))?;
    }
    Ok(recording)
}

/// The architecture asked for, or the one that makes the most of what the recording says.
fn kind(args: &Args, recording: &Recording) -> Kind {
    let usual = match args.preset {
        Some(Preset::Paper30Ms) => Kind::Stitched,
        None if recording.names_lungs() => Kind::Hybrid,
        None => Kind::StateSpace,
    };
    args.architecture.unwrap_or(usual)
}

/// Whether a recording names more than one lung.
fn many_lungs(recording: &Recording) -> bool {
    (1..recording.len()).any(|row| recording.lung(row) != recording.lung(0))
}

fn architecture(args: &Args, recording: &Recording) -> anyhow::Result<Architecture> {
    let period_us = recording.provenance.period_us;
    let or = |asked: Option<u16>, default: usize| asked.map_or(default, usize::from);
    match kind(args, recording) {
        Kind::Stitched if period_us < STITCHED_LEAST_US => bail!(
            "the stitched architecture steps one control tick at a time, and this recording's are {period_us} us: \
             collect one with --period-us {PAPER_PERIOD_US}, or fit state-space"
        ),
        Kind::Stitched => Ok(Architecture::Stitched(StitchedConfig::for_period(period_us))),
        Kind::StateSpace => {
            let shape = StateSpaceConfig::for_period(period_us, channels(recording));
            Ok(Architecture::StateSpace(StateSpaceConfig {
                lungs: many_lungs(recording),
                states: or(args.states, shape.states),
                hidden: or(args.hidden, shape.hidden),
                history: or(args.history, shape.history),
                ..shape
            }))
        }
        Kind::Hybrid => {
            if !recording.names_lungs() {
                bail!(
                    "the hybrid needs R and C of every lung, which this recording does not name: fit state-space"
                );
            }
            let shape = HybridConfig::for_period(period_us, channels(recording));
            Ok(Architecture::Hybrid(HybridConfig {
                states: or(args.states, shape.states),
                hidden: or(args.hidden, shape.hidden),
                history: or(args.history, shape.history),
                ventilators: ventilators(recording).into_iter().max().map_or(0, |last| last as usize + 1),
                groups: recording.provenance.groups.len(),
                ..shape
            }))
        }
    }
}

/// How to fit so many breaths: a small recording takes more passes, since it is gradient steps that count.
fn config(args: &Args, architecture: &Architecture, breaths: usize) -> FitConfig {
    let stitched = matches!(architecture, Architecture::Stitched(_));
    let mut base =
        if stitched { FitConfig::authors() } else { FitConfig { batch: BATCH, ..FitConfig::default() } };
    let hybrid = matches!(architecture, Architecture::Hybrid(_));
    if hybrid {
        base.adam.weight_decay = HYBRID_DECAY;
    }
    let batch = args.batch.map_or(base.batch, usize::from);
    let steps = if hybrid { HYBRID_STEPS } else { STEPS };
    let enough = (steps * batch / breaths.max(1)).clamp(LEAST_EPOCHS, MOST_EPOCHS);
    let epochs = if stitched { base.epochs } else { enough };
    FitConfig { epochs: args.epochs.unwrap_or(epochs), batch, seed: seeds::training(args.seed, 0), ..base }
}

/// The simulator, and the loss of every epoch.
fn fit(
    args: &Args,
    architecture: Architecture,
    training: &[&Episode],
    plant: &str,
) -> anyhow::Result<(Simulator, Vec<f64>)> {
    let config = config(args, &architecture, training.len());
    let mut fit = Fit::new(architecture, training, config, None);
    let bar = bar("fitting", config.epochs);
    let mut curve = Vec::with_capacity(config.epochs);
    while !stopped() {
        let Some(loss) = fit.epoch() else { break };
        if !loss.is_finite() {
            bail!(
                "the fit diverged in epoch {}: check the recording for jumps, or try another --seed",
                curve.len()
            );
        }
        curve.push(loss);
        tracing::debug!(epoch = curve.len(), loss, "epoch done");
        bar.inc(1);
    }
    bar.finish_and_clear();
    Ok((fit.simulator(plant), curve))
}

fn summary(
    args: &Args,
    simulator: &Simulator,
    curve: &[f64],
    parts: &Parts<'_>,
    recording: &Recording,
) -> Summary {
    let names = &recording.provenance.groups;
    let errors = open_loop(simulator, &parts.held_out);
    let rows =
        |episodes: &[&Episode]| -> Vec<_> { episodes.iter().map(|episode| episode.rows.clone()).collect() };
    Summary {
        seed: args.seed,
        plant: simulator.plant.clone(),
        architecture: simulator.architecture,
        parameters: simulator.parameters.len(),
        training_breaths: parts.training.len(),
        held_out_breaths: parts.held_out.len(),
        held_out_lung_breaths: parts.other_lungs.len(),
        epochs: curve.len(),
        stopped: stopped(),
        training_loss: curve.last().copied().unwrap_or_default(),
        noise: simulator.noise,
        one_step: errors.one_step,
        open_loop: errors.measured,
        open_loop_true: errors.truth,
        open_loop_held_out_lung: (!parts.other_lungs.is_empty())
            .then(|| open_loop(simulator, &parts.other_lungs).measured),
        classical_open_loop: identify::open_loop::open_loop(
            recording,
            &rows(&parts.training),
            &rows(&parts.held_out),
        ),
        response: response(simulator, &parts.held_out, &RESPONSE_S),
        waveforms: by_waveform(simulator, &repeated(&parts.held_out)),
        groups: by_group(simulator, &parts.held_out, names),
        held_out_lungs: by_group(simulator, &parts.other_lungs, names),
    }
}

/// What the table does not say.
fn remarks(summary: &Summary) -> Vec<String> {
    let mut lines = Vec::new();
    if let Some(classical) = summary.classical_open_loop {
        lines.push(format!(
            "classical identification on the same held-out breaths, from the measured flow: {classical:.3} cmH2O"
        ));
    }
    let rises: Vec<_> = summary.response.iter().map(|rise| format!("{rise:+.2}")).collect();
    let times: Vec<_> = RESPONSE_S.iter().map(|time| format!("{time} s")).collect();
    lines.push(format!(
        "five percent more command changes the predicted pressure by {} cmH2O at {}",
        rises.join(", "),
        times.join(", ")
    ));
    if summary.response.iter().any(|rise| *rise <= 0.0) {
        lines.push(
            "a pressure that does not rise with the command was read from it: the controller of the recording told \
             the simulator, which is no use for another controller (docs/RECORDINGS.md)"
                .to_owned(),
        );
    }
    lines
}

/// Breaths whose PIP occurs more than once: waveforms, not the random PIPs between them.
fn repeated<'a>(episodes: &[&'a Episode]) -> Vec<&'a Episode> {
    let count = |pip: f32| episodes.iter().filter(|e| e.pip.total_cmp(&pip).is_eq()).count();
    episodes.iter().copied().filter(|episode| count(episode.pip) > 1).collect()
}

fn by_group(simulator: &Simulator, episodes: &[&Episode], names: &[TestRun]) -> Vec<ByGroup> {
    let of_group = |index: usize| -> Vec<&Episode> {
        episodes.iter().copied().filter(|e| e.group == Some(index as u32)).collect()
    };
    let judged = names.iter().enumerate().map(|(index, name)| {
        let own = of_group(index);
        ByGroup { group: name.to_string(), episodes: own.len(), open_loop: open_loop(simulator, &own) }
    });
    judged.filter(|group| group.episodes > 0).collect()
}

fn table(summary: &Summary) -> Table {
    let title = format!(
        "Held-out breaths ({} of {}), mean absolute errors in cmH2O",
        summary.held_out_breaths,
        summary.held_out_breaths + summary.training_breaths
    );
    let mut table =
        Table::new(title, &["breaths", "number", "one step", "open loop, measured", "open loop, true"]);
    for waveform in &summary.waveforms {
        table.row(row(&format!("PIP {}", waveform.pip), waveform.episodes, &waveform.open_loop));
    }
    for group in &summary.groups {
        table.row(row(&group.group, group.episodes, &group.open_loop));
    }
    let (one_step, measured, truth) = (summary.one_step, summary.open_loop, summary.open_loop_true);
    table.row(row("all", summary.held_out_breaths, &OpenLoop { one_step, measured, truth }));
    for group in &summary.held_out_lungs {
        table.row(row(&format!("{}, lung held out", group.group), group.episodes, &group.open_loop));
    }
    table
}

fn row(name: &str, episodes: usize, errors: &OpenLoop) -> Vec<Cell> {
    let truth = errors.truth.map_or_else(|| Cell::right("unknown"), |distance| Cell::number(distance, 3));
    vec![
        Cell::text(name),
        Cell::count(episodes),
        Cell::number(errors.one_step, 3),
        Cell::number(errors.measured, 3),
        truth,
    ]
}
