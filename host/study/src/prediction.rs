//! Figures of a simulator's prediction of a recorded breath: the pressures, and how far they are apart.

use show::report::{Plot, Series, Style};

/// The measured, true and predicted pressure of a breath, and beside them the error of the prediction: its distance to the true
/// pressure, or to the measured one where that is unknown.
pub fn plots(
    title: String,
    measured: &[f32],
    truth: Option<&[f32]>,
    predicted: &[f32],
    period_s: f64,
) -> [Plot; 2] {
    let curve = |name: &str, values: &[f32]| {
        let points = values.iter().enumerate().map(|(n, value)| (n as f64 * period_s, f64::from(*value)));
        Series::new(name, Style::Line, points.collect())
    };
    let measured = curve("measured", measured);
    let truth = truth.map(|truth| curve("true", truth));
    let simulator = curve("simulator", predicted);
    let (error, name) = match &truth {
        Some(truth) => (simulator.minus(truth), "simulator - true pressure"),
        None => (simulator.minus(&measured), "simulator - measured pressure"),
    };
    let error = Plot::over_time(
        format!("{title}: error"),
        "error, cmH2O",
        vec![Series { name: name.into(), ..error }],
    );
    let curves = [Some(measured), truth, Some(simulator)].into_iter().flatten().collect();
    [Plot::over_time(title, "pressure, cmH2O", curves), error]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_error_is_that_of_the_true_pressure_if_it_is_known() {
        let error = |truth: Option<&[f32]>| {
            let [_, error] = plots("breath".into(), &[5.0, 9.0], truth, &[6.0, 7.0], 0.5);
            (error.series[0].name.clone(), error.series[0].points.clone())
        };
        let of = |name: &str, points: [(f64, f64); 2]| (name.to_owned(), points.to_vec());
        assert_eq!(error(None), of("simulator - measured pressure", [(0.0, 1.0), (0.5, -2.0)]));
        assert_eq!(error(Some(&[6.0, 8.0])), of("simulator - true pressure", [(0.0, 0.0), (0.5, -1.0)]));
    }
}
