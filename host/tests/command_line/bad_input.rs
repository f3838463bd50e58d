//! Bad input gives a one-line error that names it, and nothing is written.

use std::fs::{self, File};
use std::path::Path;
use std::sync::Arc;

use data::recording::PROVENANCE_KEY;
use parquet::column::reader::ColumnReader;
use parquet::data_type::{FloatType, Int32Type};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::SerializedFileWriter;

use super::support::Place;

#[test]
fn a_missing_file() {
    let place = Place::new();
    assert!(place.refused("fit absent.parquet --out a.safetensors").contains("absent.parquet"));
    assert!(place.refused("inspect absent.bin").contains("absent.bin"));
    assert!(place.refused("export absent.safetensors --out a.bin").contains("absent.safetensors"));
    assert!(place.refused("evaluate --bench absent.toml").contains("absent.toml"));
    assert!(place.refused("import absent.csv --out a.parquet").contains("absent.csv"));
}

#[test]
fn a_torn_recording() {
    let place = Place::new();
    let path = place.path(place.collected());
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(place.refused("fit first.parquet --out a.safetensors").contains("incomplete or damaged"));
    assert!(place.refused("inspect first.parquet").contains("incomplete or damaged"));
    assert!(!place.path("a.safetensors").exists());
}

#[test]
fn a_weights_image_with_a_flipped_bit() {
    let place = Place::new();
    place.ok(&format!("export {} --out weights.bin", place.controller()));
    let path = place.path("weights.bin");
    let good = fs::read(&path).unwrap();
    for (byte, bit) in [(0, 1), (21, 3), (good.len() / 2, 6), (good.len() - 1, 0)] {
        let mut bytes = good.clone();
        bytes[byte] ^= 1 << bit;
        fs::write(&path, bytes).unwrap();
        assert!(place.refused("inspect weights.bin").contains("weights.bin"));
        assert!(place.refused("evaluate --controller weights.bin").contains("weights.bin"));
    }
}

/// Copies the recording with one pressure that is not a number, as another program would write it: without a checksum.
fn spoil(path: &Path) {
    let reader = SerializedFileReader::new(File::open(path).unwrap()).unwrap();
    let about = reader.metadata().file_metadata();
    let provenance = about.key_value_metadata().unwrap().iter().find(|pair| pair.key == PROVENANCE_KEY);
    let schema = about.schema_descr().root_schema_ptr();
    let mut writer = SerializedFileWriter::new(Vec::new(), schema, Arc::default()).unwrap();
    let group = reader.get_row_group(0).unwrap();
    let rows = group.metadata().num_rows() as usize;
    let mut copy = writer.next_row_group().unwrap();
    for index in 0..group.num_columns() {
        let mut column = copy.next_column().unwrap().unwrap();
        match group.get_column_reader(index).unwrap() {
            ColumnReader::Int32ColumnReader(mut source) => {
                let mut values = Vec::new();
                source.read_records(rows, None, None, &mut values).unwrap();
                column.typed::<Int32Type>().write_batch(&values, None, None).unwrap();
            }
            ColumnReader::FloatColumnReader(mut source) => {
                let mut values = Vec::new();
                source.read_records(rows, None, None, &mut values).unwrap();
                if about.schema_descr().column(index).name() == "pressure" {
                    values[17] = f32::NAN;
                }
                column.typed::<FloatType>().write_batch(&values, None, None).unwrap();
            }
            _ => unreachable!("a recording has whole numbers and floats"),
        }
        column.close().unwrap();
    }
    copy.close().unwrap();
    writer.append_key_value_metadata(provenance.unwrap().clone());
    fs::write(path, writer.into_inner().unwrap()).unwrap();
}

#[test]
fn a_pressure_that_is_no_number() {
    let place = Place::new();
    spoil(&place.path(place.collected()));
    let refused = place.refused("fit first.parquet --out a.safetensors");
    assert!(refused.contains("`pressure` is NaN in row 17"), "{refused}");
    assert!(!place.path("a.safetensors").exists());
}

#[test]
fn settings_that_cannot_be() {
    let place = Place::new();
    assert!(
        place
            .wrong("collect --out a.parquet --settings peep=30 --pips 10")
            .contains("allowed are 0 to 20 cmH2O")
    );
    assert!(place.refused("collect --out a.parquet --settings peep=15 --pips 10").contains("above PEEP"));
    assert!(place.refused("evaluate --pips 30 --settings pressure_limit=32").contains("pressure limit"));
    assert!(place.refused("tune-pid --settings rate=60,inspiratory_time=2").contains("lower the rate"));
    assert!(place.refused("collect --out a.parquet --period-us 1500").contains("1500 us"));
    assert!(
        place
            .refused("collect --out a.parquet --exploration boundary_probability=2")
            .contains("boundary_probability")
    );
    assert!(place.wrong("evaluate --gains 200,1").contains("gain p is 200"));
    assert!(!place.path("a.parquet").exists());
}

#[test]
fn a_key_that_cannot_be_read_is_found_before_the_training() {
    let place = Place::new();
    // With so many breaths the training would take hours.
    for command in ["train --breaths 10000000", "train-family", "commission --breaths 1000000"] {
        assert!(place.refused(&format!("{command} --out a --key absent")).contains("absent"), "{command}");
        assert!(!place.path("a").exists(), "{command}");
    }
}

#[test]
fn a_start_that_is_no_controller() {
    let place = Place::new();
    assert!(place.refused("train-family --out a --start-from Bob").contains("adult"));
    assert!(!place.path("a").exists());
}

#[test]
fn an_unknown_lung() {
    let place = Place::new();
    assert!(place.refused("collect --out a.parquet --bench Bob").contains("R20C20"));
    assert!(place.refused("evaluate --bench paper").contains("9 lungs"));
    assert!(place.refused("inspect --bench Bob").contains("Bob"));
}

#[test]
fn files_of_another_kind() {
    let place = Place::new();
    let data = place.collected();
    place.controller();
    assert!(place.refused("fit controller.safetensors --out a.safetensors").contains("not a Parquet file"));
    assert!(place.refused(&format!("export {data} --out a.bin")).contains("is not a valid controller"));
    fs::write(place.path("notes.txt"), "a note").unwrap();
    assert!(place.refused("inspect notes.txt").contains("notes.txt"));
    let stitched = "fit first.parquet --out a.safetensors --architecture stitched";
    assert!(place.refused(stitched).contains("--period-us 30000"));
    assert!(place.refused("fit first.parquet --out a.safetensors --hold-out 50").contains("too few"));
}

#[test]
fn a_waveform_that_training_does_not_know() {
    let place = Place::new();
    assert!(place.refused("train --out run --settings rise_time=0.2").contains("rise_time"));
    assert!(!place.path("run").exists());
}
