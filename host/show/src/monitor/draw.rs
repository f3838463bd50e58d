//! Draws a view on a terminal: charts on the left, numbers on the right, keys at the bottom.
//!
//! Drawing uses only the view and fits any size; when space is short, the least important parts are omitted.

use ratatui::Frame;
use ratatui::layout::{Constraint, Layout, Rect};
use ratatui::style::{Color, Modifier, Style, Stylize};
use ratatui::symbols::Marker;
use ratatui::text::{Line, Span};
use ratatui::widgets::{Axis, Block, Borders, Chart, Dataset, GraphType, Paragraph, Wrap};
use shared::control::memory::LEARNING;
use shared::safety::alarms::{Fault, Priority};
use shared::safety::ladder::Level;
use shared::settings::Settings;
use shared::ventilator::{Mode, opening};

use super::view::{Notice, View};
use super::window::Points;
use super::words;

/// Number of chart dots per character width.
const DOTS: usize = 2;
/// Width of the column of numbers, characters.
const NUMBERS_WIDTH: u16 = 46;
/// Width below which a chart is omitted, characters.
const LEAST_CHART: u16 = 30;
/// Help line for the keys.
const KEYS: &str = "space start/stop  a acknowledge  m audio pause  t take over  q quit  c confirm  ↑↓ PIP  ←→ rate  p PID/learned";

/// Draws a view on the whole terminal.
pub fn draw(frame: &mut Frame, view: &View) {
    let rows = [Constraint::Length(1), Constraint::Min(0), Constraint::Length(2), Constraint::Length(1)];
    let [head, body, message, keys] = Layout::vertical(rows).areas(frame.area());
    frame.render_widget(headline(view), head);
    if body.width >= NUMBERS_WIDTH + LEAST_CHART {
        let columns = [Constraint::Min(LEAST_CHART), Constraint::Length(NUMBERS_WIDTH)];
        let [charts, numbers] = Layout::horizontal(columns).areas(body);
        draw_charts(frame, charts, view);
        draw_numbers(frame, numbers, view);
    } else {
        draw_charts(frame, body, view);
    }
    frame.render_widget(message_line(view), message);
    frame.render_widget(Line::from(KEYS).dim(), keys);
}

fn headline(view: &View) -> Line<'static> {
    let mut line = Line::from(vec![Span::from(view.address.clone()).bold(), "  ".into(), state(view)]);
    if let Some(identity) = view.known().identity {
        line.push_span(format!("  {}", words::identity(identity)));
    }
    line
}

/// The device's mode, highlighted according to its urgency.
fn state(view: &View) -> Span<'static> {
    let known = view.known().mode.map_or_else(|| "waiting for the device".to_owned(), words::mode);
    let loud = Style::new().fg(Color::White).bg(Color::Red).add_modifier(Modifier::BOLD);
    match (view.known().lost, view.known().mode) {
        (Some(_), _) => Span::styled(format!(" no connection; last mode: {known} "), loud),
        (None, Some(Mode::Fault(_))) => Span::styled(format!(" {known} "), loud),
        (None, mode) => match (urgent(view), mode) {
            (Some(fault), _) => Span::styled(format!(" {known}: {} ", words::fault(fault)), loud),
            (None, Some(Mode::Ventilating)) => Span::from(known).green().bold(),
            (None, _) => Span::from(known).yellow().bold(),
        },
    }
}

/// The first indicated alarm of high priority.
fn urgent(view: &View) -> Option<Fault> {
    let faults = words::indicated(view.known().status?);
    faults.into_iter().find(|fault| fault.alarm().priority == Priority::High)
}

fn message_line(view: &View) -> Paragraph<'static> {
    let text = match (view.known().lost, &view.message) {
        (_, Some(Notice::Warning(text))) => Line::from(text.clone()).red().bold(),
        (Some(reason), _) => Line::from(reason.to_owned()).red(),
        (None, Some(Notice::Note(text))) => Line::from(text.clone()),
        (None, None) => Line::default(),
    };
    Paragraph::new(text).wrap(Wrap { trim: true })
}

fn draw_charts(frame: &mut Frame, area: Rect, view: &View) {
    let [pressure, valves] = Layout::vertical([Constraint::Fill(3), Constraint::Fill(2)]).areas(area);
    draw_pressure(frame, pressure, view);
    draw_valves(frame, valves, view);
}

