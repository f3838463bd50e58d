//! The demonstration: the nine lungs of the paper on simulated devices, each lung with the best single PID of the adult family and
//! beside it with the shipped learned controller of that family.

use learn::controller::shipped;
use shared::control::pid::{KNOWN_GOOD, PidGains};
use shared::link::messages::ControllerChoice;
use shared::settings::Settings;
use shared::weights::{IMAGE_BYTES, WeightsError, decode};
use thiserror::Error;

use crate::source::{SourceError, Watch};
use device::simulated::{Served, ServedConfig};
use device::{Device, DeviceError};
use plant::bench::BenchConfig;
use plant::bench::family::{Family, FamilyError};

/// The learned controller, and the family for which it was trained and its rival searched.
const CONTROLLER: &str = "adult";

/// Why the demonstration does not start.
#[derive(Debug, Error)]
pub enum DemoError {
    /// The shipped controller is damaged.
    #[error("the controller '{CONTROLLER}' of this program is damaged: {0}; build the program again")]
    Weights(#[from] WeightsError),
    /// A device does not start.
    #[error(transparent)]
    Source(#[from] SourceError),
    /// There is no such family.
    #[error(transparent)]
    Family(#[from] FamilyError),
}

impl From<DeviceError> for DemoError {
    fn from(error: DeviceError) -> Self {
        Self::Source(error.into())
    }
}

/// Starts all devices, ventilating: for each lung the PID, then the learned controller.
///
/// # Errors
/// [`DemoError`].
pub fn start() -> Result<Vec<Watch>, DemoError> {
    let image = shipped::image(CONTROLLER).unwrap_or_default();
    decode(image)?;
    let gains = Family::find(CONTROLLER)?.pid.unwrap_or(KNOWN_GOOD);
    let mut watches = Vec::new();
    for bench in BenchConfig::paper_lungs() {
        watches.push(pid(&bench, gains)?);
        watches.push(learned(&bench, image)?);
    }
    Ok(watches)
}

fn pid(bench: &BenchConfig, gains: PidGains) -> Result<Watch, DemoError> {
    ventilate(bench, "PID", None, ControllerChoice::Pid(gains))
}

fn learned(bench: &BenchConfig, image: &[u8]) -> Result<Watch, DemoError> {
    let weights = image.first_chunk::<IMAGE_BYTES>().map(|bytes| Box::new(*bytes));
    ventilate(bench, CONTROLLER, weights, ControllerChoice::Learned)
}

/// A device on this bench, which ventilates with the default settings.
fn ventilate(
    bench: &BenchConfig,
    title: &str,
    weights: Option<Box<[u8; IMAGE_BYTES]>>,
    controller: ControllerChoice,
) -> Result<Watch, DemoError> {
    let served =
        Served::with(bench, ServedConfig { pace: 1, weights, all_sensors: true, keeps_truth: false });
    let served = served.map_err(SourceError::from)?;
    let mut device = Device::connect(served.address())?;
    device.choose(controller)?;
    device.apply(Settings::default())?;
    device.start()?;
    device.release_lease()?;
    Ok(Watch::simulated(format!("{} {title}", bench.name), served, device))
}
