//! The virtual board as a source: the real image in QEMU, the bench as its lung, the link in between.
//!
//! It gives the samples of [`super::BenchSource`] under the same seed, bit for bit.

use std::sync::PoisonError;

use shared::control::Controller;
use shared::explore::Exploration;
use shared::settings::Settings;

use super::{PortSource, Source, SourceError, Tick, TickTruth};
use device::Device;
use device::port::Address;
use emulator::{BenchPlant, Emulator, EmulatorConfig, LockstepPlant, TruthLog};
use plant::bench::BenchConfig;

/// A board that runs as long as this lives.
pub struct VirtualBoard {
    // Dropped first: it stops the device while that can still be reached.
    port: PortSource,
    _emulator: Emulator,
}

impl VirtualBoard {
    /// Switches a board on whose plant is this bench with the noise of `seed`.
    ///
    /// # Errors
    /// A bench that cannot be built, QEMU or images that are missing, a device that does not answer.
    pub fn start(config: EmulatorConfig, bench: &BenchConfig, seed: u64) -> Result<Self, SourceError> {
        let plant = BenchPlant::new(bench)?;
        let truths = plant.truths();
        let emulator = Emulator::start(config, LockstepPlant::new(plant))?;
        let device = Device::connect(&Address::Tcp(emulator.address().to_string()))?;
        let truth = Box::new(move |tick| truth_at(&truths, tick));
        let port = PortSource::new(device, seed)?.with_plant(
            format!("{} on the virtual board", bench.name),
            bench.to_toml(),
            Some(truth),
        );
        Ok(Self { port, _emulator: emulator })
    }

    /// The device's end of the link.
    pub fn port(&mut self) -> &mut PortSource {
        &mut self.port
    }
}

fn truth_at(truths: &TruthLog, tick: usize) -> Option<TickTruth> {
    truths.lock().unwrap_or_else(PoisonError::into_inner).get(tick).copied()
}

impl Source for VirtualBoard {
    fn period_us(&self) -> u32 {
        self.port.period_us()
    }

    fn plant(&self) -> String {
        self.port.plant()
    }

    fn plant_parameters(&self) -> String {
        self.port.plant_parameters()
    }

    fn configure(
        &mut self,
        controller: Controller,
        exploration: Option<Exploration>,
    ) -> Result<(), SourceError> {
        self.port.configure(controller, exploration)
    }

    fn upcoming(&mut self, settings: &[Settings]) -> Result<(), SourceError> {
        self.port.upcoming(settings)
    }

    fn breath(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError> {
        self.port.breath(settings, sink)
    }

    fn acknowledge(&mut self) -> Result<(), SourceError> {
        self.port.acknowledge()
    }
}
