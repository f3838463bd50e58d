//! Generated tables in third-party layouts.

mod field;
mod formats;
mod respiraworks;

use std::fmt::Write as _;
use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use rand::RngExt;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::map::ColumnMap;
use super::*;
use crate::identity::TestRun;
use crate::recording::{EXPIRATION, FALL, INSPIRATION, Recording};

const QUANTUM: f64 = 0.070_304;

/// Breaths of 80 rows in the Kaggle layout; time steps jitter by half a millisecond around 33.
fn kaggle(breaths: usize) -> String {
    let mut random = ChaCha8Rng::seed_from_u64(1);
    let mut text = "id,breath_id,R,C,time_step,u_in,u_out,pressure\n".to_owned();
    for breath in 0..breaths {
        let (r, c) = [(20, 50), (5, 10), (50, 20)][breath % 3];
        let mut time = 0.0;
        for row in 0..80 {
            let inspires = row < 30;
            let rise = 10.0 * (1.0 - (-time / 0.2_f64).exp());
            // The pressure falls after the valve has opened, not at the same time.
            let pressure = ((if row <= 30 { 6.0 + rise } else { 6.5 }) / QUANTUM).round() * QUANTUM;
            let u_in = if inspires { 25.0 * (1.0 - time) } else { 5.0 };
            let id = 80 * breath + row + 1;
            writeln!(
                text,
                "{id},{},{r},{c},{time},{u_in},{},{pressure}",
                7 * breath + 3,
                i32::from(!inspires)
            )
            .unwrap();
            time += 0.033 + random.random_range(-0.000_5..0.000_5);
        }
    }
    text
}

fn imported(text: &str, map: &ColumnMap) -> Result<(Recording, ImportSummary), DatasetError> {
    let folder = tempfile::tempdir().unwrap();
    let (table, out) = (folder.path().join("table.csv"), folder.path().join("out.parquet"));
    fs::write(&table, text).unwrap();
    let summary = import(&[table], &map.layout().unwrap(), &out, &Progress::silent())?;
    Ok((Recording::load(&out).unwrap(), summary))
}

#[test]
fn the_kaggle_layout_becomes_breaths_on_an_even_grid() {
    let (recording, summary) = imported(&kaggle(9), &ColumnMap::kaggle().unwrap()).unwrap();
    assert!((32_900..33_100).contains(&summary.period_us), "{summary}");
    assert_eq!((summary.rows, summary.breaths, summary.complete_breaths, summary.gaps), (720, 9, 9, 0));
    assert_eq!((summary.dropped_before_first_breath, summary.dropped_after_gap), (0, 0));
    assert_eq!(summary.kept, recording.len());
    assert!(summary.resampled_breaths >= 8, "{summary}");
    assert!((summary.quantum - QUANTUM).abs() < 1e-4, "{summary}");
    assert_eq!(summary.lungs, [("20:50".into(), 3), ("5:10".into(), 3), ("50:20".into(), 3)].into());

    let breaths = recording.breaths();
    assert_eq!(breaths.len(), 9);
    assert!(breaths.iter().all(|rows| (79..=81).contains(&rows.len())), "{breaths:?}");
    let period = f64::from(summary.period_us) * 1e-6;
    for rows in recording.inspirations() {
        assert!((29..=31).contains(&rows.len()), "{rows:?}");
        // On the grid the pressure equals the curve that was sampled off the grid.
        for (tick, row) in rows.clone().enumerate().take(28) {
            let expected = 16.0 - 10.0 * (-(tick as f64) * period / 0.2).exp();
            assert!((f64::from(recording.pressure[row]) - expected).abs() < 0.11, "tick {tick}");
        }
        assert!(recording.u_out[rows.start] < 1.0);
        assert!(
            (recording.pip[rows.start] - 16.0).abs() < 0.2 && (recording.peep[rows.start] - 6.0).abs() < 0.1
        );
    }
    assert_eq!((recording.resistance.unwrap()[0], recording.compliance.unwrap()[0]), (20.0, 50.0));
    assert!(recording.u_out[79] > 99.0);
    assert!(recording.provenance.notes.iter().any(|note| note.contains("no set-point")));
}

