//! Files of ventilators, written here in their layouts: told by their content, with every line accounted for.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::*;
use crate::import::format::Format;
use crate::import::measured::files;

/// Breaths of each file, rows of a breath and of its inspiration.
const BREATHS: usize = 6;
const ROWS: usize = 120;
const INSPIRED: usize = 40;

/// Imports a file by its content, and checks the breaths.
fn recorded(format: &str, content: &[u8]) -> (Recording, ImportSummary) {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("file"), folder.path().join("out.parquet"));
    fs::write(&path, content).unwrap();
    assert_eq!(Format::name_of(&path).unwrap(), format);
    let summary = import_as(&Format::named(format).unwrap(), &[path], &out, &Progress::silent()).unwrap();
    let recording = Recording::load(&out).unwrap();
    // Rows that are put on an even grid may become one more or fewer in a breath; filled rows are new.
    let left = summary.rows - summary.dropped_before_first_breath - summary.dropped_after_gap;
    assert!(left.abs_diff(summary.kept) <= summary.resampled_breaths + 4 * summary.filled, "{summary}");
    (recording, summary)
}

/// Flow of a row, L/s, and pressure, cmH2O.
fn at(tick: usize) -> (f64, f64) {
    let since = if tick < INSPIRED { tick } else { tick - INSPIRED } as f64;
    let flow = 0.8 * (-since / 15.0).exp();
    if tick < INSPIRED { (flow, 18.0) } else { (-flow, 6.0) }
}

/// A message of a `MakAir` in a line: kind, version and fields.
fn message(kind: u8, version: u8, fields: &[u8]) -> String {
    let mut bytes = vec![0x03, 0x0c, kind, b':', version, 3];
    bytes.extend(b"dev012345678901");
    bytes.extend(fields);
    bytes.push(b'\n');
    let sum = crc::Crc::<u32>::new(&crc::CRC_32_ISO_HDLC).checksum(&bytes[2..]);
    bytes.extend(sum.to_be_bytes());
    bytes.extend([0x30, 0xc0]);
    STANDARD.encode(bytes) + "\n"
}

/// Fields, each with a tab before it.
fn fields(parts: &[&[u8]]) -> Vec<u8> {
    parts.iter().flat_map(|part| [b"\t", *part].concat()).collect()
}

fn makair(version: u8) -> String {
    let mut text = message(b'O', version, &[]);
    for row in 0..BREATHS * ROWS {
        let (tick, time) = (row % ROWS, row as u64 * 10_000);
        let (flow, pressure) = at(tick);
        let degrees = if tick < INSPIRED { [25, 125] } else { [125, 50] };
        let phase = if tick < INSPIRED { 17 } else { 68 };
        let mut parts = fields(&[
            &time.to_be_bytes(),
            &(tick as u16).to_be_bytes(),
            &((10.0 * pressure) as i16).to_be_bytes(),
            &[phase],
            &[degrees[0]],
            &[degrees[1]],
            &[50],
            &[27],
        ]);
        if version > 1 {
            let [inward, outward] = [flow.max(0.0), (-flow).max(0.0)].map(|flow| (flow * 6000.0) as i16);
            parts.extend(fields(&[&inward.to_be_bytes(), &outward.to_be_bytes()]));
        }
        text += &message(b'D', version, &parts);
        if tick == ROWS - 1 {
            let cycle = (row / ROWS) as u32;
            text += &message(
                b'S',
                version,
                &fields(&[&time.to_be_bytes(), &cycle.to_be_bytes(), &[20], &[18], &[6], &[12]]),
            );
        }
    }
    text.insert_str(200, "?\n");
    text
}

#[test]
fn telemetry_of_a_makair_gives_pressures_settings_valves_and_flows() {
    for version in [1, 2] {
        let (recording, summary) = recorded("makair", makair(version).as_bytes());
        // The record begins within a breath; the line that was cut in two, and its rest, are no messages.
        assert_eq!((summary.breaths, summary.complete_breaths), (BREATHS - 1, BREATHS - 1), "{summary}");
        assert_eq!(summary.rows + summary.unused["damaged lines"], BREATHS * ROWS + 1, "{summary}");
        assert_eq!((summary.unused["settings"], summary.unused["messages of standby"]), (BREATHS, 1));
        let first = recording.inspirations()[0].clone();
        assert_eq!(first.len(), INSPIRED);
        assert_eq!((recording.pip[first.start], recording.peep[first.start]), (18.0, 6.0));
        assert!((recording.pressure[first.start] - 18.0).abs() < 1e-4);
        assert!((recording.u_in[first.start] - 80.0).abs() < 1e-3 && recording.u_out[first.start] < 1e-3);
        assert!((recording.u_out[first.end] - 60.0).abs() < 1e-3);
        match recording.flow_in {
            Some(flow) => assert!(version == 2 && (flow[first.start] - 0.8).abs() < 1e-3),
            None => assert_eq!(version, 1),
        }
    }
}

