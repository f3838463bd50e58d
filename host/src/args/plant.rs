//! The user's own plant in place of the bench.

use crate::command::bounds::within;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;

use anyhow::{Context, bail};
use shared::breath::{DEFAULT_PERIOD_US, PERIOD_BOUNDS_US};

use plant::link::{PATIENCE, PlantAddress, PlantLink};
use ventilator::SharedLink;

/// The choice of a plant.
#[derive(Debug, clap::Args)]
pub struct PlantArgs {
    /// Your own plant in place of the bench: tcp:HOST:PORT, or 'pipe:COMMAND' to start it
    #[arg(long, value_name = "PLANT", conflicts_with = "bench")]
    pub plant: Option<PlantAddress>,
    /// Longest time the plant may take to answer, s
    #[arg(long, value_name = "SECONDS", requires = "plant", default_value_t = PATIENCE.as_secs_f64(), value_parser = within::<f64>(0.001, 86_400.0))]
    plant_timeout: f64,
}

impl PlantArgs {
    /// The connected and identified plant, if one is chosen.
    ///
    /// # Errors
    /// A plant that does not answer, or whose control period no controller has.
    pub fn connect(&self) -> anyhow::Result<Option<SharedLink>> {
        let Some(address) = &self.plant else { return Ok(None) };
        let patience = Duration::from_secs_f64(self.plant_timeout);
        let link =
            PlantLink::open(address, patience).with_context(|| format!("cannot use the plant {address}"))?;
        let (shortest, longest) = PERIOD_BOUNDS_US;
        if let Some(own) = link.greeting().period_us.filter(|own| *own < shortest || *own > longest) {
            bail!(
                "the plant at {address} has a control period of {own} us: it must be {shortest} to {longest} us"
            );
        }
        Ok(Some(Arc::new(Mutex::new(link))))
    }
}

/// The plant's own control period, if it has one, microseconds.
pub fn own_period_us(link: Option<&SharedLink>) -> Option<u32> {
    link.and_then(|link| link.lock().unwrap_or_else(PoisonError::into_inner).greeting().period_us)
}

/// The control period in microseconds: the requested one, if the plant can run it, or the plant's own.
///
/// # Errors
/// Different control periods.
pub fn period_us(asked: Option<u32>, link: Option<&SharedLink>) -> anyhow::Result<u32> {
    match (asked, own_period_us(link)) {
        (Some(asked), Some(own)) if asked != own => {
            bail!("the plant's control period is {own} us, not {asked}: omit --period-us")
        }
        (asked, own) => Ok(asked.or(own).unwrap_or(DEFAULT_PERIOD_US)),
    }
}
