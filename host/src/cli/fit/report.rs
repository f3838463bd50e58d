//! The report of a fit: training curve, errors, and predictions beside the measurements.

use super::{remarks, table};
use data::identity::TestRun;
use data::provenance::Provenance;
use data::recording::Recording;
use learn::recipe::{Fitted, Parts};
use learn::simulator::episode::Episode;
use learn::simulator::open_loop::predict;
use show::report::{Block, Plot, Report, Section, Series, Style};
use study::prediction;
use verdict::fit_summary::FitSummary;

/// Number of held-out breaths shown.
const SHOWN: usize = 8;

/// A fit on one page.
pub fn report(summary: &FitSummary, fitted: &Fitted, parts: &Parts<'_>, recording: &Recording) -> Report {
    let Fitted { simulator, curve, .. } = fitted;
    let period_s = f64::from(simulator.architecture.timing().period_us) * 1e-6;
    let shown = [spread(&parts.held_out, SHOWN), spread(&parts.other_lungs, SHOWN / 2)].concat();
    let predictions = predict(simulator, &shown);
    let breaths = shown.iter().zip(&predictions).flat_map(|(episode, prediction)| {
        breath(episode, prediction, period_s, &recording.provenance.groups)
    });
    let mut sections = vec![
        Section {
            heading: "Errors".into(),
            text: "One step: the predicted change of pressure over one step of the simulator. Open loop: recorded \
                   commands replayed from rest, without pressure feedback, over the whole inspiration."
                .into(),
            blocks: vec![Block::Table(table(summary)), Block::Text(remarks(summary).join("\n\n"))],
        },
        Section {
            heading: "Held-out breaths".into(),
            text: "None of these was used in the fit. The simulator sees the commands and the start of the breath only. \
                   Beside each breath is the error of its prediction."
                .into(),
            blocks: vec![Block::PlotRow(breaths.collect())],
        },
    ];
    sections.extend(training(curve));
    Report {
        title: "Learned simulator".into(),
        subtitle: summary.plant.clone(),
        sections,
        provenance: Some(Provenance {
            seed: summary.seed,
            settings: serde_json::json!({
                "architecture": summary.architecture, "epochs": summary.epochs,
                "recording": recording.provenance.settings,
            }),
            ..recording.provenance.clone()
        }),
    }
}

/// At most `count` entries, evenly spread.
fn spread<'a>(episodes: &[&'a Episode], count: usize) -> Vec<&'a Episode> {
    let count = count.min(episodes.len());
    (0..count).map(|n| episodes[n * episodes.len() / count]).collect()
}

fn breath(episode: &Episode, prediction: &[f32], period_s: f64, groups: &[TestRun]) -> [Plot; 2] {
    let group = episode.group.and_then(|index| groups.get(index as usize));
    let of = group.map_or_else(String::new, |name| format!("{name}, "));
    let title = format!("{of}PIP {:.1} cmH2O", episode.pip);
    prediction::plots(title, &episode.pressure, episode.truth.as_deref(), prediction, period_s)
}

/// The loss by epoch; `None` for a fit stopped before its first epoch.
fn training(curve: &[f64]) -> Option<Section> {
    if curve.is_empty() {
        return None;
    }
    // A logarithmic axis cannot show zero.
    let point = |(epoch, loss): (usize, &f64)| ((epoch + 1) as f64, loss.max(f64::MIN_POSITIVE));
    Some(Section {
        heading: "Training".into(),
        text: "Loss per pressure sample on the training breaths.".into(),
        blocks: vec![Block::Plot(Plot {
            title: "Training curve".into(),
            x_label: "epoch".into(),
            y_label: "Huber loss, cmH2O".into(),
            series: vec![Series::new("training", Style::Line, curve.iter().enumerate().map(point).collect())],
            log_y: true,
            ..Plot::default()
        })],
    })
}
