//! The test report: measured values beside their limits, each with the command and revision that made it.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::path::Path;

use anyhow::Result;
use serde_json::Value;

use super::results::{
    DRAWN, ENDURE, Experiment, FAULTS, FAULTS_HIGH, Run, Steps, TEST_TABLE, TORTURE, TORTURE_HIGH, date,
};

/// A heading, an experiment, and what to show of its results.
type Section = (&'static str, Experiment, fn(&Value) -> String);

const SECTIONS: [Section; 8] = [
    (
        "Pressure-control rows of ISO 80601-2-12, table 201.105, as open-ventilator projects transcribed them",
        TEST_TABLE,
        test_table,
    ),
    (
        "Alarm timing: from the fault to the alarm in the device, over all rows that require the alarm first",
        FAULTS,
        alarm_timing,
    ),
    ("Fault matrix, the worst lung of each row", FAULTS, fault_matrix),
    ("Fault matrix at the highest pressure limit", FAULTS_HIGH, fault_matrix),
    ("Hostile weights and random faults", TORTURE, torture),
    ("The same at the highest pressure limit", TORTURE_HIGH, torture),
    ("Drawn faults", DRAWN, drawn),
    ("Endurance", ENDURE, endure),
];

/// The report; it names the results' folder as seen from the top.
pub fn report(root: &Path, folder: &Path, steps: &Steps) -> Result<String> {
    let mut text = "\
All trials run on the virtual bench; nothing was measured on a machine. Pressures are in cmH2O. Limits stand beside the values; the
reasons for them are in SAFETY.md.\n"
        .to_owned();
    for (heading, experiment, show) in SECTIONS {
        writeln!(text, "\n## {heading}\n").unwrap();
        let section = match experiment.last(folder)? {
            None => not_run(&experiment, folder.strip_prefix(root).unwrap_or(folder)),
            Some(Run { record, value }) => {
                let day = record.ended_s.map_or_else(|| "interrupted".to_owned(), date);
                format!(
                    "`cargo lab {}`, revision {}, {day}\n\n{}",
                    record.line(),
                    record.revision,
                    show(&value)
                )
            }
        };
        text.push_str(&section);
    }
    writeln!(text, "\n## Steps of CI\n\n`cargo xtask ci`\n").unwrap();
    text += &table(
        &["step", "result", "revision", "date"],
        steps.iter().map(|(name, step)| {
            let result = if step.passed { "passed" } else { "FAILED" };
            vec![name.clone(), result.into(), step.revision.clone(), date(step.ended_s)]
        }),
    );
    Ok(text)
}

fn not_run(experiment: &Experiment, folder: &Path) -> String {
    let command = if experiment.quick {
        "cargo xtask faults".to_owned()
    } else {
        format!("cargo lab {} --json {}", experiment.line, experiment.file(folder).display())
    };
    format!("Not run; to run it: `{command}`\n")
}

/// A table in Markdown; `-` stands for one without rows.
pub fn table(columns: &[&str], rows: impl Iterator<Item = Vec<String>>) -> String {
    let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
    let head: Vec<_> = columns.iter().map(|&column| column.to_owned()).collect();
    let body: String = rows.map(|row| line(&row)).collect();
    if body.is_empty() { "-\n".into() } else { line(&head) + &"|---".repeat(columns.len()) + "|\n" + &body }
}

/// A number with some decimals; `-` for none.
fn number(value: &Value, decimals: usize) -> String {
    value.as_f64().map_or_else(|| "-".into(), |value| format!("{value:.decimals$}"))
}

fn word(value: &Value) -> String {
    value.as_str().unwrap_or("-").to_owned()
}

fn rows(value: &Value) -> impl Iterator<Item = &Value> {
    value.as_array().into_iter().flatten()
}

fn test_table(value: &Value) -> String {
    let columns = [
        "row",
        "machine",
        "R",
        "C",
        "PIP",
        "PEEP",
        "plateau error",
        "allowed",
        "overshoot",
        "allowed",
        "volume, mL",
        "expected",
        "passes",
    ];
    let row = |row: &Value| {
        let (outcome, score) = (&row["outcome"], &row["outcome"]["score"]);
        vec![
            number(&row["row"], 0),
            word(&row["machine"]),
            number(&row["resistance"], 0),
            number(&row["compliance"], 1),
            number(&row["pip"], 0),
            number(&row["peep"], 0),
            number(&score["plateau_error"], 2),
            number(&row["tolerance"], 1),
            number(&score["overshoot"], 2),
            number(&row["overshoot_allowed"], 1),
            number(&outcome["tidal_volume"], 0),
            number(&row["expected_volume"], 0),
            yes(row["pass"] == true),
        ]
    };
    let passed = rows(value).filter(|row| row["pass"] == true).count();
    format!("{passed} of {} rows pass.\n\n{}", rows(value).count(), table(&columns, rows(value).map(row)))
}

fn yes(passes: bool) -> String {
    if passes { "yes" } else { "NO" }.into()
}

/// The larger of two numbers; one that is missing is the largest of all.
fn worst<'a>(key: &'static str) -> impl Fn(&&'a Value, &&'a Value) -> std::cmp::Ordering {
    move |a, b| {
        let of = |row: &Value| row[key].as_f64().unwrap_or(f64::INFINITY);
        of(a).total_cmp(&of(b))
    }
}

