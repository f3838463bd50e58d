//! Which controller runs, and at which control period: gains, a file of a learned controller, or its image.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::device::KNOWN_GOOD;
use shared::weights::decode;

use super::{common, plant_args};
use learn::controller::learned::Learned;
use ventilator::SharedLink;

/// Which controller.
#[derive(Debug, clap::Args)]
pub struct ControllerArgs {
    /// A PID with these gains: percent per cmH2O, per cmH2O and second, per cmH2O/s [default: 3,30,0]
    #[arg(long, value_name = "P,I,D", value_parser = common::gains, group = "which")]
    gains: Option<PidGains>,
    /// A learned controller, as trained
    #[arg(long, value_name = "FILE", group = "which")]
    controller: Option<PathBuf>,
    /// A learned controller, as packed for the chip
    #[arg(long, value_name = "FILE", group = "which")]
    weights: Option<PathBuf>,
    /// Control period, microseconds [default: 1000, or that of the learned controller or the plant]
    #[arg(long, value_name = "US")]
    period_us: Option<u32>,
}

/// A controller ready to run.
#[derive(Clone, Debug)]
pub struct Chosen {
    /// The controller.
    pub controller: Controller,
    /// Its control period, microseconds.
    pub period_us: u32,
    /// The name of a learned one: its image's checksum in hex.
    pub weights_id: Option<String>,
    /// The bytes of a learned one.
    pub image: Option<Vec<u8>>,
    /// As printed: gains or file.
    pub name: String,
}

impl Chosen {
    /// Gains of the PID, or of the one under the residual.
    pub fn gains(&self) -> PidGains {
        self.controller.pid().gains()
    }
}

impl ControllerArgs {
    /// The controller meant, for a plant if it is one.
    pub fn chosen(&self, plant: Option<&SharedLink>) -> anyhow::Result<Chosen> {
        let chosen = self.built(plant)?;
        match plant_args::own_period_us(plant) {
            Some(own) if own != chosen.period_us => bail!(
                "{} is trained for a control period of {} us, the plant's is {own} us: train one for the plant",
                chosen.name,
                chosen.period_us
            ),
            _ => Ok(chosen),
        }
    }

    fn built(&self, plant: Option<&SharedLink>) -> anyhow::Result<Chosen> {
        match (&self.controller, &self.weights) {
            (Some(file), _) => {
                let image = Learned::load(file)?.image()?;
                self.learned(file, image)
            }
            (None, Some(file)) => self.learned(file, read(file)?),
            (None, None) => {
                let gains = self.gains.unwrap_or(KNOWN_GOOD);
                let period_us = plant_args::period_us(self.period_us, plant)?;
                let (controller, name) = (Controller::Pid(Pid::new(gains, period_us)?), format_gains(&gains));
                Ok(Chosen { controller, period_us, weights_id: None, image: None, name })
            }
        }
    }

    fn learned(&self, file: &Path, bytes: Vec<u8>) -> anyhow::Result<Chosen> {
        let image = decode(&bytes).with_context(|| file.display().to_string())?;
        let period_us = image.residual.spec().period_us;
        if let Some(asked) = self.period_us.filter(|asked| *asked != period_us) {
            bail!(
                "{} is trained for a control period of {period_us} us, not {asked}: leave --period-us out",
                file.display()
            );
        }
        Ok(Chosen {
            controller: Controller::Residual(image.residual),
            period_us,
            weights_id: Some(image_id(image.id)),
            image: Some(bytes),
            name: file.display().to_string(),
        })
    }
}

/// The bytes of a file.
pub fn read(file: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))
}

/// The name of an image: its checksum in hex.
pub fn image_id(id: u32) -> String {
    format!("{id:08x}")
}

/// Gains as they are typed.
pub fn format_gains(gains: &PidGains) -> String {
    let PidGains { p, i, d } = gains;
    format!("{p},{i},{d}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn printed_gains_can_be_typed_again() {
        let gains = PidGains { p: 1.25, i: 0.1 + 0.2, d: 0.003 };
        assert_eq!(common::gains(&format_gains(&gains)), Ok(gains));
    }

    #[test]
    fn the_default_is_the_one_that_the_help_names() {
        assert_eq!(format_gains(&KNOWN_GOOD), "3,30,0");
    }
}
