//! Maps of a value over two lists, as SVG: one coloured cell per pair; the lowest one is framed.

use super::ReportError;
use super::svg::{Svg, rectangle, text};

/// A map. The colour depends on the logarithm of the value, from the lowest value to `SPAN` times it; all higher values
/// look alike.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct HeatMap {
    /// Title above the map.
    pub title: String,
    /// Quantity from left to right, with the unit.
    pub x_label: String,
    /// Quantity from bottom to top, with the unit.
    pub y_label: String,
    /// Values from left to right, evenly spaced whatever their distance.
    pub x: Vec<f64>,
    /// Values from bottom to top.
    pub y: Vec<f64>,
    /// Names in place of the values from left to right; empty for numbers.
    pub x_names: Vec<String>,
    /// Names in place of the values from bottom to top; empty for numbers.
    pub y_names: Vec<String>,
    /// A row for each `y`, a column for each `x`; `None` leaves a cell blank. Lower is better.
    pub values: Vec<Vec<Option<f64>>>,
}

/// Highest value with a distinct colour, as a multiple of the lowest.
const SPAN: f64 = 4.0;
/// Dark for low, pale for high: samples of Matplotlib's viridis (CC0), whose brightness is monotonic.
const COLORS: [[f64; 3]; 5] =
    [[68.0, 1.0, 84.0], [59.0, 82.0, 139.0], [33.0, 145.0, 140.0], [94.0, 201.0, 98.0], [253.0, 231.0, 37.0]];

const WIDTH: f64 = 800.0;
const CELL_HEIGHT: f64 = 16.0;
const LEFT: f64 = 80.0;
/// The same beside rows with names.
const LEFT_OF_NAMES: f64 = 130.0;
const RIGHT: f64 = 110.0;
const TOP: f64 = 36.0;
const BOTTOM: f64 = 56.0;
/// Attributes of texts that begin, have their middle, or end at their place.
const START: &str = "font-size=\"12\"";
const MIDDLE: &str = "font-size=\"12\" text-anchor=\"middle\"";
const END: &str = "font-size=\"12\" text-anchor=\"end\"";
/// Largest number of marks on an axis.
const MARKS: usize = 12;
/// Number of colour samples in the legend.
const LEGEND: usize = 24;

impl HeatMap {
    /// The map as an SVG document.
    ///
    /// # Errors
    /// If there is no value, or if a value is not a positive number.
    pub fn to_svg(&self) -> Result<String, ReportError> {
        Ok(self.drawing()?.to_document())
    }

    pub(super) fn drawing(&self) -> Result<Svg, ReportError> {
        let lowest = self.lowest()?;
        let (columns, rows) = (self.x.len(), self.y.len());
        let cell = ((WIDTH - self.left() - RIGHT) / columns as f64, CELL_HEIGHT);
        let height = TOP + BOTTOM + CELL_HEIGHT * rows as f64;
        let mut elements = text((self.left(), 20.0), "font-size=\"12\" font-weight=\"bold\"", &self.title);
        for (row, values) in self.values.iter().enumerate().take(rows) {
            for (column, value) in values.iter().enumerate().take(columns) {
                if let Some(value) = value {
                    elements += &self.cell((column, row), *value, lowest, cell);
                }
            }
        }
        elements += &self.axes(cell, height);
        elements += &legend(lowest, height - TOP - BOTTOM);
        Ok(Svg { size: (WIDTH, height), elements })
    }

    fn lowest(&self) -> Result<f64, ReportError> {
        let values = || self.values.iter().flatten().copied().flatten();
        if let Some(value) = values().find(|value| !(*value > 0.0 && value.is_finite())) {
            return Err(ReportError::NotPositive { plot: self.title.clone(), value });
        }
        values().reduce(f64::min).ok_or_else(|| ReportError::Empty(self.title.clone()))
    }

    /// Upper left corner of a cell.
    fn corner(&self, (column, row): (usize, usize), (width, height): (f64, f64)) -> (f64, f64) {
        (self.left() + column as f64 * width, TOP + (self.y.len() - 1 - row) as f64 * height)
    }

    fn cell(&self, place: (usize, usize), value: f64, lowest: f64, (width, height): (f64, f64)) -> String {
        let (x, y) = self.corner(place, (width, height));
        let frame = if value <= lowest { " stroke=\"#ffffff\" stroke-width=\"3\"" } else { "" };
        let label = format!("{} / {}: {value:.3}", self.x_name(place.0), self.y_name(place.1));
        format!(
            "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{width:.1}\" height=\"{height:.1}\" fill=\"{}\"{frame}>\
             <title>{label}</title></rect>\n",
            color(share(value, lowest))
        )
    }

    /// Left end of the cells.
    fn left(&self) -> f64 {
        if self.y_names.is_empty() { LEFT } else { LEFT_OF_NAMES }
    }