/// A map for [`mapped`].
const MAP: &str = r#"
plant = "bench of the neighbours"
separator = ";"
inspiration_s = 0.5
[time]
column = "t"
unit = "ms"
[pressure]
column = "Paw"
unit = "mbar"
[u_in]
column = "valve"
unit = "share"
[target]
column = "set"
[flow_in]
column = "V'in"
unit = "L/min"
[flow_out]
column = "V'out"
unit = "mL/s"
scale = 2.0
offset = 10.0
[resistance]
value = 15
[compliance]
value = 0.025
unit = "L/cmH2O"
[group]
column = "lung"
"#;

/// Rows at 100 Hz: 0.2 s of rest, then breaths of one second between 5 and 20, with 0.6 s at the top.
fn mapped(rows: usize) -> Vec<String> {
    let row = |n: usize| {
        let tick = (n + 100 - 20) % 100;
        let set = if n >= 20 && tick < 60 { 20 } else { 5 };
        format!("{};{};{};{};30;100;left\n", n * 10, set, 10.0 + tick as f64 * 0.01, f64::from(set) / 20.0)
    };
    (0..rows).map(row).collect()
}

const HEAD: &str = "t;set;Paw;valve;V'in;V'out;lung\n";

fn from_rows(rows: &[String]) -> Result<(Recording, ImportSummary), DatasetError> {
    imported(&format!("{HEAD}{}", rows.concat()), &ColumnMap::from_toml(MAP).unwrap())
}

#[test]
fn a_column_map_gives_names_units_scales_and_constants() {
    let (recording, summary) = from_rows(&mapped(420)).unwrap();
    assert_eq!((summary.period_us, summary.breaths, summary.complete_breaths), (10_000, 4, 4));
    assert_eq!((summary.dropped_before_first_breath, summary.resampled_breaths), (20, 0));
    assert_eq!(recording.breaths(), [0..100, 100..200, 200..300, 300..400]);
    let phases: Vec<_> = recording.phase[..100].chunk_by(|a, b| a == b).map(|c| (c[0], c.len())).collect();
    assert_eq!(phases, [(INSPIRATION, 50), (FALL, 10), (EXPIRATION, 40)]);
    let near = |a: f32, b: f32| assert!((a - b).abs() < 1e-4, "{a} {b}");
    near(recording.pressure[0], 10.0 * 1.019_716);
    near(recording.u_in[0], 100.0);
    near(recording.flow_in.as_deref().unwrap()[0], 0.5);
    near(recording.flow_out.as_deref().unwrap()[0], 0.21);
    near(recording.resistance.as_deref().unwrap()[0], 15.0);
    near(recording.compliance.as_deref().unwrap()[0], 25.0);
    assert_eq!(
        (recording.pip[0], recording.peep[0], recording.u_out[0], recording.u_out[60]),
        (20.0, 5.0, 0.0, 100.0)
    );
    assert_eq!(recording.provenance.groups, ["left"].map(TestRun::from));
    assert_eq!(recording.provenance.plant, "bench of the neighbours");
}

#[test]
fn a_gap_ends_a_breath_and_every_row_is_accounted_for() {
    let mut rows = mapped(420);
    rows.drain(150..160);
    let (recording, summary) = from_rows(&rows).unwrap();
    assert_eq!((summary.gaps, summary.breaths), (1, 4));
    assert_eq!(recording.breaths(), [0..100, 100..130, 130..230, 230..330]);
    assert_eq!((summary.dropped_before_first_breath, summary.dropped_after_gap), (20, 60));
    assert_eq!(summary.kept + 20 + 60, summary.rows);
    assert!(summary.to_string().contains("  after a gap               60\n"), "{summary}");
    // A clock that was set back is also a gap.
    let late = mapped(420);
    let twice = [&late[..], &late[20..]].concat();
    let (_, summary) = from_rows(&twice).unwrap();
    assert_eq!((summary.gaps, summary.breaths), (1, 7));
}

