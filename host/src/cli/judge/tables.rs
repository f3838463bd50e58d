//! The verdict as text.

use std::collections::BTreeMap;

use crate::command::Context;
use show::report::{Cell, Table};
use verdict::{
    AsynchronyCount, Judged, LimitResult, LungReport, Mean, PhaseAccuracy, Target, USUAL, Verdict,
};

/// Prints a verdict with at most `worst` sore spots.
pub fn print(context: &Context<'_>, file: &str, verdict: &Verdict, worst: usize) {
    context.line(&head(file, verdict));
    context.table(&report(verdict));
    context.table(&figures(verdict));
    let lines = accuracy(verdict).into_iter().chain(limits(verdict)).chain(sore_spots(verdict, worst));
    for line in lines.chain([asynchronies(verdict)]) {
        context.line(&line);
    }
}

/// What was judged, and what was not.
fn head(file: &str, verdict: &Verdict) -> String {
    let judged = match verdict.judged {
        Judged::True => "true pressure",
        Judged::Measured => "measured pressure",
    };
    let mut lines = vec![
        format!("{file}: {}", if verdict.plant.is_empty() { "unknown plant" } else { &verdict.plant }),
        format!(
            "{} of {} breaths judged by the {judged}, {} ms, noise {:.2} cmH2O (sd)",
            verdict.breaths.len(),
            verdict.breaths.len() + verdict.unjudged.len(),
            f64::from(verdict.period_us) * 1e-3,
            verdict.noise
        ),
    ];
    lines.push(match verdict.target {
        Target::AsSet => "Target: as set".to_owned(),
        Target::Inferred => {
            "Target: inferred, the measured plateau; errors and accuracy are unknown".to_owned()
        }
    });
    if verdict.explored > 0.0 {
        lines.push(format!(
            "{:.0} % of the inspiratory ticks were perturbed to explore: the figures are not the controller's own.",
            100.0 * verdict.explored
        ));
    }
    lines.extend(remarks(verdict));
    lines.join("\n") + "\n"
}

/// Breaths that are not judged and remarks on those that are, each text once with its number of breaths.
fn remarks(verdict: &Verdict) -> Vec<String> {
    let mut counts: BTreeMap<String, usize> = BTreeMap::new();
    for breath in &verdict.unjudged {
        *counts.entry(format!("not judged, {}", breath.reason)).or_default() += 1;
    }
    for remark in verdict.breaths.iter().flat_map(|breath| &breath.figures.remarks) {
        *counts.entry(remark.clone()).or_default() += 1;
    }
    let breaths = |count: usize| if count == 1 { "1 breath".to_owned() } else { format!("{count} breaths") };
    counts.into_iter().map(|(text, count)| format!("{}: {text}", breaths(count))).collect()
}

fn mean(value: Option<Mean>, decimals: usize) -> Cell {
    Cell::known(value.map(|value| value.mean), decimals)
}

fn worst(value: Option<Mean>, decimals: usize) -> Cell {
    Cell::known(value.map(|value| value.worst), decimals)
}

/// The fields of a test report.
fn report(verdict: &Verdict) -> Table {
    Table::of(
        "Test report, means; pressures in cmH2O, rate in 1/min, time in s, volume in mL, flow in L/min",
        &verdict.lungs,
        &[
            ("lung", &|lung: &LungReport| Cell::text(&lung.name)),
            ("row", &|lung| {
                lung.iso.map_or_else(|| Cell::right("-"), |iso| Cell::count(usize::from(iso.row)))
            }),
            ("PIP", &|lung| Cell::number(lung.pip, 1)),
            ("PEEP", &|lung| Cell::number(lung.peep, 1)),
            ("measured PIP", &|lung| mean(lung.measured_pip, 1)),
            ("end insp.", &|lung| mean(lung.end_inspiration, 1)),
            ("PEEP ", &|lung| mean(lung.measured_peep, 1)),
            ("rate", &|lung| mean(lung.rate, 1)),
            ("time", &|lung| mean(lung.inspiratory_time_s, 2)),
            ("volume", &|lung| mean(lung.tidal_volume_ml, 0)),
            ("flow", &|lung| mean(lung.peak_flow_l_min, 0)),
            ("breaths", &|lung| Cell::count(lung.breaths)),
        ],
    )
}

