//! Leaky integrators, one time constant each: `c' = a c + (1 - a) g` with `a = sigmoid(decay)`.

use engine::Lane;

/// The integrators' `a`.
#[derive(Clone, Debug)]
pub(super) struct Leaky {
    keep: Vec<f32>,
}

impl Leaky {
    /// From their decays.
    pub fn new(decays: &[f32]) -> Self {
        Self { keep: decays.iter().map(|decay| sigmoid(*decay)).collect() }
    }

    /// States after a block, from those before it and their drive.
    pub fn step(&self, before: &[Lane], drive: &[Lane], after: &mut [Lane]) {
        for (s, keep) in self.keep.iter().enumerate() {
            after[s] = before[s].zip(&drive[s], |c, g| keep * c + (1.0 - keep) * g);
        }
    }

    /// The way back. `d` holds the gradient by the states after the block, and then that by those before it; the gradient
    /// by the drive is set, that by the decays is added to.
    pub fn step_back(
        &self,
        before: &[Lane],
        drive: &[Lane],
        d: &mut [Lane],
        d_drive: &mut [Lane],
        d_decay: &mut [Lane],
    ) {
        for (s, keep) in self.keep.iter().enumerate() {
            let difference = before[s].zip(&drive[s], |c, g| keep * (1.0 - keep) * (c - g));
            d_decay[s].add_scaled(1.0, &d[s].zip(&difference, |d, x| d * x));
            d_drive[s] = d[s].map(|d| (1.0 - keep) * d);
            d[s] = d[s].map(|d| keep * d);
        }
    }
}

/// The logistic function.
pub(super) fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests_support::check_slopes;

    #[test]
    fn gradients_agree_with_finite_differences() {
        // Decays, states before the block, drives: two of each, the same in all lanes.
        let at = [-0.5, 1.5, 0.3, -0.8, 1.2, 0.4];
        let splat =
            |values: &[f32]| -> Vec<Lane> { values.iter().map(|value| Lane::splat(*value)).collect() };
        let weights = splat(&[2.0, -3.0]);
        let run = |at: &[f32]| -> f64 {
            let mut after = [Lane::ZERO; 2];
            Leaky::new(&at[..2]).step(&splat(&at[2..4]), &splat(&at[4..]), &mut after);
            after.iter().zip(&weights).map(|(after, weight)| f64::from(after[0] * weight[0])).sum()
        };
        let (mut d, mut d_drive, mut d_decay) = (weights.clone(), [Lane::ZERO; 2], [Lane::ZERO; 2]);
        let leaky = Leaky::new(&at[..2]);
        leaky.step_back(&splat(&at[2..4]), &splat(&at[4..]), &mut d, &mut d_drive, &mut d_decay);
        let gradient: Vec<f32> = d_decay.iter().chain(&d).chain(&d_drive).map(|lane| lane[0]).collect();
        check_slopes("argument", &at, 1e-2, &gradient, run);
    }
}
