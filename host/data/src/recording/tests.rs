//! Recordings in memory and on disk.

use std::path::Path;

use proptest::prelude::*;
use shared::breath::Phase;
use tempfile::TempDir;

use super::*;
use crate::identity::TestRun;
use crate::provenance::Provenance;

fn provenance(extras: &[Extra]) -> Provenance {
    let groups = if extras.contains(&Extra::Group) { vec!["A:1".into(), "A:2".into()] } else { Vec::new() };
    Provenance { groups, plant: "bench".to_owned(), ..Provenance::new(1_000, "test") }
}

/// Breaths with 20 inspiratory, 10 falling and 30 expiratory ticks.
fn recording(extras: &[Extra], breaths: u32) -> Recording {
    let mut recording = Recording::with_extras(provenance(extras), extras);
    for row in 0..breaths * 60 {
        let tick = row % 60;
        let phase = if tick < 20 {
            INSPIRATION
        } else if tick < 30 {
            FALL
        } else {
            EXPIRATION
        };
        let number = Some(row as f32 * 0.5);
        recording.push(Row {
            breath: row / 60,
            tick,
            phase,
            target: 15.0,
            pressure: row as f32 * 0.1,
            u_in: 50.0,
            u_out: 100.0,
            explore: -3.0,
            pip: 15.0,
            peep: 5.0,
            pressure_true: number,
            pressure_sensor_true: number,
            flow_in: number,
            flow_out: number,
            resistance: Some(20.0),
            compliance: Some(50.0),
            u_psol: number,
            group: Some(row % 2),
        });
    }
    recording
}

fn saved(recording: &Recording) -> (TempDir, std::path::PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording.parquet");
    recording.save(&path).unwrap();
    (folder, path)
}

prop_compose! {
    /// Any valid recording: unusual values, skipped ticks, any optional columns.
    fn any_recording()(
        chosen in prop::sample::subsequence(Extra::ALL.to_vec(), 0..=8),
        rows in prop::collection::vec((any::<bool>(), 1..4_u32, 0..3_u8, prop::array::uniform8(-1e6_f32..1e6)), 0..200),
        (period_us, seed, note) in (any::<u32>(), any::<u64>(), ".{0,20}"),
        scale in any::<f64>().prop_filter("JSON has no NaN", |scale| scale.is_finite()),
    ) -> Recording {
        let mut recording = Recording::with_extras(Provenance {
            period_us, seed, notes: vec![note], settings: serde_json::json!({ "scale": scale }), ..provenance(&chosen)
        }, &chosen);
        let (mut breath, mut tick) = (0, 0);
        for (new_breath, step, phase, v) in rows {
            if new_breath { breath += step; tick = 0; } else { tick += step; }
            recording.push(Row {
                breath, tick, phase,
                target: v[0], pressure: v[1], u_in: v[2], u_out: v[3], explore: v[4], pip: v[5], peep: v[6],
                pressure_true: Some(v[7]), pressure_sensor_true: Some(v[0]), flow_in: Some(v[1]), flow_out: Some(v[2]),
                resistance: Some(v[3]), compliance: Some(v[4]), u_psol: Some(v[5]), group: Some(u32::from(phase) % 2),
            });
        }
        recording
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn any_recording_survives_the_file_unchanged(recording in any_recording()) {
        let (_folder, path) = saved(&recording);
        prop_assert_eq!(Recording::load(&path).unwrap(), recording);
    }

    #[test]
    fn breaths_cover_all_rows_and_joined_recordings_keep_theirs(a in any_recording(), b in any_recording()) {
        let rows: usize = a.breaths().iter().map(ExactSizeIterator::len).sum();
        prop_assert_eq!(rows, a.len());
        let mut joined = a.clone();
        if joined.append(&b).is_ok() {
            prop_assert!(joined.validate().is_ok());
            prop_assert_eq!(joined.breaths().len(), a.breaths().len() + b.breaths().len());
            prop_assert_eq!(joined.inspirations().len(), a.inspirations().len() + b.inspirations().len());
        } else {
            prop_assert_eq!(joined, a);
        }
    }
}

#[test]
fn equal_recordings_give_equal_bytes() {
    let (_a, a) = saved(&recording(&Extra::ALL, 3));
    let (_b, b) = saved(&recording(&Extra::ALL, 3));
    assert_eq!(std::fs::read(a).unwrap(), std::fs::read(b).unwrap());
}

#[test]
fn an_empty_recording_keeps_its_columns() {
    let empty = Recording::new(provenance(&[]), true);
    let (_folder, path) = saved(&empty);
    assert_eq!(Recording::load(path).unwrap(), empty);
}

#[test]
fn a_file_cut_anywhere_is_called_torn() {
    let (_folder, path) = saved(&recording(&[], 2));
    let bytes = std::fs::read(&path).unwrap();
    for length in 0..bytes.len() {
        std::fs::write(&path, &bytes[..length]).unwrap();
        let error = Recording::load(&path).unwrap_err();
        assert!(matches!(error, DatasetError::Torn { .. }), "cut to {length} bytes: {error}");
    }
}

#[test]
fn a_file_with_one_damaged_byte_gives_the_right_rows_or_an_error() {
    let original = recording(&[], 1);
    let (_folder, path) = saved(&original);
    let good = std::fs::read(&path).unwrap();
    for place in 0..good.len() {
        let mut bad = good.clone();
        bad[place] ^= 0xFF;
        std::fs::write(&path, &bad).unwrap();
        if let Ok(recording) = Recording::load(&path) {
            assert_eq!(recording, original, "byte {place} of {}", good.len());
        }
    }
}

#[test]
fn a_file_that_is_absent_or_of_another_kind_is_told_apart() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("recording.parquet");
    assert!(matches!(Recording::load(&path), Err(DatasetError::Missing { .. })));
    std::fs::write(&path, "run,test\n1,2\n").unwrap();
    assert!(matches!(Recording::load(&path), Err(DatasetError::NotParquet { .. })));
    assert!(matches!(Recording::load(folder.path()), Err(DatasetError::Read { .. })));
}

