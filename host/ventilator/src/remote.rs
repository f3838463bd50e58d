//! A plant behind the lockstep link as a source: the ventilator core of `shared` here, valves and lung over there.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use shared::control::Controller;
use shared::explore::Exploration;
use shared::safety::filter::ValveCommand;
use shared::settings::Settings;
use shared::ventilator::{Ventilator, VentilatorState};

use super::bench::REST_TIME;
use super::{Reseed, Source, SourceError, Tick, TickTruth, broken_off, on_any_plant};
use plant::link::{PlantLink, Reading};

/// A link that several sources use one after the other.
pub type SharedLink = Arc<Mutex<PlantLink>>;

/// A ventilator on somebody else's plant.
pub struct PlantSource {
    link: SharedLink,
    ventilator: Ventilator,
    /// None until the first breath, which brings settings, and after a new seed.
    run: Option<Run>,
    seed: u64,
}

/// A plant that breathes.
struct Run {
    state: VentilatorState,
    reading: Reading,
    /// Setting of the plant's PEEP valve, cmH2O.
    peep: f32,
}

impl PlantSource {
    /// A ventilator on a plant, which starts anew with `seed` before the first breath.
    pub fn new(link: SharedLink, controller: Controller, period_us: u32, seed: u64) -> Self {
        Self { link, ventilator: on_any_plant(period_us, controller, None), run: None, seed }
    }

    fn link(&self) -> MutexGuard<'_, PlantLink> {
        self.link.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Brings the plant to rest, with these settings.
    fn start(&self, settings: &Settings) -> Result<Run, SourceError> {
        let mut state = self.ventilator.standby(settings)?;
        state.start();
        let reading = self.link().reset(self.period_us(), self.seed, settings.peep)?;
        Ok(Run { state, reading, peep: settings.peep })
    }

    /// All ticks of a breath.
    fn breathe(
        &self,
        run: &mut Run,
        settings: &Settings,
        sink: &mut dyn FnMut(&Tick),
    ) -> Result<(), SourceError> {
        self.ventilator.apply(&mut run.state, settings)?;
        let mut link = self.link();
        if run.peep.to_bits() != settings.peep.to_bits() {
            link.set_peep(settings.peep)?;
            run.peep = settings.peep;
        }
        loop {
            self.tick(run, &mut link, sink)?;
            if run.state.tick() == 0 {
                return Ok(());
            }
        }
    }

    /// One control tick: the ventilator decides, the plant runs one control period. The tick is known before the plant
    /// answers, and is not lost with it.
    fn tick(
        &self,
        run: &mut Run,
        link: &mut PlantLink,
        sink: &mut dyn FnMut(&Tick),
    ) -> Result<(), SourceError> {
        let Reading { pressure, truth } = run.reading;
        let output = self.ventilator.step(&mut run.state, pressure);
        if let Some(sample) = output.sample {
            sink(&Tick { sample, truth: truth.map(told) });
        }
        run.reading = link.step(output.command.u_in(), output.command.u_out())?;
        if let Some(error) = broken_off(&run.state, &output) {
            return Err(error);
        }
        if output.sample.is_none() {
            run.state.start();
            return self.tick(run, link, sink);
        }
        Ok(())
    }
}

/// A plant tells the airway's pressure and nothing else.
fn told(airway_pressure: f32) -> TickTruth {
    TickTruth { airway_pressure, sensor_pressure: f32::NAN, lung_volume: f32::NAN }
}

impl Source for PlantSource {
    fn period_us(&self) -> u32 {
        self.ventilator.period_us()
    }

    fn plant(&self) -> String {
        format!("plant at {}", self.link().address())
    }

    fn plant_parameters(&self) -> String {
        String::new()
    }

    fn configure(
        &mut self,
        controller: Controller,
        exploration: Option<Exploration>,
    ) -> Result<(), SourceError> {
        self.ventilator = on_any_plant(self.period_us(), controller, exploration);
        Ok(())
    }

    fn breath(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError> {
        let mut run = match self.run.take() {
            Some(run) => run,
            None => self.start(settings)?,
        };
        let outcome = self.breathe(&mut run, settings, sink);
        self.run = Some(run);
        outcome
    }

    fn acknowledge(&mut self) -> Result<(), SourceError> {
        let Some(mut run) = self.run.take() else { return Ok(()) };
        for _ in 0..shared::math::ticks(REST_TIME, self.period_us()) {
            run.reading = self.link().step(ValveCommand::SAFE.u_in(), ValveCommand::SAFE.u_out())?;
        }
        run.state.stop();
        run.state.acknowledge();
        run.state.start();
        self.run = Some(run);
        Ok(())
    }
}

impl Reseed for PlantSource {
    fn reseed(&mut self, seed: u64) {
        (self.seed, self.run) = (seed, None);
    }
}
