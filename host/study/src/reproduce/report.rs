//! The experiments' report: figures as a reader of the paper knows them, tables beside them.

use super::balloon::AUTHORS;
use super::changes::Change;
use super::learning::{LearnerResult, Learning};
use super::results::{BalloonFigures, LungMeans, Results};
use super::study::Study;
use super::{Ablation, LungFigures, changes, iso, learning, lungs, tracking};
use crate::StudyError;
use data::provenance::Provenance;
use judge::evaluate::BreathTrace;
use show::report::{Block, Cell, Plot, Report, Section, Series, Style, Table};

/// Length of the inspiration that is shown enlarged, s.
const ZOOM_S: f64 = 1.0;

/// Everything that the study's folder holds.
pub(super) fn report(study: &Study<'_>, results: &Results) -> Result<Report, StudyError> {
    let mut sections = Vec::new();
    sections.extend(tracking::kept(study)?.map(|tracking| tracking_section(&tracking)));
    if !results.lungs.is_empty() {
        sections.push(lungs_section(study, results)?);
    }
    if !results.unseen.is_empty() {
        sections.push(unseen_section(results));
    }
    sections.extend(changes::kept(study)?.map(|changes| changes_section(&changes)));
    sections.extend(iso::kept(study)?.map(|rows| iso_section(&rows)));
    sections.extend(results.balloon.as_ref().map(balloon_section));
    sections.extend(learning::kept(study)?.map(|learning| learning_section(&learning, results)));
    if !results.ablations.is_empty() {
        sections.push(ablations_section(&results.ablations));
    }
    Ok(Report {
        title: "Machine learning for mechanical ventilation control, reproduced".into(),
        subtitle: headline(results),
        sections,
        provenance: Some(Provenance {
            seed: results.seed,
            plant: "the paper's lungs on the virtual bench".into(),
            ..Provenance::new(study.plan().period_us, "reproduce")
        }),
    })
}

/// The result in a sentence.
pub fn headline(results: &Results) -> String {
    let Some(mean) = &results.mean else { return "not all lungs have been run yet".into() };
    let own = format!(
        "A controller for each lung: mean error {:.3} cmH2O, {:.0} % of each lung's best PID.",
        mean.learned,
        100.0 * mean.learned / mean.pid
    );
    match mean.generalist {
        Some(generalist) => format!(
            "{own} One controller for all: {:.3} cmH2O, {:.0} % of the best single PID and {:.0} % of each lung's best PID.",
            generalist,
            100.0 * generalist / mean.single_pid,
            100.0 * generalist / mean.pid
        ),
        None => own,
    }
}

/// The lungs, and their mean.
pub fn lungs_table(results: &Results) -> Table {
    let mut table = Table::new(
        "Mean absolute error of the true airway pressure over the inspiration, cmH2O",
        &[
            "lung",
            "own best PID",
            "single PID",
            "learned",
            "spread",
            "learned for all",
            "bound",
            "gap closed",
        ],
    );
    for lung in &results.lungs {
        let most = lung.learned_by_seed.iter().copied().fold(f64::MIN, f64::max);
        let least = lung.learned_by_seed.iter().copied().fold(f64::MAX, f64::min);
        let gap = lung.gap_closed().map_or_else(none, |part| Cell::right(format!("{:.0} %", 100.0 * part)));
        table.row(vec![
            Cell::text(&lung.lung),
            Cell::number(lung.pid, 3),
            Cell::number(lung.single_pid, 3),
            Cell::number(lung.learned, 3).best_if(lung.learned < lung.pid),
            Cell::number(most - least, 3),
            known(lung.generalist).best_if(lung.generalist.is_some_and(|score| score < lung.pid)),
            known(lung.bound),
            gap,
        ]);
    }
    if let Some(mean) = &results.mean {
        table.row(vec![
            Cell::text("mean"),
            Cell::number(mean.pid, 3),
            Cell::number(mean.single_pid, 3),
            Cell::number(mean.learned, 3).best_if(mean.learned < mean.pid),
            none(),
            known(mean.generalist).best_if(mean.generalist.is_some_and(|score| score < mean.pid)),
            known(mean.bound),
            none(),
        ]);
    }
    if let Some(LungMeans { bound: Some(bound), pid, single_pid, learned, generalist }) = results.mean {
        table.row(vec![
            Cell::text("mean / bound"),
            Cell::number(pid / bound, 3),
            Cell::number(single_pid / bound, 3),
            Cell::number(learned / bound, 3),
            none(),
            known(generalist.map(|generalist| generalist / bound)),
            Cell::number(1.0, 3),
            none(),
        ]);
    }
    table
}

