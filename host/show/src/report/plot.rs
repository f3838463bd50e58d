//! Plots with two axes: their curves, the checks of their points, and the ends of their axes.

use super::curve::{Limits, Point};
use super::{ReportError, Role};

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Style {
    /// Straight lines between the points.
    #[default]
    Line,
    /// Dashed line, for targets; in their colour unless another role is given.
    Dashed,
    /// Each value holds until the next point.
    Step,
    /// Dots.
    Points,
    /// Bars from zero upwards; those of several series are side by side around each whole number.
    Bars,
}

/// One curve.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Series {
    /// Name in the legend; an empty name is omitted.
    pub name: String,
    /// Points in the order in which they are joined.
    pub points: Vec<(f64, f64)>,
    /// How it is drawn.
    pub style: Style,
    /// What it stands for, which decides its colour; `None` uses the next of the other colours.
    pub role: Option<Role>,
}

impl Series {
    /// A series, whose name tells its role.
    pub fn new(name: impl Into<String>, style: Style, points: Vec<(f64, f64)>) -> Self {
        let name = name.into();
        Self { role: Role::named(&name), name, points, style }
    }

    /// The difference of this series to another one with the same times.
    #[must_use]
    pub fn minus(&self, other: &Self) -> Self {
        let both = self.points.iter().zip(&other.points);
        let points = both.map(|((time, value), (_, other))| (*time, value - other)).collect();
        Self { points, ..self.clone() }
    }
}

/// A plot with two axes.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Plot {
    /// Title above the plot.
    pub title: String,
    /// Label of the horizontal axis, with the unit.
    pub x_label: String,
    /// Label of the vertical axis, with the unit.
    pub y_label: String,
    /// Curves; the last is drawn on top.
    pub series: Vec<Series>,
    /// Ends of the vertical axis; `None` fits the points.
    pub y_range: Option<(f64, f64)>,
    /// Labels of 1, 2 and so on along the horizontal axis; empty for numbers.
    pub x_names: Vec<String>,
    /// Ends of the horizontal axis; `None` fits the points.
    pub x_range: Option<(f64, f64)>,
    /// Logarithmic vertical axis.
    pub log_y: bool,
    /// Width and height in pixels; `None` is 800 x 400.
    pub size: Option<(u32, u32)>,
}

/// Default width and height of a plot, pixels.
const SIZE: (u32, u32) = (800, 400);

impl Plot {
    /// A plot with axes that fit its points.
    pub fn new(title: impl Into<String>, x_label: &str, y_label: &str, series: Vec<Series>) -> Self {
        let (x_label, y_label) = (x_label.into(), y_label.into());
        Self { title: title.into(), x_label, y_label, series, ..Self::default() }
    }

    /// A plot of curves over time in seconds.
    pub fn over_time(title: impl Into<String>, y_label: &str, series: Vec<Series>) -> Self {
        Self::new(title, "time, s", y_label, series)
    }

    pub(super) fn size(&self) -> (u32, u32) {
        self.size.unwrap_or(SIZE)
    }

    /// Ends of both axes.
    ///
    /// # Errors
    /// If there is no point, a point is not finite, a logarithmic value is not positive, or a range is not valid.
    pub(super) fn ranges(&self) -> Result<(Limits, Limits), ReportError> {
        self.check()?;
        let x = self.limits(self.x_range, |point| point.0, 0.0, false)?;
        let y = self.limits(self.y_range, |point| point.1, 0.05, self.log_y)?;
        Ok((x, y))
    }

    fn check(&self) -> Result<(), ReportError> {
        for series in &self.series {
            let bad = series.points.iter().position(|point| !(point.0.is_finite() && point.1.is_finite()));
            if let Some(index) = bad {
                let (plot, series) = (self.title.clone(), series.name.clone());
                return Err(ReportError::NotFinite { plot, series, index });
            }
        }
        if self.series.iter().all(|series| series.points.is_empty()) {
            return Err(ReportError::Empty(self.title.clone()));
        }
        let mut values = self.series.iter().flat_map(|series| &series.points).map(|point| point.1);
        match values.find(|&value| self.log_y && value <= 0.0) {
            Some(value) => Err(ReportError::NotPositive { plot: self.title.clone(), value }),
            None => Ok(()),
        }
    }

    /// Ends of an axis: as given, or around the points with a margin as a share of their range.
    fn limits(
        &self,
        given: Option<Limits>,
        coordinate: impl Fn(&Point) -> f64,
        margin: f64,
        log: bool,
    ) -> Result<Limits, ReportError> {
        if let Some((low, high)) = given {
            let plot = self.title.clone();
            if !(low < high && low.is_finite() && high.is_finite()) {
                return Err(ReportError::BadRange { plot, low, high });
            }
            if log && low <= 0.0 {
                return Err(ReportError::NotPositive { plot, value: low });
            }
            return Ok((low, high));
        }
        let values = self.series.iter().flat_map(|series| &series.points).map(coordinate);
        let (low, high) = values.fold((f64::MAX, f64::MIN), |(low, high), v| (low.min(v), high.max(v)));
        Ok(if log {
            let factor = (high / low).powf(margin).max(1.2);
            (low / factor, high * factor)
        } else if high > low {
            (low - margin * (high - low), high + margin * (high - low))
        } else {
            let around = (0.05 * low.abs()).max(0.5);
            (low - around, high + around)
        })
    }
}
