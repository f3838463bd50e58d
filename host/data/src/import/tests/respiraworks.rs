//! Imports generated tables in the measured layout, and the measured tables if available.

use rand_distr::{Distribution, Normal};

use super::*;

const HEADER: &str = "run,test,C_ml_per_cmH2O,R_cmH2O_per_Lps,t_s,setpoint_cmH2O,pressure_cmH2O,flow_in_mlps,\
                      flow_out_mlps,cmd_inh_valve,cmd_exh_valve,cmd_psol\n";
const QUANTUM: f64 = 0.010_197;

/// Rows of one test: 40 of rest, then breaths of 3 s at 100 Hz between 5 and 15 cmH2O.
fn lines(run: &str, test: u32, rows: usize, noise: f64) -> Vec<String> {
    let mut random = ChaCha8Rng::seed_from_u64(u64::from(test));
    let normal = Normal::new(0.0, noise).unwrap();
    let line = |row: usize| {
        let tick = (row + 300 - 40) % 300;
        let setpoint = if row < 40 || tick >= 100 { 5.0 } else { 15.0_f64.min(6.0 + tick as f64) };
        let pressure = ((setpoint + normal.sample(&mut random)) / QUANTUM).round() * QUANTUM;
        let (inhale, exhale) = if setpoint > 5.0 { ("1.0", "0.05") } else { ("0.25", "0.6") };
        let time = row as f64 * 0.01;
        format!(
            "{run},{test},20,50,{time:.3},{setpoint:.3},{pressure:.4},250.5,-125.25,{inhale},{exhale},-0.0\n"
        )
    };
    (0..rows).map(line).collect()
}

fn write(folder: &Path, name: &str, lines: &[String]) -> PathBuf {
    let path = folder.join(name);
    fs::write(&path, format!("{HEADER}{}", lines.concat())).unwrap();
    path
}

fn import_tables(paths: &[PathBuf]) -> Result<(Recording, ImportSummary), DatasetError> {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.parquet");
    let layout = ColumnMap::respiraworks().unwrap().layout().unwrap();
    let summary = import(paths, &layout, &out, &Progress::silent())?;
    Ok((Recording::load(&out).unwrap(), summary))
}

fn import_lines(lines: &[String]) -> Result<(Recording, ImportSummary), DatasetError> {
    let folder = tempfile::tempdir().unwrap();
    import_tables(&[write(folder.path(), "table.csv", lines)])
}

#[test]
fn a_test_becomes_breaths_in_the_units_of_a_recording() {
    let (recording, summary) = import_lines(&lines("AIR", 3, 700, 0.1)).unwrap();
    assert_eq!(recording.breaths(), [40..340, 340..640, 640..700].map(|rows| rows.start - 40..rows.end - 40));
    assert_eq!(recording.inspirations(), [0..90, 300..390]);
    assert_eq!(recording.provenance.period_us, 10_000);
    assert_eq!(recording.provenance.groups, ["AIR:3"].map(TestRun::from));
    assert_eq!((summary.dropped_before_first_breath, summary.dropped_after_gap), (40, 0));
    assert_eq!((summary.rows, summary.kept, summary.breaths, summary.complete_breaths), (700, 660, 3, 2));

    assert_eq!((recording.pip[0], recording.peep[0]), (15.0, 5.0));
    assert_eq!((recording.u_in[0], recording.u_out[0]), (100.0, 5.0));
    assert_eq!(recording.target[..3], [6.0, 7.0, 8.0]);
    assert_eq!(recording.flow_in.as_deref().unwrap()[..1], [0.2505]);
    assert_eq!(recording.flow_out.as_deref().unwrap()[..1], [-0.12525]);
    assert_eq!(recording.resistance.as_deref().unwrap()[..1], [50.0]);
    assert_eq!(recording.compliance.as_deref().unwrap()[..1], [20.0]);
    assert!(recording.u_psol.unwrap()[0].is_sign_positive());
    assert_eq!(recording.pressure_true, None);
}

