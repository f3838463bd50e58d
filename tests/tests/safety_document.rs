//! The tables of SAFETY.md are generated from the table of alarms and from the fault matrix.
//!
//! `UPDATE_SAFETY=1 cargo test -p tests --test safety_document` regenerates them.

use std::fmt::Write as _;
use std::path::PathBuf;

use shared::safety::alarms::ALARMS;
use trials::faults::cases::{FaultCase, HAZARDS, LIMIT, Required, cases};

fn document() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../SAFETY.md"))
}

/// Table of alarms.
fn alarms() -> String {
    let mut table =
        "| alarm | priority | action | entry | exit | text |\n|---|---|---|---|---|---|\n".to_owned();
    for alarm in &ALARMS {
        let (priority, action) = (alarm.priority.name(), alarm.action.name());
        let (id, entry, exit, text) = (alarm.id, alarm.entry, alarm.exit, alarm.text);
        writeln!(table, "| `{id}` | {priority} | {action} | {entry} | {exit} | {text} |").unwrap();
    }
    table
}

/// Every fault of the matrix, by hazard.
fn faults() -> String {
    let mut table = "| hazard | cause | monitor | response | ventilation that goes on | proof: highest true pressure, cmH2O |\n\
                     |---|---|---|---|---|---|\n"
        .to_owned();
    for (hazard, cases) in HAZARDS {
        for case in cases {
            let (monitors, responses) = reaction(case);
            let (cause, ventilation, peak) = (case.name, ventilation(case), case.peak_allowed(LIMIT));
            writeln!(table, "| {hazard} | {cause} | {monitors} | {responses} | {ventilation} | {peak:.0} |")
                .unwrap();
        }
    }
    table
}

/// The monitors that must detect a fault, and the responses.
fn reaction(case: &FaultCase) -> (String, String) {
    if case.monitors.is_empty() {
        return ("none needed".to_owned(), case.safeguard.to_owned());
    }
    let alarms: Vec<_> = case.monitors.iter().map(|monitor| monitor.alarm()).collect();
    let ids: Vec<_> = alarms.iter().map(|alarm| format!("`{}`", alarm.id)).collect();
    let mut responses: Vec<_> = alarms.iter().map(|alarm| alarm.action.name()).collect();
    responses.dedup();
    (ids.join(", "), responses.join(", "))
}

/// What ventilation a row requires.
fn ventilation(case: &FaultCase) -> String {
    let share = format!("{:.0} % of the volume", 100.0 * case.least_share);
    let gap = f64::from(case.longest_gap_ms(LIMIT)) / 1000.0;
    match case.ventilation {
        Required::Impossible => "none is required".to_owned(),
        Required::Stays => "none may start by itself".to_owned(),
        Required::GoesOn | Required::Resumes => format!("{share}, a breath within {gap:.0} s"),
    }
}

/// The text with the content between the marks of a table replaced.
fn with_table(text: &str, name: &str, table: &str) -> String {
    let (begin, end) = (format!("<!-- {name}: begin -->\n"), format!("<!-- {name}: end -->"));
    let (before, rest) = text.split_once(&begin).expect("SAFETY.md has the table's begin mark");
    let (_, after) = rest.split_once(&end).expect("SAFETY.md has the table's end mark");
    format!("{before}{begin}{table}{end}{after}")
}

#[test]
fn the_tables_are_those_of_the_code() {
    let text = std::fs::read_to_string(document()).unwrap();
    let wanted = with_table(&with_table(&text, "alarms", &alarms()), "faults", &faults());
    if std::env::var_os("UPDATE_SAFETY").is_some() {
        std::fs::write(document(), &wanted).unwrap();
    }
    let now = std::fs::read_to_string(document()).unwrap();
    assert!(
        now == wanted,
        "SAFETY.md's tables are outdated; run: UPDATE_SAFETY=1 cargo test -p tests --test safety_document"
    );
}

#[test]
fn every_alarm_that_a_monitor_raises_has_a_fault_that_proves_it() {
    for alarm in &ALARMS {
        assert!(cases().any(|case| case.monitors.contains(&alarm.fault)), "{}", alarm.id);
    }
}

#[test]
fn every_row_has_an_alarm_or_a_safeguard() {
    for case in cases() {
        assert_ne!(case.monitors.is_empty(), case.safeguard.is_empty(), "{}", case.name);
    }
}
