//! The margins of a device, as measured on a test lung.

use serde::{Deserialize, Serialize};

/// What a measurement may ask for.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MeasureInfo {
    /// Amplitude of the sines, percent.
    pub amplitude: Choice,
    /// Number of frequencies.
    pub frequencies: Choice,
    /// Breaths at each frequency.
    pub breaths: Choice,
    /// Breaths before the first sine.
    pub warm_up: u32,
    /// What the settings become while it runs: the length of the ramp, s, which is that of the inspiration. Patient triggers are off.
    pub ramp_s: f32,
}

/// The sines that a page asks for.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Sines {
    /// Amplitude, percent.
    pub amplitude: f32,
    /// Number of frequencies.
    pub frequencies: u8,
    /// Breaths at each frequency.
    pub breaths: u8,
}

/// Bounds and default of a number.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Choice {
    /// The lowest.
    pub min: f32,
    /// The highest.
    pub max: f32,
    /// The default.
    pub default: f32,
}

/// A measurement that runs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct MeasuringInfo {
    /// Breaths so far.
    pub breath: u32,
    /// Breaths of the whole measurement.
    pub breaths: u32,
    /// The page that has started it, in words.
    pub by: String,
}

/// The result of a measurement.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Margins {
    /// When it ended, ms since 1970.
    pub time_ms: u64,
    /// Why there is nothing else; null if there is.
    pub refused: Option<String>,
    /// The controller that ran, in words.
    pub controller: String,
    /// Amplitude of the sines, percent.
    pub amplitude: f32,
    /// The margins.
    pub margins: Vec<Margin>,
    /// What was measured beside them, and whether the settings are those of before again.
    pub remarks: Vec<String>,
    /// What limits the loop.
    pub advice: Vec<LoopAdvice>,
    /// Nyquist and Bode plots, and a breath without a sine.
    pub charts: Vec<Chart>,
}

/// A margin.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Margin {
    /// Its name.
    pub name: &'static str,
    /// Its unit; empty for a ratio.
    pub unit: &'static str,
    /// The margin; null if it is not stated.
    pub value: Option<f64>,
    /// Why it is not stated.
    pub unstated: Option<&'static str>,
    /// Lower end of its interval of 95 %, also if it is not stated.
    pub low: Option<f64>,
    /// Upper end; null beyond the measured frequencies.
    pub high: Option<f64>,
    /// Digits after the point.
    pub decimals: usize,
    /// What a robust loop keeps.
    pub robust: String,
    /// Whether this one keeps it; null if it is not stated.
    pub keeps: Option<bool>,
}

/// Advice on a loop.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LoopAdvice {
    /// What limits it, in a word.
    pub cause: &'static str,
    /// The advice with its figure.
    pub text: String,
}

/// A figure.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Chart {
    /// Its title.
    pub title: String,
    /// Labels of the axes, with the units.
    pub x_label: String,
    /// Of the vertical one.
    pub y_label: String,
    /// Whether the horizontal axis is that of a frequency, and logarithmic.
    pub log_x: bool,
    /// Whether the vertical axis is logarithmic.
    pub log_y: bool,
    /// Ends of both axes if they are equal, so that circles are round; null fits the points.
    pub square: Option<[f64; 2]>,
    /// Its curves; the last one is on top.
    pub curves: Vec<Curve>,
}

/// A curve.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Curve {
    /// Its name.
    pub name: String,
    /// What it stands for: target, pressure, valve, limit; empty for other things.
    pub role: &'static str,
    /// Whether its line is dashed.
    pub dashed: bool,
    /// Points in the order in which they are joined.
    pub x: Vec<f64>,
    /// As many.
    pub y: Vec<f64>,
}
