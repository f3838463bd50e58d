//! Shared by tests of gradients.

/// Compares the gradient of a function with central differences of width `step` in each of its arguments.
pub fn check_slopes(what: &str, at: &[f32], step: f32, gradient: &[f32], function: impl Fn(&[f32]) -> f64) {
    assert!(gradient.iter().any(|slope| slope.abs() > 0.1), "{what}: nothing to tell slopes from");
    let mut varied = at.to_vec();
    for (n, (kept, analytic)) in at.iter().zip(gradient).enumerate() {
        varied[n] = kept + step;
        let above = function(&varied);
        varied[n] = kept - step;
        let numeric = (above - function(&varied)) / f64::from(2.0 * step);
        varied[n] = *kept;
        let tolerance = 0.01 + 0.02 * f64::from(analytic.abs());
        assert!(
            (numeric - f64::from(*analytic)).abs() < tolerance,
            "{what} {n}: {numeric} against {analytic}"
        );
    }
}
