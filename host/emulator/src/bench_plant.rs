//! The virtual bench as a plant.

use std::sync::{Arc, Mutex, PoisonError};

use shared::settings::Settings;

use crate::lockstep::Plant;
use plant::TickTruth;
use plant::bench::{Bench, BenchConfig, BenchError, PEEP_RANGE_CMH2O, STEP_US};

/// The true pressures since the last reset: entry `n` is from the instant of the `n`-th reading, which is that of tick `n`
/// since then. It is there before the board has the reading.
pub type TruthLog = Arc<Mutex<Vec<TickTruth>>>;

/// A bench behind a sensor and two valves. It steps in whole milliseconds; for other periods it reads NaN.
#[derive(Debug)]
pub struct BenchPlant {
    config: BenchConfig,
    bench: Bench,
    /// Setting of the mechanical PEEP valve, cmH2O, which resets leave alone.
    peep: f32,
    steps_per_period: u32,
    reading: f32,
    truths: TruthLog,
}

impl BenchPlant {
    /// A bench at rest at the default PEEP; a reset comes before the first step.
    ///
    /// # Errors
    /// A bench that cannot be built.
    pub fn new(config: &BenchConfig) -> Result<Self, BenchError> {
        let peep = Settings::default().peep;
        let bench = Bench::new(config, peep, 0)?;
        let truths = TruthLog::default();
        Ok(Self { config: config.clone(), bench, peep, steps_per_period: 1, reading: peep, truths })
    }

    /// The true pressures as they are logged: the caller may look at them, and take away what is there.
    pub fn truths(&self) -> TruthLog {
        Arc::clone(&self.truths)
    }
}

/// Does something with a log; whoever panicked with it in hand has not harmed it.
fn with<T>(log: &TruthLog, work: impl FnOnce(&mut Vec<TickTruth>) -> T) -> T {
    work(&mut log.lock().unwrap_or_else(PoisonError::into_inner))
}

impl Plant for BenchPlant {
    fn reset(&mut self, period_us: u32, seed: u64) -> f32 {
        let bench = Bench::new(&self.config, self.peep, seed);
        self.steps_per_period = if period_us.is_multiple_of(STEP_US) { period_us / STEP_US } else { 0 };
        self.reading = match bench {
            Ok(bench) if self.steps_per_period > 0 => {
                self.bench = bench;
                self.peep
            }
            _ => f32::NAN,
        };
        with(&self.truths, |log| {
            log.clear();
            log.push(self.bench.pressures());
        });
        self.reading
    }

    fn step(&mut self, u_in: f32, u_out: bool) -> f32 {
        for _ in 0..self.steps_per_period {
            self.reading = self.bench.step(u_in, u_out).pressure;
        }
        with(&self.truths, |log| log.push(self.bench.pressures()));
        self.reading
    }

    fn set_peep(&mut self, peep: f32) -> f32 {
        if !peep.is_nan() {
            let limited = f64::from(peep).clamp(*PEEP_RANGE_CMH2O.start(), *PEEP_RANGE_CMH2O.end());
            self.peep = limited as f32;
            self.bench.set_peep(self.peep);
        }
        self.reading
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn bench() -> BenchConfig {
        BenchConfig::paper(20.0, 20.0)
    }

    #[test]
    fn a_reset_starts_bench_and_log_anew() {
        let mut plant = BenchPlant::new(&bench()).unwrap();
        let run = |plant: &mut BenchPlant| {
            plant.reset(1000, 1);
            let readings: Vec<_> = (0..50).map(|_| plant.step(60.0, false).to_bits()).collect();
            (readings, plant.truths().lock().unwrap().clone())
        };
        let first = run(&mut plant);
        assert_eq!(run(&mut plant), first);
        assert_eq!(first.1.len(), 51, "at rest and after each step");
    }

    #[test]
    fn a_period_that_it_cannot_run_gives_no_number() {
        let mut plant = BenchPlant::new(&bench()).unwrap();
        for period_us in [0, 1500] {
            assert!(plant.reset(period_us, 1).is_nan());
            assert!(plant.step(10.0, false).is_nan());
        }
        assert!(!plant.reset(2000, 1).is_nan());
    }

    #[test]
    fn the_peep_valve_has_end_stops() {
        let mut plant = BenchPlant::new(&bench()).unwrap();
        plant.set_peep(1e9);
        plant.set_peep(f32::NAN);
        assert!(f64::from(plant.reset(1000, 1)) <= *PEEP_RANGE_CMH2O.end());
    }
}