fn draw_pressure(frame: &mut Frame, area: Rect, view: &View) {
    let dots = usize::from(area.width) * DOTS;
    let measured = view.window.pieces(dots, |sample| sample.pressure);
    let target = view.window.pieces(dots, |sample| sample.target);
    let bounds = bounds([&measured, &target].into_iter().flatten());
    let title = match view.window.last() {
        Some(last) => format!(" pressure {:.1}, target {:.1} cmH2O ", last.pressure, last.target),
        None => " pressure: no telemetry yet ".to_owned(),
    };
    let warning = Line::from(" never for use on a patient ").dim().right_aligned();
    let mut datasets = pieces(&target, Color::Yellow);
    datasets.extend(pieces(&measured, Color::Cyan));
    frame.render_widget(chart(datasets, titled(title).title(warning), bounds, view), area);
}

fn draw_valves(frame: &mut Frame, area: Rect, view: &View) {
    let dots = usize::from(area.width) * DOTS;
    let inspiratory = view.window.pieces(dots, |sample| sample.u_in);
    let expiratory = view.window.pieces(dots, |sample| opening(sample.u_out));
    let title = match view.window.last() {
        Some(last) => {
            let expiratory = if last.u_out { "open" } else { "closed" };
            format!(" valves: inspiratory {:.0} %, expiratory {expiratory} ", last.u_in)
        }
        None => " valves ".to_owned(),
    };
    let mut datasets = pieces(&expiratory, Color::DarkGray);
    datasets.extend(pieces(&inspiratory, Color::Green));
    frame.render_widget(chart(datasets, titled(title), [0.0, 100.0], view), area);
}

fn pieces(pieces: &[Points], color: Color) -> Vec<Dataset<'_>> {
    let line = |points| {
        let dataset = Dataset::default().marker(Marker::Braille).graph_type(GraphType::Line);
        dataset.style(Style::new().fg(color)).data(points)
    };
    pieces.iter().map(|points| line(points.as_slice())).collect()
}

fn titled(title: String) -> Block<'static> {
    Block::new().borders(Borders::TOP).title(title)
}

fn chart<'a>(datasets: Vec<Dataset<'a>>, block: Block<'a>, bounds: [f64; 2], view: &View) -> Chart<'a> {
    let seconds = view.window.seconds();
    let axis = Axis::default().style(Style::new().dim());
    let label = |value: f64| format!("{value:.0}");
    let time = axis.clone().bounds([-seconds, 0.0]).labels([format!("-{seconds:.0} s"), "now".to_owned()]);
    let middle = f64::midpoint(bounds[0], bounds[1]);
    let value = axis.bounds(bounds).labels([label(bounds[0]), label(middle), label(bounds[1])]);
    Chart::new(datasets).block(block).x_axis(time).y_axis(value).legend_position(None)
}

/// Bounds of the pressure axis: multiples of ten around all values, at least 0 to 30.
fn bounds<'a>(pieces: impl Iterator<Item = &'a Points>) -> [f64; 2] {
    let values = pieces.flatten().map(|(_, value)| *value);
    let (low, high) =
        values.fold((0.0_f64, 30.0_f64), |(low, high), value| (low.min(value), high.max(value)));
    [(low / 10.0).floor() * 10.0, (high / 10.0).ceil() * 10.0]
}

fn draw_numbers(frame: &mut Frame, area: Rect, view: &View) {
    let blocks = [
        ("alarms", indicated(view)),
        ("settings", settings(view)),
        ("ticks", ticks(view)),
        ("losses", losses(view)),
        ("begun alarms, newest first", alarms(view)),
        ("breaths: cmH2O, leak in L/s at 1 cmH2O", breaths(view)),
    ];
    let last = blocks.len() - 1;
    let heights = blocks.iter().enumerate().map(|(index, (_, lines))| match index {
        index if index == last => Constraint::Fill(1),
        _ => Constraint::Length(lines.len() as u16 + 1),
    });
    let areas = Layout::vertical(heights).split(area);
    for ((title, lines), area) in blocks.into_iter().zip(areas.iter()) {
        let block = Block::new().borders(Borders::TOP | Borders::LEFT).title(format!(" {title} "));
        frame.render_widget(Paragraph::new(lines).block(block), *area);
    }
}

fn settings(view: &View) -> Vec<Line<'static>> {
    let line = |name: &str, settings: &Settings| {
        let Settings { pip, peep, rate, .. } = settings;
        Line::from(format!("{name:<5} PIP {pip}, PEEP {peep} cmH2O, {rate} /min"))
    };
    let mut lines: Vec<Line<'static>> = vec![match view.known().controller {
        Some(choice) => Line::from(words::controller(choice)),
        None => Line::from("not reported yet"),
    }];
    lines.extend(view.known().in_force.map(|settings| line("now", settings)));
    lines.extend(view.known().pending.map(|settings| line("next", settings).yellow()));
    let lease = view.known().lease.filter(|lease| lease.holder.is_some());
    lines.extend(lease.map(|lease| {
        let line = Line::from(format!("steered by {}", words::lease(lease)));
        if lease.yours { line } else { line.yellow() }
    }));
    lines
}

