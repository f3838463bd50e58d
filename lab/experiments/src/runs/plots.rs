//! Plots of runs: a figure by run or against an option, and curves of several runs over each other.

use std::collections::BTreeSet;

use super::{Run, RunsError, figure_names, listed};
use campaign::record::CURVE;
use show::report::{Plot, Series, Style};

/// The curves that are plotted if no figure is named.
const TRAINING: &str = "train_curve.validation";
/// Most characters of run names that fit below a plot's bars.
const NAMES_FIT: usize = 90;

/// A plot for each figure: bars by run, or points against the number `x`, an option or a figure. A curve, or all
/// curves of a list such as `train_curve`, is plotted for all runs. Without names, the training curves are.
///
/// # Errors
/// A name that no run has, or nothing to plot.
pub fn plots(runs: &[Run], names: &[String], x: Option<&str>) -> Result<Vec<Plot>, RunsError> {
    let curves: BTreeSet<&str> =
        runs.iter().flat_map(|run| run.record.results.curves.keys()).map(String::as_str).collect();
    if names.is_empty() {
        let training: Vec<_> = curves.iter().filter(|curve| curve.ends_with(TRAINING)).collect();
        if training.is_empty() {
            return Err(RunsError::NothingToPlot { known: listed(figure_names(runs).into_iter()) });
        }
        return Ok(training.into_iter().map(|curve| overlaid(runs, curve)).collect());
    }
    let mut plots = Vec::new();
    for name in names {
        super::check_figure(runs, name)?;
        let chosen = curves.iter().filter(|curve| is_of(curve, name));
        plots.extend(chosen.map(|curve| overlaid(runs, curve)));
        if runs.iter().any(|run| run.record.results.figures.contains_key(name)) {
            plots.push(match x {
                None => by_run(runs, name),
                Some(x) => against(runs, name, x)?,
            });
        }
    }
    Ok(plots)
}

/// Whether a name stands for a curve: the name itself, or that of the list with the curve; either may lack its first parts.
pub(super) fn is_of(curve: &str, name: &str) -> bool {
    let ends =
        |path: &str| path.strip_suffix(name).is_some_and(|rest| rest.is_empty() || rest.ends_with('.'));
    let list = curve.rsplit_once('.').map_or("", |(list, _)| list);
    let lists = name.rsplit('.').take(2).any(|part| part.ends_with(CURVE));
    curve == name || lists && (ends(curve) || ends(list))
}

/// The curves of this name.
fn overlaid(runs: &[Run], curve: &str) -> Plot {
    let series = runs.iter().filter_map(|run| {
        let points = run.record.results.curves.get(curve)?.points();
        let points = points.filter(|(_, value)| value.is_finite()).map(|(step, value)| (step as f64, value));
        Some(Series::new(run.name.clone(), Style::Line, points.collect()))
    });
    Plot::new(curve, "step", "", series.collect())
}

/// A bar for each run.
fn by_run(runs: &[Run], figure: &str) -> Plot {
    let values = runs.iter().enumerate().filter_map(|(n, run)| Some((n as f64 + 1.0, run.figure(figure)?)));
    let points: Vec<_> = values.collect();
    let highest = points.iter().map(|point| point.1).fold(0.0, f64::max);
    let lowest = points.iter().map(|point| point.1).fold(0.0, f64::min);
    let names: Vec<String> = runs.iter().map(|run| run.name.clone()).collect();
    let fit = names.iter().map(String::len).max().unwrap_or(0) * runs.len() <= NAMES_FIT;
    Plot {
        // The length of a bar is its value only if the axis begins at zero.
        y_range: (highest > lowest).then_some((1.05 * lowest, 1.05 * highest)),
        x_range: Some((0.5, runs.len() as f64 + 0.5)),
        x_names: if fit { names } else { (1..=runs.len()).map(|n| n.to_string()).collect() },
        ..Plot::new(
            figure,
            if fit { "run" } else { "run, by its number in the list" },
            "",
            vec![Series::new("", Style::Bars, points)],
        )
    }
}

/// A point for each run that has both numbers.
fn against(runs: &[Run], figure: &str, x: &str) -> Result<Plot, RunsError> {
    let points: Vec<_> = runs.iter().filter_map(|run| Some((run.number(x)?, run.figure(figure)?))).collect();
    if points.is_empty() {
        return Err(RunsError::NoNumber { figure: figure.to_owned(), x: x.to_owned() });
    }
    let low = points.iter().map(|point| point.0).fold(f64::MAX, f64::min);
    let high = points.iter().map(|point| point.0).fold(f64::MIN, f64::max);
    let margin = if high > low { 0.05 * (high - low) } else { 0.5 };
    let range = Some((low - margin, high + margin));
    Ok(Plot { x_range: range, ..Plot::new(figure, x, figure, vec![Series::new("", Style::Points, points)]) })
}
