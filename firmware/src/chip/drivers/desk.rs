//! On the desk: the virtual bench, which the chip simulates itself, in place of sensors and valves.

use bench::{Bench, BenchConfig, BenchError, end_stops};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use shared::device::control::PlantChange;
use shared::link::messages::DeviceKind;
use shared::link::refusal::Refusal;
use shared::safety::filter::ValveCommand;
use shared::sensor::Readings;
use shared::settings::Settings;
use static_cell::StaticCell;

use super::plant_interface::PlantInterface;

/// Bench that a host has described, for the next tick.
static DESCRIBED: Signal<CriticalSectionRawMutex, BenchConfig> = Signal::new();

/// The bench, static because it takes kilobytes. With its error, which never occurs: taking the value out would copy it through the
/// stack.
static BENCH: StaticCell<Result<Bench, BenchError>> = StaticCell::new();
/// What a host has described.
static CONFIG: StaticCell<BenchConfig> = StaticCell::new();

/// The bench as the ventilator's sensors and valves.
pub struct Desk {
    config: &'static mut BenchConfig,
    bench: &'static mut Bench,
    command: ValveCommand,
}

impl Desk {
    /// The default bench at rest. Called once.
    #[inline(never)]
    pub fn new() -> Self {
        let config = CONFIG.init_with(BenchConfig::default);
        match BENCH.init_with(|| Bench::new(config, Settings::default().peep, 0)) {
            Ok(bench) => Self { config, bench, command: ValveCommand::SAFE },
            Err(_) => unreachable!("the default bench and PEEP are valid"),
        }
    }

    /// Begins again at rest at `peep` cmH2O; returns the readings there.
    #[inline(never)]
    fn restart(&mut self, peep: f32, seed: u64) -> Readings {
        let peep = end_stops(peep) as f32;
        let restarted = self.bench.restart(self.config, peep, seed);
        debug_assert!(
            restarted.is_ok(),
            "the description was validated, and the valve's end stops limit PEEP"
        );
        self.readings(peep)
    }

    fn readings(&mut self, airway: f32) -> Readings {
        Readings { airway, outlet: self.bench.outlet_reading(), flow: self.bench.flow_reading() }
    }
}

/// Simulates the described bench from the next tick on.
///
/// # Errors
/// [`Refusal::BadBench`].
pub fn describe(description: &[u8]) -> Result<(), Refusal> {
    let config = BenchConfig::from_bytes(description).map_err(|_| Refusal::BadBench)?;
    DESCRIBED.signal(config);
    Ok(())
}

impl PlantInterface for Desk {
    const KIND: DeviceKind = DeviceKind::Desk;

    /// Runs 1 ms, or begins again.
    fn read(&mut self, change: &PlantChange) -> Readings {
        let described = DESCRIBED.try_take().map(|config| *self.config = config).is_some();
        if described || change.reset.is_some() {
            return self.restart(change.peep.unwrap_or(self.bench.peep()), change.reset.unwrap_or(0));
        }
        let airway = self.bench.step(self.command.u_in(), self.command.u_out());
        let readings = self.readings(airway);
        // A new PEEP is for the breath that begins, after the last step of the one before.
        if let Some(peep) = change.peep {
            self.bench.set_peep(peep);
        }
        readings
    }

    fn drive(&mut self, command: &ValveCommand) {
        self.command = *command;
    }
}