#[test]
fn rows_between_the_scored_inspiration_and_peep_are_the_fall() {
    let (recording, _) = import_lines(&lines("AIR", 1, 400, 0.1)).unwrap();
    let phases: Vec<_> = recording.phase[..300].chunk_by(|a, b| a == b).map(|c| (c[0], c.len())).collect();
    assert_eq!(phases, [(INSPIRATION, 90), (FALL, 10), (EXPIRATION, 200)]);
}

#[test]
fn a_change_of_test_or_run_ends_a_breath() {
    let mut table = lines("AIR", 1, 150, 0.1);
    table.extend(lines("AIR", 2, 150, 0.1));
    table.extend(lines("OXY", 2, 150, 0.1));
    let (recording, summary) = import_lines(&table).unwrap();
    assert_eq!(recording.provenance.groups, ["AIR:1", "AIR:2", "OXY:2"].map(TestRun::from));
    assert_eq!(recording.breaths(), [0..110, 110..220, 220..330]);
    let groups = recording.group.unwrap();
    assert_eq!([groups[0], groups[110], groups[329]], [0, 1, 2]);
    assert_eq!((summary.tests, summary.dropped_before_first_breath), (3, 120));
}

#[test]
fn a_gap_in_time_ends_a_breath_and_rows_up_to_the_next_rise_are_dropped() {
    let mut table = lines("AIR", 1, 400, 0.1);
    table.drain(200..210);
    let (recording, summary) = import_lines(&table).unwrap();
    assert_eq!(recording.breaths(), [0..160, 160..220]);
    assert_eq!(summary.gaps, 1);
    assert_eq!((summary.dropped_before_first_breath, summary.dropped_after_gap), (40, 130));
    assert_eq!(summary.kept + 40 + 130, summary.rows);
}

#[test]
fn several_tables_become_one_recording() {
    let folder = tempfile::tempdir().unwrap();
    let a = write(folder.path(), "a.csv", &lines("A", 1, 400, 0.1));
    let b = write(folder.path(), "b.csv", &lines("B", 1, 400, 0.1));
    let (recording, summary) = import_tables(&[a, b]).unwrap();
    assert_eq!(recording.provenance.groups, ["A:1", "B:1"].map(TestRun::from));
    assert_eq!((summary.breaths, recording.breaths().len()), (4, 4));
    assert_eq!(recording.provenance.settings["files"], json!(["a.csv", "b.csv"]));
}

#[test]
fn quantum_noise_and_saturation_are_estimated() {
    let (_, summary) = import_lines(&lines("AIR", 1, 3_040, 0.08)).unwrap();
    assert!((summary.quantum - QUANTUM).abs() < 2e-5, "{}", summary.quantum);
    assert!((summary.noise - 0.08).abs() < 0.008, "{}", summary.noise);
    assert!(summary.pressure.low < 5.0 && summary.pressure.high > 15.0);
    // The generated valves are always at an end of their range; the oxygen valve is not in use.
    assert_eq!((summary.saturated_inhale, summary.saturated_exhale, summary.saturated_psol), (1.0, 1.0, 0.0));
    assert!(summary.to_string().contains("rows read                   3040\n"), "{summary}");
}

/// The error for a table whose line 52 has `cell` in the given column.
fn error_for(column: usize, cell: &str) -> DatasetError {
    let mut table = lines("AIR", 1, 100, 0.1);
    let mut cells: Vec<_> = table[50].trim_end().split(',').collect();
    cells[column] = cell;
    table[50] = cells.join(",") + "\n";
    import_lines(&table).unwrap_err()
}

