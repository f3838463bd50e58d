//! Line plots as SVG, using only plotters' SVG backend: no font library, and the same bytes every time.

use plotters::coord::Shift;
use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;
use plotters::style::text_anchor::{HPos, Pos, VPos};

use super::curve::{self, Limits, Point};
use super::svg::{self, Svg};
use super::{ReportError, ticks};

/// How a series is drawn.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Style {
    /// Straight lines between the points.
    #[default]
    Line,
    /// Dashed line, for targets; dark unless a colour is given.
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
    /// Red, green, blue; `None` uses the next colour of the palette.
    pub color: Option<(u8, u8, u8)>,
}

impl Series {
    /// A series in a palette colour.
    pub fn new(name: impl Into<String>, style: Style, points: Vec<(f64, f64)>) -> Self {
        Self { name: name.into(), points, style, color: None }
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

/// Okabe and Ito's colours, distinguishable for colour-blind readers; without yellow, which is too pale on white.
const PALETTE: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(86, 180, 233),
    RGBColor(230, 159, 0),
];
/// Default width and height of a plot, pixels.
const SIZE: (u32, u32) = (800, 400);
const INK: RGBColor = RGBColor(34, 34, 34);
const FAINT: RGBColor = RGBColor(228, 228, 228);

/// Longer series are reduced to this number of points.
const MAX_POINTS: usize = 1_500;
/// Scale of the canvas: the drawing library rounds to whole pixels, which does not show on a canvas this much larger.
const FINE: u32 = 4;
const TITLE_SIZE: u32 = 17;
const TEXT_SIZE: u32 = 14;
const LINE_HEIGHT: u32 = 20;
const MARGIN: u32 = 8;
/// Share of the distance between whole numbers that the bars of a number fill.
const BARS_SHARE: f64 = 0.8;
/// Length of a legend entry's line sample, pixels.
const SAMPLE: u32 = 26;
/// Mean width of a character as a share of the text size.
const CHARACTER: f64 = 0.52;

type Area<'a> = DrawingArea<SVGBackend<'a>, Shift>;
/// A panel with its axes.
type Chart<'a, 'b, Y> = ChartContext<'a, SVGBackend<'b>, Cartesian2d<RangedCoordf64, Y>>;
/// Failure of the drawing library as text; the caller adds the plot's title.
type Drawn = Result<(), String>;
/// Height in pixels, or why drawing failed.
type Height = Result<u32, String>;

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

    /// The plot as an SVG document.
    ///
    /// # Errors
    /// If there is no point, a point is not finite, a logarithmic value is not positive, or a range is not valid.
    pub fn to_svg(&self) -> Result<String, ReportError> {
        Ok(self.drawing()?.to_document())
    }

    /// Several plots below each other, as one SVG document.
    ///
    /// # Errors
    /// See [`Self::to_svg`].
    pub fn stacked(plots: &[Self]) -> Result<String, ReportError> {
        let drawings = plots.iter().map(Self::drawing).collect::<Result<Vec<_>, _>>()?;
        Ok(Svg::stacked(&drawings).to_document())
    }

    pub(super) fn size(&self) -> (u32, u32) {
        self.size.unwrap_or(SIZE)
    }

