//! The result of a measurement for a page: the rows, figures and words that `trainer margins` shows.

use shared::explore::sines::AMPLITUDE_MAX;
use shared::settings::Settings;
use show::report::{Plot, Role, Series, Style};
use tuning::measurement::{FREQUENCIES, Measured, PHASES, Plan, WARM_UP};
use tuning::{figures, words};
use verdict::Cause;

use crate::stream::{Chart, Choice, Curve, LoopAdvice, Margin, Margins, MeasureInfo, Sines};

/// Lowest amplitude, percent: a smaller one is lost in the noise.
const AMPLITUDE_MIN: f32 = 0.1;
/// Most points of a curve: more are not seen on a page.
const POINTS: usize = 1000;

/// What a measurement may ask for.
pub fn choices() -> MeasureInfo {
    let Plan { settings, amplitude, frequencies, phases, .. } = Plan::default();
    let count = |range: std::ops::RangeInclusive<u8>, default: u8| Choice {
        min: (*range.start()).into(),
        max: (*range.end()).into(),
        default: default.into(),
    };
    MeasureInfo {
        amplitude: Choice { min: AMPLITUDE_MIN, max: AMPLITUDE_MAX, default: amplitude },
        frequencies: count(FREQUENCIES, frequencies),
        breaths: count(PHASES, phases),
        warm_up: WARM_UP,
        ramp_s: settings.rise_time,
    }
}

/// What is measured for a page, of a device with these settings.
///
/// # Errors
/// Which number is out of its bounds.
pub fn plan(sines: Sines, before: &Settings) -> Result<Plan, String> {
    let Sines { amplitude, frequencies, breaths } = sines;
    let choices = choices();
    for (name, value, Choice { min, max, .. }) in [
        ("amplitude", amplitude, choices.amplitude),
        ("number of frequencies", frequencies.into(), choices.frequencies),
        ("number of breaths at each frequency", breaths.into(), choices.breaths),
    ] {
        // In this form a NaN fails too.
        if !(value >= min && value <= max) {
            return Err(format!("the {name} is {value}, allowed are {min} to {max}"));
        }
    }
    Ok(Plan { settings: Plan::ramp(before), amplitude, frequencies, phases: breaths, ..Plan::default() })
}

/// The result for a page.
pub fn margins(measured: &Measured, controller: String, time_ms: u64) -> Margins {
    let mut remarks = words::remarks(measured);
    remarks.extend(words::unstated(measured));
    let advice = measured.advice.iter();
    Margins {
        time_ms,
        refused: None,
        controller,
        amplitude: measured.plan.amplitude,
        margins: words::rows(&measured.margins).into_iter().map(margin).collect(),
        remarks,
        advice: advice
            .map(|advice| LoopAdvice { cause: cause(advice.cause), text: advice.text.clone() })
            .collect(),
        charts: charts(measured),
    }
}

fn margin(row: words::Row) -> Margin {
    let words::Row { name, unit, value, unstated, interval, decimals, robust, keeps } = row;
    let (low, high) = interval.unzip();
    Margin { name, unit, value, unstated, low, high: high.flatten(), decimals, robust, keeps }
}

fn cause(cause: Cause) -> &'static str {
    match cause {
        Cause::Gain => "gain",
        Cause::Delay => "delay",
        Cause::Play => "play",
        Cause::Leak => "leak",
    }
}

fn charts(measured: &Measured) -> Vec<Chart> {
    let counting = measured.estimates.iter().filter(|estimate| estimate.counts());
    let response = counting.map(|estimate| estimate.response).collect();
    let [size, angle] = figures::bode(&measured.estimates);
    let [pressure, command] = figures::breath(&measured.breath);
    let over_frequency = |plot| Chart { log_x: true, ..chart(plot) };
    vec![
        chart(figures::nyquist(&[("loop".to_owned(), response)])),
        over_frequency(size),
        over_frequency(angle),
        chart(pressure),
        chart(command),
    ]
}

fn chart(plot: Plot) -> Chart {
    let Plot { title, x_label, y_label, series, x_range, y_range, log_y, .. } = plot;
    let square = x_range.filter(|range| Some(*range) == y_range).map(|(low, high)| [low, high]);
    let curves = series.iter().map(curve).collect();
    Chart { title, x_label, y_label, log_x: false, log_y, square, curves }
}

fn curve(series: &Series) -> Curve {
    let every = series.points.len().div_ceil(POINTS).max(1);
    let (x, y) = series.points.iter().step_by(every).copied().unzip();
    let role = match series.role {
        Some(Role::Target) => "target",
        Some(Role::Pressure) => "pressure",
        Some(Role::InspiratoryValve) => "valve",
        Some(Role::Limit) => "limit",
        _ => "",
    };
    Curve { name: series.name.clone(), role, dashed: series.style == Style::Dashed, x, y }
}
