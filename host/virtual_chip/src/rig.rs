//! The rig of every simulated device: its control half, the bench in place of sensors and valves, and the ticks.
//!
//! A tick is [`Rig::follow`] -> [`Rig::step`] -> [`Rig::run_plant`], from any of the three on: the owner decides what
//! lies between them, such as faults of a sensor, requests of a host, and ticks that the device misses.

use plant::bench::BenchPlant;
use plant::{Plant, Reading};
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::residual::Residual;
use shared::device::control::Control;
use shared::link::messages::DeviceKind;
use shared::safety::filter::ValveCommand;
use shared::sensor::Readings;
use shared::ventilator::Output;

/// Clock rate that a simulated device reports, Hz; its ticks take no time.
const CORE_HZ: u32 = 1_000_000;

/// The reading of a bench that cannot run.
const NO_READING: Reading = Reading { pressure: f32::NAN, outlet: f32::NAN, flow: f32::NAN, truth: None };

/// The control half of a device on a bench.
#[derive(Clone, Debug)]
pub struct Rig {
    /// The control half.
    pub control: Control,
    /// The plant.
    pub plant: BenchPlant,
    /// PEEP that the device wants of the plant, cmH2O.
    peep: f32,
    /// The plant's last reading.
    pub reading: Reading,
    /// The command in force.
    pub command: ValveCommand,
    /// Number of ticks of the device.
    pub ticks: u32,
}

impl Rig {
    /// A device on a plant at rest at a PEEP, cmH2O.
    pub fn new(control: Control, plant: BenchPlant, peep: f32) -> Self {
        let (reading, command) = (Reading::of_pressure(peep), ValveCommand::SAFE);
        Self { control, plant, peep, reading, command, ticks: 0 }
    }

    /// Restarts the device: its valves are safe until it commands them.
    pub fn restart(&mut self, control: Control) {
        (self.control, self.command) = (control, ValveCommand::SAFE);
    }

    /// Makes the changes of the plant that the device demands before its next step; returns whether the plant has
    /// restarted at rest.
    pub fn follow(&mut self) -> bool {
        let change = self.control.plant_change();
        self.peep = change.peep.unwrap_or(self.peep);
        if let Some(seed) = change.reset {
            let reading = self.plant.reset(DEFAULT_PERIOD_US, seed, self.peep);
            self.reading = reading.unwrap_or(NO_READING);
        }
        if let Some(peep) = change.peep {
            self.plant.bench.set_peep(peep);
        }
        change.reset.is_some()
    }

    /// Runs a tick of the device on these readings.
    pub fn step(&mut self, readings: Readings) -> Output {
        let output = self.control.step(readings);
        self.command = output.command;
        self.ticks = self.ticks.wrapping_add(1);
        output
    }

    /// Runs the plant for a tick with the command in force.
    pub fn run_plant(&mut self) {
        let reading = self.plant.step(self.command.u_in(), self.command.u_out());
        self.reading = reading.unwrap_or(NO_READING);
    }

    /// The last reading of all sensors.
    pub fn readings(&self) -> Readings {
        let Reading { pressure: airway, outlet, flow, .. } = self.reading;
        Readings { airway, outlet, flow }
    }
}

/// The control half of a simulated device, with a learned controller if there is one.
pub fn control(learned: Option<&Residual>) -> Control {
    let control = Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, CORE_HZ);
    let mut control = control.expect("the default control period is in bounds");
    if let Some(learned) = learned {
        control.learn(learned);
    }
    control
}
