//! Results of a patient, and of all together.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use shared::safety::alarms::{ALARMS, Fault, Priority};

use super::deserved::Verdict;
use super::efforts::Efforts;

/// Seconds of a day.
const DAY_S: f64 = 86_400.0;
/// Number of patients listed as the worst.
const WORST: usize = 10;

/// Alarms of a kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct AlarmCount {
    /// Those with a true condition; of a low priority: all.
    pub deserved: u64,
    /// Those without.
    pub undeserved: u64,
}

/// Result of one patient's stay.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PatientResult {
    /// Number of the patient.
    pub patient: u64,
    /// Duration, s.
    pub seconds: f64,
    /// Breaths that the lung took, by its true volume.
    pub breaths: u64,
    /// Times that ventilation stopped.
    pub interruptions: u64,
    /// Longest time from the end of a delivered inspiration to the next one, s.
    pub longest_gap_s: f64,
    /// Minute volume, as a share of that of the passive patient without a leak.
    pub minute_volume_share: f64,
    /// Highest true airway pressure, cmH2O.
    pub peak_true: f64,
    /// Its distance above the pressure limit in force at that time, cmH2O; negative below it.
    pub peak_above_limit: f64,
    /// Alarms by id.
    pub alarms: BTreeMap<String, AlarmCount>,
    /// Conditions without an alarm, by name.
    pub missed: BTreeMap<String, u64>,
    /// How breaths followed the patient's efforts.
    pub efforts: Efforts,
}

impl PatientResult {
    /// Counts an alarm.
    pub fn count(&mut self, fault: Fault, verdict: Verdict) {
        let count = self.alarms.entry(fault.alarm().id.to_owned()).or_default();
        match verdict {
            Verdict::Deserved | Verdict::Counted => count.deserved += 1,
            Verdict::Undeserved => count.undeserved += 1,
        }
    }

    /// Undeserved alarms of a priority.
    pub fn undeserved(&self, priority: Priority) -> u64 {
        let of =
            |alarm: &shared::safety::alarms::Alarm| self.alarms.get(alarm.id).map_or(0, |c| c.undeserved);
        ALARMS.iter().filter(|alarm| alarm.priority == priority).map(of).sum()
    }

    /// Alarms that were due and did not come.
    pub fn missed(&self) -> u64 {
        self.missed.values().sum()
    }

    /// For the order of the worst: interruptions, undeserved high, missed, undeserved medium, self-triggered breaths.
    fn badness(&self) -> [u64; 5] {
        let undeserved = |priority| self.undeserved(priority);
        let (high, medium) = (undeserved(Priority::High), undeserved(Priority::Medium));
        [self.interruptions, high, self.missed(), medium, self.efforts.self_triggered]
    }
}

/// Alarms of a kind in all patients.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct AlarmRow {
    /// Id of the alarm.
    pub id: &'static str,
    /// Its priority.
    pub priority: Priority,
    /// Those with a true condition; of a low priority: all.
    pub deserved: u64,
    /// Those without.
    pub undeserved: u64,
    /// All of them, per patient and day.
    pub per_patient_day: f64,
}

/// Results of all patients.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Summary {
    /// Patients.
    pub patients: u64,
    /// Sum of their stays, days.
    pub patient_days: f64,
    /// Breaths that the lungs took.
    pub breaths: u64,
    /// Times that ventilation stopped.
    pub interruptions: u64,
    /// High-priority alarms without a true condition.
    pub high_alarms_undeserved: u64,
    /// Medium-priority alarms without a true condition, per patient and day.
    pub medium_alarms_undeserved_per_day: f64,
    /// Alarms that were due and did not come.
    pub alarms_missed: u64,
    /// The same by condition.
    pub missed: BTreeMap<String, u64>,
    /// Longest time without a delivered breath, s.
    pub longest_gap_s: f64,
    /// Highest true airway pressure, cmH2O.
    pub peak_true: f64,
    /// Farthest that it was above the pressure limit in force, cmH2O.
    pub peak_above_limit: f64,
    /// Lowest minute volume of a patient, as a share of that of the passive patient without a leak.
    pub least_minute_volume_share: f64,
    /// Breaths that efforts have started, as a share of the device's breaths.
    pub triggered_share: f64,
    /// Breaths that the device took for triggered ones without an effort, in a thousand breaths.
    pub self_triggered_per_mille: f64,
    /// Share of the efforts of at least 3 cmH2O in expirations that no breath followed.
    pub efforts_missed_share: f64,
    /// Median delay of a triggered breath behind the beginning of its effort, ms; none without one.
    pub trigger_delay_ms: Option<u32>,
    /// Alarms by kind, without those that never occurred.
    pub alarms: Vec<AlarmRow>,
    /// The worst patients, the worst one first.
    pub worst: Vec<PatientResult>,
}

