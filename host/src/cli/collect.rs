//! `trainer collect`: records breaths with random perturbations.

use std::path::Path;

use anyhow::{Context as _, anyhow, bail};
use serde::Serialize;
use serde_json::{Value, json};
use shared::breath::PAPER_PIPS;
use shared::explore::{Exploration, Range};

use crate::args::controller::{Chosen, ControllerArgs};
use crate::args::settings::SettingsArgs;
use crate::args::source::SourceArgs;
use crate::args::waveforms::pips;
use crate::command::bounds::{MOST, some, within};
use crate::command::{Command, Context, OutFile, Output, OutputArgs};
use data::kind::Kind;
use data::recording::{self, Recording};
use show::report::{Cell, Table};
use ventilator::collect::{CollectConfig, CollectError, Collected, collect};
use ventilator::seeds;

/// Record breaths under a PID with random perturbations
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer collect --out first.parquet
  trainer collect --out stiff.parquet --bench R50C10 --exploration boundary_probability=0.3
  trainer collect --out real.parquet --port /dev/ttyACM0 --breaths 60
  trainer collect --out mine.parquet --plant tcp:localhost:7000
  trainer collect --out mine.parquet --plant 'pipe:python3 examples/python/plant.py'
  trainer collect --out slow.parquet --period-us 30000 --exploration triangle_height=-20:20

Ctrl-C ends the collection and saves the breaths recorded so far. So does a plant or a device that
fails.")]
pub struct Args {
    /// File to write the recording to (.parquet)
    #[arg(long, value_name = "PATH", value_parser = OutFile::of(Kind::Recording))]
    out: OutFile,
    #[command(flatten)]
    source: SourceArgs,
    /// Number of breaths to record
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = some())]
    breaths: usize,
    #[command(flatten)]
    controller: ControllerArgs,
    /// PIPs of every second breath, cmH2O
    #[arg(long, value_name = "CMH2O,..", value_delimiter = ',', default_values_t = PAPER_PIPS, value_parser = pips())]
    pips: Vec<f32>,
    /// Range of the random PIPs of the other breaths, cmH2O
    #[arg(long, value_name = "LOW:HIGH", value_parser = range, default_value = text(CollectConfig::default().pip_range))]
    pip_range: Range,
    /// Number of breaths ended early by the pressure limit after which collection gives up
    #[arg(long, value_name = "N", default_value_t = CollectConfig::default().aborts, value_parser = within::<usize>(0, MOST))]
    aborts: usize,
    /// Seed of the PIPs, perturbations and sensor noise
    #[arg(long, default_value_t = 1)]
    seed: u64,
    #[command(flatten)]
    output: OutputArgs,
    #[command(flatten)]
    exploration: ExplorationArgs,
    #[command(flatten)]
    settings: SettingsArgs,
}

/// Parameters of the perturbations.
#[derive(Debug, clap::Args)]
struct ExplorationArgs {
    #[arg(long, value_name = "NAME=VALUE,..", value_delimiter = ',', value_parser = perturbation, help = perturbations())]
    exploration: Vec<Perturbation>,
}

/// A parameter of [`Exploration`] as typed, by name; none for no perturbation at all.
type Perturbation = Option<(String, Value)>;

/// Switches the perturbations off.
const NONE: &str = "none";
/// Names of the parameters that can be typed.
const PARAMETERS: [&str; 5] =
    ["boundary_probability", "boundary_height", "boundary_duration", "triangle_height", "triangle_duration"];

/// Parses a parameter: `NAME=NUMBER` or `NAME=LOW:HIGH`.
fn perturbation(typed: &str) -> Result<Perturbation, String> {
    if typed == NONE {
        return Ok(None);
    }
    let (name, value) = typed.split_once('=').ok_or("write NAME=VALUE, or none")?;
    if !PARAMETERS.contains(&name) {
        return Err(format!("there is no parameter {name}: choose from {}", PARAMETERS.join(", ")));
    }
    let value = match value.parse::<f32>() {
        Ok(number) => json!(number),
        Err(_) => json!(range(value)?),
    };
    // Here, so that the error is that of this parameter.
    serde_json::from_value::<Exploration>(json!({ name: value })).map_err(|error| error.to_string())?;
    Ok(Some((name.to_owned(), value)))
}