fn ticks(view: &View) -> Vec<Line<'static>> {
    let Some(times) = view.known().times else {
        return vec![Line::from("not reported yet")];
    };
    let us = |cycles: f32| times.microseconds(cycles);
    let span = |name: &str, span: &shared::timing::CycleStats| {
        let [shortest, longest] = [span.shortest, span.longest].map(|cycles| us(cycles as f32));
        Line::from(format!("{name:<8}{shortest:>8.1}{:>8.1}{longest:>9.1} us", us(span.mean)))
    };
    let missed = Line::from(format!("{} ticks, {} missed", times.ticks, times.missed));
    vec![
        Line::from("        shortest    mean  longest").dim(),
        span("work", &times.work),
        span("latency", &times.latency),
        span("period", &times.period),
        if times.missed == 0 { missed } else { missed.red().bold() },
    ]
}

fn losses(view: &View) -> Vec<Line<'static>> {
    let traffic = view.known().traffic;
    let counters = &traffic.device;
    let line = |name: &str, count: u64| {
        let line = Line::from(format!("{name:<26}{count:>10}"));
        if count == 0 { line } else { line.red().bold() }
    };
    vec![
        Line::from(format!("{:<26}{:>10}", "frames received", traffic.frames)),
        line("damaged, device to host", traffic.corrupt),
        line("damaged, host to device", counters.corrupt_frames.into()),
        line("batches lost", traffic.lost_batches),
        line("samples dropped on device", counters.dropped.into()),
    ]
}

/// Number of indicated alarms shown: the most urgent ones.
const INDICATED_LINES: usize = 4;

fn indicated(view: &View) -> Vec<Line<'static>> {
    let Some(alarms) = view.known().status else {
        return vec![Line::from("not reported yet")];
    };
    let faults = words::indicated(alarms);
    let mut lines = vec![ladder(alarms.level)];
    if let Some(audio) = view.known().audio.filter(|audio| audio.pause_left > 0) {
        lines.push(Line::from(format!("sounder: {}", words::audio(&audio))).yellow());
    }
    let line = |fault: &Fault| {
        let line = Line::from(words::alarm(*fault, alarms));
        match fault.alarm().priority {
            Priority::High => line.red().bold(),
            Priority::Medium => line.yellow().bold(),
            Priority::Low => line.cyan(),
        }
    };
    lines.extend(faults.iter().take(INDICATED_LINES).map(line));
    match faults.len() {
        0 => lines.push(Line::from("none is indicated")),
        count if count > INDICATED_LINES => {
            lines.push(Line::from(format!("and {} more", count - INDICATED_LINES)));
        }
        _ => {}
    }
    lines
}

fn ladder(level: Level) -> Line<'static> {
    let line = Line::from(format!("in command: {}", words::level(level)));
    if level == Level::Learned { line } else { line.yellow() }
}

/// Number of begun alarms shown; older ones stay in memory.
const ALARM_LINES: usize = 3;

fn alarms(view: &View) -> Vec<Line<'static>> {
    let period_us = view.known().identity.map_or(0, |identity| identity.period_us);
    let line = |alarm: &super::view::AlarmEntry| {
        let text = format!("{}: {}", words::moment(alarm.tick, period_us), words::fault(alarm.fault));
        Line::from(text).red()
    };
    let mut lines: Vec<_> = view.alarms.iter().take(ALARM_LINES).map(line).collect();
    if lines.is_empty() {
        lines.push(Line::from("none since this monitor started"));
    }
    lines
}

fn breaths(view: &View) -> Vec<Line<'static>> {
    let head = ["breath", "error", "peak", "end", "leak", "adopted"];
    let [breath, error, peak, end, leak, adopted] = head;
    let head = format!("{breath:>7}{error:>7}{peak:>7}{end:>6}{leak:>8}{adopted:>9}");
    let rows = view.breaths.iter().map(|breath| {
        let [error, peak, end] = [breath.mean_absolute_error, breath.peak_pressure, breath.end_pressure];
        let leak = breath.leak.map_or_else(|| "-".to_owned(), |leak| format!("{leak:.3}"));
        let adopted = format!("{}/{LEARNING}", breath.adopted);
        Line::from(format!("{:>7}{error:>7.2}{peak:>7.1}{end:>6.1}{leak:>8}{adopted:>9}", breath.breath))
    });
    let head = Line::from(head).dim();
    std::iter::once(head).chain(rows).collect()
}
