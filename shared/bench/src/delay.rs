//! A delay line for the readings of a sensor, in steps of the bench.

use crate::math::round;
use crate::step::STEP_S;
use crate::storage::{List, MOST_DELAY_MS};

/// Readings that have not come out yet.
#[derive(Clone, Debug)]
pub(crate) struct Delay {
    /// One reading for each step of the delay, and the newest.
    ring: List<f32, { MOST_DELAY_MS + 1 }>,
    /// Step of the newest reading.
    newest: u64,
}

impl Delay {
    /// A line that delays by so many milliseconds, resolved to a step.
    pub(crate) fn new(delay_ms: f64) -> Self {
        let steps = round(1e-3 * delay_ms / STEP_S) as usize;
        Self { ring: core::iter::repeat_n(0.0, steps + 1).collect(), newest: 0 }
    }

    /// Fills the line with a reading, as if there had been no other before this time, s.
    pub(crate) fn fill(&mut self, reading: f32, time_s: f64) {
        self.ring.iter_mut().for_each(|place| *place = reading);
        self.newest = step_at(time_s);
    }

    /// Takes the reading of this time, s, and gives the one of the delay before. Between two readings the earlier one stands.
    pub(crate) fn pass(&mut self, reading: f32, time_s: f64) -> f32 {
        let (step, length) = (step_at(time_s), self.ring.len() as u64);
        let place = |step: u64| (step % length) as usize;
        let before = self.ring[place(self.newest)];
        for skipped in (self.newest + 1).max(step.saturating_sub(length))..step {
            self.ring[place(skipped)] = before;
        }
        self.ring[place(step)] = reading;
        self.newest = step;
        self.ring[place(step + 1)]
    }
}

/// The step of the bench at a time, s.
fn step_at(time_s: f64) -> u64 {
    round(time_s / STEP_S) as u64
}

#[cfg(test)]
mod tests {
    use super::Delay;

    #[test]
    fn a_reading_comes_out_after_the_delay_whatever_the_time_between_readings() {
        for (delay_ms, every_ms) in [(0_u32, 1_u32), (1, 1), (25, 1), (25, 10), (7, 3), (3, 40)] {
            let mut delay = Delay::new(f64::from(delay_ms));
            delay.fill(-1.0, 0.0);
            for ms in (every_ms..400).step_by(every_ms as usize) {
                let found = delay.pass(ms as f32, f64::from(ms) * 1e-3);
                // The last reading that is at least so old.
                let due = ms.checked_sub(delay_ms).map_or(0, |at| at / every_ms * every_ms);
                let expected = if due == 0 { -1.0 } else { due as f32 };
                assert!(
                    (found - expected).abs() < 1e-6,
                    "{delay_ms} ms, every {every_ms} ms: {found} at {ms} ms"
                );
            }
        }
    }
}
