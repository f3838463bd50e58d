//! The bench as a plant, driven in control periods.

use shared::settings::Settings;

use super::{Bench, BenchConfig, BenchError, end_stops, steps_per_period};
use crate::{Plant, Reading};

/// A bench behind a sensor and two valves. It steps in whole milliseconds; at other periods it reads NaN.
#[derive(Clone, Debug)]
pub struct BenchPlant {
    config: BenchConfig,
    /// The bench, whose parts may be made to fail at any time.
    pub bench: Bench,
    /// Number of bench steps in a control period; `None` if the last reset failed.
    steps: u32,
}

impl BenchPlant {
    /// A bench at rest at the default PEEP, with control periods of 1 ms until it is reset.
    ///
    /// # Errors
    /// A bench that cannot be built.
    pub fn new(config: &BenchConfig) -> Result<Self, BenchError> {
        Self::at_rest(config, Settings::default().peep, 0)
    }

    /// The same at another PEEP, cmH2O, and with this seed of its random numbers.
    ///
    /// # Errors
    /// As [`Bench::new`].
    pub fn at_rest(config: &BenchConfig, peep: f32, seed: u64) -> Result<Self, BenchError> {
        Ok(Self { config: config.clone(), bench: Bench::new(config, peep, seed)?, steps: 1 })
    }

    fn reading(&mut self, pressure: f32) -> Reading {
        let (outlet, flow) = (self.bench.outlet_reading(), self.bench.flow_reading());
        Reading { pressure, outlet, flow, truth: Some(self.bench.pressures()) }
    }
}

impl Plant for BenchPlant {
    type Error = BenchError;

    fn name(&self) -> String {
        self.config.name.clone()
    }

    fn parameters(&self) -> String {
        self.config.to_toml()
    }

    fn reset(&mut self, period_us: u32, seed: u64, peep: f32) -> Result<Reading, BenchError> {
        self.steps = 0;
        let (steps, peep) = (steps_per_period(period_us)?, end_stops(peep) as f32);
        self.bench = Bench::new(&self.config, peep, seed)?;
        self.steps = steps;
        Ok(self.reading(peep))
    }

    fn set_peep(&mut self, peep: f32) -> Result<(), BenchError> {
        self.bench.set_peep(peep);
        Ok(())
    }

    #[inline]
    fn step(&mut self, u_in: f32, u_out: bool) -> Result<Reading, BenchError> {
        let mut pressure = f32::NAN;
        for _ in 0..self.steps {
            pressure = self.bench.step(u_in, u_out);
        }
        Ok(self.reading(pressure))
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Failure, PEEP_RANGE_CMH2O};
    use super::*;

    fn plant() -> BenchPlant {
        BenchPlant::new(&BenchConfig::paper(20.0, 20.0)).unwrap()
    }

    #[test]
    fn a_reset_starts_it_as_the_first_time() {
        let mut plant = plant();
        let run = |plant: &mut BenchPlant| {
            let rest = plant.reset(1000, 1, 5.0).unwrap();
            let steps: Vec<_> = (0..50).map(|_| plant.step(60.0, false).unwrap()).collect();
            (rest, steps)
        };
        let first = run(&mut plant);
        assert_eq!(run(&mut plant), first);
        assert!(first.1[49].pressure > first.0.pressure + 1.0);
    }

    #[test]
    fn it_reports_all_three_sensors() {
        let mut config = BenchConfig::paper(20.0, 20.0);
        for sensor in [&mut config.outlet_sensor.noise_sd_cmh2o, &mut config.flow_sensor.noise_sd_l_per_s] {
            *sensor = 0.0;
        }
        config.outlet_sensor.quantum_cmh2o = 0.0;
        let mut plant = BenchPlant::new(&config).unwrap();
        let rest = plant.reset(1_000, 1, 5.0).unwrap();
        assert!((rest.outlet - 5.0).abs() < 1e-6 && rest.flow.abs() < 1e-6);
        config.flow_sensor.present = false;
        let mut plant = BenchPlant::new(&config).unwrap();
        plant.reset(1_000, 1, 5.0).unwrap();
        let reading = plant.step(50.0, false).unwrap();
        assert!((reading.outlet - reading.pressure).abs() < 1.0 && reading.flow.is_nan());
    }

    #[test]
    fn a_failure_lasts_until_it_is_restored_and_a_cough_is_one_pulse() {
        let mut plant = plant();
        let highest = |plant: &mut BenchPlant| {
            (0..1000).map(|_| plant.step(15.0, false).unwrap().pressure).fold(0.0, f32::max)
        };
        let sound = highest(&mut plant);
        plant.bench.fail(Failure::Disconnected);
        highest(&mut plant);
        assert!(highest(&mut plant) < 2.0);
        plant.bench.restore();
        (0..5).for_each(|_| _ = highest(&mut plant));
        assert!(highest(&mut plant) >= sound - 1.0);
        let mut coughing = BenchPlant::new(&BenchConfig::paper(20.0, 20.0)).unwrap();
        coughing.bench.cough(40.0);
        assert!(highest(&mut coughing) > sound + 10.0);
    }

    #[test]
    fn a_period_that_it_cannot_run_gives_no_number() {
        let mut plant = plant();
        for period_us in [0, 1500] {
            assert!(matches!(plant.reset(period_us, 1, 5.0), Err(BenchError::Period { .. })));
            assert!(plant.step(10.0, false).unwrap().pressure.is_nan());
        }
        assert!(plant.reset(2000, 1, 5.0).is_ok());
        assert!(!plant.step(10.0, false).unwrap().pressure.is_nan());
    }

    #[test]
    fn the_peep_valve_has_end_stops() {
        let reading = plant().reset(1000, 1, 1e9).unwrap();
        assert!(f64::from(reading.pressure) <= *PEEP_RANGE_CMH2O.end());
    }
}