    fn x_name(&self, column: usize) -> String {
        self.x_names.get(column).cloned().unwrap_or_else(|| number(self.x[column]))
    }

    fn y_name(&self, row: usize) -> String {
        self.y_names.get(row).cloned().unwrap_or_else(|| number(self.y[row]))
    }

    fn axes(&self, cell: (f64, f64), height: f64) -> String {
        let mut svg = String::new();
        let step = |names: &[String], marks: usize| {
            if names.is_empty() { marks.div_ceil(MARKS).max(1) } else { 1 }
        };
        for column in (0..self.x.len()).step_by(step(&self.x_names, self.x.len())) {
            let x = self.corner((column, 0), cell).0 + 0.5 * cell.0;
            svg += &text((x, height - BOTTOM + 16.0), MIDDLE, &self.x_name(column));
        }
        for row in (0..self.y.len()).step_by(step(&self.y_names, self.y.len())) {
            let y = self.corner((0, row), cell).1 + 0.5 * cell.1 + 4.0;
            svg += &text((self.left() - 6.0, y), END, &self.y_name(row));
        }
        let middle = 0.5 * (self.left() + WIDTH - RIGHT);
        svg += &text((middle, height - 14.0), MIDDLE, &self.x_label);
        let (x, y) = (18.0, 0.5 * (TOP + height - BOTTOM));
        svg + &text((x, y), &format!("{MIDDLE} transform=\"rotate(-90 {x} {y:.1})\""), &self.y_label)
    }
}

/// The colour scale beside the map.
fn legend(lowest: f64, height: f64) -> String {
    let (x, sample) = (WIDTH - RIGHT + 24.0, height / LEGEND as f64);
    let mut svg = String::new();
    for n in 0..LEGEND {
        let y = TOP + n as f64 * sample;
        let color = color(1.0 - n as f64 / (LEGEND - 1) as f64);
        svg += &rectangle((x, y), (x + 16.0, y + sample + 0.5), &color);
    }
    svg += &text((x + 22.0, TOP + 10.0), START, &format!("≥ {:.2}", lowest * SPAN));
    svg + &text((x + 22.0, TOP + height), START, &format!("{lowest:.2}"))
}

/// A number with three significant digits.
fn number(value: f64) -> String {
    if value == 0.0 {
        return "0".to_owned();
    }
    let decimals = (2 - value.abs().log10().floor() as i32).max(0) as usize;
    let text = format!("{value:.decimals$}");
    if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
}

/// Position of a value between the lowest value and the highest with a distinct colour, 0 to 1.
fn share(value: f64, lowest: f64) -> f64 {
    ((value / lowest).ln() / SPAN.ln()).clamp(0.0, 1.0)
}

fn color(share: f64) -> String {
    let place = share * (COLORS.len() - 1) as f64;
    let low = (place as usize).min(COLORS.len() - 2);
    let mix = |channel: usize| {
        let (from, to) = (COLORS[low][channel], COLORS[low + 1][channel]);
        (from + (to - from) * (place - low as f64)).round() as u8
    };
    format!("#{:02x}{:02x}{:02x}", mix(0), mix(1), mix(2))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map() -> HeatMap {
        HeatMap {
            title: "a < b".into(),
            x: vec![0.0, 0.5, 250.0],
            y: vec![1.0, 2.0],
            values: vec![vec![Some(2.0), Some(1.0), None], vec![Some(8.0), Some(100.0), Some(1.5)]],
            ..HeatMap::default()
        }
    }

    #[test]
    fn every_known_value_has_a_cell_and_the_lowest_is_framed() {
        let svg = map().to_svg().unwrap();
        assert_eq!(svg.matches("<title>").count(), 5);
        assert_eq!(svg.matches("stroke-width").count(), 1);
        assert!(svg.contains("<title>0.5 / 1: 1.000</title>") && svg.contains("a &lt; b"), "{svg}");
    }

    #[test]
    fn low_is_dark_and_everything_beyond_the_span_is_alike() {
        assert_eq!(color(share(1.0, 1.0)), "#440154");
        assert_eq!(color(share(SPAN, 1.0)), color(share(100.0, 1.0)));
        assert_ne!(color(share(1.1, 1.0)), color(share(1.2, 1.0)));
    }

    #[test]
    fn a_map_without_usable_values_is_refused() {
        let with = |value| HeatMap { values: vec![vec![value]], ..map() }.to_svg();
        assert!(matches!(with(None), Err(ReportError::Empty { .. })));
        assert!(matches!(with(Some(f64::NAN)), Err(ReportError::NotPositive { .. })));
        assert!(matches!(with(Some(0.0)), Err(ReportError::NotPositive { .. })));
    }

    #[test]
    fn marks_have_three_digits() {
        assert_eq!([0.0, 0.05, 1.234, 12.0, 259.99].map(number), ["0", "0.05", "1.23", "12", "260"]);
    }
}
