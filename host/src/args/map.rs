//! Files of third parties: their format, told by their content, or the column map of a table.

use std::path::{Path, PathBuf};

use anyhow::{Context as _, bail};

use crate::command::{Context, quoted};
use data::import::format::{CSV, Format};
use data::import::import_as;
use data::import::map::ColumnMap;
use data::recording::Recording;

/// The choice of a column map.
#[derive(Debug, clap::Args)]
pub struct MapArgs {
    /// Column map of a table of your own: a TOML file that names columns and units (docs/RECORDINGS.md)
    #[arg(long, value_name = "FILE")]
    map: Option<PathBuf>,
}

impl MapArgs {
    /// Whether a map is given.
    pub fn is_given(&self) -> bool {
        self.map.is_some()
    }

    /// How to read a file: by the map or, without one, by the name of a format or else by its content.
    ///
    /// # Errors
    /// A file that is no column map, or a table without one.
    pub fn format(&self, file: &Path, named: Option<&str>) -> anyhow::Result<Format> {
        if let Some(map) = &self.map {
            if let Some(named) = named.filter(|named| *named != CSV) {
                bail!("--map is for tables: leave it out for the format {named}, or write --format {CSV}");
            }
            let shown = || map.display().to_string();
            return Ok(Format::Table(ColumnMap::load(map).and_then(|map| map.layout()).with_context(shown)?));
        }
        let name = named.map_or_else(|| Format::name_of(file), Ok)?;
        let Some(format) = Format::named(name) else {
            let file = quoted(file.display().to_string());
            bail!(
                "{file} is a table of no known format: name its columns with --map; `trainer import {file} --propose-map \
                 columns.toml` proposes a map"
            );
        };
        Ok(format)
    }
}

/// Reads a recording, or imports a file of a third party.
///
/// # Errors
/// A file that cannot be read, or a table without a column map.
pub fn load(file: &Path, map: &MapArgs, context: &Context<'_>) -> anyhow::Result<Recording> {
    if file.extension().is_some_and(|extension| extension == "parquet") {
        return Ok(Recording::load(file)?);
    }
    let format = map.format(file, None)?;
    let folder = tempfile::tempdir().context("cannot create a temporary folder")?;
    let out = folder.path().join("imported.parquet");
    context.progress(|progress| import_as(&format, &[file.to_owned()], &out, progress))?;
    Ok(Recording::load(&out)?)
}