#[test]
fn an_invalid_recording_is_not_written_over_a_good_one() {
    let good = recording(&[], 1);
    let (_folder, path) = saved(&good);
    let mut bad = recording(&[], 1);
    bad.pressure[7] = f32::NAN;
    assert!(matches!(bad.save(&path), Err(DatasetError::NotFinite { column: "pressure", row: 7, .. })));
    assert_eq!(Recording::load(&path).unwrap(), good);
}

/// Damages one recording in one way and returns the validation error.
fn refused(spoil: impl FnOnce(&mut Recording)) -> String {
    let mut recording = recording(&Extra::ALL, 2);
    spoil(&mut recording);
    recording.validate().unwrap_err().to_string()
}

#[test]
fn the_check_names_column_and_row_of_the_first_fault() {
    assert!(refused(|r| r.u_out[4] = f32::NAN).contains("`u_out` is NaN in row 4"));
    assert!(
        refused(|r| r.flow_in.as_mut().unwrap()[9] = f32::INFINITY).contains("`flow_in` is inf in row 9")
    );
    assert!(refused(|r| r.peep.truncate(119)).contains("`peep` has 119 rows where `breath` has 120"));
    assert!(refused(|r| r.phase[3] = 3).contains("`phase` is 3 in row 3"));
    assert!(refused(|r| r.group.as_mut().unwrap()[5] = 2).contains("`group` is 2 in row 5"));
    assert!(refused(|r| r.tick[8] = r.tick[7]).contains("row 8"));
    assert!(refused(|r| r.breath[60..].fill(0)).contains("row 60"));
    assert!(recording(&Extra::ALL, 2).validate().is_ok());
}

#[test]
fn a_row_that_lacks_a_recorded_column_is_refused() {
    for extra in Extra::ALL {
        let mut recording = Recording::with_extras(provenance(&[extra]), &[extra]);
        recording.push(Row::default());
        let error = recording.validate().unwrap_err().to_string();
        assert!(error.contains(extra.name()), "{error}");
    }
}