    pub(super) fn drawing(&self) -> Result<Svg, ReportError> {
        self.check()?;
        let x = self.limits(self.x_range, |point| point.0, 0.0, false)?;
        let y = self.limits(self.y_range, |point| point.1, 0.05, self.log_y)?;
        let mut document = String::new();
        let failed = |detail: String| ReportError::Draw { plot: self.title.clone(), detail };
        self.draw(&mut document, x, y).map_err(failed)?;
        let elements = svg::elements(&document)
            .ok_or_else(|| failed("the drawing library returned no SVG document".to_owned()))?;
        let (width, height) = (f64::from(self.size().0), f64::from(self.size().1));
        let fine = f64::from(FINE);
        Ok(Svg {
            size: (width, height),
            canvas: (fine * width, fine * height),
            elements: elements.to_owned(),
        })
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

    fn draw(&self, svg: &mut String, x: Limits, y: Limits) -> Drawn {
        let canvas = (self.size().0 * FINE, self.size().1 * FINE);
        let root = SVGBackend::with_string(svg, canvas).into_drawing_area();
        root.fill(&WHITE).map_err(text)?;
        let header = self.draw_header(&root)?;
        let (_, panel) = root.split_vertically(header * FINE);
        if self.log_y {
            let marks = ticks::logarithmic(y, self.y_marks());
            self.draw_panel(&panel, x, (y.0..y.1).log_scale().with_key_points(marks), y)?;
        } else {
            self.draw_panel(&panel, x, y.0..y.1, y)?;
        }
        root.present().map_err(text)
    }

    /// Draws title and legend; returns their height in pixels.
    fn draw_header(&self, root: &Area) -> Height {
        let mut top = MARGIN;
        if !self.title.is_empty() {
            put_text(root, &self.title, (MARGIN, top + LINE_HEIGHT / 2), TITLE_SIZE, FontStyle::Bold)?;
            top += LINE_HEIGHT + 4;
        }
        let mut left = MARGIN;
        let mut any = false;
        for (series, color) in
            self.series.iter().zip(self.colors()).filter(|(series, _)| !series.name.is_empty())
        {
            let width = SAMPLE + 6 + text_width(&series.name) + 16;
            if any && left + width > self.size().0 {
                (left, top) = (MARGIN, top + LINE_HEIGHT);
            }
            let middle = top + LINE_HEIGHT / 2;
            draw_sample(root, series.style, color, left, middle)?;
            put_text(root, &series.name, (left + SAMPLE + 6, middle), TEXT_SIZE, FontStyle::Normal)?;
            left += width;
            any = true;
        }
        Ok(if any { top + LINE_HEIGHT } else { top })
    }

    /// Colour of each series; only those without a given colour use the palette.
    fn colors(&self) -> Vec<RGBColor> {
        let mut taken = 0;
        let mut color = |series: &Series| match (series.color, series.style) {
            (Some((red, green, blue)), _) => RGBColor(red, green, blue),
            (None, Style::Dashed) => INK,
            (None, _) => {
                taken += 1;
                palette(taken - 1)
            }
        };
        self.series.iter().map(&mut color).collect()
    }

    /// Number of marks that fit on the vertical axis.
    fn y_marks(&self) -> usize {
        (self.size().1 / 45).max(3) as usize
    }

    /// Number of marks that fit on the horizontal axis.
    fn x_marks(&self) -> usize {
        match self.x_names.len() {
            0 => (self.size().0 / 75).max(3) as usize,
            names => names + 1,
        }
    }

    fn x_mark(&self, value: f64) -> String {
        if self.x_names.is_empty() {
            return number(value);
        }
        let name = self.x_names.get((value as usize).wrapping_sub(1)).filter(|_| value.fract() == 0.0);
        name.cloned().unwrap_or_default()
    }

    /// Opposite corners of a series' bars, beside those of other series with bars.
    fn bars(&self, series: &Series, floor: f64) -> impl Iterator<Item = [Point; 2]> {
        let beside: Vec<&Series> = self.series.iter().filter(|other| other.style == Style::Bars).collect();
        let place = beside.iter().position(|other| std::ptr::eq(*other, series)).unwrap_or(0);
        let width = BARS_SHARE / beside.len().max(1) as f64;
        let left = place as f64 * width - BARS_SHARE / 2.0;
        series.points.iter().map(move |(x, y)| [(x + left, floor), (x + left + width, *y)])
    }

    fn draw_panel<Y>(&self, panel: &Area, x: Limits, y_coord: Y, y: Limits) -> Drawn
    where
        Y: AsRangedCoord<Value = f64>,
        Y::CoordDescType: Ranged<ValueType = f64> + ValueFormatter<f64>,
    {
        let mut chart = ChartBuilder::on(panel)
            .margin(MARGIN * FINE)
            .margin_right(3 * MARGIN * FINE)
            .x_label_area_size(44 * FINE)
            .y_label_area_size(62 * FINE)
            .build_cartesian_2d(x.0..x.1, y_coord)
            .map_err(text)?;
        chart
            .configure_mesh()
            .x_desc(self.x_label.as_str())
            .y_desc(self.y_label.as_str())
            .x_labels(self.x_marks())
            .y_labels(self.y_marks())
            .x_label_formatter(&|value| self.x_mark(*value))
            .y_label_formatter(&|value| number(*value))
            .label_style(font(TEXT_SIZE, FontStyle::Normal))
            .axis_desc_style(font(TEXT_SIZE, FontStyle::Normal))
            .bold_line_style(FAINT.stroke_width(FINE))
            .light_line_style(TRANSPARENT)
            .axis_style(INK.stroke_width(FINE))
            .set_all_tick_mark_size(4 * FINE)
            .draw()
            .map_err(text)?;
        for (series, color) in self.series.iter().zip(self.colors()) {
            self.draw_series(&mut chart, series, color, (x, y))?;
        }
        Ok(())
    }

    fn draw_series<Y: Ranged<ValueType = f64>>(
        &self,
        chart: &mut Chart<'_, '_, Y>,
        series: &Series,
        color: RGBColor,
        (x, y): (Limits, Limits),
    ) -> Drawn {
        if series.style == Style::Bars {
            let bars = self.bars(series, y.0.max(0.0));
            chart.draw_series(bars.map(|corners| Rectangle::new(corners, color.filled()))).map_err(text)?;
            return Ok(());
        }
        let thin = curve::decimate(&series.points, MAX_POINTS);
        if series.style == Style::Points {
            let shown = thin.into_iter().filter(|&point| curve::inside(point, x, y));
            chart
                .draw_series(shown.map(|point| Circle::new(point, 3 * FINE, color.filled())))
                .map_err(text)?;
            return Ok(());
        }
        let joined = if series.style == Style::Step { curve::steps(&thin) } else { thin };
        curve::clip(&joined, x, y)
            .into_iter()
            .try_for_each(|part| draw_line(chart, part, series.style, color))
    }
}

fn draw_line<Y: Ranged<ValueType = f64>>(
    chart: &mut Chart<'_, '_, Y>,
    points: Vec<Point>,
    style: Style,
    color: RGBColor,
) -> Drawn {
    let stroke = color.stroke_width(2 * FINE);
    if style == Style::Dashed {
        let dashes = DashedLineSeries::new(points, 7 * FINE, 5 * FINE, stroke);
        chart.draw_series(dashes).map_err(text)?;
    } else {
        chart.draw_series(LineSeries::new(points, stroke)).map_err(text)?;
    }
    Ok(())
}

/// Draws a short sample of the curve for the legend.
fn draw_sample(root: &Area, style: Style, color: RGBColor, left: u32, middle: u32) -> Drawn {
    let at = |x: u32| ((x * FINE) as i32, (middle * FINE) as i32);
    let pieces: &[(u32, u32)] = match style {
        Style::Line | Style::Step => &[(0, SAMPLE)],
        Style::Dashed => &[(0, 10), (16, SAMPLE)],
        Style::Points | Style::Bars => &[],
    };
    for (start, end) in pieces {
        let ends = vec![at(left + start), at(left + end)];
        root.draw(&PathElement::new(ends, color.stroke_width(2 * FINE))).map_err(text)?;
    }
    if style == Style::Bars {
        let (x, y, half) = ((left + SAMPLE / 2) * FINE, middle * FINE, 5 * FINE);
        let corners = [(x - half, y - half), (x + half, y + half)].map(|(x, y)| (x as i32, y as i32));
        root.draw(&Rectangle::new(corners, color.filled())).map_err(text)?;
    }
    if style == Style::Points {
        root.draw(&Circle::new(at(left + SAMPLE / 2), 3 * FINE, color.filled())).map_err(text)?;
    }
    Ok(())
}

fn put_text(root: &Area, words: &str, at: (u32, u32), size: u32, weight: FontStyle) -> Drawn {
    let style = font(size, weight).pos(Pos::new(HPos::Left, VPos::Center));
    root.draw_text(words, &style, ((at.0 * FINE) as i32, (at.1 * FINE) as i32)).map_err(text)
}

/// The palette, repeated in ever darker shades.
fn palette(index: usize) -> RGBColor {
    let shade = 0.6_f64.powi((index / PALETTE.len()) as i32);
    let RGBColor(red, green, blue) = PALETTE[index % PALETTE.len()];
    let darker = |channel: u8| (f64::from(channel) * shade) as u8;
    RGBColor(darker(red), darker(green), darker(blue))
}

/// Text style on the enlarged canvas.
fn font(size: u32, style: FontStyle) -> TextStyle<'static> {
    TextStyle::from(FontDesc::new(FontFamily::SansSerif, f64::from(size * FINE), style)).color(&INK)
}

/// Estimated text width, because measuring needs a font library.
fn text_width(words: &str) -> u32 {
    (CHARACTER * f64::from(TEXT_SIZE) * words.chars().count() as f64).ceil() as u32
}

/// Label of an axis mark, without the extra digits of binary fractions.
fn number(value: f64) -> String {
    if value != 0.0 && !(1e-3..1e5).contains(&value.abs()) {
        return format!("{value:.0e}");
    }
    let digits = format!("{value:.4}");
    let short = digits.trim_end_matches('0').trim_end_matches('.');
    if short == "-0" { "0".to_owned() } else { short.to_owned() }
}

fn text(error: impl std::fmt::Display) -> String {
    error.to_string()
}
