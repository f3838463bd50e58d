//! Tables as ventilators and laboratories write them: any encoding, any marks, rows twice, late or missing. A breath of two seconds with an
//! inspiration of one is written in all of these forms; what comes out must be alike.

use std::io::Write as _;

use flate2::Compression;
use flate2::write::GzEncoder;

use super::*;

/// Period, s.
const PERIOD: f64 = 0.02;
/// Rows of a breath, and of its inspiration.
const BREATH: usize = 100;
const INSPIRED: usize = 50;
const BREATHS: usize = 12;
/// Names and map of [`plain`].
const NAMES: &str = "time,paw,set,flow,exh";
const FIELD: &str = "[time]\ncolumn = 'time'\n[pressure]\ncolumn = 'paw'\n[target]\ncolumn = 'set'\n\
                     [u_out]\ncolumn = 'exh'\nunit = 'share'\n[flow]\ncolumn = 'flow'\nunit = 'L/min'\n";

/// Time s, pressure cmH2O, set-point cmH2O, flow L/s and expiratory valve of a row, with PEEP 5, PIP 20 and a lung of R 20, C 20.
fn at(row: usize) -> (f64, f64, f64, f64, usize) {
    let tick = row % BREATH;
    let inspires = tick < INSPIRED;
    let since = (if inspires { tick } else { tick - INSPIRED }) as f64 * PERIOD;
    let flow = 0.75 * (-since / 0.4).exp() * if inspires { 1.0 } else { -1.0 };
    let set = if inspires { 20.0 } else { 5.0 };
    (row as f64 * PERIOD, set, set, flow, usize::from(!inspires))
}

/// The lines of the rows, as `line` writes each; a rest of half a breath comes first.
fn lines(line: impl Fn(usize) -> String) -> Vec<String> {
    (INSPIRED..BREATH * (BREATHS + 1)).map(|row| line(row) + "\n").collect()
}

fn plain(row: usize) -> String {
    let (time, paw, set, flow, exh) = at(row);
    format!("{time:.3},{paw:.2},{set:.1},{:.2},{exh}", 60.0 * flow)
}

fn table(names: &str, lines: &[String]) -> Vec<u8> {
    format!("{names}\n{}", lines.concat()).into_bytes()
}

fn import_bytes(bytes: &[u8], map: &str) -> Result<(Recording, ImportSummary), DatasetError> {
    let folder = tempfile::tempdir().unwrap();
    let (path, out) = (folder.path().join("table.csv"), folder.path().join("out.parquet"));
    fs::write(&path, bytes).unwrap();
    let layout = ColumnMap::from_toml(map).unwrap().layout().unwrap();
    let summary = import(&[path], &layout, &out, &Progress::silent())?;
    Ok((Recording::load(&out).unwrap(), summary))
}

/// Imports a table that must give all breaths, with both levels and, unless `flow` is false, the flow.
fn sound(bytes: &[u8], map: &str, flow: bool) -> ImportSummary {
    let (recording, summary) = import_bytes(bytes, map).unwrap();
    assert_eq!((summary.breaths, summary.complete_breaths), (BREATHS, BREATHS), "{summary}");
    for rows in recording.inspirations() {
        let found = rows.len();
        assert!((INSPIRED - 1..=INSPIRED + 1).contains(&found), "{found} rows");
        assert!(
            (recording.pip[rows.start] - 20.0).abs() < 0.1 && (recording.peep[rows.start] - 5.0).abs() < 0.1
        );
        if flow {
            let inward = recording.flow_in.as_deref().unwrap()[rows.start + 5];
            assert!((inward - 0.75 * (-0.1_f32 / 0.4).exp()).abs() < 0.05, "{inward}");
        }
    }
    summary
}

