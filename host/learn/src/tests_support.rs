//! What tests of gradients share.

/// Compares the gradient of a function with central differences by each of its arguments.
pub fn check_slopes(what: &str, at: &[f32], gradient: &[f32], function: impl Fn(&[f32]) -> f64) {
    let step = 1e-2;
    let mut varied = at.to_vec();
    for (n, (kept, analytic)) in at.iter().zip(gradient).enumerate() {
        varied[n] = kept + step;
        let above = function(&varied);
        varied[n] = kept - step;
        let numeric = (above - function(&varied)) / f64::from(2.0 * step);
        varied[n] = *kept;
        let tolerance = 0.01 * (1.0 + f64::from(analytic.abs()));
        assert!(
            (numeric - f64::from(*analytic)).abs() < tolerance,
            "{what} {n}: {numeric} against {analytic}"
        );
    }
}