impl Summary {
    /// Sums up the results of patients.
    pub fn of(results: &[PatientResult]) -> Self {
        let sum = |of: &dyn Fn(&PatientResult) -> u64| results.iter().map(of).sum::<u64>();
        let highest = |of: fn(&PatientResult) -> f64| results.iter().map(of).reduce(f64::max).unwrap_or(0.0);
        let patient_days = results.iter().map(|result| result.seconds / DAY_S).sum::<f64>();
        let per_day = |count: u64| if count == 0 { 0.0 } else { count as f64 / patient_days };
        let mut missed = BTreeMap::new();
        for (condition, count) in results.iter().flat_map(|result| &result.missed) {
            *missed.entry(condition.clone()).or_insert(0) += count;
        }
        let alarms = ALARMS.iter().map(|alarm| {
            let count = |of: fn(&AlarmCount) -> u64| sum(&|result| result.alarms.get(alarm.id).map_or(0, of));
            let (deserved, undeserved) = (count(|count| count.deserved), count(|count| count.undeserved));
            let per_patient_day = per_day(deserved + undeserved);
            AlarmRow { id: alarm.id, priority: alarm.priority, deserved, undeserved, per_patient_day }
        });
        let mut worst: Vec<_> = results.iter().filter(|result| result.badness() != [0; 5]).cloned().collect();
        worst.sort_by_key(|result| std::cmp::Reverse(result.badness()));
        worst.truncate(WORST);
        let mut efforts = Efforts::default();
        for result in results {
            efforts.add(&result.efforts);
        }
        Self {
            patients: results.len() as u64,
            patient_days,
            breaths: sum(&|result| result.breaths),
            interruptions: sum(&|result| result.interruptions),
            high_alarms_undeserved: sum(&|result| result.undeserved(Priority::High)),
            medium_alarms_undeserved_per_day: per_day(sum(&|result| result.undeserved(Priority::Medium))),
            alarms_missed: sum(&PatientResult::missed),
            missed,
            longest_gap_s: highest(|result| result.longest_gap_s),
            peak_true: highest(|result| result.peak_true),
            peak_above_limit: highest(|result| result.peak_above_limit),
            least_minute_volume_share: -highest(|result| -result.minute_volume_share),
            triggered_share: efforts.triggered as f64 / efforts.breaths.max(1) as f64,
            self_triggered_per_mille: efforts.self_triggered_per_mille(),
            efforts_missed_share: efforts.missed_share(),
            trigger_delay_ms: efforts.median_delay_ms(),
            alarms: alarms.filter(|row| row.deserved + row.undeserved > 0).collect(),
            worst,
        }
    }

    /// Whether nothing happened that must not.
    pub fn passes(&self) -> bool {
        self.interruptions == 0 && self.high_alarms_undeserved == 0 && self.alarms_missed == 0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stay(patient: u64) -> PatientResult {
        PatientResult {
            patient,
            seconds: DAY_S / 2.0,
            breaths: 100,
            minute_volume_share: 0.9,
            ..Default::default()
        }
    }

    #[test]
    fn the_sum_counts_by_kind_and_by_day_and_lists_the_worst() {
        let (mut bad, mut worse) = (stay(1), stay(2));
        bad.count(Fault::Leak, Verdict::Undeserved);
        bad.count(Fault::HostSilent, Verdict::Counted);
        worse.count(Fault::Occlusion, Verdict::Undeserved);
        worse.count(Fault::Occlusion, Verdict::Deserved);
        let summary = Summary::of(&[stay(0), bad, worse, stay(3)]);
        assert_eq!((summary.patients, summary.breaths, summary.high_alarms_undeserved), (4, 400, 1));
        assert!((summary.medium_alarms_undeserved_per_day - 0.5).abs() < 1e-12);
        assert!((summary.least_minute_volume_share - 0.9).abs() < 1e-12);
        let worst: Vec<_> = summary.worst.iter().map(|result| result.patient).collect();
        assert_eq!(worst, [2, 1], "a patient without trouble is none of the worst");
        let ids: Vec<_> = summary.alarms.iter().map(|row| (row.id, row.deserved, row.undeserved)).collect();
        assert_eq!(ids, [("occlusion", 1, 1), ("host-silent", 1, 0), ("leak", 0, 1)]);
        assert!(!summary.passes() && Summary::of(&[stay(0)]).passes());
    }
}