#[test]
fn encodings_and_compression_do_not_matter() {
    let table = table(NAMES, &lines(plain));
    let text = String::from_utf8(table.clone()).unwrap();
    let utf16 = |bytes: fn(u16) -> [u8; 2]| text.encode_utf16().flat_map(bytes).collect::<Vec<u8>>();
    let (little, big) = (utf16(u16::to_le_bytes), utf16(u16::to_be_bytes));
    let mut packed = GzEncoder::new(Vec::new(), Compression::default());
    packed.write_all(&table).unwrap();
    let mut packed_utf16 = GzEncoder::new(Vec::new(), Compression::default());
    packed_utf16.write_all(&[&[0xff, 0xfe][..], &little].concat()).unwrap();
    for bytes in [
        table.clone(),
        [&b"\xef\xbb\xbf"[..], &table].concat(),
        [&[0xff, 0xfe][..], &little].concat(),
        [&[0xfe, 0xff][..], &big].concat(),
        little,
        big,
        packed.finish().unwrap(),
        packed_utf16.finish().unwrap(),
        text.replace('\n', "\r\n").into_bytes(),
    ] {
        sound(&bytes, FIELD, true);
    }
    // An umlaut of Western Europe in a name that is used, and in one that is not.
    let latin = text.replace("exh", "ge\u{f6}ffnet");
    let latin: Vec<u8> = latin.chars().map(|letter| u8::try_from(u32::from(letter)).unwrap()).collect();
    sound(&latin, &FIELD.replace("exh", "ge\u{f6}ffnet"), true);
}

#[test]
fn marks_lines_before_the_names_and_units_below_them_do_not_matter() {
    let comma = |row| plain(row).replace(',', ";").replace('.', ",");
    let table_with_commas = table("time;paw;set;flow;exh", &lines(comma));
    sound(&table_with_commas, &format!("separator = ';'\ndecimal = ','\n{FIELD}"), true);
    sound(&table_with_commas, &format!("separator = ';'\n{FIELD}"), true);
    let points = format!("separator = ';'\ndecimal = '.'\n{FIELD}");
    let refused = import_bytes(&table_with_commas, &points).unwrap_err().to_string();
    assert!(refused.contains("decimal = \",\""), "{refused}");
    let rows = lines(plain);
    let before = format!("Ventilator 7; ward B\n# lung, C 20\n\n{NAMES}");
    sound(&table(&before, &rows), FIELD, true);
    sound(&table(&format!("# {NAMES}"), &rows), FIELD, true);
    let summary = sound(&table(&format!("{NAMES}\ns,cmH2O,cmH2O,L/min,-"), &rows), FIELD, true);
    assert_eq!(summary.disorder.heads, 1);
    let mut remarked = rows.clone();
    remarked.insert(300, "% suction\n".to_owned());
    sound(&table(NAMES, &remarked), &format!("comment = '%'\n{FIELD}"), true);
    sound(&table(&format!("{NAMES}\n{NAMES}"), &rows), &format!("skip_lines = 1\n{FIELD}"), true);
}

#[test]
fn times_may_be_those_of_a_clock_or_come_from_the_period() {
    let clock = |row| {
        let (_, rest) = plain(row).split_once(',').map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
        let ms = (row as f64 * PERIOD * 1000.0).round() as u32 + 86_390_000;
        let (s, of_day) = (ms / 1000 % 86_400, ms % 1000);
        format!(
            "2026-03-{:02} {:02}:{:02}:{:02}.{of_day:03},{rest}",
            1 + ms / 86_400_000,
            s / 3600,
            s / 60 % 60,
            s % 60
        )
    };
    sound(&table(NAMES, &lines(clock)), FIELD, true);
    let without = FIELD.replace("[time]\ncolumn = 'time'\n", "");
    sound(&table(NAMES, &lines(plain)), &format!("period_ms = 20\n{without}"), true);
    // Columns by their places, in a table without names.
    let places = "period_ms = 20\n[pressure]\ncolumn = 2\n[flow]\ncolumn = 4\nunit = 'L/min'\n";
    sound(lines(plain).concat().as_bytes(), places, true);
}

