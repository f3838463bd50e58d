//! Appearance of reports, and that they are self-contained.

use super::*;
use data::provenance::Provenance;

fn table() -> Table {
    let mut table = Table::new("Error over the inspiration", &["controller", "error, cmH2O", "overshoot, %"]);
    table.row(vec![Cell::text("PID"), Cell::number(1.374, 2), Cell::number(12.0, 1)]);
    table.row(vec![
        Cell::text("residual <32>"),
        Cell::number(1.118, 2).best_if(true),
        Cell::number(3.2, 1).best_if(true),
    ]);
    table.row(vec![Cell::text("none"), Cell::number(f64::NAN, 2)]);
    table
}

fn plot() -> Plot {
    let wave = |i: i32| (f64::from(i) * 0.1, 5.0 + 10.0 * (f64::from(i) * 0.1).sin().abs());
    Plot {
        title: "Pressure & <flow>".to_owned(),
        x_label: "time, s".to_owned(),
        y_label: "pressure, cmH2O".to_owned(),
        series: vec![
            Series::new("target", Style::Dashed, vec![(0.0, 15.0), (3.0, 15.0)]),
            Series::new("measured", Style::Line, (0..30).map(wave).collect()),
        ],
        ..Plot::default()
    }
}

fn report() -> Report {
    let provenance = Provenance {
        git_revision: "0123456789ab".to_owned(),
        plant: "bench".to_owned(),
        settings: serde_json::json!({ "note": "<b>" }),
        notes: vec!["by \"hand\"".to_owned()],
        ..Provenance::new(1_000, "test")
    };
    let section = Section {
        heading: "Results".to_owned(),
        text: "First.\n\nSecond & last.".to_owned(),
        blocks: vec![Block::Table(table()), Block::Text("Done.".to_owned())],
    };
    let sections = vec![section];
    Report {
        title: "Trial <1>".to_owned(),
        subtitle: "PID & residual".to_owned(),
        sections,
        provenance: Some(provenance),
    }
}

fn with_plots() -> Report {
    let mut report = report();
    report.sections[0].blocks.extend([Block::Plot(plot()), Block::PlotRow(vec![plot(), plot()])]);
    report
}

#[test]
fn a_table_in_the_terminal() {
    insta::assert_snapshot!(table().to_plain());
}

#[test]
fn bold_marks_appear_only_where_styles_are_wanted() {
    assert!(!table().to_plain().contains('\u{1b}'));
    assert!(table().render(true, 80).contains("\u{1b}[1m"));
}

#[test]
fn rows_of_any_length_give_a_table() {
    let mut ragged = Table::new("", &["a"]);
    ragged.row(vec![]);
    ragged.row(vec![Cell::text("x"), Cell::count(2)]);
    assert!(ragged.to_plain().contains('2'));
    assert!(Table::default().to_html().contains("<tbody>"));
}

#[test]
fn a_report_as_html() {
    let html = report().to_html().unwrap();
    let (_, body) = html.split_once("</style>\n").unwrap();
    insta::assert_snapshot!(body);
}

#[test]
fn a_report_refers_to_nothing_outside_itself() {
    let html = with_plots().to_html().unwrap();
    for reference in ["http:", "https:", "src=", "href=", "url(", "@import", "<script", "<link"] {
        assert!(!html.contains(reference), "{reference}");
    }
    assert_eq!(html.matches("<svg").count(), 3);
}

#[test]
fn drawings_follow_the_page_to_its_dark_colours() {
    let (html, svg) = (with_plots().to_html().unwrap(), plot().to_svg().unwrap());
    let (light, dark) = Role::Pressure.color();
    for text in [&html, &svg] {
        let rule = format!("svg [stroke=\"{light}\"]{{stroke:{dark}}}");
        let (_, on_dark) = text.split_once(&rule).expect("the rule");
        assert!(text.contains("@media (prefers-color-scheme: dark) {\nsvg [fill="));
        assert!(
            on_dark.contains(&format!("fill=\"none\" stroke=\"{light}\""))
                && on_dark.contains("currentColor")
        );
    }
    // A page has its own background; a file of its own brings one along.
    assert!(!html.contains("fill=\"#FFFFFF\"/>") && svg.contains("fill=\"#FFFFFF\"/>"));
}

#[test]
fn a_controller_has_its_colour_wherever_its_curve_is() {
    let curve = |name: &str| Series::new(name, Style::Line, vec![(0.0, 1.0), (1.0, 2.0)]);
    let strokes = |names: [&str; 3]| {
        let svg = Plot { series: names.map(curve).to_vec(), ..plot() }.drawing().unwrap().elements;
        let curves = svg.lines().filter(|line| line.contains("stroke-width=\"2\"")).skip(3);
        let stroke = |line: &str| line.split("stroke=\"").nth(1).unwrap()[..7].to_owned();
        curves.map(stroke).collect::<Vec<_>>()
    };
    let [pid, learned] = [Role::Pid, Role::Learned].map(|role| role.color().0.to_owned());
    let first = strokes(["PID", "learned", "round 1"]);
    assert_eq!(strokes(["round 1", "learned", "PID"]), [&first[2], &learned, &pid].map(String::clone));
    assert_eq!(first[..2], [pid, learned]);
}

#[test]
fn text_cannot_break_out_of_a_plot() {
    let svg = plot().to_svg().unwrap();
    assert!(svg.contains("Pressure &amp; &lt;flow&gt;") && !svg.contains("<flow>"));
}

#[test]
fn saving_replaces_the_file() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("out/report.html");
    report().save(&path).unwrap();
    with_plots().save(&path).unwrap();
    assert_eq!(std::fs::read_to_string(path).unwrap(), with_plots().to_html().unwrap());
}