/// A figure, if it is known.
fn known(figure: Option<f64>) -> Cell {
    figure.map_or_else(none, |figure| Cell::number(figure, 3))
}

fn none() -> Cell {
    Cell::right("-")
}

fn lungs_section(study: &Study<'_>, results: &Results) -> Result<Section, StudyError> {
    let at = |of: &dyn Fn(&LungFigures) -> Option<f64>| -> Vec<(f64, f64)> {
        (1..).zip(&results.lungs).filter_map(|(n, lung)| Some((f64::from(n), of(lung)?))).collect()
    };
    let mut series = vec![
        Series::new("single PID", Style::Bars, at(&|lung| Some(lung.single_pid))),
        Series::new("own best PID", Style::Bars, at(&|lung| Some(lung.pid))),
        Series::new("learned", Style::Bars, at(&|lung| Some(lung.learned))),
    ];
    let generalist = at(&|lung| lung.generalist);
    if !generalist.is_empty() {
        series.push(Series::new("learned for all", Style::Bars, generalist));
    }
    let bound = at(&|lung| lung.bound);
    if !bound.is_empty() {
        series.push(Series::new("bound", Style::Bars, bound));
    }
    let simulators = lungs::kept(study)?.unwrap_or_default();
    let mut distances = Table::new(
        "Open-loop distance of the learned simulators, cmH2O, and what they were learned from",
        &["lung", "distance", "minutes recorded"],
    );
    for (bench, lung) in study.lungs().iter().zip(&simulators) {
        let seconds = lung.ticks.iter().sum::<usize>() as f64 * 1e-6 * f64::from(study.plan().period_us);
        distances.row(vec![
            Cell::text(&bench.name),
            Cell::number(lung.open_loop.iter().sum::<f64>() / lung.open_loop.len().max(1) as f64, 3),
            Cell::number(seconds / lung.ticks.len().max(1) as f64 / 60.0, 1),
        ]);
    }
    Ok(Section {
        heading: "Performance and robustness".into(),
        text: "Best PID of a search on the very bench against the controller trained on the simulator learned for that lung; \
               and one controller for all lungs against the best single PID."
            .into(),
        blocks: vec![
            Block::Table(lungs_table(results)),
            Block::Plot(Plot {
                title: "Score by lung".into(),
                x_label: "lung".into(),
                y_label: "mean error, cmH2O".into(),
                y_range: Some((0.0, highest(&series))),
                series,
                x_names: results.lungs.iter().map(|lung| lung.lung.clone()).collect(),
                x_range: Some((0.5, results.lungs.len() as f64 + 0.5)),
                ..Plot::default()
            }),
            Block::Table(distances),
        ],
    })
}

/// Upper end of an axis with these bars.
fn highest(series: &[Series]) -> f64 {
    1.05 * series.iter().flat_map(|series| &series.points).fold(0.0, |most: f64, (_, y)| most.max(*y))
}

fn tracking_section(tracking: &tracking::Tracking) -> Section {
    let plot = |title: &str, y_label: &str, series| Plot {
        title: title.into(),
        x_label: "time, s".into(),
        y_label: y_label.into(),
        series,
        ..Plot::default()
    };
    let pressures = |until: f64| {
        let mut series = Vec::new();
        if let Some((_, trace)) = tracking.controllers.first() {
            series.push(Series::new("target", Style::Dashed, points(trace, &trace.target, until)));
        }
        series.extend(
            tracking
                .controllers
                .iter()
                .map(|(name, trace)| Series::new(name, Style::Line, points(trace, &trace.pressure, until))),
        );
        series
    };
    let inspiratory = tracking
        .controllers
        .iter()
        .map(|(name, trace)| Series::new(name, Style::Line, points(trace, &trace.u_in, ZOOM_S)));
    let expiratory = tracking.controllers.first().map(|(_, trace)| {
        let open: Vec<f64> = trace.u_out.iter().map(|open| f64::from(u8::from(*open)) * 100.0).collect();
        Series::new("expiratory valve", Style::Step, points(trace, &open, f64::INFINITY))
    });
    Section {
        heading: "Tracking".into(),
        text: format!(
            "True airway pressure on {} under the best P-only, I-only and PID controllers and the learned ones.",
            tracking.lung
        ),
        blocks: vec![
            Block::Plot(plot("Three breaths", "airway pressure, cmH2O", pressures(f64::INFINITY))),
            Block::Plot(plot("One inspiration", "airway pressure, cmH2O", pressures(ZOOM_S))),
            Block::PlotRow(vec![
                plot("Inspiratory valve", "opening, %", inspiratory.collect()),
                plot("Expiratory valve", "opening, %", expiratory.into_iter().collect()),
            ]),
        ],
    }
}