#[test]
fn the_speed_of_the_blower_is_a_share_of_the_highest_in_both_versions() {
    let folder = tempfile::tempdir().unwrap();
    for (version, expected) in [(1, 500.0 / 1800.0), (2, 5000.0 / 1800.0)] {
        let path = folder.path().join(version.to_string());
        fs::write(&path, makair(version)).unwrap();
        let told = makair_telemetry(&path).unwrap();
        // The line that was cut in two is no message.
        assert_eq!(told.len(), BREATHS * ROWS - 1);
        assert!(told.iter().all(|row| (row.speed - expected).abs() < 1e-12));
        assert!(told.iter().all(|row| row.flows.is_some() == (version > 1)));
    }
}

#[test]
fn the_recorded_files_of_makairs_are_whole() {
    let names = ["v1-short-with-errors.record", "v2-a.record", "v2-b.record", "v2-c.record"];
    let Some(paths) = files("makair", &names) else { return };
    // Rows and breaths as counted by hand; the first breath of a record has begun before it, or is the first of all.
    for (path, (rows, breaths)) in paths.iter().zip([(21_914, 70), (3415, 13), (4787, 18), (3422, 13)]) {
        let (recording, summary) = recorded("makair", &fs::read(path).unwrap());
        assert_eq!(summary.rows, rows);
        assert!(summary.breaths.abs_diff(breaths) <= 2, "{} of {breaths} breaths", summary.breaths);
        assert!(!summary.unused.contains_key("damaged lines"));
        assert!(recording.pip.iter().all(|pip| (5.0..=60.0).contains(pip)));
    }
}

/// Breaths of a Puritan Bennett 840; `head` begins the lines of values, as a time does in some files.
fn pb840(head: &str) -> String {
    let mut text = String::new();
    for breath in 0..BREATHS {
        // Two breaths are missing in the middle.
        let number = 100 + breath + if breath >= 3 { 2 } else { 0 };
        writeln!(text, "{head}BS, S:{number},").unwrap();
        for tick in 0..ROWS {
            let (flow, pressure) = at(tick);
            writeln!(text, "{head}{:.2}, {pressure:.2}", 60.0 * flow).unwrap();
        }
        writeln!(text, "{head}BE").unwrap();
    }
    text
}

#[test]
fn waveforms_of_a_puritan_bennett_840_give_breaths() {
    let dated = format!("2016-01-27-20-30-35.1\n{}\0", pb840(""));
    for content in [pb840(""), pb840("2016-01-27 20:30:35.1, "), dated] {
        let (recording, summary) = recorded("pb840", content.as_bytes());
        assert_eq!((summary.breaths, summary.rows, summary.period_us), (BREATHS, BREATHS * ROWS, 20_000));
        assert_eq!(summary.unused["missing breaths"], 2);
        for rows in recording.inspirations() {
            assert_eq!(rows.len(), INSPIRED);
            assert!((recording.pip[rows.start] - 18.0).abs() < 1e-3, "{summary}");
            assert!((recording.flow_in.as_deref().unwrap()[rows.start] - 0.8).abs() < 1e-3);
        }
        assert!((recording.peep[recording.inspirations()[1].start] - 6.0).abs() < 1e-3);
    }
    // A breath without a number, and a line without values, are counted.
    let damaged = pb840("").replace("S:101,", "").replacen("18.00", "-", 1);
    let (_, summary) = recorded("pb840", damaged.as_bytes());
    assert_eq!(summary.unused["breaths without a number"], 1);
    assert_eq!(summary.unused["lines outside of breaths"], ROWS);
    assert_eq!(summary.unused["lines without flow and pressure"], 1);
}

/// Lines of a Puritan Bennett 840 as spreadsheets and cut cables leave them.
#[test]
fn damaged_waveforms_of_a_puritan_bennett_840_lose_no_mark() {
    let text = pb840("");
    for content in [
        text.replace('\n', ",\n"),
        text.replace("BS, S:", "BS ,  S:").replace(", ", " ,  "),
        text.replace(", ", ";").replace('.', ","),
        text.replace(", ", "\t").replace('\n', "\r\n"),
        // The rest of a breath comes first: more lines than a look at the names of a table takes.
        "0.50, 6.00\n".repeat(300) + &text,
    ] {
        let (_, summary) = recorded("pb840", content.as_bytes());
        assert_eq!((summary.breaths, summary.rows), (BREATHS, BREATHS * ROWS), "{summary}");
    }
    // The rest of a line is lost, and some lines after it: the mark that follows still begins a breath.
    let begin = text.find("BS, S:101").unwrap();
    let cut = format!("{}{}", &text[..begin + 500], &text[text.find("BS, S:102").unwrap()..]);
    let (recording, summary) = recorded("pb840", cut.as_bytes());
    assert_eq!(summary.breaths, BREATHS, "{summary}");
    assert!(recording.breaths().iter().all(|rows| rows.len() <= ROWS), "{summary}");
}