#[test]
fn only_complete_inspirations_are_listed() {
    let whole = recording(&[], 3);
    assert_eq!(whole.breaths(), [0..60, 60..120, 120..180]);
    assert_eq!(whole.inspirations(), [0..20, 60..80, 120..140]);

    let mut lost_tick = recording(&[], 2);
    lost_tick.tick[10..60].iter_mut().for_each(|tick| *tick += 1);
    assert_eq!(lost_tick.inspirations().first(), Some(&(60..80)));

    let mut late = recording(&[], 1);
    late.tick.iter_mut().for_each(|tick| *tick += 1);
    assert!(late.inspirations().is_empty());

    let mut cut = recording(&[], 1);
    cut.phase.fill(INSPIRATION);
    assert!(cut.inspirations().is_empty());
}

#[test]
fn joining_renumbers_breaths_and_groups_and_notes_the_origin() {
    let mut joined = recording(&Extra::ALL, 2);
    let mut other = recording(&Extra::ALL, 1);
    other.breath.fill(7);
    other.provenance.seed = 99;
    joined.append(&other).unwrap();
    joined.validate().unwrap();
    assert_eq!(joined.breaths(), [0..60, 60..120, 120..180]);
    assert_eq!(joined.breath[120], 2);
    assert_eq!(joined.group.as_deref().unwrap()[120..122], [2, 3]);
    assert_eq!(joined.provenance.groups, ["A:1", "A:2", "A:1", "A:2"].map(TestRun::from));
    assert_eq!(joined.pressure[120..], other.pressure);
    let note = &joined.provenance.notes[0];
    let origin =
        "The 60 samples from number 121 on are another recording: plant bench, seed 99, made by test,";
    assert!(note.starts_with(origin), "{note}");
}

#[test]
fn recordings_that_differ_in_period_or_columns_do_not_join() {
    let mut base = recording(&[], 1);
    let mut slow = recording(&[], 1);
    slow.provenance.period_us = 10_000;
    assert!(matches!(base.append(&slow), Err(DatasetError::Different("the control period"))));
    let rich = recording(&Extra::TRUTH, 1);
    assert!(matches!(base.append(&rich), Err(DatasetError::Different("their columns"))));
    assert_eq!(base, recording(&[], 1));
}

mod foreign_files {
    //! Parquet files written by another program.

    use std::sync::Arc;

    use parquet::basic::{LogicalType, Repetition, Type as Physical};
    use parquet::data_type::{DoubleType, FloatType, Int32Type};
    use parquet::file::metadata::KeyValue;
    use parquet::file::writer::SerializedFileWriter;
    use parquet::schema::types::Type;

    use super::*;

    /// A column of two rows.
    enum Cells {
        Whole { bits: i8, values: [i32; 2] },
        Single([Option<f32>; 2]),
        Double([f64; 2]),
    }

    type Columns = Vec<(&'static str, Cells)>;

    fn good_columns() -> Columns {
        let mut columns = vec![
            ("breath", Cells::Whole { bits: 32, values: [0, 0] }),
            ("tick", Cells::Whole { bits: 32, values: [0, 1] }),
            ("phase", Cells::Whole { bits: 8, values: [0, 1] }),
        ];
        for name in ["target", "pressure", "u_in", "u_out", "explore", "pip", "peep"] {
            columns.push((name, Cells::Single([Some(1.0), Some(2.0)])));
        }
        columns
    }

    fn load(columns: &Columns, metadata: Option<&str>) -> Result<Recording, DatasetError> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("foreign.parquet");
        write(&path, columns, metadata);
        Recording::load(path)
    }

    /// Like pandas: every column may have empty cells.
    fn field(name: &str, cells: &Cells) -> Type {
        let (physical, logical) = match cells {
            Cells::Whole { bits, .. } => (Physical::INT32, Some(LogicalType::integer(*bits, false))),
            Cells::Single(_) => (Physical::FLOAT, None),
            Cells::Double(_) => (Physical::DOUBLE, None),
        };
        let builder = Type::primitive_type_builder(name, physical).with_logical_type(logical);
        builder.with_repetition(Repetition::OPTIONAL).build().unwrap()
    }

