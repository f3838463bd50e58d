//! Nyquist and Bode plots of loops, and the breath beside them.

use std::f64::consts::TAU;

use show::report::{Plot, Role, Series, Style};

use super::estimate::Estimate;
use super::measurement::Moments;
use super::response::ResponsePoint;
use super::stability::RequiredMargins;

/// Points of a circle.
const CIRCLE: usize = 180;

/// Nyquist plot of loops by name, with the unit circle and that of the highest allowed Ms around -1.
pub fn nyquist(loops: &[(String, Vec<ResponsePoint>)]) -> Plot {
    let circle = |name: &str, centre: f64, radius: f64| {
        let at = |place: usize| {
            let angle = TAU * place as f64 / CIRCLE as f64;
            (centre + radius * angle.cos(), radius * angle.sin())
        };
        Series::new(name, Style::Dashed, (0..=CIRCLE).map(at).collect())
    };
    let ms = RequiredMargins::default().ms;
    let limit = circle(&format!("Ms = {ms}"), -1.0, 1.0 / ms);
    let mut series = vec![circle("abs(L) = 1", 0.0, 1.0), Series { role: Some(Role::Limit), ..limit }];
    for (name, response) in loops {
        let points = response.iter().map(|at| (at.loop_gain.re, at.loop_gain.im)).collect();
        series.push(Series::new(name, Style::Line, points));
    }
    Plot {
        x_range: Some((-2.5, 1.5)),
        y_range: Some((-2.5, 1.5)),
        size: Some((640, 700)),
        ..Plot::new("Loop gain", "real part", "imaginary part", series)
    }
}

/// Bode plots of loop and plant, the magnitudes first and then the angles.
pub fn bode(estimates: &[Estimate]) -> [Plot; 2] {
    let over = |name: &str, of: &dyn Fn(&Estimate) -> f64| {
        Series::new(name, Style::Line, estimates.iter().map(|at| (at.response.hz, of(at))).collect())
    };
    let unwrapped = |name: &str, of: &dyn Fn(&Estimate) -> f64| {
        let mut turns = 0.0_f64;
        let mut before: Option<f64> = None;
        let points = estimates.iter().map(|at| {
            let angle = of(at);
            if let Some(before) = before {
                turns += ((before - angle) / TAU).round() - turns;
            }
            let angle = angle + TAU * turns;
            before = Some(angle);
            (at.response.hz, angle.to_degrees())
        });
        Series::new(name, Style::Line, points.collect())
    };
    let sizes = vec![
        over("loop", &|at| at.response.loop_gain.norm()),
        over("plant, cmH2O per percent", &|at| at.plant.norm()),
    ];
    let angles =
        vec![unwrapped("loop", &|at| at.response.loop_gain.arg()), unwrapped("plant", &|at| at.plant.arg())];
    [
        Plot { log_y: true, ..Plot::new("Magnitude", "frequency, Hz", "magnitude", sizes) },
        Plot::new("Angle", "frequency, Hz", "angle, degrees", angles),
    ]
}

/// Pressure and command of a breath without a sine, with the target.
pub fn breath(moments: &[Moments]) -> [Plot; 2] {
    let over = |name: &str, style: Style, of: fn(&Moments) -> f32| {
        let points = moments.iter().map(|at| (f64::from(at.time_s), f64::from(of(at)))).collect();
        Series::new(name, style, points)
    };
    [
        Plot::over_time(
            "A breath without a sine",
            "pressure, cmH2O",
            vec![
                over("target", Style::Dashed, |at| at.target),
                over("pressure", Style::Line, |at| at.pressure),
            ],
        ),
        Plot::over_time(
            "The valve's effort",
            "command, percent",
            vec![Series {
                role: Some(Role::InspiratoryValve),
                ..over("command", Style::Line, |at| at.command)
            }],
        ),
    ]
}
