//! Shared by the tests of all crates: the location of the measured tables, and their recording.

use std::path::{Path, PathBuf};

use progress::Progress;

use super::import;
use super::map::ColumnMap;
use crate::recording::Recording;

/// The three measured tables, if available.
pub fn measured() -> Option<Vec<PathBuf>> {
    files("respiraworks", &["CT_AIR.csv", "CT_OXY.csv", "NPV_AIR.csv"])
}

/// Recorded files, if available: in a folder of the one given by `EUPNEA_DATA`, else beside the project.
pub fn files(folder: &str, names: &[&str]) -> Option<Vec<PathBuf>> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data");
    let folder = std::env::var_os("EUPNEA_DATA").map_or_else(beside, PathBuf::from).join(folder);
    let paths: Vec<PathBuf> = names.iter().map(|name| folder.join(name)).collect();
    if paths.iter().all(|path| path.exists()) {
        return Some(paths);
    }
    eprintln!("skipped: no recorded files in {}", folder.display());
    None
}

/// Imports measured tables into a file of `folder` and reads it; panics if that fails.
pub fn measured_recording(tables: &[PathBuf], folder: &Path) -> Recording {
    let layout = ColumnMap::respiraworks().and_then(|map| map.layout()).expect("the map is sound");
    let out = folder.join("measured.parquet");
    import(tables, &layout, &out, &Progress::silent()).expect("the tables are whole");
    Recording::load(out).expect("it was just written")
}
