//! First-order lag, solved exactly for an input that is constant over one sub-step.

use crate::math::exp;

/// Distance to the input below which the output takes the input's value: the tail would otherwise decay into denormal
/// numbers, which are slow.
const SETTLED: f64 = 1e-12;

/// `time_constant * dy/dt = input - y`.
#[derive(Clone, Debug)]
pub(super) struct Lag {
    /// Share of the remaining difference that one sub-step covers.
    share: f64,
    output: f64,
}

impl Lag {
    /// A lag at rest at `output`; with a time constant of zero it follows the input immediately.
    pub(super) fn new(time_constant_s: f64, sub_step_s: f64, output: f64) -> Self {
        // Division by zero gives exp(-inf) = 0, so the share is 1, as required.
        Self { share: 1.0 - exp(-sub_step_s / time_constant_s), output }
    }

    /// One sub-step towards `input`; returns the new output.
    pub(super) fn advance(&mut self, input: f64) -> f64 {
        let difference = input - self.output;
        if difference.abs() < SETTLED {
            self.output = input;
        } else {
            self.output += self.share * difference;
        }
        self.output
    }

    /// The present output.
    pub(super) fn output(&self) -> f64 {
        self.output
    }
}

#[cfg(test)]
mod tests {
    use super::Lag;

    #[test]
    fn covers_63_percent_of_a_step_in_one_time_constant() {
        let mut lag = Lag::new(0.025, 0.000_25, 0.0);
        for _ in 0..100 {
            lag.advance(10.0);
        }
        assert!((lag.output() - 10.0 * (1.0 - (-1.0_f64).exp())).abs() < 1e-9);
    }

    #[test]
    fn a_zero_time_constant_follows_at_once() {
        let mut lag = Lag::new(0.0, 0.000_25, 3.0);
        assert!((lag.advance(7.0) - 7.0).abs() < f64::EPSILON);
    }

    #[test]
    fn settles_on_exactly_its_input() {
        let mut lag = Lag::new(0.004, 0.000_25, 1.0);
        for _ in 0..1_000 {
            lag.advance(0.0);
        }
        assert_eq!(lag.output().to_bits(), 0.0_f64.to_bits());
    }
}
