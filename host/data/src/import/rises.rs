//! Detects the starts of breaths in a series of set-points.

/// Distance above PEEP from which a set-point counts as rising to PIP, cmH2O.
const RISE: f32 = 0.5;
/// Change below which the set-point counts as resting, cmH2O; its transmission rounds to 0.001.
const REST: f32 = 0.05;
/// Rest required before a rise, seconds: a table that starts within a rise starts no breath.
const REST_S: f64 = 0.05;

/// Whether a set-point is above PEEP, cmH2O.
pub(super) fn is_up(setpoint: f32, peep: f32) -> bool {
    setpoint > peep + RISE
}

/// Detects rises in a stream of set-points.
#[derive(Debug, Clone)]
pub(super) struct Rises {
    rest_rows: usize,
    state: Option<State>,
}

#[derive(Debug, Clone, Copy)]
enum State {
    /// At `level` for `rows` rows.
    Low { level: f32, rows: usize },
    /// Within a breath; the highest set-point is `peak`.
    High { peak: f32 },
}

impl Rises {
    pub(super) fn new(period_s: f64) -> Self {
        Self { rest_rows: (REST_S / period_s).ceil().max(1.0) as usize, state: None }
    }

    /// Resets the state, as after a gap.
    pub(super) fn reset(&mut self) {
        self.state = None;
    }

    /// Whether a breath starts with the next set-point; never with the first, because a rise needs a preceding row.
    pub(super) fn starts(&mut self, setpoint: f32) -> bool {
        let mut starts = false;
        self.state = Some(match self.state {
            Some(State::High { peak }) if is_up(peak, setpoint) => State::Low { level: setpoint, rows: 1 },
            Some(State::High { peak }) => State::High { peak: peak.max(setpoint) },
            Some(State::Low { level, rows }) if rows >= self.rest_rows && is_up(setpoint, level) => {
                starts = true;
                State::High { peak: setpoint }
            }
            Some(State::Low { level, rows }) if self.rests(setpoint - level, rows) => {
                State::Low { level, rows: rows + 1 }
            }
            None | Some(State::Low { .. }) => State::Low { level: setpoint, rows: 1 },
        });
        starts
    }

    /// A resting set-point may creep up: a slow rise does so in small steps.
    fn rests(&self, above: f32, rows: usize) -> bool {
        above.abs() <= REST || (above > 0.0 && rows >= self.rest_rows)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn starts(parts: &[(f32, usize)]) -> Vec<usize> {
        let setpoints: Vec<f32> = parts.iter().flat_map(|&(level, rows)| vec![level; rows]).collect();
        let mut rises = Rises::new(0.01);
        (0..setpoints.len()).filter(|row| rises.starts(setpoints[*row])).collect()
    }

    #[test]
    fn a_breath_starts_at_each_rise_after_a_rest() {
        assert_eq!(starts(&[(5.0, 30), (15.0, 100), (5.0, 200), (15.0, 100)]), [30, 330]);
    }

    #[test]
    fn a_series_that_begins_within_an_inspiration_or_a_rise_waits_for_the_next() {
        assert_eq!(starts(&[(30.0, 87), (5.0, 200), (30.0, 100)]), [287]);
        assert_eq!(starts(&[(12.0, 1), (18.0, 1), (24.0, 1), (30.0, 90), (5.0, 200), (30.0, 5)]), [293]);
    }

    #[test]
    fn rounding_of_the_set_point_starts_no_breath() {
        assert_eq!(starts(&[(5.0, 30), (15.0, 50), (14.999, 20), (15.0, 30), (5.001, 9), (5.0, 50)]), [30]);
    }

    #[test]
    fn a_slow_rise_starts_one_breath() {
        let mut parts = vec![(5.0, 30)];
        parts.extend((1..=100).map(|step| (5.0 + 0.1 * step as f32, 1)));
        parts.extend([(15.0, 50), (5.0, 50)]);
        assert_eq!(starts(&parts), [35]);
    }

    #[test]
    fn a_flat_or_empty_series_has_no_breath() {
        assert_eq!(starts(&[]), [0_usize; 0]);
        assert_eq!(starts(&[(5.0, 1_000)]), [0_usize; 0]);
    }
}