#[test]
fn a_change_of_group_ends_a_breath() {
    let mut rows = mapped(420);
    rows[200..].iter_mut().for_each(|row| *row = row.replace("left", "right"));
    let (recording, summary) = from_rows(&rows).unwrap();
    assert_eq!(recording.provenance.groups, ["left", "right"].map(TestRun::from));
    assert_eq!((summary.breaths, summary.gaps, summary.dropped_before_first_breath), (4, 0, 40));
    let groups = recording.group.unwrap();
    assert_eq!((groups[0], groups[179], groups[180]), (0, 0, 1));
}

#[test]
fn a_valve_that_closes_starts_a_breath_where_nothing_else_does() {
    let map = "inspiration_s = 0.3\n[time]\ncolumn = 't'\n[pressure]\ncolumn = 'p'\n[u_in]\ncolumn = 'u'\n[u_out]\ncolumn = 'o'\nunit = 'share'\n";
    let mut text = "t,p,u,o\n".to_owned();
    for n in 0..100 {
        writeln!(text, "{},{},{},{}", f64::from(n) * 0.1, n % 7, n % 100, i32::from(n % 20 >= 8)).unwrap();
    }
    let (recording, summary) = imported(&text, &ColumnMap::from_toml(map).unwrap()).unwrap();
    assert_eq!((summary.breaths, summary.dropped_before_first_breath), (4, 20));
    assert_eq!(recording.inspirations()[0], 0..3, "inspiration_s goes before the valve");
}

#[test]
fn maps_that_make_no_sense_are_refused_with_what_to_write() {
    let refused = |from: &str, to: &str| {
        assert!(MAP.contains(from));
        let map = ColumnMap::from_toml(&MAP.replace(from, to));
        map.and_then(|map| map.layout()).unwrap_err().to_string()
    };
    assert!(refused("\"mbar\"", "\"bar\"").contains("cmH2O, mmH2O, hPa, mbar"));
    assert!(refused("value = 15", "").contains("[resistance]"));
    assert!(refused("column = \"Paw\"", "value = 3.0").contains("[pressure]"));
    assert!(refused("inspiration_s = 0.5", "inspiration_s = -1").contains("above 0"));
    assert!(refused("[target]", "[traget]").contains("traget"));
    assert!(
        refused("separator = \";\"", "separator = \";\"\ndecimal = \"\u{20ac}\"")
            .contains("one ASCII character")
    );
    assert!(refused("[flow_in]", "[flow]\ncolumn = \"f\"\n[flow_in]").contains("one [flow]"));
    assert!(refused("column = \"valve\"", "column = 0").contains("counted from 1"));
    let refused = |map: &str| ColumnMap::from_toml(map).unwrap().layout().unwrap_err().to_string();
    assert!(refused("[pressure]\ncolumn = 'p'\n").contains("period_ms"));
}

#[test]
fn a_stopped_import_leaves_the_older_file_and_nothing_beside_it() {
    let folder = tempfile::tempdir().unwrap();
    let (table, out) = (folder.path().join("table.csv"), folder.path().join("out.parquet"));
    fs::write(&table, kaggle(9)).unwrap();
    fs::write(&out, "older").unwrap();
    let layout = ColumnMap::kaggle().unwrap().layout().unwrap();
    let stopped = import(&[table], &layout, &out, &Progress::quiet(&AtomicBool::new(true)));
    assert!(matches!(stopped, Err(DatasetError::Stopped)));
    assert_eq!(fs::read_to_string(&out).unwrap(), "older");
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 2);
}

#[test]
fn a_file_that_grows_while_it_is_read_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.parquet");
    let tables = ["first.csv", "second.csv"].map(|name| folder.path().join(name));
    for table in &tables {
        fs::write(table, kaggle(9)).unwrap();
    }
    // Half a line, as a logger leaves one.
    let grow = |_: &progress::Event<'_>| {
        let mut log = fs::File::options().append(true).open(&tables[1]).unwrap();
        log.write_all(b"9999,70,20,").unwrap();
    };
    let layout = ColumnMap::kaggle().unwrap().layout().unwrap();
    let changed = import(&tables, &layout, &out, &Progress::new(&grow, &AtomicBool::new(false)));
    assert!(matches!(changed, Err(DatasetError::Changed(path)) if path == tables[1]));
    assert!(!out.exists());
}

