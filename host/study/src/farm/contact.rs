//! Where units are reached, and whether a device is the unit that it was.

use std::sync::Mutex;

use super::description::{Place, Unit};
use super::folder::UnitState;
use super::{FarmRun, UnitName, Worker};
use crate::error::{Result, StudyError};
use device::port::Address;
use device::simulated::Served;
use device::{Device, DeviceError};
use plant::locked;
use shared::breath::DEFAULT_PERIOD_US;
use shared::calibration::Calibration;
use ventilator::PortSource;

/// Where a unit is reached.
pub(super) struct Contact {
    address: Address,
    /// The device in this process, if the unit is virtual.
    served: Option<Served>,
}

impl Contact {
    /// Switches on the device of a virtual unit.
    pub fn new(unit: &Unit, pace: u32) -> Result<Self> {
        Ok(match &unit.place {
            Place::Port(address) | Place::Desk(address, _) => Self { address: address.clone(), served: None },
            Place::Bench(bench) => {
                let served = Served::start(bench, pace)?;
                Self { address: served.address().clone(), served: Some(served) }
            }
        })
    }

    /// Connects to the device.
    pub fn device(&self) -> Result<Device> {
        Ok(Device::connect(&self.address)?)
    }

    /// Connects to the device as a source; the plant of a simulated unit starts with this seed.
    pub fn source(&self, unit: &Unit, seed: u64) -> Result<PortSource> {
        let mut source = PortSource::new(self.device()?, seed)?;
        let Some(bench) = unit.bench() else { return Ok(source) };
        if let Some(served) = &self.served {
            return Ok(source.with_plant(format!("unit {}", unit.name), bench.to_toml(), served.truth()));
        }
        source.simulate(bench)?;
        Ok(source)
    }

    /// Whether the device is in this process, and forgets everything with it.
    fn is_virtual(&self) -> bool {
        self.served.is_some()
    }
}

/// A unit as the farm knows it.
struct Known {
    name: UnitName,
    state: UnitState,
}

impl Known {
    /// Whether this calibration was stored on the unit, or was being stored when the farm was killed.
    fn holds(&self, calibration: &Calibration) -> bool {
        self.state.calibrations.iter().chain(&self.state.pending).any(|stored| stored == calibration)
    }
}

impl FarmRun<'_> {
    /// Talks to every unit before anything moves. A unit that does not answer is left out; one that answers as another is an error.
    pub(super) fn contact(&self, workers: &mut [Worker<'_>]) -> Result<()> {
        let known =
            |worker: &Worker<'_>| Ok(Known { name: worker.unit.name.clone(), state: worker.state()? });
        let known: Vec<Known> = workers.iter().map(known).collect::<Result<_>>()?;
        let strangers = Mutex::new(Vec::new());
        self.on_all(workers, |worker| match self.greet(worker, &known) {
            Err(stranger @ StudyError::Description { .. }) => {
                locked(&strangers).push(stranger);
                Ok(())
            }
            greeted => greeted,
        });
        match locked(&strangers).pop() {
            Some(stranger) => Err(stranger),
            None => Ok(()),
        }
    }

    /// Checks that a device can run the farm's controllers, and that it is the unit that it was.
    fn greet(&self, worker: &Worker<'_>, known: &[Known]) -> Result<()> {
        let unit = worker.unit;
        let mut device = worker.contact.device()?;
        let period_us = device.identify()?.period_us;
        if period_us != DEFAULT_PERIOD_US {
            return Err(worker.refused(&format!(
                "has a control period of {period_us} us, but the farm's controllers need {DEFAULT_PERIOD_US}"
            )));
        }
        if let Place::Desk(_, bench) = &unit.place
            && let Err(error) = device.set_bench(&bench.to_bytes())
        {
            let DeviceError::Refused(refusal) = error else { return Err(error.into()) };
            return Err(worker.refused(&format!("does not simulate the bench: {refusal}")));
        }
        let Some(own) = known.iter().find(|known| known.name == unit.name) else { return Ok(()) };
        let (_, held) = device.calibration(0)?;
        if let (None, Some(last), true) = (held, own.state.calibrations.last(), worker.contact.is_virtual()) {
            // The flash of a virtual device is the farm's folder.
            device.calibrate(last)?;
            return Ok(());
        }
        match stranger(held.as_ref(), own, known) {
            None => Ok(()),
            Some(_) if self.adopt.contains(&unit.name) => worker.forget_device(),
            Some(why) => Err(worker.refused(&format!("answers as another unit: {why}"))),
        }
    }
}

impl Worker<'_> {
    /// Connects to the device, which must still be the unit that it was: boards can change their ports while a farm runs.
    pub(super) fn recognised(&self) -> Result<Device> {
        let mut device = self.contact.device()?;
        let (_, held) = device.calibration(0)?;
        self.recognise(held.as_ref())?;
        Ok(device)
    }

    /// Checks that a device that holds this calibration is the unit.
    pub(super) fn recognise(&self, held: Option<&Calibration>) -> Result<()> {
        let own = Known { name: self.unit.name.clone(), state: self.state()? };
        match stranger(held, &own, &[]) {
            None => Ok(()),
            Some(why) => Err(self.refused(&format!("answers as another unit: {why}"))),
        }
    }

    /// A refusal of the unit, with its line.
    fn refused(&self, what: &str) -> StudyError {
        let Unit { name, place, line, .. } = self.unit;
        StudyError::Description { line: line.clone(), message: format!("unit {name} at {place} {what}") }
    }
}

/// Why a device that holds this calibration is not the unit; none if it is, or may be.
fn stranger(held: Option<&Calibration>, own: &Known, known: &[Known]) -> Option<String> {
    let name = &own.name;
    match held {
        Some(held) if own.holds(held) => None,
        Some(held) => match known.iter().find(|known| known.holds(held)) {
            Some(holder) => {
                Some(format!("it holds the calibration of unit {}; check the cables", holder.name))
            }
            // A device that was calibrated elsewhere joins the farm.
            None if own.state.calibrations.is_empty() => None,
            None => Some(format!(
                "its calibration is not the one that this farm stored; check the cables or, if the device was replaced, add --adopt {name}"
            )),
        },
        None if own.state.calibrations.is_empty() => None,
        None => Some(format!(
            "it holds no calibration, but this farm stored one; check the cables or, if the device was replaced or erased, add --adopt {name}"
        )),
    }
}