/// A recording of a SERVO-U with these names, decimal mark, separator, and factors of pressure and flow.
fn servo_u(names: &str, decimal: char, separator: char, factors: (f64, f64)) -> String {
    let mut text =
        "[REC]\nFecha\t2026-01-28\nDecimal separator\t,\n==========\nPEEP\t6\tcmH2O\n\n[DATA]\n".to_owned();
    writeln!(text, "{names}").unwrap();
    for row in 0..BREATHS * ROWS {
        let (flow, pressure) = at(row % ROWS);
        let (seconds, ms) = (row / 100, row % 100 * 10);
        let (pressure, flow) = (pressure * factors.0, flow * factors.1);
        let values = format!("{pressure:.4}\t{flow:.3}\t{}", row % ROWS).replace('.', &decimal.to_string());
        let trigger = if row % ROWS == 0 { "\tFlujo" } else { "" };
        writeln!(text, "10:00:{seconds:02}:{ms:03}\tInsp.\t{values}{trigger}").unwrap();
    }
    text.replace('\t', &separator.to_string())
}

#[test]
fn a_recording_of_a_servo_u_is_read_in_any_language_and_unit() {
    let spanish = "Tiempo\tFase\tPva (cmH2O)\tFLUJO (l/m)\tV (ml)\tTriger";
    let plain = servo_u(spanish, '.', '\t', (1.0, 60.0));
    for text in [
        plain.clone(),
        servo_u("Time\tPhase\tPressure\tFlow\tVolume\tTrigger", ',', '\t', (1.0, 60.0)),
        format!("\u{feff}{}", servo_u(spanish, ',', ';', (1.0, 60.0)).replace('\n', "\r\n")),
        servo_u("Zeit\tPhase\tPaw (kPa)\tFlow (l/s)\tV (ml)", ',', '\t', (0.098_066_5, 1.0)),
    ] {
        let (recording, summary) = recorded("servo-u", text.as_bytes());
        assert_eq!(summary.breaths_from, "the flow");
        assert_eq!(summary.rows, BREATHS * ROWS);
        assert!(summary.breaths >= BREATHS - 2 && summary.unused.is_empty(), "{summary}");
        let rows = recording.inspirations()[1].clone();
        assert!((INSPIRED - 1..=INSPIRED + 1).contains(&rows.len()), "{rows:?}");
        assert!((recording.pip[rows.start] - 18.0).abs() < 1e-3, "{}", recording.pip[rows.start]);
        let flow = recording.flow_in.as_deref().unwrap()[rows.start];
        assert!((flow - 0.8).abs() < 0.06, "{flow}");
    }
    // Lines without values are counted, and so is one that was cut off; another recording may follow.
    let dashes = plain.replacen("6.0000\t", "---\t", 3);
    let cut = &plain[..plain.trim_end().rfind('\t').unwrap()];
    let (_, summary) = recorded("servo-u", format!("{dashes}\n{cut}").as_bytes());
    assert_eq!((summary.unused["incomplete lines"], summary.rows), (4, 2 * BREATHS * ROWS - 4));
    assert_eq!(summary.gaps, 1, "{summary}");
}

#[test]
fn what_a_servo_u_cannot_mean_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let [path, out] = ["file.txt", "out.parquet"].map(|name| folder.path().join(name));
    fs::write(&path, "[TRE]\nFecha\t2026-01-28\n").unwrap();
    assert!(Format::name_of(&path).unwrap_err().to_string().contains("export waveforms"));
    let names = "Time\tPhase\tPressure (psi)\tFlow (l/m)\tVolume (ml)";
    for (text, hint) in [
        (servo_u(names, '.', '\t', (1.0, 60.0)), "unknown unit"),
        ("[REC]\nFecha\t2026-01-28\n".to_owned(), "no rows"),
    ] {
        fs::write(&path, text).unwrap();
        let refused = import_as(&Format::ServoU, std::slice::from_ref(&path), &out, &Progress::silent());
        assert!(refused.unwrap_err().to_string().contains(hint), "{hint}");
    }
}

#[test]
fn a_table_of_another_layout_needs_a_map() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("table.csv");
    for (text, format) in [
        ("time,paw\n0,5\n".to_owned(), "csv"),
        (kaggle(1), "kaggle"),
        ("[{\"event\":\"M\"}]".to_owned(), "pirds"),
        ("1593299588:M:P:A:0:26324:10112\n".to_owned(), "pirds"),
    ] {
        fs::write(&path, text).unwrap();
        assert_eq!(Format::name_of(&path).unwrap(), format);
    }
    assert!(Format::named("csv").is_none());
}
