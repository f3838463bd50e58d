//! The ventilator core of `shared` in this process, on any plant: the loop that reads, decides and moves the valves.

use std::sync::{Arc, Mutex};

use shared::control::{ControlLaw, Controller};
use shared::explore::Exploration;
use shared::explore::sines::SineSweep;
use shared::safety::alarms::Fault;
use shared::safety::filter::ValveCommand;
use shared::safety::ladder::Level;
use shared::safety::monitors::Monitors;
use shared::sensor::Readings;
use shared::settings::Settings;
use shared::ventilator::{Mode, Output, Ventilator, VentilatorState};

use super::{REST_TIME, Reseed, Source, SourceError, Tick};
use plant::balloon::{self, Balloon};
use plant::bench::{BenchConfig, BenchPlant};
use plant::link::PlantLink;
use plant::{Plant, Reading};

/// A ventilator on a plant, with a [`Controller`] or any other control law.
#[derive(Clone, Debug)]
pub struct InProcess<P, C: ControlLaw = Controller> {
    plant: P,
    ventilator: Ventilator<C>,
    /// Whether only a latched fault ends a breath with an error.
    goes_on: bool,
    /// Seed of the plant's random numbers.
    seed: u64,
    /// `None` before the first breath, which brings the settings, and after a new seed.
    run: Option<Run<C::State>>,
}

/// A running plant and ventilator.
#[derive(Clone, Debug)]
struct Run<S> {
    state: VentilatorState<S>,
    reading: Reading,
    /// Setting of the plant's PEEP valve, cmH2O.
    peep: f32,
}

/// A ventilator on the virtual bench.
pub type BenchSource<C = Controller> = InProcess<BenchPlant, C>;
/// A link used by several sources, one after the other.
pub type SharedLink = Arc<Mutex<PlantLink>>;
/// A ventilator on a third-party plant.
pub type PlantSource<C = Controller> = InProcess<SharedLink, C>;
/// A ventilator on the authors' balloon, at its control period of 30 ms.
pub type BalloonSource = InProcess<Balloon>;

impl<C: ControlLaw> InProcess<BenchPlant, C> {
    /// A ventilator at rest on a bench; `seed` is that of the sensor noise.
    ///
    /// # Errors
    /// A bench that cannot be built, settings that are refused, or a period that is not a multiple of the bench's step.
    pub fn new(
        config: &BenchConfig,
        controller: C,
        settings: &Settings,
        period_us: u32,
        seed: u64,
    ) -> Result<Self, SourceError> {
        let ventilator = Ventilator::new(period_us, controller);
        let mut source =
            Self { plant: BenchPlant::new(config)?, ventilator, goes_on: false, seed, run: None };
        source.run = Some(source.start(settings)?);
        Ok(source)
    }
}

impl<C: ControlLaw> InProcess<SharedLink, C> {
    /// A ventilator on a plant, which is reset with `seed` before the first breath.
    pub fn new(link: SharedLink, controller: C, period_us: u32, seed: u64) -> Self {
        Self::on_any_plant(link, controller, period_us, seed)
    }
}

impl InProcess<Balloon> {
    /// A ventilator at rest.
    pub fn new(controller: Controller) -> Self {
        Self::on_any_plant(Balloon::default(), controller, balloon::PERIOD_US, 0)
    }
}

impl<P, C: ControlLaw> InProcess<P, C> {
    /// With only the monitors that suit any plant's valve and sensor: those of excessive pressure.
    fn on_any_plant(plant: P, controller: C, period_us: u32, seed: u64) -> Self {
        let ventilator = Ventilator::new(period_us, controller).with_monitors(Monitors::ANY_PLANT);
        Self { plant, ventilator, goes_on: false, seed, run: None }
    }

    /// Goes on as a device does after a breath that is useless for a recording: one that the pressure limit or the loss of the
    /// reading has ended. Only a latched fault is still an error.
    #[must_use]
    pub fn going_on(mut self) -> Self {
        self.goes_on = true;
        self
    }
}

impl<P, C: ControlLaw> InProcess<P, C> {
    /// Enables only these monitors.
    #[must_use]
    pub fn with_monitors(mut self, monitors: Monitors) -> Self {
        self.ventilator = self.ventilator.with_monitors(monitors);
        self
    }
}

