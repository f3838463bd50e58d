//! The choice of what breathes: a device, the user's own plant, or the bench.

use shared::settings::Settings;

use super::common::BenchArgs;
use super::controller_args::Chosen;
use super::plant_args::PlantArgs;
use super::port_args::{self, PortArgs};
use ventilator::{BenchSource, PlantSource, SharedLink, Source};

/// The choice of a source.
#[derive(Debug, clap::Args)]
pub struct SourceArgs {
    #[command(flatten)]
    pub bench: BenchArgs,
    #[command(flatten)]
    pub port: PortArgs,
    #[command(flatten)]
    pub plant: PlantArgs,
}

impl SourceArgs {
    /// The source of breaths with these settings under a controller; `plant` is the connected plant, if one is chosen.
    pub fn open(
        &self,
        plant: Option<SharedLink>,
        chosen: &Chosen,
        settings: &Settings,
        seed: u64,
    ) -> anyhow::Result<Box<dyn Source>> {
        let (controller, period_us) = (chosen.chip()?.clone(), chosen.period_us);
        Ok(if let Some(address) = &self.port.port {
            Box::new(port_args::source(address, chosen, seed)?)
        } else if let Some(link) = plant {
            Box::new(PlantSource::new(link, controller, period_us, seed))
        } else {
            Box::new(BenchSource::new(&self.bench.one()?, controller, settings, period_us, seed)?)
        })
    }
}
