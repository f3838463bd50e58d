//! The signals of a closed loop over lanes, tick by tick.

use engine::Lane;

/// Measured error (cmH2O) and applied command (percent) of every tick; in the backward pass, their gradients.
#[derive(Debug)]
pub struct Signals {
    pub error: Vec<Lane>,
    pub command: Vec<Lane>,
}

impl Signals {
    /// Memory for `ticks` ticks.
    pub fn new(ticks: usize) -> Self {
        Self { error: vec![Lane::ZERO; ticks], command: vec![Lane::ZERO; ticks] }
    }

    /// Sets all values to zero.
    pub fn clear(&mut self) {
        self.error.fill(Lane::ZERO);
        self.command.fill(Lane::ZERO);
    }
}