impl<P: Plant, C: ControlLaw> InProcess<P, C>
where
    SourceError: From<P::Error>,
{
    /// Runs one whole breath; see [`Source::breath`].
    ///
    /// # Errors
    /// Refused settings, a fault of the ventilator or of the plant.
    pub fn breathe(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError> {
        let mut breath = self.begin(settings)?;
        loop {
            if breath.tick(sink)? && breath.is_at_start() {
                return Ok(());
            }
        }
    }

    /// Begins a breath with these settings, for a caller that runs it tick by tick. Only at the end of a breath.
    ///
    /// # Errors
    /// Refused settings or a plant that cannot be reset.
    pub fn begin(&mut self, settings: &Settings) -> Result<RunningBreath<'_, P, C>, SourceError> {
        if self.run.is_none() {
            self.run = Some(self.start(settings)?);
        }
        let mut breathing = self.breathing().expect("it runs");
        breathing.begin(settings)?;
        Ok(breathing)
    }

    /// The running breath; none before the first one.
    #[inline]
    pub fn breathing(&mut self) -> Option<RunningBreath<'_, P, C>> {
        let Self { plant, ventilator, goes_on, run, .. } = self;
        Some(RunningBreath { plant, ventilator, goes_on: *goes_on, run: run.as_mut()? })
    }

    /// Whether an effort of the patient starts the next breath.
    pub fn triggered(&self) -> bool {
        self.run.as_ref().is_some_and(|run| run.state.triggered())
    }

    /// Resets the plant with these settings.
    fn start(&mut self, settings: &Settings) -> Result<Run<C::State>, SourceError> {
        let state = self.ventilator.standby(settings)?;
        let reading = self.plant.reset(self.ventilator.period_us(), self.seed, settings.peep)?;
        Ok(Run { state, reading, peep: settings.peep })
    }
}

/// A breath that runs tick by tick.
#[derive(Debug)]
pub struct RunningBreath<'a, P, C: ControlLaw> {
    plant: &'a mut P,
    ventilator: &'a mut Ventilator<C>,
    /// As in [`InProcess`].
    goes_on: bool,
    run: &'a mut Run<C::State>,
}

impl<P, C: ControlLaw> RunningBreath<'_, P, C> {
    /// The plant's reading at the start of the next tick.
    pub fn reading(&self) -> &Reading {
        &self.run.reading
    }

    /// The ventilator's state before the next tick.
    pub fn state(&self) -> &VentilatorState<C::State> {
        &self.run.state
    }

    /// Replaces the controller from the next tick on.
    pub fn set_controller(&mut self, controller: C) {
        self.ventilator.set_controller(controller);
    }

    /// Whether the next tick starts a breath.
    pub fn is_at_start(&self) -> bool {
        self.run.state.tick() == 0
    }
}

impl<P: Plant, C: ControlLaw> RunningBreath<'_, P, C>
where
    SourceError: From<P::Error>,
{
    /// Applies the settings of a breath and lets it start.
    fn begin(&mut self, settings: &Settings) -> Result<(), SourceError> {
        let run = &mut *self.run;
        self.ventilator.apply(&mut run.state, settings)?;
        run.state.start();
        if run.peep.to_bits() != settings.peep.to_bits() {
            self.plant.set_peep(settings.peep)?;
            run.peep = settings.peep;
        }
        Ok(())
    }

    /// One control tick: the ventilator reads and decides, then the plant runs one control period. The tick is recorded
    /// before the plant answers, in case it fails. Returns whether the breath advanced; without a valid reading it
    /// waits.
    ///
    /// # Errors
    /// A fault that makes the breath useless for a recording, or one of the plant.
    #[inline]
    pub fn tick(&mut self, sink: &mut (impl FnMut(&Tick) + ?Sized)) -> Result<bool, SourceError> {
        let run = &mut *self.run;
        let Reading { pressure: airway, outlet, flow, truth } = run.reading;
        let output = self.ventilator.step(&mut run.state, Readings { airway, outlet, flow });
        let fault = if self.goes_on { latched(&output) } else { broken_off(&run.state, &output) };
        if let (Some(sample), None) = (output.sample, fault) {
            sink(&Tick { sample, truth });
        }
        run.reading = self.plant.step(output.command.u_in(), output.command.u_out())?;
        match fault {
            Some(fault) => {
                Err(SourceError::Fault { fault, breath: run.state.breath_number(), tick: run.state.tick() })
            }
            None => Ok(output.sample.is_some()),
        }
    }
}

/// The latched fault, if there is one.
fn latched(output: &Output) -> Option<Fault> {
    match output.mode {
        Mode::Fault(fault) => Some(fault),
        _ => None,
    }
}

/// Why a tick makes its breath useless for a recording, if it does: a latched fault, the pressure limit, or a lost reading.
fn broken_off<S>(state: &VentilatorState<S>, output: &Output) -> Option<Fault> {
    match latched(output) {
        Some(fault) => Some(fault),
        _ if state.cut() => Some(Fault::HighPressure),
        _ if state.level() == Level::Backup => state.indications().cause_of_backup(),
        _ => None,
    }
}

