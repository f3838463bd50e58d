//! The choice of a controller (gains, or a learned one by its name, file or weights image) and its control period.

use crate::command::bounds::within;
use shared::breath::PERIOD_BOUNDS_US;
use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use shared::checksum::crc32;
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::control::residual::Residual;
use shared::device::KNOWN_GOOD;
use shared::weights::{ImageId, MAGIC, decode};

use super::gains::{format_gains, gains};
use super::plant::{own_period_us, period_us};
use learn::controller::authors::AuthorsController;
use learn::controller::learned::{self, Learned};
use learn::controller::{Trainable, shipped};
use ventilator::SharedLink;
use ventilator::law::AnyLaw;

/// The choice of a controller.
#[derive(Debug, clap::Args)]
pub struct ControllerArgs {
    /// Gains P,I,D of a PID, percent of the valve per cmH2O, cmH2O s and cmH2O/s [default: 3,30,0]
    #[arg(long, value_name = "P,I,D", value_parser = gains, group = "which")]
    pub gains: Option<PidGains>,
    /// A learned controller: a shipped one, such as adult, or a file as written by `trainer train`, of any architecture, or as its
    /// weights image
    #[arg(long, value_name = "NAME|FILE", group = "which")]
    pub controller: Option<PathBuf>,
    /// Control period, microseconds [default: 1000, or that of the learned controller or the plant]
    #[arg(long, value_name = "US", value_parser = within::<u32>(PERIOD_BOUNDS_US.0, PERIOD_BOUNDS_US.1))]
    pub period_us: Option<u32>,
}

/// A controller that is ready to run.
#[derive(Clone, Debug)]
pub struct Chosen {
    /// The controller.
    pub controller: AnyLaw,
    /// Its control period, microseconds.
    pub period_us: u32,
    /// The id of a learned controller: its image's checksum in hexadecimal.
    pub weights_id: Option<String>,
    /// The weights image of a learned controller.
    pub image: Option<Vec<u8>>,
    /// The name for output: gains, a file, or that of the control law.
    pub name: String,
    /// Identifies the controller in kept results: gains, the id of the weights, or a law with its parameters. For a third party's
    /// policy it contains an address, which anything may answer: see [`Chosen::known_as`].
    pub id: String,
    /// What the controller is beside its PID, for output; none for a PID.
    pub beside_pid: Option<String>,
}

impl Chosen {
    /// A PID.
    ///
    /// # Errors
    /// Gains or a control period that no PID has.
    pub fn pid(gains: PidGains, period_us: u32) -> anyhow::Result<Self> {
        let controller = AnyLaw::new(Controller::Pid(Pid::new(gains, period_us)?));
        let name = format_gains(&gains);
        Ok(Self { beside_pid: None, ..Self::host_only(controller, period_us, name.clone(), name) })
    }

    /// A control law without weights, which is known by its name beside its PID.
    pub fn host_only(controller: AnyLaw, period_us: u32, name: String, id: String) -> Self {
        let beside_pid = Some(name.clone());
        Self { controller, period_us, weights_id: None, image: None, name, id, beside_pid }
    }

    /// The same policy, which kept results know by this name and the PID underneath.
    #[must_use]
    pub fn known_as(self, name: &str) -> Self {
        Self { id: format!("policy {name} over {}", format_gains(&self.gains())), ..self }
    }

    /// Checks that the control period is that of `plant`, if there is one and it has its own.
    ///
    /// # Errors
    /// Different control periods.
    pub fn suits(&self, plant: Option<&SharedLink>) -> anyhow::Result<()> {
        match own_period_us(plant) {
            Some(own) if own != self.period_us => bail!(
                "{} is trained for a control period of {} us, but the plant's is {own} us: train a controller on the plant",
                self.name,
                self.period_us
            ),
            _ => Ok(()),
        }
    }

    /// Gains of the PID, or of the one underneath.
    pub fn gains(&self) -> PidGains {
        self.controller.pid().gains()
    }

    /// The controller, which must be one that a device can run.
    ///
    /// # Errors
    /// One that runs on the host only.
    pub fn chip(&self) -> anyhow::Result<&Controller> {
        let refused = || anyhow!("{} runs on the host only: choose gains or a learned controller", self.name);
        self.controller.chip().ok_or_else(refused)
    }

    /// The residual, if the controller is a learned one.
    pub fn residual(&self) -> Option<&Residual> {
        match self.controller.chip()? {
            Controller::Residual(residual) => Some(residual),
            Controller::Pid(_) => None,
        }
    }
}

impl ControllerArgs {
    /// The chosen controller, built for `plant` if there is one.
    ///
    /// # Errors
    /// Arguments or a file that make no controller, or none for this plant.
    pub fn chosen(&self, plant: Option<&SharedLink>) -> anyhow::Result<Chosen> {
        let chosen = self.built(plant, &[])?;
        chosen.suits(plant)?;
        Ok(chosen)
    }

