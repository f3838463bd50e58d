//! The fault matrix: a table for each hazard.

use std::fmt::Write as _;

use trials::faults::cases::{FaultCase, HAZARDS, LIMIT, Required};

/// A table for each hazard, one row for each fault.
pub fn tables() -> String {
    let mut text = String::new();
    for (hazard, cases) in HAZARDS {
        writeln!(
            text,
            "\nHazard: {hazard}.\n\n\
             | cause | requirement | response | volume, longest gap | cmH2O |\n\
             |---|---|---|---|---:|"
        )
        .unwrap();
        for case in cases {
            let (requirements, responses) = reaction(case);
            let (cause, ventilation, peak) = (case.name, ventilation(case), case.peak_allowed(LIMIT));
            writeln!(text, "| {cause} | {requirements} | {responses} | {ventilation} | {peak:.0} |").unwrap();
        }
    }
    text + "\n"
}

/// The alarms that must detect a fault, and the responses; or what keeps it harmless without an alarm.
fn reaction(case: &FaultCase) -> (String, String) {
    if let Some(safeguard) = case.safeguard {
        return (format!("`{}`", safeguard.requirement), safeguard.text.to_owned());
    }
    let alarms: Vec<_> = case.monitors.iter().map(|monitor| monitor.alarm()).collect();
    let ids: Vec<_> = alarms.iter().map(|alarm| format!("`{}`", alarm.id)).collect();
    let mut responses: Vec<_> = alarms.iter().map(|alarm| alarm.action.name()).collect();
    responses.dedup();
    (ids.join(", "), responses.join(", "))
}

/// What ventilation a row requires.
fn ventilation(case: &FaultCase) -> String {
    let share = format!("{:.0} %", 100.0 * case.least_share);
    let gap = f64::from(case.longest_gap_ms(LIMIT)) / 1000.0;
    match case.ventilation {
        Required::Impossible => "none required".to_owned(),
        Required::Stays => "no start by itself".to_owned(),
        Required::GoesOn | Required::Resumes => format!("{share}, {gap:.0} s"),
    }
}
