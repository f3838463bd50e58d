//! Plots of the recorded ticks: pressure and target above, the valve below, for both parts.

use shared::recorder::{Activity, TickEntry};

use super::{events, story, summary};
use crate::report::{Block, Plot, Report, Section, Series, Style};
use device::blackbox::{Blackbox, RecordedTicks};

/// A page with plots, summary and the whole log; `device` identifies the device.
pub fn report(blackbox: &Blackbox, device: &str) -> Report {
    let mut sections = vec![Section {
        heading: "What happened".to_owned(),
        text: story(blackbox),
        blocks: vec![Block::Table(summary(blackbox, device))],
    }];
    let parts = [
        ("Every control tick", &blackbox.fast),
        ("Every 20th tick, with the highest pressure of the 20", &blackbox.slow),
    ];
    for (heading, trace) in parts {
        sections.extend(section(heading, trace));
    }
    sections.push(Section {
        heading: "Events".to_owned(),
        blocks: vec![Block::Table(events(blackbox, usize::MAX))],
        ..Section::default()
    });
    Report { title: "Flight recorder".to_owned(), subtitle: device.to_owned(), sections, ..Report::default() }
}

/// Both plots of a trace; `None` for an empty one.
fn section(heading: &str, trace: &RecordedTicks) -> Option<Section> {
    let pressure = curves(trace, "pressure", Style::Line, |tick| Some(tick.pressure));
    let target = curves(trace, "target", Style::Dashed, |tick| tick.target);
    let valve = curves(trace, "inspiratory valve", Style::Step, |tick| Some(tick.u_in));
    let plots: Vec<Block> =
        [("Airway pressure", "cmH2O", [pressure, target].concat()), ("Inspiratory valve", "%", valve)]
            .into_iter()
            .filter(|(_, _, series)| !series.is_empty())
            .map(|(title, unit, mut series)| {
                series.extend(end(trace, &series));
                Block::Plot(Plot {
                    title: title.to_owned(),
                    x_label: "s before the end of the recording".to_owned(),
                    y_label: unit.to_owned(),
                    series,
                    size: Some((900, 300)),
                    ..Plot::default()
                })
            })
            .collect();
    (!plots.is_empty()).then(|| Section { heading: heading.to_owned(), text: String::new(), blocks: plots })
}

/// A curve, split at gaps and missing numbers; only the first piece has the name.
fn curves(
    trace: &RecordedTicks,
    name: &str,
    style: Style,
    value: impl Fn(&TickEntry) -> Option<f32>,
) -> Vec<Series> {
    let mut pieces: Vec<Vec<(f64, f64)>> = vec![Vec::new()];
    for (time, tick) in trace.timed() {
        let point = tick.and_then(&value).filter(|value| value.is_finite());
        match (point, pieces.last_mut()) {
            (Some(value), Some(piece)) => piece.push((time, value.into())),
            (None, Some(piece)) if !piece.is_empty() => pieces.push(Vec::new()),
            _ => {}
        }
    }
    let drawn = pieces.into_iter().filter(|piece| !piece.is_empty());
    let named = |(index, points): (usize, Vec<(f64, f64)>)| {
        let whole = Series::new(name, style, points);
        if index == 0 { whole } else { Series { name: String::new(), ..whole } }
    };
    drawn.enumerate().map(named).collect()
}

/// A vertical line where ventilation ended, as high as the other curves.
fn end(trace: &RecordedTicks, others: &[Series]) -> Option<Series> {
    let ticks: Vec<_> = trace.timed().filter_map(|(time, tick)| Some((time, tick?))).collect();
    let ended = ticks.windows(2).rev().find(|pair| {
        pair[0].1.activity == Activity::Ventilating && pair[1].1.activity != Activity::Ventilating
    })?;
    let values = || others.iter().flat_map(|series| &series.points).map(|point| point.1);
    let (lowest, highest) = (values().reduce(f64::min)?, values().reduce(f64::max)?);
    let (time, after) = ended[1];
    let name = if after.activity == Activity::Fault { "fault" } else { "stop" };
    Some(Series::new(name, Style::Dashed, vec![(time, lowest), (time, highest)]))
}