    /// The chosen controller, whose control period may differ from that of `plant`. `others` are further names that the caller knows.
    ///
    /// # Errors
    /// Arguments or a file that make no controller.
    pub fn built(&self, plant: Option<&SharedLink>, others: &[&str]) -> anyhow::Result<Chosen> {
        let Some(file) = &self.controller else {
            let gains = self.gains.unwrap_or(KNOWN_GOOD);
            return Chosen::pid(gains, period_us(self.period_us, plant)?);
        };
        let learned = match authors(file)? {
            Some(chosen) => chosen,
            None => of_image(file, image_among(file, others)?)?,
        };
        if let Some(asked) = self.period_us.filter(|asked| *asked != learned.period_us) {
            bail!(
                "{} is trained for a control period of {} us, not {asked}: omit --period-us",
                learned.name,
                learned.period_us
            );
        }
        Ok(learned)
    }
}

/// The learned controller of the authors' architecture in this file; none if the file contains anything else.
fn authors(file: &Path) -> anyhow::Result<Option<Chosen>> {
    if !learned::architecture(file).is_ok_and(|name| Some(name.as_str()) == AuthorsController::NAME) {
        return Ok(None);
    }
    let controller = Learned::<AuthorsController>::read(file)?.controller;
    let (period_us, name) = (controller.spec().period_us, file.display().to_string());
    let id = format!("authors {}", image_id(crc32(&read(file)?)));
    let chosen = Chosen::host_only(AnyLaw::new(controller), period_us, name, id);
    Ok(Some(Chosen { beside_pid: AuthorsController::NAME.map(str::to_owned), ..chosen }))
}

/// A learned controller that a device can run: the shipped one with this name, or the one in this file.
///
/// # Errors
/// A file that cannot be read or contains something else.
pub fn learned(controller: &Path) -> anyhow::Result<Chosen> {
    of_image(controller, image_of(controller)?)
}

/// The controller of a weights image from a file.
fn of_image(file: &Path, bytes: Vec<u8>) -> anyhow::Result<Chosen> {
    let image = decode(&bytes).with_context(|| file.display().to_string())?;
    let id = image_id(image.id);
    Ok(Chosen {
        period_us: image.residual.spec().period_us,
        controller: AnyLaw::new(Controller::Residual(image.residual)),
        weights_id: Some(id.clone()),
        id,
        image: Some(bytes),
        name: file.display().to_string(),
        beside_pid: Some("learned".to_owned()),
    })
}

/// The weights image of a learned controller: of the shipped one with this name, or of the one in this file.
///
/// # Errors
/// A file that cannot be read or contains something else.
pub fn image_of(controller: &Path) -> anyhow::Result<Vec<u8>> {
    image_among(controller, &[])
}

/// Like [`image_of`]; the error names `others` too.
fn image_among(controller: &Path, others: &[&str]) -> anyhow::Result<Vec<u8>> {
    if let Some(image) = controller.to_str().and_then(shipped::image) {
        return Ok(image.to_vec());
    }
    if controller.extension().is_none() && !controller.exists() {
        let mut names: Vec<&str> = shipped::names().collect();
        names.extend(others);
        bail!("there is no controller {}: name a file, or one of {}", controller.display(), names.join(", "));
    }
    let bytes = read(controller)?;
    if bytes.starts_with(&MAGIC) || controller.extension().is_some_and(|ending| ending == "bin") {
        return Ok(bytes);
    }
    Ok(Learned::load(controller)?.image()?)
}

/// Reads a file.
///
/// # Errors
/// A file that cannot be read.
pub fn read(file: &Path) -> anyhow::Result<Vec<u8>> {
    std::fs::read(file).with_context(|| format!("cannot read {}", file.display()))
}

/// The id of an image: its checksum in hexadecimal.
pub fn image_id(id: u32) -> String {
    ImageId(id).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;
    use learn::controller::learned::Origin;

    #[test]
    fn kept_results_distinguish_the_content_of_an_authors_file() {
        let chosen = |controller: PathBuf| {
            let controller = Some(controller);
            ControllerArgs { controller, gains: None, period_us: None }.chosen(None).unwrap().id
        };
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("authors.safetensors");
        let saved = |p: f32| {
            let gains = PidGains { p, ..KNOWN_GOOD };
            let controller = AuthorsController::pid_law(Pid::new(gains, 1000).unwrap(), 1000).unwrap();
            Learned { controller, origin: Origin::default() }.save(&file).unwrap();
            chosen(file.clone())
        };
        let (first, second) = (saved(3.0), saved(4.0));
        assert_ne!(first, second, "the same file with another controller");
        assert_eq!(first, saved(3.0));
    }
}
