//! On the desk: the virtual bench, which the chip simulates itself, in place of sensors and valves.

use bench::{Bench, BenchConfig, end_stops};
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

/// The bench, static because it takes kilobytes.
static RIG: StaticCell<Rig> = StaticCell::new();

/// A bench and its description. Until its first start there is none: it is built in place.
struct Rig {
    config: BenchConfig,
    bench: Option<Bench>,
}

/// The bench as the ventilator's sensors and valves.
pub struct Desk {
    rig: &'static mut Rig,
    command: ValveCommand,
}

impl Desk {
    /// The default bench at rest. Called once.
    #[inline(never)]
    pub fn new() -> Self {
        let rig = RIG.init_with(|| Rig { config: BenchConfig::default(), bench: None });
        rig.start(Settings::default().peep, 0);
        Self { rig, command: ValveCommand::SAFE }
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

impl Rig {
    /// Begins at rest at `peep` cmH2O; returns the readings there.
    #[inline(never)]
    fn start(&mut self, peep: f32, seed: u64) -> Readings {
        let peep = end_stops(peep) as f32;
        // The description was validated, and the valve's end stops limit PEEP.
        self.bench = Bench::new(&self.config, peep, seed).ok();
        self.readings(peep)
    }

    /// Runs 1 ms.
    fn step(&mut self, command: &ValveCommand) -> Readings {
        let bench = self.bench.as_mut();
        let airway = bench.map_or(f32::NAN, |bench| bench.step(command.u_in(), command.u_out()));
        self.readings(airway)
    }

    fn readings(&mut self, airway: f32) -> Readings {
        self.bench.as_mut().map_or(f32::NAN.into(), |bench| Readings {
            airway,
            outlet: bench.outlet_reading(),
            flow: bench.flow_reading(),
        })
    }

    /// The PEEP to which the valve was last turned, cmH2O.
    fn peep(&self) -> f32 {
        self.bench.as_ref().map_or(0.0, Bench::peep)
    }
}

impl PlantInterface for Desk {
    const KIND: DeviceKind = DeviceKind::Desk;

    fn read(&mut self, change: &PlantChange) -> Readings {
        let rig = &mut *self.rig;
        let described = DESCRIBED.try_take().map(|config| rig.config = config).is_some();
        if described || change.reset.is_some() {
            return rig.start(change.peep.unwrap_or(rig.peep()), change.reset.unwrap_or(0));
        }
        let readings = rig.step(&self.command);
        // A new PEEP is for the breath that begins, after the last step of the one before.
        if let (Some(peep), Some(bench)) = (change.peep, &mut rig.bench) {
            bench.set_peep(peep);
        }
        readings
    }

    fn drive(&mut self, command: &ValveCommand) {
        self.command = *command;
    }
}
