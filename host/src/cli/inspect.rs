//! `trainer inspect`: shows what a file contains.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};
use serde::Serialize;
use serde_json::{Value, json};
use shared::control::network::Network;
use shared::control::residual::ResidualSpec;
use shared::weights::trust::is_signed;
use shared::weights::{ARCHITECTURE, FORMAT_VERSION, Image, MAGIC, decode};

use crate::args::bench::one;
use crate::args::controller::image_id;
use crate::command::{Command, Context, Output, OutputArgs};
use data::recording::Recording;
use data::tensors;
use learn::controller::authors::{AuthorsController, AuthorsSpec};
use learn::controller::learned::{Learned, Origin, architecture};
use learn::controller::{ControllerArchitecture, Trainable};
use learn::simulator::model::Simulator;
use plant::bench::BenchConfig;
use show::report::{Cell, Table};

/// Show the contents of a recording, simulator, controller or image
#[derive(Debug, clap::Args)]
#[command(after_help = "\
Examples:
  trainer inspect weights.bin
  trainer inspect first.parquet --json -
  trainer inspect --bench R20C20 > bench.toml")]
pub struct Args {
    /// Any file that the trainer writes
    #[arg(value_name = "FILE", required_unless_present = "bench")]
    file: Option<PathBuf>,
    /// Print the description (TOML) of this bench, to edit and pass to --bench of other commands: a lung as in R20C20, or a TOML file
    #[arg(long, value_name = "LUNG|FILE", conflicts_with = "file")]
    bench: Option<String>,
    #[command(flatten)]
    output: OutputArgs,
}

/// Names and values, in the order in which they are shown.
type Facts = Vec<(&'static str, Value)>;

/// The content of `--json`.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Outcome {
    Bench(Box<BenchConfig>),
    File(Value),
}

impl Command for Args {
    type Outcome = Outcome;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Outcome>> {
        if let Some(name) = &self.bench {
            let bench = one(name)?;
            context.line(bench.to_toml().trim_end());
            return Ok(Some(Outcome::Bench(Box::new(bench))));
        }
        let file = self.file.as_deref().context("no file given")?;
        let facts = facts(file)?;
        context.table(&table(file, &facts));
        let named = facts.into_iter().map(|(name, value)| (name.to_owned(), value));
        Ok(Some(Outcome::File(named.collect())))
    }
}

/// Describes a file by the format in its first bytes or, if those are damaged, by its name's extension.
fn facts(file: &Path) -> anyhow::Result<Facts> {
    let bytes = std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))?;
    let named = |extension| file.extension().is_some_and(|found| found == extension);
    if bytes.starts_with(&MAGIC) || named("bin") {
        let mut facts = image(&decode(&bytes).with_context(|| file.display().to_string())?)?;
        facts.push(("signed", json!(is_signed(&bytes))));
        return Ok(facts);
    }
    if bytes.starts_with(b"PAR1") || named("parquet") {
        return Ok(recording(&Recording::load(file)?));
    }
    match tensors::kind(file)?.as_str() {
        learn::simulator::model::KIND => simulator(&Simulator::load(file)?),
        learn::controller::learned::KIND => learned_of_any_architecture(file),
        other => bail!("{} contains {other}, unknown to this version: update the trainer", file.display()),
    }
}

fn image(image: &Image) -> anyhow::Result<Facts> {
    let mut facts = vec![
        ("kind", json!("weights image")),
        ("id", json!(image_id(image.id))),
        ("format version", json!(FORMAT_VERSION)),
        ("architecture", json!(ARCHITECTURE)),
        ("training", json!(label(&image.identity.training))),
        ("plant", json!(label(&image.identity.plant))),
        ("image version", json!(image.version)),
    ];
    facts.extend(controller(image.residual.spec())?);
    facts.push(("golden last command", json!(f32::from_bits(image.golden.last))));
    facts.push(("golden checksum", json!(format!("{:08x}", image.golden.all))));
    Ok(facts)
}

fn controller(spec: &ResidualSpec) -> anyhow::Result<Facts> {
    let ResidualSpec { period_us, gains, lambda, authority, .. } = spec;
    Ok(vec![
        ("network", json!(Network::SHAPE)),
        ("parameters", json!(Network::PARAMETERS)),
        ("period, us", json!(period_us)),
        ("gains P, I, D", json!([gains.p, gains.i, gains.d])),
        ("lambda", json!(lambda)),
        ("authority, percent", json!(authority)),
        ("features", serde_json::to_value(spec.features)?),
    ])
}

fn learned_of_any_architecture(file: &Path) -> anyhow::Result<Facts> {
    let name = architecture(file)?;
    if name == ControllerArchitecture::Ours.name() {
        learned(&Learned::load(file)?)
    } else if Some(name.as_str()) == AuthorsController::NAME {
        Ok(authors(&Learned::read(file)?))
    } else {
        bail!(
            "{} has the architecture {name}, which this version does not know: update the trainer",
            file.display()
        )
    }
}

