//! A student: a state that the network keeps through a breath, in which it can learn its unit.
//!
//! The state is a leaky average of the first outputs of the last hidden layer, and an input of the next tick, in the place of what earlier
//! breaths taught. Only in training, to see what a first breath could gain by it.

use engine::Lane;
use shared::control::memory::RECALLED;

/// Shares of an output that the averages take in per tick: about 10, 25 and 65 ms at 1 kHz, in turn.
const SHARES: [f32; 3] = [0.1, 0.04, 0.015];

/// The state; in the backward pass, the gradients with respect to it.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Student([Lane; RECALLED]);

impl Student {
    /// The inputs that it makes.
    pub fn inputs(&self) -> &[Lane; RECALLED] {
        &self.0
    }

    /// Takes in the hidden outputs of a tick.
    pub fn learn(&mut self, hidden: &[Lane]) {
        for ((state, hidden), share) in self.0.iter_mut().zip(hidden).zip(SHARES.iter().cycle()) {
            *state = state.zip(hidden, |state, hidden| state + share * (hidden - state));
        }
    }

    /// Backward pass of [`Self::learn`]: the gradients with respect to the hidden outputs.
    pub fn learn_back(&mut self) -> [Lane; RECALLED] {
        let mut d_hidden = self.0;
        for ((state, d), share) in self.0.iter_mut().zip(&mut d_hidden).zip(SHARES.iter().cycle()) {
            *d = d.map(|d| share * d);
            *state = state.map(|d| (1.0 - share) * d);
        }
        d_hidden
    }

    /// Backward pass of [`Self::inputs`]: adds the gradients with respect to them.
    pub fn inputs_back(&mut self, d_inputs: &[Lane]) {
        for (state, d) in self.0.iter_mut().zip(d_inputs) {
            state.add_scaled(1.0, d);
        }
    }
}