/// The help of the option: names, units and defaults.
fn perturbations() -> String {
    let Exploration { boundary_probability, boundary_height, boundary_duration, .. } = Exploration::default();
    let Exploration { triangle_height, triangle_duration, .. } = Exploration::default();
    let [height, fade, peak, length] =
        [boundary_height, boundary_duration, triangle_height, triangle_duration].map(text);
    format!(
        "Perturbations, with their [defaults], or {NONE}: boundary_probability [{boundary_probability}] is the share of breaths that \
         are perturbed at their start, by boundary_height [{height}] percent of the valve, which fades out within boundary_duration \
         [{fade}] s; the others get a triangle within the inspiration, of triangle_height [{peak}] percent and triangle_duration \
         [{length}] s"
    )
}

impl ExplorationArgs {
    fn exploration(&self) -> anyhow::Result<Option<Exploration>> {
        if self.exploration.len() > 1 && self.exploration.contains(&None) {
            bail!("--exploration {NONE} leaves nothing to set: give it alone");
        }
        let typed: Option<serde_json::Map<_, _>> = self.exploration.iter().cloned().collect();
        Ok(typed.map(|typed| serde_json::from_value(typed.into())).transpose()?)
    }
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    seed: u64,
    plant: String,
    controller: String,
    weights_id: Option<String>,
    breaths: usize,
    aborted: usize,
    ticks: usize,
    period_us: u32,
    pressure: (f32, f32),
    explored: f64,
    complete: bool,
    /// Why there are not more breaths.
    #[serde(skip)]
    failure: Option<anyhow::Error>,
}

impl Command for Args {
    type Outcome = Summary;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Summary>> {
        let plant = self.source.plant.connect()?;
        let chosen = self.controller.chosen(plant.as_ref())?;
        let controller = chosen.chip()?;
        let config = config(self)?;
        self.out.check_room(recorded_bytes(&config, chosen.period_us))?;
        let mut source = self.source.open(plant, &chosen, &config.settings, config.seed)?;
        let recorded = context.progress(|progress| collect(source.as_mut(), controller, &config, progress));
        let (mut collected, failure) = match recorded {
            Ok(collected) => (collected, None),
            Err(CollectError::Interrupted { reason, collected }) => (*collected, Some(reason)),
            Err(error) => return Err(error.into()),
        };
        if collected.breaths == 0 && context.stopped() {
            bail!("stopped before the first breath was complete; nothing was saved");
        }
        let provenance = &mut collected.recording.provenance;
        provenance.seed = self.seed;
        provenance.weights_id = chosen.weights_id.clone().unwrap_or_default();
        save(&collected.recording, &self.out)?;
        for shortfall in source.shortfalls() {
            eprintln!("warning: {shortfall}");
        }
        let mut summary = summary(self, &chosen, &config, &collected);
        context.table(&table(&summary));
        context.saved(&self.out);
        if let Some(reason) = failure {
            let (breaths, plant, file) = (summary.breaths, &summary.plant, self.out.display());
            summary.failure = Some(anyhow::Error::new(reason).context(format!(
                "cannot collect more breaths from {plant}: {breaths} complete breaths are saved in {file}"
            )));
        } else if !summary.complete && !context.stopped() {
            summary.failure = Some(anyhow!(
                "gave up after {} breaths ended early; {} of {} breaths are saved: use lower gains, less exploration or a higher --aborts",
                collected.aborts,
                collected.breaths,
                config.breaths
            ));
        }
        Ok(Some(summary))
    }

    fn conclude(&self, outcome: Summary, _context: &Context<'_>) -> anyhow::Result<()> {
        outcome.failure.map_or(Ok(()), Err)
    }
}

/// About the size of the recording, bytes.
fn recorded_bytes(config: &CollectConfig, period_us: u32) -> u64 {
    /// As measured: 17 on a bench.
    const BYTES_PER_TICK: f64 = 20.0;
    let ticks = 60e6 / f64::from(config.settings.rate) / f64::from(period_us);
    (config.breaths as f64 * ticks * BYTES_PER_TICK) as u64
}

/// Saves a recording. If that fails, the breaths, which may be those of a real lung, are saved among the temporary files.
fn save(recording: &Recording, out: &Path) -> anyhow::Result<()> {
    let Err(error) = recording.save(out) else { return Ok(()) };
    let rescued = std::env::temp_dir().join(format!("rescued-{}.parquet", std::process::id()));
    match recording.save(&rescued) {
        Ok(()) => {
            Err(error).context(format!("the recording is saved in {} instead: move it", rescued.display()))
        }
        Err(_) => Err(error.into()),
    }
}