#[test]
fn breaths_are_shown_by_what_there_is() {
    let rows = table(NAMES, &lines(plain));
    let without = |names: &[&str]| {
        let parts = FIELD.split("\n[").map(|part| part.trim_start_matches('['));
        let kept = parts.filter(|part| !names.iter().any(|name| part.starts_with(name)));
        kept.map(|part| ["[", part, "\n"].concat()).collect::<Vec<_>>().concat()
    };
    for (names, from) in [
        (&[][..], "the set-point"),
        (&["target"], "the expiratory valve"),
        (&["u_out"], "the set-point"),
        (&["target", "u_out"], "the flow"),
        (&["target", "u_out", "flow"], "the pressure"),
    ] {
        let summary = sound(&rows, &without(names), !names.contains(&"flow"));
        assert_eq!(summary.breaths_from, from);
        assert!(summary.to_string().contains(from));
    }
    // A set-point that never moves shows none.
    let constant = |row| {
        let (time, paw, _, flow, exh) = at(row);
        format!("{time:.3},{paw:.2},8,{:.2},{exh}", 60.0 * flow)
    };
    let (_, summary) = import_bytes(&table(NAMES, &lines(constant)), FIELD).unwrap();
    assert_eq!((summary.breaths, summary.breaths_from), (BREATHS, "the expiratory valve"));
}

#[test]
fn a_leak_does_not_lengthen_inspirations_that_the_flow_shows() {
    let leaking = |row| {
        let (time, paw, _, flow, _) = at(row);
        format!("{time:.3},{paw:.2},{:.2}", 60.0 * (flow + 0.1 * paw.sqrt()))
    };
    let map =
        "[time]\ncolumn = 'time'\n[pressure]\ncolumn = 'paw'\n[flow]\ncolumn = 'flow'\nunit = 'L/min'\n";
    let summary = sound(&table("time,paw,flow", &lines(leaking)), map, false);
    assert_eq!(summary.breaths_from, "the flow");
}

#[test]
fn a_volume_gives_the_flow() {
    let volumes = |row| {
        let (time, paw, ..) = at(row);
        let since = (row % INSPIRED) as f64 * PERIOD;
        let filled = 300.0 * (1.0 - (-since / 0.4).exp());
        let volume =
            if row % BREATH < INSPIRED { filled } else { 300.0 * (1.0 - (-1.0_f64 / 0.4).exp()) - filled };
        format!("{time:.3},{paw:.2},{volume:.3}")
    };
    let map = "[time]\ncolumn = 'time'\n[pressure]\ncolumn = 'paw'\n[volume]\ncolumn = 'v'\nunit = 'mL'\n";
    let summary = sound(&table("time,paw,v", &lines(volumes)), map, true);
    assert_eq!(summary.breaths_from, "the flow");
}

#[test]
fn rows_that_are_there_twice_or_late_cost_nothing() {
    let rows = lines(plain);
    let twice: Vec<String> = rows.iter().flat_map(|row| [row.clone(), row.clone()]).collect();
    let summary = sound(&table(NAMES, &twice), FIELD, true);
    assert_eq!((summary.disorder.repeated, summary.gaps), (rows.len(), 0));
    assert_eq!(summary.rows, twice.len());
    assert!(summary.to_string().contains("equal to the one before"), "{summary}");

    let mut late = rows.clone();
    for place in (100..1000).step_by(90) {
        let row = late.remove(place);
        late.insert(place + 7, row);
    }
    let summary = sound(&table(NAMES, &late), FIELD, true);
    assert_eq!((summary.disorder.reordered, summary.gaps), (10, 0));

    let mut other = rows.clone();
    let (time, _) = rows[400].split_once(',').unwrap();
    other.insert(401, format!("{time},99.00,5.0,0.00,1\n"));
    assert_eq!(sound(&table(NAMES, &other), FIELD, true).disorder.same_time, 1);
}

