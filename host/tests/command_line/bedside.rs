//! A simulated device at the far end of a pseudo-terminal.

use std::time::Duration;

use device::Device;
use device::port::{Address, BAUD, Port};
use device::simulated::Simulated;
use plant::bench::BenchConfig;
use serialport::{SerialPort, TTYPort};

/// Longest time that a step with a device may take.
pub const LONG: Duration = Duration::from_mins(1);

/// The device. It ends when dropped, and its link with it.
pub struct Bedside {
    _simulated: Simulated,
    _cable: TTYPort,
    name: String,
}

impl Bedside {
    /// A device in standby on this bench.
    pub fn at(bench: &BenchConfig) -> Self {
        let (mut master, cable) = TTYPort::pair().unwrap();
        master.set_timeout(Duration::from_millis(2)).unwrap();
        let name = cable.name().unwrap();
        let reader = Box::new(master.try_clone_native().unwrap());
        master.set_timeout(LONG).unwrap();
        let simulated = Simulated::start(bench, Port { reader, writer: Box::new(master) }).unwrap();
        Self { _simulated: simulated, _cable: cable, name }
    }

    /// Name of its port.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// A connection to it.
    pub fn connected(&self) -> Device {
        Device::connect(&Address::Serial { name: self.name.clone(), baud: BAUD }).unwrap()
    }
}
