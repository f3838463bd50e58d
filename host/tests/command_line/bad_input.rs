//! Whatever is wrong with the input is said in one line that names it, and nothing is written.

use std::fs::{self, File};
use std::path::Path;

use arrow_array::{Array, ArrayRef, Float32Array, RecordBatch};
use data::recording::{PROVENANCE_KEY, Recording};
use parquet::arrow::ArrowWriter;
use parquet::arrow::arrow_reader::ParquetRecordBatchReaderBuilder;
use parquet::file::metadata::KeyValue;

use super::support::Place;

#[test]
fn a_missing_file() {
    let place = Place::new();
    assert!(place.refused("fit --data absent.parquet --out a.safetensors").contains("absent.parquet"));
    assert!(place.refused("inspect absent.bin").contains("absent.bin"));
    assert!(place.refused("pack absent.safetensors --out a.bin").contains("absent.safetensors"));
    assert!(place.refused("evaluate --bench absent.toml").contains("absent.toml"));
    assert!(place.refused("import respiraworks absent.csv --out a.parquet").contains("absent.csv"));
}

#[test]
fn a_torn_recording() {
    let place = Place::new();
    let path = place.path(place.collected());
    let bytes = fs::read(&path).unwrap();
    fs::write(&path, &bytes[..bytes.len() / 2]).unwrap();
    assert!(place.refused("fit --data first.parquet --out a.safetensors").contains("torn"));
    assert!(place.refused("inspect first.parquet").contains("torn"));
    assert!(!place.path("a.safetensors").exists());
}

#[test]
fn a_weights_image_with_a_flipped_bit() {
    let place = Place::new();
    place.ok(&format!("pack {} --out weights.bin", place.controller()));
    let path = place.path("weights.bin");
    let good = fs::read(&path).unwrap();
    for (byte, bit) in [(0, 1), (21, 3), (good.len() / 2, 6), (good.len() - 1, 0)] {
        let mut bytes = good.clone();
        bytes[byte] ^= 1 << bit;
        fs::write(&path, bytes).unwrap();
        assert!(place.refused("inspect weights.bin").contains("weights.bin"));
        assert!(place.refused("evaluate --weights weights.bin").contains("weights.bin"));
    }
}

/// Writes the recording again with one pressure that is no number, as another program would: without a checksum.
fn spoil(path: &Path) {
    let provenance = serde_json::to_string(&Recording::load(path).unwrap().provenance).unwrap();
    let reader = ParquetRecordBatchReaderBuilder::try_new(File::open(path).unwrap()).unwrap();
    let schema = reader.schema().clone();
    let batches: Vec<RecordBatch> = reader.build().unwrap().map(Result::unwrap).collect();
    let mut writer = ArrowWriter::try_new(Vec::new(), schema.clone(), None).unwrap();
    for (number, batch) in batches.into_iter().enumerate() {
        let mut columns: Vec<ArrayRef> = batch.columns().to_vec();
        if number == 0 {
            let index = schema.index_of("pressure").unwrap();
            let column = columns[index].as_any().downcast_ref::<Float32Array>().unwrap();
            let mut values = column.values().to_vec();
            values[17] = f32::NAN;
            columns[index] = std::sync::Arc::new(Float32Array::from(values));
        }
        writer.write(&RecordBatch::try_new(schema.clone(), columns).unwrap()).unwrap();
    }
    writer.append_key_value_metadata(KeyValue::new(PROVENANCE_KEY.to_owned(), provenance));
    fs::write(path, writer.into_inner().unwrap()).unwrap();
}

#[test]
fn a_pressure_that_is_no_number() {
    let place = Place::new();
    spoil(&place.path(place.collected()));
    let refused = place.refused("fit --data first.parquet --out a.safetensors");
    assert!(refused.contains("`pressure` is NaN in row 17"), "{refused}");
    assert!(!place.path("a.safetensors").exists());
}

#[test]
fn settings_that_cannot_be() {
    let place = Place::new();
    assert!(place.refused("collect --out a.parquet --peep 30 --pips 10").contains("peep is 30 cmH2O"));
    assert!(place.refused("collect --out a.parquet --peep 15 --pips 10").contains("below PEEP"));
    assert!(place.refused("evaluate --pips 30 --pressure-limit 32").contains("pressure limit"));
    assert!(place.refused("tune-pid --rate 60 --inspiratory-time 2").contains("lower the rate"));
    assert!(place.refused("collect --out a.parquet --period-us 1500").contains("1500 us"));
    assert!(
        place.refused("collect --out a.parquet --boundary-probability 2").contains("boundary_probability")
    );
    assert!(place.refused("evaluate --gains 200,1").contains("gain p is 200"));
    assert!(!place.path("a.parquet").exists());
}

#[test]
fn an_unknown_lung() {
    let place = Place::new();
    assert!(place.refused("collect --out a.parquet --lung Bob").contains("R20C20"));
    assert!(place.refused("evaluate --lung paper").contains("9 lungs"));
    assert!(place.refused("inspect --bench Bob").contains("Bob"));
}

#[test]
fn files_of_another_kind() {
    let place = Place::new();
    let data = place.collected();
    place.controller();
    assert!(
        place.refused("fit --data controller.safetensors --out a.safetensors").contains("not a Parquet file")
    );
    assert!(place.refused(&format!("pack {data} --out a.bin")).contains("is no controller"));
    fs::write(place.path("notes.txt"), "a note").unwrap();
    assert!(place.refused("inspect notes.txt").contains("notes.txt"));
    let stitched = "fit --data first.parquet --out a.safetensors --architecture stitched";
    assert!(place.refused(stitched).contains("--period-us 30000"));
    assert!(place.refused("fit --data first.parquet --out a.safetensors --hold-out 50").contains("too few"));
}

#[test]
fn a_waveform_that_training_does_not_know() {
    let place = Place::new();
    assert!(place.refused("train --out run --rise-time 0.2").contains("--rise-time"));
    assert!(!place.path("run").exists());
}
