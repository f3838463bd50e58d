//! Learned controllers and simulators as ONNX.

use std::path::Path;

use anyhow::bail;
use data::tensors;
use learn::controller::Trainable;
use learn::controller::authors::AuthorsController;
use learn::controller::learned::{self, Learned};
use learn::onnx::{self, check};
use learn::simulator::model::{self, Simulator};
use serde::Serialize;
use serde_json::{Value, to_value};
use shared::control::Controller;

use super::Args;
use crate::args::controller::learned as learned_controller;
use crate::command::{Context, write, write_json};

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    kind: &'static str,
    bytes: usize,
    period_us: u32,
}

/// A file, and what it computes.
struct Exported {
    kind: &'static str,
    period_us: u32,
    onnx: Vec<u8>,
    check: Value,
}

/// Writes the controller or simulator as ONNX.
pub fn onnx(args: &Args, context: &Context<'_>) -> anyhow::Result<Summary> {
    let Exported { kind, period_us, onnx, check } = exported(&args.file, args.unit)?;
    write(&args.out, &onnx)?;
    context.line(&format!("saved {}: {kind}, {} bytes", args.out.display(), onnx.len()));
    if let Some(file) = &args.check {
        write_json(file, &check)?;
        context.saved(file);
    }
    Ok(Summary { kind, bytes: onnx.len(), period_us })
}

fn exported(input: &Path, unit: Option<u32>) -> anyhow::Result<Exported> {
    let kind = if input.exists() { tensors::kind(input)? } else { learned::KIND.to_owned() };
    if kind == model::KIND {
        return simulator(&Simulator::load(input)?, unit);
    }
    if unit.is_some() {
        bail!("--unit is that of a simulator, but {} contains a {kind}: omit it", input.display());
    }
    if input.exists() && Some(learned::architecture(input)?.as_str()) == AuthorsController::NAME {
        return authors(&Learned::read(input)?.controller);
    }
    controller(input)
}

fn controller(input: &Path) -> anyhow::Result<Exported> {
    let chosen = learned_controller(input)?;
    let Some(residual) = chosen.residual() else { bail!("{} is no learned controller", chosen.name) };
    let law = Controller::Residual(residual.clone());
    Ok(Exported {
        kind: "controller",
        period_us: chosen.period_us,
        onnx: onnx::residual(residual),
        check: to_value(check::controller(&law, chosen.period_us))?,
    })
}

fn authors(controller: &AuthorsController) -> anyhow::Result<Exported> {
    let period_us = controller.spec().period_us;
    Ok(Exported {
        kind: "controller",
        period_us,
        onnx: onnx::authors(controller),
        check: to_value(check::controller(controller, period_us))?,
    })
}

fn simulator(simulator: &Simulator, unit: Option<u32>) -> anyhow::Result<Exported> {
    Ok(Exported {
        kind: "simulator",
        period_us: simulator.architecture.timing().period_us,
        onnx: onnx::simulator(simulator, unit)?,
        check: to_value(check::simulator(simulator, unit))?,
    })
}