#[test]
fn a_bad_cell_is_named_with_file_line_and_column() {
    let cases = [
        (6, "NaN", "pressure_cmH2O", "is not finite"),
        (6, "", "pressure_cmH2O", "is not a number"),
        (4, "soon", "t_s", "is not a number"),
        (9, "1.2", "cmd_inh_valve", "is not a command from 0 to 1"),
    ];
    for (place, cell, name, why) in cases {
        match error_for(place, cell) {
            DatasetError::TableCell { path, line, column, value, reason } => {
                assert!(path.ends_with("table.csv"));
                assert_eq!((line, column.as_str(), value.as_str()), (52, name, cell));
                let (told, what_to_do) = reason.split_once(": ").unwrap();
                assert!(told == why && what_to_do.starts_with("correct the cell"), "{reason}");
            }
            other => panic!("{other}"),
        }
    }
}

#[test]
fn a_short_line_a_missing_column_and_a_missing_file_are_told_apart() {
    let mut table = lines("AIR", 1, 100, 0.1);
    table[10] = "AIR,1,20\n".to_owned();
    let error = import_lines(&table).unwrap_err();
    assert!(
        matches!(error, DatasetError::TableLine { .. })
            && error.to_string().contains("line 12: it has 3 cells"),
        "{error}"
    );

    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("other.csv");
    fs::write(&path, "run,test\nA,1\n").unwrap();
    assert!(
        matches!(import_tables(&[path]), Err(DatasetError::TableColumn { column, .. }) if column == "t_s")
    );
    assert!(matches!(import_tables(&[folder.path().join("none.csv")]), Err(DatasetError::Missing { .. })));
}

#[test]
fn tables_without_a_breath_or_at_two_rates_are_refused() {
    assert!(matches!(import_lines(&lines("AIR", 1, 40, 0.1)), Err(DatasetError::NoBreath { .. })));
    let folder = tempfile::tempdir().unwrap();
    let fast = write(folder.path(), "fast.csv", &lines("AIR", 1, 400, 0.1));
    let mut slow = lines("AIR", 2, 400, 0.1);
    for (row, line) in slow.iter_mut().enumerate() {
        let mut cells: Vec<_> = line.split(',').map(str::to_owned).collect();
        cells[4] = format!("{:.3}", row as f64 * 0.02);
        *line = cells.join(",");
    }
    let slow = write(folder.path(), "slow.csv", &slow);
    match import_tables(&[fast, slow]).unwrap_err() {
        DatasetError::Period { path, found_us, expected_us } => {
            assert!(path.ends_with("slow.csv"));
            assert_eq!((found_us, expected_us), (20_000, 10_000));
        }
        other => panic!("{other}"),
    }
}

#[test]
fn the_measured_tables_import_whole() {
    let Some(paths) = measured() else { return };
    let (recording, summary) = import_tables(&paths).unwrap();
    println!("{summary}");
    assert_eq!((summary.rows, summary.tests, summary.gaps, summary.period_us), (56_160, 24, 0, 10_000));
    assert_eq!(summary.breaths, recording.breaths().len());
    assert_eq!(summary.kept + summary.dropped_before_first_breath, summary.rows);
    assert_eq!(summary.dropped_after_gap, 0);
    assert!((summary.quantum - 0.010_197).abs() < 2e-5, "one pascal is expected: {}", summary.quantum);

    // Each test contains its row of the lung table, whole breaths at one pair of settings.
    let settings = [(15, 5), (25, 10), (30, 5), (35, 10), (20, 5), (35, 10), (35, 5), (35, 10)];
    for inspiration in recording.inspirations() {
        let row = inspiration.start;
        let test = recording.test_run(row).unwrap().run.as_ref().unwrap();
        let (pip, peep) = settings[test.parse::<usize>().unwrap() - 1];
        assert_eq!((recording.pip[row], recording.peep[row]), (pip as f32, peep as f32), "row {row}");
        assert_eq!(inspiration.len(), 90);
    }
}

#[test]
fn the_oxygen_run_is_driven_by_the_oxygen_valve_alone() {
    let Some(paths) = measured() else { return };
    let (recording, _) = import_tables(&paths[1..2]).unwrap();
    assert!(recording.u_in.iter().all(|&command| command == 0.0));
    assert!(recording.u_psol.unwrap().iter().any(|&command| command > 99.0));
}