#[test]
fn a_few_missing_rows_are_filled_and_more_of_them_end_the_breath() {
    let mut rows = lines(plain);
    let kept = |rows: &[String]| import_bytes(&table(NAMES, rows), FIELD).unwrap();
    let whole = kept(&rows).0;
    rows.drain(410..412);
    rows.drain(700..701);
    let summary = sound(&table(NAMES, &rows), FIELD, true);
    assert_eq!((summary.filled, summary.gaps), (2, 0), "{summary}");
    let filled = kept(&rows).0;
    assert_eq!(filled.len(), whole.len());
    let apart = filled.pressure.iter().zip(&whole.pressure).map(|(a, b)| (a - b).abs());
    assert!(apart.fold(0.0, f32::max) < 0.01);
    rows.drain(500..503);
    let (_, summary) = kept(&rows);
    assert_eq!((summary.filled, summary.gaps), (2, 1), "{summary}");
}

#[test]
fn a_table_in_random_order_is_refused_with_what_to_do() {
    let mut random = ChaCha8Rng::seed_from_u64(3);
    let mut shuffle = |mut rows: Vec<String>| {
        for n in (1..rows.len()).rev() {
            rows.swap(n, random.random_range(0..=n));
        }
        rows
    };
    let refused = import_bytes(&table(NAMES, &shuffle(lines(plain))), FIELD).unwrap_err().to_string();
    assert!(refused.contains("backwards") && refused.contains("sort the rows"), "{refused}");
    let numbered = lines(|row| format!("{},{}", row / BREATH, plain(row)));
    let map = format!("[breath]\ncolumn = 'id'\n{FIELD}");
    let refused = import_bytes(&table(&format!("id,{NAMES}"), &shuffle(numbered)), &map).unwrap_err();
    assert!(refused.to_string().contains("sort the rows by breath and time"), "{refused}");
    // Times in whole seconds say nothing of the rows in between.
    let coarse = lines(|row| {
        let (_, rest) = plain(row).split_once(',').map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
        format!("{},{rest}", row / 50)
    });
    let refused = import_bytes(&table(NAMES, &coarse), FIELD).unwrap_err().to_string();
    assert!(refused.contains("stands still") && refused.contains("period_ms"), "{refused}");
}

#[test]
fn a_change_of_peep_belongs_to_the_breath_that_ends_with_it() {
    let peep = |row: usize| if row < 6 * BREATH { 5.0 } else { 10.0 };
    let stepped = lines(|row| {
        let (time, _, set, flow, exh) = at(row);
        let set = if exh == 0 { set } else { peep(row + 20) };
        format!("{time:.3},{set:.2},{set:.1},{:.2},{exh}", 60.0 * flow)
    });
    let (recording, _) = import_bytes(&table(NAMES, &stepped), FIELD).unwrap();
    let peeps: Vec<f32> = recording.breaths().iter().map(|rows| recording.peep[rows.start]).collect();
    assert_eq!(peeps, [&[5.0; 4][..], &[10.0; 8]].concat());
    // Standby before the first breath, with the new PEEP set one row before its rise.
    let standby =
        lines(|row| if row < BREATH - 1 { format!("{:.3},0,0,0,1", at(row).0) } else { plain(row) });
    let by_target = FIELD.replace("[u_out]\ncolumn = 'exh'\nunit = 'share'\n", "");
    for map in [FIELD, &by_target] {
        let (recording, _) = import_bytes(&table(NAMES, &standby), map).unwrap();
        let first = recording.inspirations()[0].clone();
        assert!((INSPIRED..=INSPIRED + 1).contains(&first.len()), "{first:?}");
        assert_eq!((recording.pip[first.start], recording.peep[first.start]), (20.0, 5.0));
    }
}