#[test]
fn bad_cells_columns_and_tables_are_named() {
    let mut rows = mapped(420);
    rows[50] = rows[50].replace(";30;", ";NaN;");
    let error = from_rows(&rows).unwrap_err().to_string();
    assert!(error.contains("line 52") && error.contains("V'in") && error.contains("not finite"), "{error}");
    let kaggle_map = ColumnMap::kaggle().unwrap();
    let error = imported("id,breath_id,R,C\n1,1,1,1\n", &kaggle_map).unwrap_err().to_string();
    assert!(error.contains("no column `time_step`"), "{error}");
    assert!(error.contains("`id`, `breath_id`, `R`, `C`"), "{error}");
    let error = from_rows(&mapped(15)).unwrap_err().to_string();
    assert!(error.contains("15 rows of ") && error.contains("unit of [time]"), "{error}");
    let layout = kaggle_map.layout().unwrap();
    let absent = import(&["none.csv".into()], &layout, Path::new("x.parquet"), &Progress::silent());
    assert!(matches!(absent, Err(DatasetError::Missing { .. })));
}

#[test]
fn a_file_that_is_no_table_is_told_as_what_it_is_with_what_to_do() {
    let map = ColumnMap::kaggle().unwrap();
    let layout = map.layout().unwrap();
    let folder = tempfile::tempdir().unwrap();
    let refused = |path: &Path| {
        let out = folder.path().join("out.parquet");
        import(&[path.to_owned()], &layout, &out, &Progress::silent()).unwrap_err().to_string()
    };
    assert!(refused(folder.path()).contains("is a folder"));
    let path = folder.path().join("table.csv");
    for (content, told) in [
        (Vec::new(), "is empty"),
        (kaggle(0).into_bytes(), "no rows"),
        (b"PK\x03\x04\x14\x00".to_vec(), "export it as CSV"),
        (kaggle(9).replace(',', ";").into_bytes(), "correct the separator"),
        (kaggle(9).replace("id,breath_id", "u_out,breath_id").into_bytes(), "several columns `u_out`"),
    ] {
        fs::write(&path, content).unwrap();
        let refused = refused(&path);
        assert!(refused.contains(told) && refused.contains("table.csv"), "{refused}");
    }
}

#[test]
fn a_cell_that_is_no_number_is_told_as_what_it_may_be() {
    let rows = mapped(420);
    for (cell, told) in
        [(";12:00:01;", "is not a number"), (";inf;", "is not finite"), (";;", "is not a number")]
    {
        let mut wrong = rows.clone();
        wrong[50] = wrong[50].replace(";30;", cell);
        let refused = from_rows(&wrong).unwrap_err().to_string();
        assert!(refused.contains("line 52") && refused.contains(told), "{refused}");
    }
}

#[test]
fn values_that_no_ventilator_has_are_refused() {
    let map = ColumnMap::kaggle().unwrap();
    let table = kaggle(9);
    let pressures = table.lines().map(|line| match line.rsplit_once(',') {
        Some((rest, pressure)) if pressure.parse::<f64>().is_ok() => format!("{rest},{pressure}e6\n"),
        _ => format!("{line}\n"),
    });
    let refused = imported(&pressures.collect::<String>(), &map).unwrap_err().to_string();
    assert!(refused.contains("`pressure`") && refused.contains("impossible in this unit"), "{refused}");
    let layout = ColumnMap::from_toml("separator = '\u{20ac}'\ninspiration_s = 1\n[time]\ncolumn = 't'\n[pressure]\ncolumn = 'p'\n[u_in]\ncolumn = 'u'\n[breath]\ncolumn = 'b'\n").unwrap();
    assert!(layout.layout().unwrap_err().to_string().contains("one ASCII character"));
}
