//! How well breaths follow the patient: efforts that start no breath, delays, and breaths that no effort has started.
//!
//! An effort can be missed only if it begins in an expiration, later than 0.3 s after the inspiration: before that the
//! ventilator is not to respond. It is followed if a breath begins before it ends.

use serde::{Deserialize, Serialize};

/// Peak of the efforts that must be followed, cmH2O.
pub const TELLING_CMH2O: f64 = 3.0;
/// Time after the end of an inspiration in which an effort may go unanswered, ms.
const REFRACTORY_MS: u32 = 300;
/// Time after an effort or a cough in which its end may still move the gas, ms.
const SETTLES_MS: u32 = 300;
/// Bins of the delays, of `BIN_MS` each; the last one is open-ended.
const BINS: usize = 60;
/// See [`BINS`].
const BIN_MS: u32 = 10;

/// Counts of a stay.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Efforts {
    /// Breaths of the device.
    pub breaths: u64,
    /// Breaths that an effort is said to have started, and those of them without one.
    pub triggered: u64,
    /// See `triggered`.
    pub self_triggered: u64,
    /// Efforts of at least [`TELLING_CMH2O`] that had to be followed, and those of them that were not.
    pub due: u64,
    /// See `due`.
    pub missed: u64,
    /// Triggered efforts by the time from their beginning to that of the breath.
    pub delays: Vec<u64>,
}

impl Efforts {
    /// Adds another stay's.
    pub fn add(&mut self, other: &Self) {
        self.breaths += other.breaths;
        self.triggered += other.triggered;
        self.self_triggered += other.self_triggered;
        self.due += other.due;
        self.missed += other.missed;
        self.delays.resize(self.delays.len().max(other.delays.len()), 0);
        self.delays.iter_mut().zip(&other.delays).for_each(|(sum, count)| *sum += count);
    }

    /// Median of the delays, ms: the upper end of its bin. None without a triggered effort.
    pub fn median_delay_ms(&self) -> Option<u32> {
        let all: u64 = self.delays.iter().sum();
        let mut before = 0;
        let reaches = |count: &u64| {
            before += count;
            2 * before >= all
        };
        let bin = self.delays.iter().position(reaches).filter(|_| all > 0)?;
        Some((bin as u32 + 1) * BIN_MS)
    }

    /// Share of the due efforts that were missed.
    pub fn missed_share(&self) -> f64 {
        self.missed as f64 / self.due.max(1) as f64
    }

    /// Breaths without an effort that are said to have one, in a thousand breaths.
    pub fn self_triggered_per_mille(&self) -> f64 {
        1e3 * self.self_triggered as f64 / self.breaths.max(1) as f64
    }

    fn delayed(&mut self, ms: u32) {
        self.delays.resize(BINS, 0);
        self.delays[(ms / BIN_MS).min(BINS as u32 - 1) as usize] += 1;
    }
}

/// A tick, as the bench and the device know it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct EffortTick {
    /// Pressure of the muscles, cmH2O, and the number of efforts begun so far.
    pub muscle_pressure: f64,
    /// See `muscle_pressure`.
    pub efforts: u32,
    /// Tick of the breath, and the length of its inspiration.
    pub tick: u32,
    /// See `tick`.
    pub inspiration: u32,
    /// Whether the running breath is said to follow an effort.
    pub triggered: bool,
}

/// An effort that goes on.
#[derive(Clone, Copy, Debug, Default)]
struct Effort {
    /// Ticks since it began.
    age: u32,
    peak: f64,
    /// Whether it had to be followed.
    due: bool,
    /// Delay of the breath that followed, and whether it was triggered.
    followed: Option<(u32, bool)>,
}

/// Watches the efforts of one patient.
#[derive(Clone, Debug, Default)]
pub struct EffortWatch {
    count: u32,
    effort: Option<Effort>,
    /// Ticks since the muscles were last tense.
    quiet: u32,
    result: Efforts,
}

impl EffortWatch {
    /// Adds a tick.
    pub fn add(&mut self, now: &EffortTick) {
        if now.tick == 0 {
            self.breath_begins(now.triggered);
        }
        let relaxed = now.muscle_pressure.abs() < 1e-3;
        self.quiet = if relaxed { self.quiet.saturating_add(1) } else { 0 };
        if let Some(effort) = &mut self.effort {
            effort.age += 1;
            effort.peak = effort.peak.max(now.muscle_pressure);
        }
        if now.efforts != self.count {
            self.count = now.efforts;
            self.effort_ends();
            let due = now.tick >= now.inspiration + REFRACTORY_MS;
            self.effort = Some(Effort { due, ..Effort::default() });
        } else if relaxed && self.effort.is_some_and(|effort| effort.age > 1) {
            self.effort_ends();
        }
    }