fn points(trace: &BreathTrace, values: &[f64], until: f64) -> Vec<(f64, f64)> {
    let both = trace.time_s.iter().copied().zip(values.iter().copied());
    both.take_while(|(time, _)| *time < until).collect()
}

fn unseen_section(results: &Results) -> Section {
    let mut table = Table::new(
        "Mean error, cmH2O",
        &["plant", "within the trained lungs", "own best PID", "single PID", "learned for all"],
    );
    for plant in &results.unseen {
        table.row(vec![
            Cell::text(&plant.plant),
            Cell::text(if plant.inside { "yes" } else { "no" }),
            Cell::number(plant.pid, 3),
            Cell::number(plant.single_pid, 3),
            Cell::number(plant.generalist, 3).best_if(plant.generalist < plant.single_pid),
        ]);
    }
    Section {
        heading: "Unseen plants".into(),
        text: "The controller for all lungs and the best single PID on plants that neither has met.".into(),
        blocks: vec![Block::Table(table)],
    }
}

fn changes_section(changes: &[Change]) -> Section {
    let mut table = Table::new(
        "Breaths until the score stays within 10 % of where it settles, the breath of the change included",
        &["change", "learned for all", "single PID"],
    );
    for change in changes {
        table.row(vec![
            Cell::text(&change.what),
            Cell::count(Change::breaths_to_reconverge(&change.generalist)),
            Cell::count(Change::breaths_to_reconverge(&change.single_pid)),
        ]);
    }
    let series = |change: &Change| {
        let points = (1..).zip(&change.generalist).map(|(breath, score)| (f64::from(breath), *score));
        Series::new(&change.what, Style::Line, points.collect())
    };
    Section {
        heading: "Changes of the lung".into(),
        text: "R20C20 becomes another lung between the fourth and the fifth breath.".into(),
        blocks: vec![
            Block::Plot(Plot {
                title: "Score of each breath, learned for all".into(),
                x_label: "breath".into(),
                y_label: "mean error, cmH2O".into(),
                series: changes.iter().map(series).collect(),
                ..Plot::default()
            }),
            Block::Table(table),
        ],
    }
}

fn iso_section(rows: &[iso::IsoResult]) -> Section {
    let mut table = Table::new(
        "Plateau error and overshoot in cmH2O, rise in ms, tidal volume in mL; PID / learned for all",
        &["row", "R", "C", "PIP/PEEP", "plateau", "overshoot", "rise", "volume", "expected", "kept"],
    );
    let pair = |row: &iso::IsoResult, of: &dyn Fn(&iso::IsoOutcome) -> f64, decimals: usize| {
        let text = |outcome: &Option<iso::IsoOutcome>| {
            outcome
                .as_ref()
                .map_or_else(|| "fault".to_owned(), |outcome| format!("{:.decimals$}", of(outcome)))
        };
        Cell::right(format!("{} / {}", text(&row.single_pid), text(&row.generalist)))
    };
    let kept = |outcome: &Option<iso::IsoOutcome>| {
        if outcome.is_some_and(|outcome| outcome.pass) { "yes" } else { "no" }
    };
    for row in rows {
        table.row(vec![
            Cell::count(row.number.into()),
            Cell::right(row.lung.0.to_string()),
            Cell::right(row.lung.1.to_string()),
            Cell::right(format!("{}/{}", row.pressures.0, row.pressures.1)),
            pair(row, &|outcome| outcome.score.plateau_error, 2),
            pair(row, &|outcome| outcome.score.overshoot, 1),
            pair(row, &|outcome| outcome.score.rise_ms, 0),
            pair(row, &|outcome| outcome.tidal_volume, 0),
            Cell::number(row.expected_volume, 0),
            Cell::text(format!("{} / {}", kept(&row.single_pid), kept(&row.generalist))),
        ]);
    }
    Section {
        heading: "Pressure-control test table".into(),
        text: "Rows of ISO 80601-2-12, table 201.105, as the open-ventilator community transcribed them. A row is kept if the \
               plateau's mean distance from PIP is at most 2 cmH2O and 4 % of PIP. From row 9 on the lungs are those of \
               infants: the least flow that this bench's valve can set raises their pressure by far more than a millisecond \
               of control can answer, so what fails there fails by the valve."
            .into(),
        blocks: vec![Block::Table(table)],
    }
}

