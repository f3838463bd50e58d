//! The account of a policy: in which ticks the valve obeyed it, what it got wrong, and how long it took to answer.

use std::time::Duration;

use serde::Serialize;

/// Ratio of the upper to the lower end of a bin of answer times.
const BIN_RATIO: f64 = 1.05;

/// An event in the ventilations of a policy.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Event {
    /// Number of the ventilation, from 1; each begins at rest.
    pub run: u64,
    /// Number of its breath, from 0.
    pub breath: u32,
    /// Tick of the breath.
    pub tick: u32,
    /// What happened.
    pub what: String,
}

/// Counts over all ventilations of a policy. A tick is one of an inspiration; each is in exactly one of `commanded`, `limited` and
/// `pid`. After the pressure limit has ended an inspiration, none commands, and no tick is counted.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Account {
    /// Ventilations.
    pub runs: u64,
    /// Breaths.
    pub breaths: u64,
    /// Ticks.
    pub ticks: u64,
    /// Ticks in which the valve had the policy's command.
    pub commanded: u64,
    /// Ticks on the way between the policy's command and the PID's: the supervisor limits the rate of change.
    pub limited: u64,
    /// Ticks in which the PID commanded, or below it on the ladder the capped PID or backup ventilation.
    pub pid: u64,
    /// Commands that were not used because they are not finite or outside the valve's range.
    pub refused: u64,
    /// The first of these.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub first_refused: Option<Event>,
    /// What ended the link; from there on the PID commanded.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub failure: Option<Event>,
    /// Time from an observation to its command.
    #[serde(flatten)]
    pub answers: AnswerTimes,
}

impl Account {
    /// Share of the ticks, percent; 0 without ticks.
    pub fn percent(&self, ticks: u64) -> f64 {
        100.0 * ticks as f64 / self.ticks.max(1) as f64
    }

    /// Counts a tick with the command that was applied, percent; `asked` holds the PID's command and, if it was usable, the policy's;
    /// none if the controller was not asked.
    pub(super) fn count(&mut self, applied: f32, asked: Option<(f32, Option<f32>)>) {
        self.ticks += 1;
        let same = |command: f32| command.to_bits() == applied.to_bits();
        match asked {
            Some((_, Some(policy))) if same(policy) => self.commanded += 1,
            Some((base, _)) if !same(base) => self.limited += 1,
            _ => self.pid += 1,
        }
    }
}

/// Distribution of answer times, in bins of 5 %. Only these figures of a policy's account depend on the machine.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[serde(into = "AnswerQuantiles")]
pub struct AnswerTimes {
    bins: Vec<u64>,
}

/// Quantiles of answer times, microseconds; none without answers.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct AnswerQuantiles {
    /// The median.
    pub answer_median_us: Option<f64>,
    /// 99 % of the answers are as fast as this.
    pub answer_p99_us: Option<f64>,
}

impl AnswerTimes {
    pub(super) fn add(&mut self, time: Duration) {
        let microseconds = (1e6 * time.as_secs_f64()).max(1.0);
        let bin = (microseconds.ln() / BIN_RATIO.ln()) as usize;
        if self.bins.len() <= bin {
            self.bins.resize(bin + 1, 0);
        }
        self.bins[bin] += 1;
    }

    /// The quantile of a share: the upper end of its bin, microseconds.
    fn quantile(&self, share: f64) -> Option<f64> {
        let wanted = share * self.bins.iter().sum::<u64>() as f64;
        let mut below = 0;
        let bin = self.bins.iter().position(|count| {
            below += count;
            below > 0 && below as f64 >= wanted
        })?;
        Some(BIN_RATIO.powi(bin as i32 + 1))
    }

    /// Median and 99 %.
    pub fn quantiles(&self) -> AnswerQuantiles {
        AnswerQuantiles { answer_median_us: self.quantile(0.5), answer_p99_us: self.quantile(0.99) }
    }
}

impl From<AnswerTimes> for AnswerQuantiles {
    fn from(times: AnswerTimes) -> Self {
        times.quantiles()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tick_is_the_policys_the_pids_or_on_the_way_between_them() {
        let mut account = Account::default();
        for (applied, asked) in [
            (40.0, Some((10.0, Some(40.0)))),
            (35.0, Some((10.0, Some(40.0)))),
            (10.0, Some((10.0, Some(40.0)))),
            (10.0, Some((10.0, None))),
            (12.0, Some((10.0, None))),
            (12.0, None),
            (10.0, Some((10.0, Some(10.0)))),
        ] {
            account.count(applied, asked);
        }
        assert_eq!((account.commanded, account.limited, account.pid, account.ticks), (2, 2, 3, 7));
    }

    #[test]
    fn quantiles_of_answer_times_are_within_a_bin() {
        let mut times = AnswerTimes::default();
        assert_eq!(times.quantiles(), AnswerQuantiles { answer_median_us: None, answer_p99_us: None });
        (1..=1000).for_each(|us| times.add(Duration::from_micros(us)));
        let AnswerQuantiles { answer_median_us, answer_p99_us } = times.quantiles();
        for (found, wanted) in [(answer_median_us, 500.0), (answer_p99_us, 990.0)] {
            let ratio = found.unwrap() / wanted;
            assert!((1.0..=BIN_RATIO * BIN_RATIO).contains(&ratio), "{found:?}, not {wanted}");
        }
    }
}