    fn write(path: &Path, columns: &Columns, metadata: Option<&str>) {
        let fields = columns.iter().map(|(name, cells)| Arc::new(field(name, cells))).collect();
        let schema = Arc::new(Type::group_type_builder("schema").with_fields(fields).build().unwrap());
        let mut writer = SerializedFileWriter::new(Vec::new(), schema, Arc::default()).unwrap();
        let mut group = writer.next_row_group().unwrap();
        for (_, cells) in columns {
            let mut column = group.next_column().unwrap().unwrap();
            match cells {
                Cells::Whole { values, .. } => {
                    column.typed::<Int32Type>().write_batch(values, Some(&[1, 1]), None).unwrap();
                }
                Cells::Single(values) => {
                    let there = values.map(|value| value.is_some().into());
                    let values: Vec<f32> = values.iter().flatten().copied().collect();
                    column.typed::<FloatType>().write_batch(&values, Some(&there), None).unwrap();
                }
                Cells::Double(values) => {
                    column.typed::<DoubleType>().write_batch(values, Some(&[1, 1]), None).unwrap();
                }
            }
            column.close().unwrap();
        }
        group.close().unwrap();
        if let Some(text) = metadata {
            writer.append_key_value_metadata(KeyValue::new(PROVENANCE_KEY.to_owned(), text.to_owned()));
        }
        std::fs::write(path, writer.into_inner().unwrap()).unwrap();
    }

    fn origin() -> String {
        serde_json::to_string(&provenance(&[])).unwrap()
    }

    fn with(name: &str, cells: Cells) -> Columns {
        let mut columns = good_columns();
        columns.iter_mut().find(|column| column.0 == name).unwrap().1 = cells;
        columns
    }

    #[test]
    fn a_file_in_the_same_layout_is_read() {
        let mut columns = good_columns();
        columns.push(("comment", Cells::Double([0.0, 0.0])));
        assert_eq!(load(&columns, Some(&origin())).unwrap().pressure, [1.0, 2.0]);
    }

    #[test]
    fn a_missing_column_is_named() {
        for (name, _) in good_columns() {
            let columns = good_columns().into_iter().filter(|column| column.0 != name).collect::<Columns>();
            let error = load(&columns, Some(&origin())).unwrap_err();
            assert!(matches!(error, DatasetError::MissingColumn { column, .. } if column == name), "{error}");
        }
    }

    #[test]
    fn a_wrong_type_is_named_with_both_types() {
        let error = load(&with("u_in", Cells::Double([0.0, 0.0])), Some(&origin())).unwrap_err();
        assert!(error.to_string().contains("column `u_in` is DOUBLE, expected Float32"), "{error}");
    }

    #[test]
    fn empty_cells_and_nan_are_refused() {
        let error = load(&with("peep", Cells::Single([None, Some(1.0)])), Some(&origin()));
        assert!(matches!(error, Err(DatasetError::Null { column: "peep", nulls: 1, .. })));
        let error =
            load(&with("peep", Cells::Single([Some(1.0), Some(f32::NAN)])), Some(&origin())).unwrap_err();
        let text = error.to_string();
        assert!(text.contains("foreign.parquet: column `peep` is NaN in row 1"), "{text}");
    }

    #[test]
    fn a_file_without_a_readable_provenance_of_this_format_is_refused() {
        assert!(matches!(load(&good_columns(), None), Err(DatasetError::NoProvenance { .. })));
        assert!(matches!(load(&good_columns(), Some("{}")), Err(DatasetError::BadProvenance { .. })));
        let newer = serde_json::to_string(&Provenance { format: 2, ..provenance(&[]) }).unwrap();
        let error = load(&good_columns(), Some(&newer)).unwrap_err();
        assert!(matches!(error, DatasetError::Format { found: 2, expected: 1, .. }));
    }
}

#[test]
fn every_phase_has_its_number_and_every_other_number_has_none() {
    for phase in [Phase::Inspiration, Phase::Fall, Phase::Expiration] {
        assert_eq!(numbered_phase(phase_number(phase)), Some(phase));
    }
    assert_eq!(phase_number(Phase::Fall), FALL);
    assert!((EXPIRATION + 1..=u8::MAX).all(|number| numbered_phase(number).is_none()));
}
