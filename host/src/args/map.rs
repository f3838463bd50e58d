//! Column maps of third-party tables, and recordings from tables.

use std::path::Path;

use anyhow::{Context as _, bail};

use crate::command::Context;
use data::import::map::ColumnMap;
use data::recording::Recording;

/// The choice of a column map.
#[derive(Debug, clap::Args)]
pub struct MapArgs {
    /// Column map of the tables, which names columns and units: respiraworks, kaggle or a TOML file (docs/RECORDINGS.md)
    #[arg(long, value_name = "NAME|FILE")]
    map: Option<String>,
}

impl MapArgs {
    /// The chosen column map, if there is one.
    ///
    /// # Errors
    /// A file that is no column map.
    pub fn chosen(&self) -> anyhow::Result<Option<ColumnMap>> {
        self.map.as_deref().map(column_map).transpose()
    }
}

fn column_map(name: &str) -> anyhow::Result<ColumnMap> {
    Ok(match name {
        "respiraworks" => ColumnMap::respiraworks()?,
        "kaggle" => ColumnMap::kaggle()?,
        file => ColumnMap::load(Path::new(file)).with_context(|| file.to_owned())?,
    })
}

/// Reads a recording, or imports a table.
///
/// # Errors
/// A file that cannot be read, or a table without a column map.
pub fn load(file: &Path, map: Option<&ColumnMap>, context: &Context<'_>) -> anyhow::Result<Recording> {
    if file.extension().is_some_and(|extension| extension == "parquet") {
        return Ok(Recording::load(file)?);
    }
    let Some(map) = map else {
        bail!("{} is not a recording (.parquet): name its column map with --map", file.display());
    };
    let layout = map.layout()?;
    let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
    let out = folder.path().join("imported.parquet");
    context.progress(|progress| data::import::import(&[file.to_owned()], &layout, &out, progress))?;
    Ok(Recording::load(&out)?)
}