#[test]
fn uneven_rows_keep_pressure_and_target_together() {
    let mut random = ChaCha8Rng::seed_from_u64(5);
    let jitter: Vec<f64> = (0..BREATH * (BREATHS + 1)).map(|_| random.random_range(-0.2..0.2)).collect();
    let uneven = lines(|row| {
        let (_, rest) = plain(row).split_once(',').map(|(a, b)| (a.to_owned(), b.to_owned())).unwrap();
        format!("{:.4},{rest}", (row as f64 + jitter[row]) * PERIOD)
    });
    let (recording, summary) = import_bytes(&table(NAMES, &uneven), FIELD).unwrap();
    assert!(summary.resampled_breaths > BREATHS / 2, "{summary}");
    let apart = recording.pressure.iter().zip(&recording.target).map(|(p, target)| (p - target).abs());
    assert!(apart.fold(0.0, f32::max) < 0.01);
    // No value lies between the levels, as one in the middle of an edge would.
    let levels = |pressure: &f32| (pressure - 5.0).abs().min((pressure - 20.0).abs());
    assert!(recording.pressure.iter().map(levels).fold(0.0, f32::max) < 0.01);
}

#[test]
fn doubtful_units_are_asked_about() {
    let asked = |map: &str| import_bytes(&table(NAMES, &lines(plain)), map).unwrap().1.to_string();
    assert!(!asked(FIELD).contains("check "));
    assert!(asked(&FIELD.replace("unit = 'L/min'", "")).contains("is it in L/min?"));
    assert!(asked(&FIELD.replace("'paw'", "'paw'\nunit = 'kPa'")).contains("pressure reaches 204 cmH2O"));
    assert!(asked(&FIELD.replace("'flow'", "'flow'\nscale = -1")).contains("turn its sign"));
}

#[test]
fn names_that_come_again_begin_another_recording() {
    let without = FIELD.replace("[time]\ncolumn = 'time'\n", "");
    let rows = lines(plain);
    let twice = [&rows[..], &[format!("{NAMES}\ns,cmH2O,cmH2O,L/min,-\n")], &rows[..]].concat();
    for map in [FIELD.to_owned(), format!("period_ms = 20\n{without}")] {
        let (recording, summary) = import_bytes(&table(NAMES, &twice), &map).unwrap();
        assert_eq!((summary.disorder.heads, summary.gaps, summary.rows), (2, 1, 2 * rows.len()), "{summary}");
        assert_eq!((summary.breaths, summary.complete_breaths), (2 * BREATHS, 2 * BREATHS), "{summary}");
        assert!(recording.breaths().iter().all(|rows| rows.len() <= BREATH + 1));
    }
    // Other words among the rows are an error.
    let words = [&rows[..40], &["suction,,,,\n".to_owned()], &rows[40..]].concat();
    let refused = import_bytes(&table(NAMES, &words), FIELD).unwrap_err().to_string();
    assert!(refused.contains("line 42, column `time`: `suction` is not a number"), "{refused}");
}

#[test]
fn thousands_may_have_marks() {
    let marked = |thousands: char, decimal: char| {
        lines(move |row| {
            let (time, paw, set, flow, exh) = at(row);
            let ml = (flow.abs() * 60_000.0).round() as usize;
            let sign = if flow < 0.0 { "\u{2212}" } else { "" };
            let grouped = if ml < 1000 {
                format!("{ml}{decimal}0")
            } else {
                format!("{}{thousands}{:03}{decimal}0", ml / 1000, ml % 1000)
            };
            let cell = |value: f64| format!("{value:.2}").replace('.', &decimal.to_string());
            format!("{};{};{};{sign}{grouped};{exh}", cell(time), cell(paw), cell(set))
        })
    };
    let map = format!("separator = ';'\n{}", FIELD.replace("L/min", "mL/min"));
    for (thousands, decimal) in [('.', ','), (',', '.'), ('\u{a0}', ','), ('\'', '.')] {
        let map = if decimal == '.' { format!("decimal = '.'\n{map}") } else { map.clone() };
        sound(&table("time;paw;set;flow;exh", &marked(thousands, decimal)), &map, true);
    }
}