/// The mean figures.
fn figures(verdict: &Verdict) -> Table {
    Table::of(
        "Figures, means; overshoot, undershoot, swing and fall below PEEP: the worst breath's; rise in ms, all else in \
         cmH2O",
        &verdict.lungs,
        &[
            ("lung", &|lung: &LungReport| Cell::text(&lung.name)),
            ("PIP", &|lung| Cell::number(lung.pip, 1)),
            ("error", &|lung| mean(lung.error, 2)),
            ("rise", &|lung| mean(lung.rise_ms, 0)),
            ("overshoot", &|lung| worst(lung.overshoot, 2)),
            ("undershoot", &|lung| worst(lung.undershoot, 2)),
            ("swings", &|lung| mean(lung.swings, 1)),
            ("swing", &|lung| worst(lung.swing_size, 2)),
            ("Hz", &|lung| mean(lung.frequency, 1)),
            ("plateau", &|lung| mean(lung.plateau_error, 2)),
            ("slope, 1/s", &|lung| mean(lung.slope, 1)),
            ("below PEEP", &|lung| worst(lung.below_peep, 2)),
        ],
    )
}

fn accuracy(verdict: &Verdict) -> Vec<String> {
    let line = |end: &str, accuracy: Option<PhaseAccuracy>| match accuracy {
        Some(found) => format!(
            "End of {end}: {} covers {} breaths; largest error {:.2} cmH2O, {:.0} % of {USUAL}",
            found.declared,
            found.breaths,
            found.largest,
            100.0 * found.of_usual
        ),
        None => format!("End of {end}: accuracy unknown"),
    };
    let lines =
        [line("inspiration", verdict.accuracy_inspiration), line("expiration", verdict.accuracy_expiration)];
    vec![lines.join("\n") + "\n"]
}

fn limits(verdict: &Verdict) -> Vec<String> {
    let one = |result: &LimitResult| {
        let (name, unit) = (result.kind.name(), result.kind.unit());
        let limit = match result.limit.percent {
            0.0 => format!("{} {unit}", result.limit.fixed),
            percent => format!("{} {unit} + {percent} %", result.limit.fixed),
        };
        let worst =
            result.violations.iter().max_by(|a, b| (a.value - a.allowed).total_cmp(&(b.value - b.allowed)));
        // A breath without the figure keeps no limit, and neither does one that cannot be judged at all.
        let all = verdict.breaths.len() + verdict.unjudged.len();
        let unknown = match all - result.checked {
            0 => String::new(),
            unknown => format!(", unknown in {unknown} of {all}"),
        };
        match worst {
            None if result.checked == all => format!("Limit on {name}, {limit}: kept in all {all} breaths"),
            None => {
                format!("Limit on {name}, {limit}: kept in the {} breaths judged{unknown}", result.checked)
            }
            Some(worst) => format!(
                "Limit on {name}, {limit}: VIOLATED in {} of {} breaths judged{unknown}; worst {:.2} in breath {} of {}",
                result.violations.len(),
                result.checked,
                worst.value,
                worst.breath,
                worst.lung
            ),
        }
    };
    let lines: Vec<String> = verdict.limits.iter().map(one).collect();
    if lines.is_empty() { lines } else { vec![lines.join("\n") + "\n"] }
}

fn sore_spots(verdict: &Verdict, worst: usize) -> Vec<String> {
    let spots = &verdict.sore_spots;
    if spots.is_empty() {
        return vec!["No sore spots\n".to_owned()];
    }
    let shown = spots.iter().take(worst).enumerate();
    let lines = shown.map(|(n, spot)| {
        let advice =
            spot.advice.as_ref().map_or_else(String::new, |advice| format!("\n     {}", advice.text));
        format!("{:>3}. {}{advice}", n + 1, spot.text)
    });
    let more = spots.len().saturating_sub(worst);
    let more = (more > 0).then(|| format!("     and {more} more (--worst)"));
    let title = "Sore spots, the most severe first".to_owned();
    vec![std::iter::once(title).chain(lines).chain(more).collect::<Vec<_>>().join("\n") + "\n"]
}

/// Most breaths that are listed for one asynchrony.
const LISTED: usize = 12;

fn asynchronies(verdict: &Verdict) -> String {
    let Some(found) = &verdict.asynchronies else {
        return "Asynchronies: unknown without flow in both directions\n".to_owned();
    };
    let one = |count: &AsynchronyCount| {
        let listed =
            count.breaths.iter().take(LISTED).map(ToString::to_string).collect::<Vec<_>>().join(", ");
        let more = if count.breaths.len() > LISTED { ", ..." } else { "" };
        let (name, events, share) = (count.kind.name(), count.events, 100.0 * count.share);
        format!("  {name}: {events} ({share:.1} per 100 breaths), in breath {listed}{more}")
    };
    let kinds: Vec<String> = found.kinds.iter().filter(|count| count.events > 0).map(one).collect();
    let unchecked = match found.unchecked {
        0 => String::new(),
        unchecked => format!(", {unchecked} not checked"),
    };
    let head = if kinds.is_empty() {
        format!("Asynchronies: none in {} breaths{unchecked}", found.checked)
    } else {
        format!("Asynchronies in {} breaths{unchecked}: {:.1} %", found.checked, found.index_percent)
    };
    std::iter::once(head).chain(kinds).collect::<Vec<_>>().join("\n") + "\n"
}