fn alarm_timing(value: &Value) -> String {
    let mut alarms: BTreeMap<String, Vec<&Value>> = BTreeMap::new();
    for row in rows(&value["rows"]).filter(|row| row["monitor"][0].is_string()) {
        alarms.entry(word(&row["monitor"][0])).or_default().push(row);
    }
    let line = |(alarm, rows): (String, Vec<&Value>)| {
        let slowest = *rows.iter().max_by(|a, b| worst("detect_ms")(a, b)).unwrap_or(&&Value::Null);
        let (fault, lung) = (word(&slowest["fault"]), word(&slowest["lung"]));
        let times = [number(&slowest["detect_ms"], 0), number(&slowest["detect_allowed_ms"], 0)];
        [vec![alarm, rows.len().to_string()], times.into(), vec![fault, lung]].concat()
    };
    let columns = ["alarm", "trials", "slowest, ms", "allowed", "fault", "lung"];
    table(&columns, alarms.into_iter().map(line))
}

fn fault_matrix(value: &Value) -> String {
    let mut faults: Vec<(String, Vec<&Value>)> = Vec::new();
    for row in rows(&value["rows"]) {
        let fault = word(&row["fault"]);
        match faults.last_mut() {
            Some((last, rows)) if *last == fault => rows.push(row),
            _ => faults.push((fault, vec![row])),
        }
    }
    let line = |(fault, rows): (String, Vec<&Value>)| {
        let most = |key| rows.iter().copied().max_by(worst(key)).unwrap_or(&Value::Null);
        let least = rows.iter().copied().min_by(worst("minute_volume_share")).unwrap_or(&Value::Null);
        let (slowest, highest, gap) = (most("detect_ms"), most("peak_true"), most("longest_gap_s"));
        let has_alarm = rows.iter().any(|row| row["monitor"][0].is_string());
        let passed = rows.iter().filter(|row| row["pass"] == true).count();
        vec![
            fault,
            if has_alarm { number(&slowest["detect_ms"], 0) } else { "-".into() },
            if has_alarm { number(&slowest["detect_allowed_ms"], 0) } else { "-".into() },
            number(&highest["peak_true"], 1),
            number(&highest["peak_allowed"], 0),
            number(&least["minute_volume_share"], 2),
            number(&least["share_required"], 2),
            number(&gap["longest_gap_s"], 1),
            number(&gap["gap_allowed_s"], 1),
            format!("{passed} of {}", rows.len()),
        ]
    };
    let columns = [
        "fault",
        "alarm, ms",
        "allowed",
        "pressure",
        "allowed",
        "share of volume",
        "required",
        "gap, s",
        "allowed",
        "lungs that pass",
    ];
    table(&columns, faults.into_iter().map(line))
}

