//! The choice of what breathes: a device, the user's own plant, or the bench.

use shared::settings::Settings;

use super::bench::BenchArgs;
use super::controller::Chosen;
use super::plant::PlantArgs;
use super::port::{PortArgs, source};
use ventilator::{BenchSource, PlantSource, SharedLink, Source};

/// The choice of a source.
#[derive(Debug, clap::Args)]
pub struct SourceArgs {
    /// The bench.
    #[command(flatten)]
    pub bench: BenchArgs,
    /// The device.
    #[command(flatten)]
    pub port: PortArgs,
    /// The plant.
    #[command(flatten)]
    pub plant: PlantArgs,
}

impl SourceArgs {
    /// The source of breaths with these settings under a controller; `plant` is the connected plant, if one is chosen.
    ///
    /// # Errors
    /// A controller that runs on the host only, or a bench or a device that cannot be used.
    pub fn open(
        &self,
        plant: Option<SharedLink>,
        chosen: &Chosen,
        settings: &Settings,
        seed: u64,
    ) -> anyhow::Result<Box<dyn Source>> {
        let (controller, period_us) = (chosen.chip()?.clone(), chosen.period_us);
        Ok(if let Some(address) = &self.port.port {
            Box::new(source(address, chosen, seed, self.bench.described()?.as_ref())?)
        } else if let Some(link) = plant {
            Box::new(PlantSource::new(link, controller, period_us, seed))
        } else {
            Box::new(BenchSource::new(&self.bench.one()?, controller, settings, period_us, seed)?)
        })
    }
}
