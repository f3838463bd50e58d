//! The tables of SAFETY.md are generated from the table of alarms and from the fault matrix.
//!
//! `UPDATE_SAFETY=1 cargo test -p tests --test safety_document` regenerates them.

use std::fmt::Write as _;
use std::path::PathBuf;

use judge::faults::cases::{LIMIT, cases};
use shared::safety::alarms::{ALARMS, Priority};

fn document() -> PathBuf {
    PathBuf::from(concat!(env!("CARGO_MANIFEST_DIR"), "/../SAFETY.md"))
}

/// Table of alarms.
fn alarms() -> String {
    let mut table =
        "| alarm | priority | action | entry | exit | text |\n|---|---|---|---|---|---|\n".to_owned();
    for alarm in &ALARMS {
        let priority = match alarm.priority {
            Priority::Low => "low",
            Priority::Medium => "medium",
            Priority::High => "high",
        };
        let action = alarm.action.name();
        let (id, entry, exit, text) = (alarm.id, alarm.entry, alarm.exit, alarm.text);
        writeln!(table, "| `{id}` | {priority} | {action} | {entry} | {exit} | {text} |").unwrap();
    }
    table
}

/// Every fault of the matrix with the monitors that must detect it.
fn faults() -> String {
    let mut table =
        "| fault | monitors that must fire | highest true pressure allowed, cmH2O |\n|---|---|---|\n"
            .to_owned();
    for case in cases() {
        let monitors: Vec<String> =
            case.monitors.iter().map(|monitor| format!("`{}`", monitor.alarm().id)).collect();
        let monitors = if monitors.is_empty() {
            "none; pressure and ventilation are judged".to_owned()
        } else {
            monitors.join(", ")
        };
        writeln!(table, "| {} | {monitors} | {:.0} |", case.name, case.peak_allowed(LIMIT)).unwrap();
    }
    table
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