fn learning_section(found: &Learning, results: &Results) -> Section {
    let learners = [("PPO", &found.ppo), ("DQN", &found.dqn), ("ours", &found.ours)];
    let mut table = Table::new(
        "Reinforcement learning and ours on the same learned simulators",
        &[
            "learner",
            "score on the true bench, cmH2O",
            "on the held-out simulator",
            "million ticks",
            "to near the best",
        ],
    );
    let figures = results.rl.map(|rl| [rl.ppo, rl.dqn, rl.ours]);
    for ((name, learner), figure) in learners.into_iter().zip(figures.into_iter().flatten()) {
        table.row(vec![
            Cell::text(name),
            Cell::number(learner.score, 3),
            Cell::number(learner.best(), 3),
            Cell::number(learner.samples as f64 * 1e-6, 1),
            figure.samples_to_near_best.map_or_else(none, |ticks| Cell::number(ticks as f64 * 1e-6, 1)),
        ]);
    }
    let curve = |(name, learner): (&str, &LearnerResult)| {
        let points = learner.curve.iter().map(|(samples, score)| (*samples as f64 * 1e-6, *score));
        Series::new(name, Style::Line, points.collect())
    };
    Section {
        heading: "Reinforcement learning".into(),
        text: "PPO and DQN see the simulators from outside, with the observations of our controller; ours differentiates them. A \
               tick is 1 ms of one simulated inspiration. The last column counts the ticks until a learner's score on the \
               held-out simulator was within 2 % of the best that any of the three reached."
            .into(),
        blocks: vec![
            Block::Table(table),
            Block::Plot(Plot {
                title: "Score against samples".into(),
                x_label: "million simulated ticks".into(),
                y_label: "mean error on the held-out simulator, cmH2O".into(),
                series: learners.into_iter().map(curve).collect(),
                log_y: true,
                ..Plot::default()
            }),
        ],
    }
}

fn ablations_section(found: &[Ablation]) -> Section {
    let mut table = Table::new(
        "One round of collect, fit and train on the lung in the middle of the list, cmH2O",
        &["varied", "variant", "score", "its PID", "open loop", "breaths"],
    );
    for ablation in found {
        table.row(vec![
            Cell::text(&ablation.group),
            Cell::text(&ablation.variant),
            Cell::number(ablation.score, 3),
            Cell::number(ablation.pid, 3),
            Cell::number(ablation.open_loop, 3),
            Cell::count(ablation.breaths),
        ]);
    }
    let of_group = |group: &str| {
        let own = found.iter().filter(|ablation| ablation.group == group);
        Series::new(group, Style::Points, own.map(|a| (a.open_loop, a.score)).collect())
    };
    Section {
        heading: "Ablations".into(),
        text: "Each variant differs from the lung's pipeline in one thing. Open-loop distance says how good a simulator is, the \
               score how good the controller trained through it."
            .into(),
        blocks: vec![
            Block::Table(table),
            Block::Plot(Plot {
                title: "Open-loop distance against closed-loop score".into(),
                x_label: "open-loop distance, cmH2O".into(),
                y_label: "score on the true bench, cmH2O".into(),
                series: ["exploration", "breaths", "rounds"].map(of_group).to_vec(),
                ..Plot::default()
            }),
        ],
    }
}

fn balloon_section(found: &BalloonFigures) -> Section {
    let mut table =
        Table::new("Mean of |p - PIP| over six waveforms, cmH2O", &["controller", "ours", "authors"]);
    let [grid_pi, on_plant, through_simulator] = AUTHORS;
    let rows = [
        ("full flow, then an exact hold", Some(found.floor), None),
        ("best PI of the authors' grid", Some(found.grid_pi), Some(grid_pi)),
        ("network trained on the plant itself", None, Some(on_plant)),
        ("network trained through a learned simulator", Some(found.learned), Some(through_simulator)),
    ];
    for (name, ours, authors) in rows {
        table.row(vec![Cell::text(name), known(ours), known(authors)]);
    }
    Section {
        heading: "The authors' own plant".into(),
        text: "Their balloon lung at 30 ms, every breath from 0 cmH2O. Ours has only seen recordings of it."
            .into(),
        blocks: vec![Block::Table(table)],
    }
}