fn learned(learned: &Learned) -> anyhow::Result<Facts> {
    let id = decode(&learned.image()?)?.id;
    let mut facts = vec![("kind", json!("learned controller")), ("id", json!(image_id(id)))];
    facts.extend(origin(&learned.origin));
    facts.extend(controller(learned.controller.spec())?);
    Ok(facts)
}

fn authors(learned: &Learned<AuthorsController>) -> Facts {
    let AuthorsSpec { period_us, gains, lambda, authority, error_spacing_us } = learned.controller.spec();
    let mut facts =
        vec![("kind", json!("learned controller")), ("architecture", json!(AuthorsController::NAME))];
    facts.extend(origin(&learned.origin));
    facts.extend([
        ("parameters", json!(AuthorsController::size())),
        ("period, us", json!(period_us)),
        ("gains P, I, D", json!([gains.p, gains.i, gains.d])),
        ("lambda", json!(lambda)),
        ("authority, percent", json!(authority)),
        ("error spacing, us", json!(error_spacing_us)),
    ]);
    facts
}

fn origin(origin: &Origin) -> Facts {
    vec![
        ("plant", json!(origin.plant)),
        ("seed", json!(origin.seed)),
        ("revision", json!(origin.git_revision)),
        ("score in training", json!(origin.validation)),
        ("score of its PID", json!(origin.base)),
    ]
}

fn simulator(simulator: &Simulator) -> anyhow::Result<Facts> {
    Ok(vec![
        ("kind", json!("learned simulator")),
        ("plant", json!(simulator.plant)),
        ("shape", serde_json::to_value(simulator.architecture)?),
        ("parameters", json!(simulator.parameters.len())),
        ("noise, cmH2O", json!(simulator.noise)),
        ("starting pressure, cmH2O", json!(simulator.start_pressure)),
    ])
}

fn recording(recording: &Recording) -> Facts {
    let provenance = &recording.provenance;
    let ids = if provenance.weights_id.is_empty() { "none" } else { &provenance.weights_id };
    vec![
        ("kind", json!("recording")),
        ("source", json!(provenance.source)),
        ("plant", json!(provenance.plant)),
        ("seed", json!(provenance.seed)),
        ("revision", json!(provenance.git_revision)),
        ("weights", json!(ids)),
        ("period, us", json!(provenance.period_us)),
        ("ticks", json!(recording.len())),
        ("breaths", json!(recording.breaths().len())),
        ("complete inspirations", json!(recording.inspirations().len())),
        ("pressure, cmH2O", json!(data::recording::range(&recording.pressure))),
        ("inspiratory valve, percent", json!(data::recording::range(&recording.u_in))),
        ("groups", json!(provenance.groups)),
        ("notes", json!(provenance.notes)),
        ("settings", provenance.settings.clone()),
        ("bench", json!(provenance.plant_parameters)),
    ]
}

fn table(file: &Path, facts: &Facts) -> Table {
    let mut table = Table::new("", &[&file.display().to_string(), ""]);
    for (name, value) in facts {
        rows(name, value, &mut table);
    }
    table
}

/// A row for each value: fields of an object have rows of their own.
fn rows(name: &str, value: &Value, table: &mut Table) {
    match value {
        Value::Object(fields) => {
            fields.iter().for_each(|(field, value)| rows(&format!("{name}: {field}"), value, table));
        }
        value => table.row(vec![Cell::text(name), Cell::text(text(value))]),
    }
}

/// A value as a reader expects it: no quotes and brackets, and numbers with the digits that were stored.
fn text(value: &Value) -> String {
    match value {
        Value::Null => "none".to_owned(),
        Value::String(text) => text.trim_end().to_owned(),
        Value::Array(values) if values.is_empty() => "none".to_owned(),
        Value::Array(values) => values.iter().map(text).collect::<Vec<_>>().join(", "),
        Value::Number(number) => match number.as_f64() {
            // Of single precision, in which most values are stored: its own digits, not those of the wider number.
            Some(wide) if number.is_f64() && f64::from(wide as f32).total_cmp(&wide).is_eq() => {
                (wide as f32).to_string()
            }
            _ => number.to_string(),
        },
        other => other.to_string(),
    }
}

/// A fixed-length field of the image as text.
fn label(field: &[u8]) -> String {
    String::from_utf8_lossy(field).trim_end_matches('\0').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fields_of_zeros_are_empty_and_cut_texts_still_readable() {
        assert_eq!(label(&[0; 16]), "");
        assert_eq!(label(b"R20C20\0\0\0\0\0\0\0\0\0\0"), "R20C20");
        assert_eq!(label(b"a lung with a na"), "a lung with a na");
    }

    #[test]
    fn nested_facts_have_a_row_each() {
        let features = json!({ "taps": [0, 1], "times": { "first": 3 } });
        let facts = vec![("features", features), ("plant", json!("a\nb\n")), ("gain", json!(0.1_f32))];
        let text = table(Path::new("file"), &facts).to_plain();
        for part in ["features: taps ", " 0, 1\n", "features: times: first ", " 3\n", " 0.1"] {
            assert!(text.contains(part), "{part}: {text}");
        }
    }
}