    fn breath_begins(&mut self, triggered: bool) {
        self.result.breaths += 1;
        self.result.triggered += u64::from(triggered);
        self.result.self_triggered +=
            u64::from(triggered && self.effort.is_none() && self.quiet > SETTLES_MS);
        if let Some(effort) = &mut self.effort {
            effort.followed = effort.followed.or(Some((effort.age, triggered)));
        }
    }

    fn effort_ends(&mut self) {
        let Some(effort) = self.effort.take().filter(|effort| effort.due && effort.peak >= TELLING_CMH2O)
        else {
            return;
        };
        self.result.due += 1;
        match effort.followed {
            None => self.result.missed += 1,
            Some((delay, true)) => self.result.delayed(delay),
            Some((_, false)) => {}
        }
    }

    /// The counts so far.
    pub fn result(&self) -> &Efforts {
        &self.result
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::endure::course;
    use crate::endure::patient::Patient;
    use crate::endure::sound_controller;
    use plant::bench::{BenchConfig, LeakChange};
    use rayon::prelude::*;
    use shared::settings::Settings;

    /// An effort of a peak from one tick to another of a breath that ends at `end`, its efforts after those before it.
    fn breath(watch: &mut EffortWatch, triggered: bool, effort: (u32, u32, f64), end: u32) {
        let before = watch.count;
        for tick in 0..end {
            let (from, to, peak) = effort;
            let muscle_pressure = if (from..to).contains(&tick) { peak } else { 0.0 };
            let efforts = before + u32::from(tick >= from);
            watch.add(&EffortTick { muscle_pressure, efforts, tick, inspiration: 1000, triggered });
        }
    }

    const NONE: (u32, u32, f64) = (u32::MAX, u32::MAX, 0.0);

    #[test]
    fn an_effort_in_an_expiration_is_followed_or_missed() {
        let mut watch = EffortWatch::default();
        breath(&mut watch, false, (2000, 3000, 3.0), 2045);
        breath(&mut watch, true, NONE, 3000);
        breath(&mut watch, false, (1300, 1600, 3.0), 3000);
        breath(&mut watch, false, (2900, 4000, 3.0), 3000);
        breath(&mut watch, false, NONE, 3000);
        let efforts = watch.result();
        assert_eq!((efforts.due, efforts.missed, efforts.triggered, efforts.self_triggered), (3, 1, 1, 0));
        assert_eq!(efforts.median_delay_ms(), Some(50), "45 ms; the clock's breath has no delay");
    }

    #[test]
    fn a_weak_effort_and_one_in_an_inspiration_need_no_breath() {
        let mut watch = EffortWatch::default();
        breath(&mut watch, false, (2000, 2500, 2.9), 3000);
        breath(&mut watch, false, (500, 800, 9.0), 3000);
        breath(&mut watch, false, (1299, 1600, 9.0), 3000);
        breath(&mut watch, false, NONE, 3000);
        assert_eq!(watch.result().due, 0);
    }

    #[test]
    fn a_triggered_breath_without_an_effort_is_self_triggered() {
        let mut watch = EffortWatch::default();
        breath(&mut watch, false, (1200, 1500, 9.0), 1801);
        breath(&mut watch, true, NONE, 2000);
        breath(&mut watch, false, (1200, 1500, 9.0), 1799);
        breath(&mut watch, true, NONE, 2000);
        assert_eq!((watch.result().triggered, watch.result().self_triggered), (2, 1), "an effort's end");
        assert!((watch.result().self_triggered_per_mille() - 250.0).abs() < 1e-9);
    }

    #[test]
    fn the_median_delay_is_that_of_half_of_the_efforts() {
        let mut efforts = Efforts::default();
        assert_eq!(efforts.median_delay_ms(), None);
        for ms in [5, 12, 19, 33, 9999] {
            efforts.delayed(ms);
        }
        assert_eq!(efforts.median_delay_ms(), Some(20));
        let mut twice = efforts.clone();
        twice.add(&efforts);
        assert_eq!((twice.median_delay_ms(), twice.delays.iter().sum::<u64>()), (Some(20), 10));
    }

    /// A patient on this lung who makes efforts of a strength faster than the set rate, at an adult's machine drawn from the seed.
    fn patient(number: u64, lung: (f64, f64), effort: f64, leak: f64, rate: f32) -> Patient {
        let mut drawn = (0..).map(|seed| Patient::draw(21 + seed, number, 0.1));
        let mut patient = drawn.find(|patient| !patient.newborn).unwrap();
        patient.changes.clear();
        patient.settings = Settings { rate, inspiratory_time: 0.8, fall_time: 0.3, ..Settings::default() };
        let bench = &mut patient.bench;
        let first = &mut bench.lung.first;
        (first.resistance_cmh2o_per_l_s, first.compliance_ml_per_cmh2o) = lung;
        bench.circuit.leak_l_per_s_at_30_cmh2o = leak;
        bench.circuit.leak_changes.clear();
        bench.faults.clear();
        bench.patient = BenchConfig::default().patient;
        bench.patient.effort_cmh2o = effort;
        bench.patient.effort_rate_per_min = 1.3 * f64::from(rate);
        bench.patient.effort_duration_s = 1.0;
        bench.patient.effort_variability_percent = 15.0;
        patient
    }

    /// The counts of patients with these strengths of effort on nine lungs, without and with a leak of 0.3 L/s.
    fn follow(strengths: &[f64]) -> Efforts {
        let (controller, _) = sound_controller().unwrap();
        let mut patients = Vec::new();
        for resistance in [5.0, 20.0, 50.0] {
            for compliance in [10.0, 20.0, 50.0] {
                for (leak, rate) in [(0.005, 12.0), (0.005, 20.0), (0.15, 20.0), (0.3, 12.0)] {
                    for effort in strengths {
                        let number = patients.len() as u64;
                        patients.push(patient(number, (resistance, compliance), *effort, leak, rate));
                    }
                }
            }
        }
        let stays: Vec<_> = patients
            .par_iter()
            .map(|patient| course::run(patient, &controller, 0.1, &mut ()).unwrap().unwrap().efforts)
            .collect();
        let mut sum = Efforts::default();
        for stay in &stays {
            sum.add(stay);
        }
        sum
    }

    /// Verifies: effort-triggers.
    #[test]
    fn breaths_follow_efforts_on_nine_lungs_with_and_without_a_leak() {
        let efforts = follow(&[3.0, 8.0]);
        let delay = efforts.median_delay_ms().unwrap();
        assert!(efforts.due > 5000 && delay <= 100, "{} efforts, {delay} ms", efforts.due);
        assert!(efforts.missed_share() <= 0.02, "{} of {} missed", efforts.missed, efforts.due);
        let self_triggered = efforts.self_triggered_per_mille();
        assert!(self_triggered <= 1.0, "{self_triggered} in 1000");
    }

    /// The counts of patients with these strengths of effort at a PEEP, in whom a leak of this size begins after a minute.
    fn with_a_large_leak(strengths: &[f64], peep: f32, leak: f64) -> Efforts {
        let (controller, _) = sound_controller().unwrap();
        let mut patients = Vec::new();
        for lung in [(5.0, 10.0), (5.0, 50.0), (20.0, 20.0), (50.0, 10.0), (50.0, 50.0)] {
            for effort in strengths {
                let mut patient = patient(patients.len() as u64, lung, *effort, 0.005, 16.0);
                (patient.settings.peep, patient.settings.pip) = (peep, peep + 15.0);
                let change = LeakChange { at_s: 61.0, leak_l_per_s_at_30_cmh2o: leak };
                patient.bench.circuit.leak_changes = vec![change];
                patients.push(patient);
            }
        }
        let stay =
            |patient: &Patient| course::run(patient, &controller, 0.1, &mut ()).unwrap().unwrap().efforts;
        let mut sum = Efforts::default();
        for stay in &patients.par_iter().map(stay).collect::<Vec<_>>() {
            sum.add(stay);
        }
        sum
    }

    /// Verifies: no-false-triggers.
    #[test]
    fn up_to_the_largest_leak_efforts_alone_start_breaths() {
        for (peep, leak) in [(5.0, 0.9), (5.0, 1.0), (15.0, 0.5), (15.0, 1.0)] {
            let passive = with_a_large_leak(&[0.0], peep, leak);
            // One as the leak begins: nothing tells it from an effort then.
            assert!(passive.breaths > 400, "PEEP {peep}, leak {leak}: {passive:?}");
            assert!(passive.self_triggered <= 5, "PEEP {peep}, leak {leak}: {passive:?}");
            let breathing = with_a_large_leak(&[5.0, 12.0], peep, leak);
            assert!(breathing.due > 500, "PEEP {peep}, leak {leak}: {breathing:?}");
            assert!(breathing.missed_share() <= 0.05, "PEEP {peep}, leak {leak}: {breathing:?}");
            assert!(breathing.self_triggered <= 10, "PEEP {peep}, leak {leak}: {breathing:?}");
        }
    }

    /// Verifies: no-false-triggers.
    #[test]
    fn a_passive_patient_starts_no_breath() {
        let efforts = follow(&[0.0]);
        assert!(efforts.breaths > 3000 && efforts.self_triggered_per_mille() <= 1.0, "{efforts:?}");
    }
}
