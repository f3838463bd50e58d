//! Imports a table as large as the Kaggle competition's in a separate process, so that its memory can be measured.

#![cfg(target_os = "linux")]

use std::fmt::Write as _;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::Path;
use std::time::Instant;

use data::import::import;
use data::import::map::ColumnMap;
use progress::Progress;

const BREATHS: usize = 75_000;
const ROWS: usize = 80;
/// Memory limit, MiB: far less than the table's size, and than a gibibyte.
const MOST_MIB: f64 = 128.0;
/// Number of different breaths, which are written repeatedly.
const DIFFERENT: usize = 500;

/// A table with time steps that jitter around 33 ms, 400 MB.
fn write_table(path: &Path) {
    let mut breaths = String::new();
    for breath in 0..DIFFERENT {
        for row in 0..ROWS {
            let (id, expires) = (ROWS * breath + row, u8::from(row >= 30));
            let time = 0.033 * row as f64 + 0.000_4 * ((breath + row) as f64).sin();
            let pressure = 6.0 + 10.0 * f64::from(1 - expires) * (1.0 - (-time / 0.2).exp());
            writeln!(breaths, "{id},{breath},20,50,{time},{},{expires},{pressure}", 25.0 - time).unwrap();
        }
    }
    let mut file = BufWriter::new(File::create(path).unwrap());
    file.write_all(b"id,breath_id,R,C,time_step,u_in,u_out,pressure\n").unwrap();
    (0..BREATHS / DIFFERENT).for_each(|_| file.write_all(breaths.as_bytes()).unwrap());
    file.flush().unwrap();
}

/// Peak resident memory, MiB.
fn peak_mib() -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmHWM")).unwrap();
    line.split_whitespace().nth(1).unwrap().parse::<f64>().unwrap() / 1024.0
}

#[test]
fn six_million_rows_stream_through_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let (table, out) = (folder.path().join("train.csv"), folder.path().join("out.parquet"));
    write_table(&table);
    let layout = ColumnMap::kaggle().unwrap().layout().unwrap();
    let start = Instant::now();
    let summary = import(&[table], &layout, &out, &Progress::silent()).unwrap();
    println!("{:.1} s, {:.0} MiB at most", start.elapsed().as_secs_f64(), peak_mib());
    assert_eq!((summary.rows, summary.breaths), (BREATHS * ROWS, BREATHS));
    assert!(peak_mib() < MOST_MIB, "{} MiB", peak_mib());
}
