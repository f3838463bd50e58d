//! A learned controller on a bench as an FMU.

use std::env::consts::{DLL_PREFIX, DLL_SUFFIX};
use std::path::PathBuf;

use anyhow::Context as _;
use fmu::{Component, Resources, archive};
use serde::Serialize;

use super::Args;
use crate::args::bench::one;
use crate::args::controller::{image_id, image_of, read};
use crate::command::{Context, write};

/// Bench of an FMU unless another one is chosen.
const BENCH: &str = "R20C20";

/// The content of `--json`.
#[derive(Debug, Serialize)]
pub struct Summary {
    id: String,
    bench: String,
    bytes: usize,
}

/// Writes the FMU. Before, it starts once as a check.
pub fn fmu(args: &Args, context: &Context<'_>) -> anyhow::Result<Summary> {
    let bench = one(args.bench.as_deref().unwrap_or(BENCH))?;
    let resources = Resources::new(&bench, &image_of(&args.file)?)?;
    let id = image_id(resources.image_id());
    Component::new(resources.clone()).start()?;
    let bytes = archive(&resources, &library()?)?;
    write(&args.out, &bytes)?;
    let shown = args.out.display();
    context.line(&format!("saved {shown}: {} bytes, controller {id} on {}", bytes.len(), bench.name));
    Ok(Summary { id, bench: bench.name, bytes: bytes.len() })
}

/// The shared library that runs inside an FMU. Cargo puts it beside this program, or for tests into the folder `deps` there.
fn library() -> anyhow::Result<Vec<u8>> {
    let name = format!("{DLL_PREFIX}eupnea_fmu{DLL_SUFFIX}");
    let program = std::env::current_exe().context("cannot find the path of this program")?;
    let beside = program.with_file_name(&name);
    let places: [PathBuf; 2] = [beside.clone(), program.with_file_name("deps").join(&name)];
    let found = places.iter().find(|place| place.is_file()).with_context(|| {
        format!(
            "an FMU contains the library {}, which is missing: build it with cargo build --release -p fmu_library and put it there",
            beside.display()
        )
    })?;
    read(found)
}
