//! Detects the starts of breaths in a series of set-points.

/// Distance above PEEP from which a set-point counts as rising to PIP, cmH2O.
const RISE: f32 = 0.5;
/// Change below which the set-point counts as resting, cmH2O; its transmission rounds to 0.001.
const REST: f32 = 0.05;
/// Rest required before a rise, seconds: a table that starts within a rise starts no breath.
const REST_S: f64 = 0.05;
/// Rest at a level above PEEP after which a further rise shows that the one before was a step of PEEP, seconds and rows.
const STEP_S: f64 = 0.15;
const STEP_ROWS: usize = 3;

/// Whether a set-point is above PEEP, cmH2O.
pub(super) fn is_up(setpoint: f32, peep: f32) -> bool {
    setpoint > peep + RISE
}

/// Detects rises in a stream of set-points.
#[derive(Debug, Clone)]
pub(super) struct Rises {
    rest_rows: usize,
    step_rows: usize,
    state: Option<State>,
}

/// What a set-point shows.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shown {
    /// Nothing new.
    Nothing,
    /// The start of a breath.
    Start,
    /// The start of a breath, and that the start before was only a step of PEEP.
    StartAfterStep,
}

#[derive(Debug, Clone, Copy)]
enum State {
    /// At `level` for `rows` rows.
    Low { level: f32, rows: usize },
    /// Within a breath; the highest set-point is `peak`, and the last `rows` are there.
    High { peak: f32, rows: usize },
}

impl Rises {
    pub(super) fn new(period_s: f64) -> Self {
        let rows = |seconds: f64, least: usize| ((seconds / period_s).ceil() as usize).max(least);
        Self { rest_rows: rows(REST_S, 1), step_rows: rows(STEP_S, STEP_ROWS), state: None }
    }

    /// Resets the state, as after a gap.
    pub(super) fn reset(&mut self) {
        self.state = None;
    }

    /// Whether a breath starts with the next set-point; never with the first, because a rise needs a preceding row.
    pub(super) fn next(&mut self, setpoint: f32) -> Shown {
        let mut shown = Shown::Nothing;
        self.state = Some(match self.state {
            Some(State::High { peak, .. }) if is_up(peak, setpoint) => {
                State::Low { level: setpoint, rows: 1 }
            }
            Some(State::High { peak, rows }) if rows >= self.step_rows && is_up(setpoint, peak) => {
                shown = Shown::StartAfterStep;
                State::High { peak: setpoint, rows: 1 }
            }
            Some(State::High { peak, rows }) if (setpoint - peak).abs() <= REST => {
                State::High { peak, rows: rows + 1 }
            }
            Some(State::High { peak, .. }) => State::High { peak: peak.max(setpoint), rows: 1 },
            Some(State::Low { level, rows }) if rows >= self.rest_rows && is_up(setpoint, level) => {
                shown = Shown::Start;
                State::High { peak: setpoint, rows: 1 }
            }
            Some(State::Low { level, rows }) if self.rests(setpoint - level, rows) => {
                State::Low { level, rows: rows + 1 }
            }
            None | Some(State::Low { .. }) => State::Low { level: setpoint, rows: 1 },
        });
        shown
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
        let (mut rises, mut starts) = (Rises::new(0.01), Vec::new());
        for (row, setpoint) in setpoints.into_iter().enumerate() {
            match rises.next(setpoint) {
                Shown::Nothing => {}
                Shown::Start => starts.push(row),
                Shown::StartAfterStep => *starts.last_mut().unwrap() = row,
            }
        }
        starts
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
    fn a_step_of_peep_starts_no_breath() {
        assert_eq!(starts(&[(5.0, 30), (8.0, 40), (15.0, 100), (8.0, 100), (15.0, 9)]), [70, 270]);
        assert_eq!(starts(&[(5.0, 30), (15.0, 100), (8.0, 100), (5.0, 50), (15.0, 9)]), [30, 280]);
    }

    #[test]
    fn a_flat_or_empty_series_has_no_breath() {
        assert_eq!(starts(&[]), [0_usize; 0]);
        assert_eq!(starts(&[(5.0, 1_000)]), [0_usize; 0]);
    }
}