impl<P: Plant, C: ControlLaw> Source<C> for InProcess<P, C>
where
    SourceError: From<P::Error>,
{
    fn period_us(&self) -> u32 {
        self.ventilator.period_us()
    }

    fn plant(&self) -> String {
        self.plant.name()
    }

    fn plant_parameters(&self) -> String {
        self.plant.parameters()
    }

    fn configure(&mut self, controller: C, exploration: Option<Exploration>) -> Result<(), SourceError> {
        self.ventilator.set_controller(controller);
        self.ventilator.set_exploration(exploration);
        Ok(())
    }

    fn sweep(&mut self, sweep: Option<SineSweep>) -> Result<(), SourceError> {
        sweep.as_ref().map_or(Ok(()), SineSweep::validate)?;
        self.ventilator.set_sweep(sweep);
        Ok(())
    }

    fn breath(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError> {
        self.breathe(settings, sink)
    }

    fn acknowledge(&mut self) -> Result<(), SourceError> {
        let Some(run) = &mut self.run else { return Ok(()) };
        for _ in 0..shared::math::ticks(REST_TIME, self.ventilator.period_us()) {
            run.reading = self.plant.step(ValveCommand::SAFE.u_in(), ValveCommand::SAFE.u_out())?;
        }
        run.state.stop();
        run.state.acknowledge();
        Ok(())
    }
}

impl<P: Plant, C: ControlLaw> Reseed<C> for InProcess<P, C>
where
    SourceError: From<P::Error>,
{
    fn reseed(&mut self, seed: u64) {
        (self.seed, self.run) = (seed, None);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::bench::BenchError;
    use shared::breath::{DEFAULT_PERIOD_US, Phase, paper_settings};
    use shared::control::pid::{Pid, PidGains};
    use shared::ventilator::Sample;

    fn on_bench(period_us: u32) -> BenchSource {
        let pid = Pid::new(PidGains { p: 1.0, i: 20.0, d: 0.0 }, period_us).unwrap();
        let lung = BenchConfig::paper(20.0, 20.0);
        BenchSource::new(&lung, Controller::Pid(pid), &paper_settings(20.0), period_us, 1).unwrap()
    }

    fn on_balloon() -> BalloonSource {
        let pid = Pid::new(PidGains { p: 3.0, i: 8.0, d: 0.0 }, balloon::PERIOD_US).unwrap();
        BalloonSource::new(Controller::Pid(pid))
    }

    fn samples(source: &mut BenchSource, pip: f32) -> Vec<Sample> {
        let mut samples = Vec::new();
        source.breath(&paper_settings(pip), &mut |tick| samples.push(tick.sample)).unwrap();
        samples
    }

    #[test]
    fn a_breath_gives_every_tick_once() {
        for (period_us, ticks) in [(DEFAULT_PERIOD_US, 3000), (30_000, 100)] {
            let samples = samples(&mut on_bench(period_us), 20.0);
            assert_eq!(samples.len(), ticks);
            assert!(samples.iter().enumerate().all(|(n, s)| s.tick == n as u32));
        }
    }

    #[test]
    fn settings_hold_from_the_breath_they_are_given_with() {
        let mut source = on_bench(DEFAULT_PERIOD_US);
        for pip in [15.0, 30.0, 10.0] {
            assert!((samples(&mut source, pip)[500].target - pip).abs() < f32::EPSILON);
        }
    }

    #[test]
    fn a_new_seed_starts_the_plant_again() {
        let mut source = on_bench(DEFAULT_PERIOD_US);
        let first = samples(&mut source, 20.0);
        assert_ne!(samples(&mut source, 20.0), first);
        source.reseed(1);
        assert_eq!(samples(&mut source, 20.0), first);
    }

    #[test]
    fn truth_and_reading_are_of_the_same_instant() {
        let mut worst = 0.0_f32;
        on_bench(DEFAULT_PERIOD_US)
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
        assert!(matches!(refused, Err(SourceError::Bench(BenchError::Period { period_us: 1500 }))));
    }

    #[test]
    fn every_breath_on_the_balloon_starts_at_no_pressure_and_has_29_samples() {
        let mut source = on_balloon();
        for pip in [35.0, 10.0, 35.0] {
            let mut pressure = Vec::new();
            source
                .breath(&balloon::settings(pip), &mut |tick| {
                    if tick.sample.phase == Phase::Inspiration {
                        pressure.push(tick.sample.pressure);
                    }
                })
                .unwrap();
            assert_eq!(pressure.len(), balloon::SAMPLES);
            assert!(pressure[0].abs() < 1e-6 && pressure[balloon::SAMPLES - 1] > 0.9 * pip, "{pressure:?}");
        }
    }

    #[test]
    fn a_high_pressure_ends_the_breath_and_can_be_acknowledged() {
        let mut source = on_balloon();
        let limited = Settings { pressure_limit: 20.0, ..balloon::settings(15.0) };
        let exploration = Exploration {
            boundary_probability: 1.0,
            boundary_height: (100.0, 100.0),
            boundary_duration: (0.5, 0.5),
            ..Exploration::default()
        };
        source.configure(source.ventilator.controller().clone(), Some(exploration)).unwrap();
        assert!(matches!(source.breath(&limited, &mut |_| ()), Err(SourceError::Fault { .. })));
        source.acknowledge().unwrap();
        source.configure(source.ventilator.controller().clone(), None).unwrap();
        source.breath(&balloon::settings(15.0), &mut |_| ()).unwrap();
    }
}