fn torture(value: &Value) -> String {
    let columns = ["", "measured", "allowed"];
    let line =
        |name: &str, measured: String, allowed: &str| vec![name.to_owned(), measured, allowed.to_owned()];
    let lines = [
        line("breaths", number(&value["breaths"], 0), "-"),
        line("pressure limit", number(&value["limit"], 0), "-"),
        line(
            "highest true pressure",
            number(&value["peak_true"], 1),
            "the bound of SAFETY.md above the limit",
        ),
        line("runs above the bound", number(&value["above_limit"], 0), "0"),
        line("runs that end latched", number(&value["latched"], 0), "-"),
    ];
    table(&columns, lines.into_iter())
}

fn drawn(value: &Value) -> String {
    let columns = ["", "measured", "allowed"];
    let broken = value["broken"].as_object().into_iter().flatten().map(|(promise, classes)| {
        let cases: u64 =
            classes.as_object().into_iter().flatten().filter_map(|(_, class)| class["cases"].as_u64()).sum();
        vec![format!("cases that broke: {promise}"), cases.to_string(), "0".into()]
    });
    let cases = vec!["cases".to_owned(), number(&value["cases"], 0), "-".into()];
    let failed = vec!["cases that broke a promise".to_owned(), number(&value["failed"], 0), "0".into()];
    table(&columns, [cases, failed].into_iter().chain(broken))
}

fn endure(value: &Value) -> String {
    let columns = ["", "measured", "allowed"];
    let lines = [
        ("patients", "patients", 0, "-"),
        ("patient-days", "patient_days", 1, "-"),
        ("breaths", "breaths", 0, "-"),
        ("interruptions", "interruptions", 0, "0"),
        ("longest gap, s", "longest_gap_s", 1, "-"),
        ("undeserved alarms of high priority", "high_alarms_undeserved", 0, "0"),
        ("undeserved alarms of medium priority per patient-day", "medium_alarms_undeserved_per_day", 2, "-"),
        ("missed alarms", "alarms_missed", 0, "0"),
        ("highest true pressure", "peak_true", 1, "-"),
    ];
    let line = |(name, key, decimals, allowed): (&str, &str, usize, &str)| {
        vec![name.to_owned(), number(&value[key], decimals), allowed.to_owned()]
    };
    table(&columns, lines.into_iter().map(line))
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn what_was_not_run_is_said_with_its_command() {
        let folder = tempfile::tempdir().unwrap();
        let text = report(Path::new("/"), folder.path(), &Steps::new()).unwrap();
        assert_eq!(text.matches("Not run; to run it:").count(), SECTIONS.len());
        assert!(text.contains("`cargo lab endure --patients 60 --seed 33 --json "), "{text}");
    }

    #[test]
    fn the_slowest_alarm_and_the_worst_lung_are_shown_with_their_limits() {
        let row = |lung: &str, detect: Value, peak: f64, pass: bool| {
            json!({"fault": "leak", "lung": lung, "monitor": ["leak"], "detect_ms": detect, "detect_allowed_ms": 3000,
                "peak_true": peak, "peak_allowed": 60.0, "minute_volume_share": 0.9, "share_required": 0.8,
                "longest_gap_s": 2.0, "gap_allowed_s": 6.0, "pass": pass})
        };
        let value =
            json!({"rows": [row("R5C10", json!(700), 25.0, true), row("R20C20", json!(900), 24.0, true)]});
        assert!(
            alarm_timing(&value).contains("| leak | 2 | 900 | 3000 | leak | R20C20 |"),
            "{}",
            alarm_timing(&value)
        );
        let line = "| leak | 900 | 3000 | 25.0 | 60 | 0.90 | 0.80 | 2.0 | 6.0 | 2 of 2 |";
        assert!(fault_matrix(&value).contains(line), "{}", fault_matrix(&value));
        let silent =
            json!({"rows": [row("R5C10", Value::Null, 25.0, false), row("R20C20", json!(900), 24.0, true)]});
        assert!(
            alarm_timing(&silent).contains("| leak | 2 | - | 3000 | leak | R5C10 |"),
            "a missing alarm is the worst"
        );
    }
}