#[test]
fn a_plot_shows_title_axes_legend_and_is_the_same_every_time() {
    let svg = plot().to_svg().unwrap();
    assert!(
        svg.starts_with("<svg width=\"800\" height=\"400\" viewBox=\"0 0 800 400\" xmlns="),
        "{}",
        &svg[..90]
    );
    for words in ["time, s", "pressure, cmH2O", "target", "measured"] {
        assert!(svg.contains(words), "{words}");
    }
    assert_eq!(svg, plot().to_svg().unwrap());
}

#[test]
fn series_keep_apart_when_the_palette_is_used_up() {
    let series =
        (0..12).map(|i| Series::new("", Style::Line, vec![(0.0, f64::from(i)), (1.0, f64::from(i))]));
    let svg = Plot { series: series.collect(), ..plot() }.to_svg().unwrap();
    let strokes =
        svg.lines().filter(|line| line.starts_with("<polyline") && line.contains("stroke-width=\"2\""));
    let colors: std::collections::BTreeSet<_> =
        strokes.filter_map(|line| line.split("stroke=").nth(1)?.get(..9)).collect();
    assert_eq!(colors.len(), 12);
}

#[test]
fn a_curve_beyond_the_given_range_is_cut_at_the_frame() {
    let series = vec![Series::new("", Style::Line, vec![(0.0, 0.0), (1.0, 100.0)])];
    let cut = Plot { series, x_range: Some((0.0, 1.0)), y_range: Some((0.0, 50.0)), ..plot() };
    let whole =
        Plot { series: vec![Series::new("", Style::Line, vec![(0.0, 0.0), (0.5, 50.0)])], ..cut.clone() };
    assert_eq!(cut.to_svg().unwrap(), whole.to_svg().unwrap());
}

#[test]
fn a_long_series_stays_small() {
    let mut long = plot();
    long.series[1].points = (0..200_000).map(|i| (f64::from(i) * 1e-3, f64::from(i % 977))).collect();
    assert!(long.to_svg().unwrap().len() < 100_000);
}

#[test]
fn every_style_and_a_logarithmic_axis_draw() {
    for style in [Style::Line, Style::Dashed, Style::Step, Style::Points] {
        for log_y in [false, true] {
            let series = vec![Series::new("s", style, vec![(0.0, 1e-3), (1.0, 1.0), (2.0, 1e3)])];
            let svg = Plot { series, log_y, ..plot() }.to_svg().unwrap();
            assert_eq!(svg.contains("<circle"), style == Style::Points);
        }
    }
}

#[test]
fn bars_stand_side_by_side_over_their_names() {
    let bars = |name: &str| Series::new(name, Style::Bars, vec![(1.0, 2.0), (2.0, 1.0)]);
    let x_names = vec!["first".to_owned(), "second".to_owned()];
    let (x_range, y_range) = (Some((0.5, 2.5)), Some((0.0, 3.0)));
    let plot = Plot { series: vec![bars("a"), bars("b")], x_names, x_range, y_range, ..plot() };
    let svg = plot.to_svg().unwrap();
    for name in ["first", "second"] {
        assert_eq!(svg.matches(&format!(">{name}</text>")).count(), 1, "{name}");
    }
    let attribute = |line: &str, name: &str| -> f64 {
        let (_, after) = line.split_once(&format!(" {name}=\"")).unwrap();
        after.split('"').next().unwrap().parse().unwrap()
    };
    // Two samples in the legend, then the bars of each series.
    let places = |color: &str| -> Vec<(f64, f64)> {
        let bars = svg.lines().filter(|line| line.starts_with("<rect") && line.contains(color));
        bars.map(|line| (attribute(line, "x"), attribute(line, "width"))).collect()
    };
    let (first, second) = (places("\"#117733\""), places("\"#AA4499\""));
    assert_eq!((first.len(), second.len()), (3, 3));
    for (one, other) in first[1..].iter().zip(&second[1..]) {
        assert!((one.0 + one.1 - other.0).abs() <= 0.25, "{one:?} {other:?}");
    }
}

#[test]
fn a_narrow_logarithmic_axis_still_has_marks() {
    let series = vec![Series::new("", Style::Line, vec![(0.0, 1.2), (1.0, 1.9)])];
    let svg = Plot { series, log_y: true, ..plot() }.to_svg().unwrap();
    for mark in ["1.2", "1.6", "2"] {
        assert!(svg.contains(&format!(">{mark}</text>")), "{mark}");
    }
}

#[test]
fn a_flat_series_and_a_single_point_have_axes() {
    for points in [vec![(0.0, 5.0), (1.0, 5.0)], vec![(2.0, 0.0)]] {
        let series = vec![Series::new("s", Style::Points, points)];
        assert!(Plot { series, ..plot() }.to_svg().unwrap().contains("<circle"));
    }
}

#[test]
fn what_cannot_be_plotted_is_refused_with_the_reason() {
    let refused = |spoil: &dyn Fn(&mut Plot)| {
        let mut plot = plot();
        spoil(&mut plot);
        plot.to_svg().unwrap_err()
    };
    let nan = refused(&|plot| plot.series[1].points[4].1 = f64::NAN);
    assert!(matches!(nan, ReportError::NotFinite { series, index: 4, .. } if series == "measured"));
    assert!(matches!(refused(&|plot| plot.series.clear()), ReportError::Empty { .. }));
    assert!(matches!(refused(&|plot| plot.x_range = Some((1.0, f64::NAN))), ReportError::BadRange { .. }));
    assert!(matches!(refused(&|plot| plot.y_range = Some((1.0, 1.0))), ReportError::BadRange { .. }));
    let zero = refused(&|plot| {
        plot.log_y = true;
        plot.series[0].points[0].1 = 0.0;
    });
    assert!(matches!(zero, ReportError::NotPositive { .. }));
}
