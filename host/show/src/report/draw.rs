//! Draws a plot as SVG: title and legend, axes, curves. No font library: where the width of a text matters, it is estimated.

use super::ReportError;
use super::curve::{self, Limits, Point};
use super::plot::{Plot, Series, Style};
use super::role::{FAINT, Role, other};
use super::svg::{self, Svg};
use super::ticks;

/// Colour of the axes: that of the text around.
const INK: &str = "currentColor";
/// Longer series are reduced to this number of points.
const MAX_POINTS: usize = 1_500;
const TITLE_SIZE: f64 = 17.0;
const TEXT_SIZE: f64 = 14.0;
const LINE_HEIGHT: f64 = 20.0;
const MARGIN: f64 = 8.0;
/// Space for marks and label of the horizontal axis below it, and of the vertical one beside it, pixels.
const BESIDE_AXES: (f64, f64) = (44.0, 62.0);
const TICK: f64 = 4.0;
/// Share of the distance between whole numbers that the bars of a number fill.
const BARS_SHARE: f64 = 0.8;
/// Length of a legend entry's sample, pixels.
const SAMPLE: f64 = 26.0;
/// Mean width of a character, and height of the middle of a text above its line, as shares of the text size.
const CHARACTER: (f64, f64) = (0.52, 0.35);

impl Plot {
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

    pub(super) fn drawing(&self) -> Result<Svg, ReportError> {
        let (x, y) = self.ranges()?;
        let size = (f64::from(self.size().0), f64::from(self.size().1));
        let colors = colors(&self.series);
        let (header, top) = header(self, &colors, size.0);
        let frame = Frame {
            left: MARGIN + BESIDE_AXES.1,
            right: size.0 - 3.0 * MARGIN,
            top: top + MARGIN,
            bottom: size.1 - MARGIN - BESIDE_AXES.0,
            x,
            y,
            log_y: self.log_y,
        };
        let mut elements = header + &axes(self, &frame);
        let beside: Vec<&Series> = self.series.iter().filter(|series| series.style == Style::Bars).collect();
        for (series, color) in self.series.iter().zip(&colors) {
            elements += &match beside.iter().position(|other| std::ptr::eq(*other, series)) {
                Some(place) => bars(series, (place, beside.len()), color, &frame),
                None => curve(series, color, &frame),
            };
        }
        Ok(Svg { size, elements })
    }
}

/// Title and legend, and their height in pixels.
fn header(plot: &Plot, colors: &[&str], width: f64) -> (String, f64) {
    let (mut elements, mut left, mut top) = (String::new(), MARGIN, MARGIN);
    if !plot.title.is_empty() {
        let place = (MARGIN, top + LINE_HEIGHT / 2.0 + CHARACTER.1 * TITLE_SIZE);
        let style = format!("font-size=\"{TITLE_SIZE}\" font-weight=\"bold\"");
        elements += &svg::text(place, &style, &plot.title);
        top += LINE_HEIGHT + 4.0;
    }
    for (series, color) in plot.series.iter().zip(colors).filter(|(series, _)| !series.name.is_empty()) {
        let entry = SAMPLE + 6.0 + CHARACTER.0 * TEXT_SIZE * series.name.chars().count() as f64 + 16.0;
        if left > MARGIN && left + entry > width {
            (left, top) = (MARGIN, top + LINE_HEIGHT);
        }
        let middle = top + LINE_HEIGHT / 2.0;
        elements += &sample(series.style, color, (left, middle));
        elements += &label((left + SAMPLE + 6.0, middle), "start", &series.name);
        left += entry;
    }
    (elements, if left > MARGIN { top + LINE_HEIGHT } else { top })
}

/// A short sample of a series for the legend.
fn sample(style: Style, color: &str, (left, y): Point) -> String {
    let x = left + SAMPLE / 2.0;
    match style {
        Style::Points => svg::dot((x, y), color),
        Style::Bars => svg::rectangle((x - 5.0, y - 5.0), (x + 5.0, y + 5.0), color),
        Style::Line | Style::Step | Style::Dashed => {
            svg::line(&[(left, y), (left + SAMPLE, y)], color, 2.0, style == Style::Dashed)
        }
    }
}

/// Where the points of a plot are on the page.
struct Frame {
    left: f64,
    right: f64,
    top: f64,
    bottom: f64,
    x: Limits,
    y: Limits,
    log_y: bool,
}

impl Frame {
    fn at(&self, (x, y): Point) -> Point {
        let share = |value: f64, (low, high): Limits| (value - low) / (high - low);
        let up = if self.log_y { share(y.ln(), (self.y.0.ln(), self.y.1.ln())) } else { share(y, self.y) };
        let right = share(x, self.x);
        (self.left + right * (self.right - self.left), self.bottom - up * (self.bottom - self.top))
    }