fn config(args: &Args) -> anyhow::Result<CollectConfig> {
    Ok(CollectConfig {
        breaths: args.breaths,
        pips: args.pips.clone(),
        pip_range: args.pip_range,
        settings: args.settings.checked(&args.pips)?,
        prescriptions: None,
        exploration: args.exploration.exploration()?,
        aborts: args.aborts,
        seed: seeds::collection(args.seed, 0),
    })
}

fn summary(args: &Args, chosen: &Chosen, config: &CollectConfig, collected: &Collected) -> Summary {
    let Collected { recording, breaths, aborts } = collected;
    Summary {
        seed: args.seed,
        plant: recording.provenance.plant.clone(),
        controller: chosen.name.clone(),
        weights_id: chosen.weights_id.clone(),
        breaths: *breaths,
        aborted: *aborts,
        ticks: recording.len(),
        period_us: chosen.period_us,
        pressure: recording::range(&recording.pressure).unwrap_or((0.0, 0.0)),
        explored: recording.explored(),
        complete: *breaths == config.breaths,
        failure: None,
    }
}

fn table(summary: &Summary) -> Table {
    let seconds = summary.ticks as f64 * f64::from(summary.period_us) * 1e-6;
    let (low, high) = summary.pressure;
    let mut table = Table::new("", &["recording", &summary.plant]);
    for (name, value) in [
        ("controller", summary.controller.clone()),
        ("breaths", summary.breaths.to_string()),
        ("breaths ended early", summary.aborted.to_string()),
        ("ticks", format!("{} of {} us, {seconds:.0} s", summary.ticks, summary.period_us)),
        ("measured pressure", format!("{low:.1} to {high:.1} cmH2O")),
        ("inspiration perturbed", format!("{:.0} % of the time", 100.0 * summary.explored)),
    ] {
        table.row(vec![Cell::text(name), Cell::text(value)]);
    }
    table
}

/// Parses a range `LOW:HIGH`.
fn range(text: &str) -> Result<Range, String> {
    let number = |part: &str| part.trim().parse::<f32>().ok();
    let ends = text.split_once(':').and_then(|(low, high)| Some((number(low)?, number(high)?)));
    ends.ok_or_else(|| "write LOW:HIGH, such as 8:37".to_owned())
}

/// Formats a range as the command line accepts it.
fn text((low, high): Range) -> String {
    format!("{low}:{high}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_as_they_are_printed() {
        for ends in [(8.0, 37.0), (-30.0, 30.0), (0.05, 0.3)] {
            assert_eq!(range(&text(ends)), Ok(ends));
        }
        for wrong in ["8", "8:", "low:high", ""] {
            assert!(range(wrong).unwrap_err().contains("LOW:HIGH"), "{wrong}");
        }
    }

    fn typed(words: &[&str]) -> Result<Option<Exploration>, String> {
        let exploration = words.iter().map(|word| perturbation(word)).collect::<Result<_, _>>()?;
        Ok(ExplorationArgs { exploration }.exploration().unwrap())
    }

    #[test]
    fn perturbations_are_named_values() {
        assert_eq!(typed(&[]), Ok(Some(Exploration::default())));
        assert_eq!(typed(&["none"]), Ok(None));
        let words = ["boundary_probability=0.3", "boundary_height=1:2", "triangle_duration=7:8"];
        let expected = Exploration {
            boundary_probability: 0.3,
            boundary_height: (1.0, 2.0),
            triangle_duration: (7.0, 8.0),
            ..Exploration::default()
        };
        assert_eq!(typed(&words), Ok(Some(expected)));
        for unknown in ["height=1:2", "seed=5"] {
            assert!(typed(&[unknown]).unwrap_err().contains("boundary_probability"), "{unknown}");
        }
        let both = ["none", "boundary_height=1:2"].map(|word| perturbation(word).unwrap());
        assert!(ExplorationArgs { exploration: both.to_vec() }.exploration().is_err());
        assert!(typed(&["boundary_height=1"]).is_err() && typed(&["boundary_height"]).is_err());
    }
}
