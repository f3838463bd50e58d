//! The in-process source: the ventilator core of `shared`, its valves and its sensor on the virtual bench.

use shared::control::{ControlLaw, Controller};
use shared::explore::Exploration;
use shared::safety::filter::ValveCommand;
use shared::settings::Settings;
use shared::ventilator::{Ventilator, VentilatorState};

use super::{Source, SourceError, Tick, broken_off, ventilator};
use plant::bench::{Bench, BenchConfig, STEP_US};

/// How long a fault's vented lung rests before the next breath, s.
pub(super) const REST_TIME: f32 = 3.0;

/// A ventilator on the virtual bench, with a controller of ours or another.
#[derive(Clone, Debug)]
pub struct BenchSource<C: ControlLaw = Controller> {
    config: BenchConfig,
    bench: Bench,
    ventilator: Ventilator<C>,
    state: VentilatorState<C::State>,
    steps_per_tick: u32,
    reading: f32,
}

impl<C: ControlLaw> BenchSource<C> {
    /// A ventilator at rest on a bench; `seed` is that of the sensor's noise.
    ///
    /// # Errors
    /// A bench that cannot be built, settings that are refused, a period that is no multiple of the bench's step.
    pub fn new(
        config: &BenchConfig,
        controller: C,
        settings: &Settings,
        period_us: u32,
        seed: u64,
    ) -> Result<Self, SourceError> {
        if period_us == 0 || !period_us.is_multiple_of(STEP_US) {
            return Err(SourceError::Period { period_us });
        }
        let ventilator = ventilator(period_us, controller, None);
        let mut state = ventilator.standby(settings)?;
        state.start();
        let bench = Bench::new(config, settings.peep, seed)?;
        let (config, steps_per_tick) = (config.clone(), period_us / STEP_US);
        Ok(Self { config, bench, ventilator, state, steps_per_tick, reading: settings.peep })
    }

    /// The bench, for those who want to look behind the sensor.
    pub fn bench(&self) -> &Bench {
        &self.bench
    }

    /// Runs one whole breath, as [`Source::breath`] does.
    ///
    /// # Errors
    /// Refused settings or a fault of the ventilator.
    pub fn breathe(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError> {
        self.ventilator.apply(&mut self.state, settings)?;
        self.bench.set_peep(settings.peep);
        loop {
            let tick = self.tick()?;
            sink(&tick);
            if self.state.tick() == 0 {
                return Ok(());
            }
        }
    }

    /// One control tick: the ventilator reads, decides, and the bench runs one control period.
    #[inline]
    fn tick(&mut self) -> Result<Tick, SourceError> {
        let truth = self.bench.pressures();
        let output = self.ventilator.step(&mut self.state, self.reading);
        for _ in 0..self.steps_per_tick {
            self.reading = self.bench.step(output.command.u_in(), output.command.u_out()).pressure;
        }
        if let Some(error) = broken_off(&self.state, &output) {
            return Err(error);
        }
        let Some(sample) = output.sample else {
            self.state.start();
            return self.tick();
        };
        Ok(Tick { sample, truth: Some(truth) })
    }
}

impl Source for BenchSource {
    fn period_us(&self) -> u32 {
        self.ventilator.period_us()
    }

    fn plant(&self) -> String {
        self.config.name.clone()
    }

    fn plant_parameters(&self) -> String {
        self.config.to_toml()
    }

    fn configure(
        &mut self,
        controller: Controller,
        exploration: Option<Exploration>,
    ) -> Result<(), SourceError> {
        self.ventilator = ventilator(self.period_us(), controller, exploration);
        Ok(())
    }

    fn breath(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError> {
        self.breathe(settings, sink)
    }

    fn acknowledge(&mut self) -> Result<(), SourceError> {
        for _ in 0..shared::math::ticks(REST_TIME, STEP_US) {
            self.reading = self.bench.step(ValveCommand::SAFE.u_in(), ValveCommand::SAFE.u_out()).pressure;
        }
        self.state.stop();
        self.state.acknowledge();
        self.state.start();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
    use shared::control::pid::{Pid, PidGains};
    use shared::ventilator::Sample;

    fn source(period_us: u32) -> BenchSource {
        let pid = Pid::new(PidGains { p: 1.0, i: 20.0, d: 0.0 }, period_us).unwrap();
        let lung = BenchConfig::paper(20.0, 20.0);
        BenchSource::new(&lung, Controller::Pid(pid), &paper_settings(20.0), period_us, 1).unwrap()
    }

    fn samples(source: &mut BenchSource, pip: f32) -> Vec<Sample> {
        let mut samples = Vec::new();
        source.breath(&paper_settings(pip), &mut |tick| samples.push(tick.sample)).unwrap();
        samples
    }

    #[test]
    fn a_breath_gives_every_tick_once() {
        for (period_us, ticks) in [(DEFAULT_PERIOD_US, 3000), (30_000, 100)] {
            let samples = samples(&mut source(period_us), 20.0);
            assert_eq!(samples.len(), ticks);
            assert!(samples.iter().enumerate().all(|(n, s)| s.tick == n as u32));
        }
    }

    #[test]
    fn settings_hold_from_the_breath_they_are_given_with() {
        let mut source = source(DEFAULT_PERIOD_US);
        for pip in [15.0, 30.0, 10.0] {
            assert!((samples(&mut source, pip)[500].target - pip).abs() < f32::EPSILON);
        }
    }

    #[test]
    fn truth_and_reading_are_of_the_same_instant() {
        let mut worst = 0.0_f32;
        source(DEFAULT_PERIOD_US)
            .breath(&paper_settings(25.0), &mut |tick| {
                worst = worst.max((tick.sample.pressure - tick.truth.unwrap().sensor_pressure).abs());
            })
            .unwrap();
        assert!(worst < 0.6, "noise of 0.1 cmH2O and a quantum of 0.07 cmH2O, not {worst}");
    }

    #[test]
    fn a_period_that_the_bench_cannot_run_is_refused() {
        let pid = Pid::new(PidGains::default(), 1500).unwrap();
        let lung = BenchConfig::paper(20.0, 20.0);
        let refused = BenchSource::new(&lung, Controller::Pid(pid), &paper_settings(20.0), 1500, 1);
        assert!(matches!(refused, Err(SourceError::Period { period_us: 1500 })));
    }
}