    /// The nearest point within the frame.
    fn nearest(&self, (x, y): Point) -> Point {
        (x.clamp(self.x.0, self.x.1), y.clamp(self.y.0, self.y.1))
    }
}

/// The axes with their marks and labels, and a faint line at each mark.
fn axes(plot: &Plot, frame: &Frame) -> String {
    let Frame { left, right, top, bottom, .. } = *frame;
    let mut elements = String::new();
    for (value, name) in x_marks(plot, frame.x) {
        let (x, _) = frame.at((value, frame.y.0));
        elements += &svg::line(&[(x, bottom), (x, top)], FAINT.0, 1.0, false);
        elements += &svg::line(&[(x, bottom), (x, bottom + TICK)], INK, 1.0, false);
        elements += &label((x, bottom + TICK + 10.0), "middle", &name);
    }
    let count = (plot.size().1 / 45).max(3) as usize;
    let marks = if plot.log_y { ticks::logarithmic } else { ticks::linear };
    for value in marks(frame.y, count) {
        let (_, y) = frame.at((frame.x.0, value));
        elements += &svg::line(&[(left, y), (right, y)], FAINT.0, 1.0, false);
        elements += &svg::line(&[(left - TICK, y), (left, y)], INK, 1.0, false);
        elements += &label((left - TICK - 4.0, y), "end", &number(value));
    }
    elements += &svg::line(&[(left, top), (left, bottom), (right, bottom)], INK, 1.0, false);
    elements += &label((f64::midpoint(left, right), bottom + BESIDE_AXES.0 - 8.0), "middle", &plot.x_label);
    // Turned, a text is as far right of its place as it is otherwise above it.
    let (x, y) = (MARGIN + 8.0 + CHARACTER.1 * TEXT_SIZE, f64::midpoint(top, bottom));
    let style =
        format!("font-size=\"{TEXT_SIZE}\" text-anchor=\"middle\" transform=\"rotate(-90 {x} {y:.1})\"");
    elements + &svg::text((x, y), &style, &plot.y_label)
}

/// Places and texts of the marks on the horizontal axis.
fn x_marks(plot: &Plot, x: Limits) -> Vec<(f64, String)> {
    if plot.x_names.is_empty() {
        let marks = ticks::linear(x, (plot.size().0 / 75).max(3) as usize);
        return marks.into_iter().map(|value| (value, number(value))).collect();
    }
    let numbered = (1_u32..).map(f64::from).zip(plot.x_names.iter().cloned());
    numbered.filter(|(value, _)| (x.0..=x.1).contains(value)).collect()
}

/// The bars of a series, which has this place among so many with bars.
fn bars(series: &Series, (place, count): (usize, usize), color: &str, frame: &Frame) -> String {
    let width = BARS_SHARE / count as f64;
    let left = place as f64 * width - BARS_SHARE / 2.0;
    let corner = |point: Point| frame.at(frame.nearest(point));
    let floor = frame.y.0.max(0.0);
    let bar =
        |&(x, y): &Point| svg::rectangle(corner((x + left, floor)), corner((x + left + width, y)), color);
    series.points.iter().map(bar).collect()
}

/// A series as a line or as dots.
fn curve(series: &Series, color: &str, frame: &Frame) -> String {
    let few = curve::decimate(&series.points, MAX_POINTS);
    if series.style == Style::Points {
        let inside = few.into_iter().filter(|&point| curve::inside(point, frame.x, frame.y));
        return inside.map(|point| svg::dot(frame.at(point), color)).collect();
    }
    let joined = if series.style == Style::Step { curve::steps(&few) } else { few };
    let line = |part: Vec<Point>| {
        let part: Vec<Point> = part.into_iter().map(|point| frame.at(point)).collect();
        svg::line(&part, color, 2.0, series.style == Style::Dashed)
    };
    curve::clip(&joined, frame.x, frame.y).into_iter().map(line).collect()
}

/// Colour of each series on a light page; only those without a role use the other colours.
fn colors(series: &[Series]) -> Vec<&'static str> {
    let mut others = (0..).map(other);
    let role = |series: &Series| series.role.or((series.style == Style::Dashed).then_some(Role::Target));
    let colors = series.iter().map(|series| role(series).map(|role| role.color().0));
    colors.filter_map(|color| color.or_else(|| others.next())).collect()
}

/// A text that has its start, middle or end at a place, and its middle at that height.
fn label((x, y): Point, anchor: &str, words: &str) -> String {
    let style = format!("font-size=\"{TEXT_SIZE}\" text-anchor=\"{anchor}\"");
    svg::text((x, y + CHARACTER.1 * TEXT_SIZE), &style, words)
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
