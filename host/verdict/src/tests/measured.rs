//! The measured tables of a ventilator, if available.

use super::*;
use data::import::{measured, measured_recording};

#[test]
fn the_measured_tables_are_judged_run_by_run() {
    let Some(tables) = measured() else { return };
    let folder = tempfile::tempdir().unwrap();
    let recording = measured_recording(&tables, folder.path());
    let verdict = judge(&recording, Judged::True, &Limits::default()).unwrap();
    assert_eq!(verdict.lungs.len(), 24);
    assert_eq!(verdict.breaths.len() + verdict.unjudged.len(), recording.breaths().len());
    for lung in &verdict.lungs {
        let row = lung.lung.run.as_ref().unwrap().run.clone().unwrap();
        assert_eq!(lung.iso.unwrap().row.to_string(), row, "{}", lung.name);
        let error = lung.error.unwrap().mean;
        assert!((0.8..10.1).contains(&error), "{}: {error}", lung.name);
        assert!(lung.tidal_volume_ml.unwrap().mean > 100.0, "{}", lung.name);
    }
}
