//! The choice of a controller (gains, a learned controller's file or its weights image, or a rival) and its control period.

use std::path::{Path, PathBuf};

use anyhow::{Context, anyhow, bail};
use shared::checksum::crc32;
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::control::residual::Residual;
use shared::device::KNOWN_GOOD;
use shared::weights::{ImageId, decode};

use super::gains::{format_gains, gains};
use super::plant::{own_period_us, period_us};
use laws::policy::PolicyLaw;
use laws::policy::link::PolicyLink;
use laws::rivals::Rival;
use laws::rivals::machine::Machine;
use learn::controller::authors::AuthorsController;
use learn::controller::learned::{self, Learned};
use learn::controller::{Trainable, shipped};
use plant::bench::BenchConfig;
use plant::bench::family::Family;
use ventilator::SharedLink;
use ventilator::law::AnyLaw;

/// The choice of a controller.
#[derive(Debug, clap::Args)]
pub struct ControllerArgs {
    /// Gains P,I,D of a PID: percent per cmH2O, percent per cmH2O and second, percent per cmH2O/s [default: 3,30,0]
    #[arg(long, value_name = "P,I,D", value_parser = gains, group = "which")]
    gains: Option<PidGains>,
    /// A learned controller: a shipped one, such as adult, or a file as written by `trainer train`, of any architecture; or a rival that
    /// runs on the host only: variable-gain, iterative, feed-forward or gated
    #[arg(long, value_name = "NAME|FILE", group = "which")]
    controller: Option<PathBuf>,
    /// Values of a rival's parameters, in the order in which `trainer tune-rival` prints them [default: those tuned for adults]
    #[arg(long, value_name = "VALUE,..", value_delimiter = ',', requires = "controller")]
    parameters: Option<Vec<f32>>,
    /// A weights image, as written by `trainer pack`
    #[arg(long, value_name = "FILE", group = "which")]
    weights: Option<PathBuf>,
    /// Control period, microseconds [default: 1000, or that of the learned controller or the plant]
    #[arg(long, value_name = "US")]
    period_us: Option<u32>,
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
    /// The name for output: gains, file or rival.
    pub name: String,
    /// Identifies the controller in kept results: gains, the id of the weights, or a rival with its parameters. For a policy it
    /// contains the policy's address, which anything may answer: see [`Chosen::known_as`].
    pub id: String,
}

impl Chosen {
    /// A PID.
    ///
    /// # Errors
    /// Gains or a control period that no PID has.
    pub fn pid(gains: PidGains, period_us: u32) -> anyhow::Result<Self> {
        let controller = AnyLaw::new(Controller::Pid(Pid::new(gains, period_us)?));
        let name = format_gains(&gains);
        Ok(Self { controller, period_us, weights_id: None, image: None, id: name.clone(), name })
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

    /// What the controller is beside its PID, for output; none for a PID.
    pub fn beside_pid(&self) -> Option<&str> {
        match self.controller.chip() {
            Some(Controller::Pid(_)) => None,
            Some(Controller::Residual(_)) => Some("learned"),
            None if self.controller.downcast::<AuthorsController>().is_some() => Some("authors"),
            None if self.controller.downcast::<PolicyLaw>().is_some() => Some("policy"),
            None => Some(&self.name),
        }
    }
}

impl ControllerArgs {
    /// The chosen controller, built for `plant` if there is one. A rival knows the nominal machine for adults.
    ///
    /// # Errors
    /// Arguments or a file that make no controller, or none for this plant.
    pub fn chosen(&self, plant: Option<&SharedLink>) -> anyhow::Result<Chosen> {
        let chosen = self.built(plant, &BenchConfig::default())?;
        chosen.suits(plant)?;
        Ok(chosen)
    }

    /// The chosen controller for the plants of a family. A rival knows the nominal machine of the family.
    ///
    /// # Errors
    /// Arguments or a file that make no controller.
    pub fn chosen_for(&self, family: &Family) -> anyhow::Result<Chosen> {
        self.built(None, &family.nominal())
    }

    /// A policy over the PID with the given gains. It runs at its own control period, if it has one, which must be that of `plant`.
    ///
    /// # Errors
    /// Different control periods, or gains that no PID has.
    pub fn chosen_with(&self, policy: PolicyLink, plant: Option<&SharedLink>) -> anyhow::Result<Chosen> {
        let (name, own) = (format!("policy at {}", policy.address()), policy.period_us());
        if let (Some(asked), Some(own)) = (self.period_us, own)
            && asked != own
        {
            bail!("the control period of the {name} is {own} us, not {asked}: omit --period-us");
        }
        if let (Some(plants), Some(own)) = (own_period_us(plant), own)
            && plants != own
        {
            bail!(
                "the control period of the {name} is {own} us, but the plant's is {plants} us: use matching ones"
            );
        }
        let period_us = period_us(self.period_us.or(own), plant)?;
        let pid = Pid::new(self.gains.unwrap_or(KNOWN_GOOD), period_us)?;
        let id = format!("{name} over {}", format_gains(&pid.gains()));
        let controller = AnyLaw::new(PolicyLaw::new(policy, pid, period_us));
        Ok(Chosen { controller, period_us, weights_id: None, image: None, name, id })
    }

    fn built(&self, plant: Option<&SharedLink>, nominal: &BenchConfig) -> anyhow::Result<Chosen> {
        let rival = self.controller.as_deref().and_then(Path::to_str).and_then(Rival::find);
        if let Some(rival) = rival {
            let period_us = period_us(self.period_us, plant)?;
            return self.rival(rival, Machine::of(nominal), period_us);
        }
        if self.parameters.is_some() {
            bail!("--parameters are those of a rival: name one with --controller, {}", rival_names());
        }
        let learned = match (&self.controller, &self.weights) {
            (Some(file), _) => match authors(file)? {
                Some(chosen) => chosen,
                None => learned(file)?,
            },
            (None, Some(file)) => of_image(file, read(file)?)?,
            (None, None) => {
                let gains = self.gains.unwrap_or(KNOWN_GOOD);
                return Chosen::pid(gains, period_us(self.period_us, plant)?);
            }
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

    /// A rival that knows this machine.
    fn rival(&self, rival: Rival, machine: Machine, period_us: u32) -> anyhow::Result<Chosen> {
        let values = self.parameters.clone().unwrap_or_else(|| rival.tuned());
        let controller = rival.law(&values, machine, period_us)?;
        let name = rival.name().to_owned();
        let id = format!("{name} {}", values.iter().map(f32::to_string).collect::<Vec<_>>().join(","));
        Ok(Chosen { controller, period_us, weights_id: None, image: None, name, id })
    }
}

/// The learned controller of the authors' architecture in this file; none if the file contains anything else.
fn authors(file: &Path) -> anyhow::Result<Option<Chosen>> {
    if !learned::architecture(file).is_ok_and(|name| Some(name.as_str()) == AuthorsController::NAME) {
        return Ok(None);
    }
    let controller = Learned::<AuthorsController>::read(file)?.controller;
    Ok(Some(Chosen {
        period_us: controller.spec().period_us,
        controller: AnyLaw::new(controller),
        weights_id: None,
        image: None,
        name: file.display().to_string(),
        id: format!("authors {}", image_id(crc32(&read(file)?))),
    }))
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
    })
}

/// The names of the rivals.
pub fn rival_names() -> String {
    Rival::ALL.map(Rival::name).join(", ")
}

/// The weights image of a learned controller: of the shipped one with this name, or of the one in this file.
///
/// # Errors
/// A file that cannot be read or contains something else.
pub fn image_of(controller: &Path) -> anyhow::Result<Vec<u8>> {
    if let Some(rival) = controller.to_str().and_then(Rival::find) {
        bail!("{} runs on the host only and has no weights: choose a learned controller", rival.name());
    }
    if let Some(image) = controller.to_str().and_then(shipped::image) {
        return Ok(image.to_vec());
    }
    if controller.extension().is_none() && !controller.exists() {
        let names: Vec<_> = shipped::names().collect();
        bail!(
            "there is no controller {}: name a file, or one of {}, or for evaluate, robust and margins a rival, {}",
            controller.display(),
            names.join(", "),
            rival_names()
        );
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
    use shared::breath::DEFAULT_PERIOD_US;

    #[test]
    fn on_a_family_a_rival_knows_the_machine_of_that_family() {
        let named = Some(PathBuf::from(Rival::FeedForward.name()));
        let args = ControllerArgs {
            controller: named,
            gains: None,
            parameters: None,
            weights: None,
            period_us: None,
        };
        let with = |nominal: &BenchConfig| {
            let rival = Rival::FeedForward;
            rival.law(&rival.tuned(), Machine::of(nominal), DEFAULT_PERIOD_US).unwrap()
        };
        let neonate = Family::find("neonate").unwrap();
        assert_eq!(args.chosen_for(&neonate).unwrap().controller, with(&neonate.nominal()));
        assert_eq!(args.chosen(None).unwrap().controller, with(&BenchConfig::default()));
        assert_ne!(with(&neonate.nominal()), with(&BenchConfig::default()));
    }

    #[test]
    fn kept_results_distinguish_a_rivals_parameters_and_the_content_of_an_authors_file() {
        let chosen = |controller: PathBuf, parameters: Option<Vec<f32>>| {
            let controller = Some(controller);
            let args = ControllerArgs { controller, gains: None, parameters, weights: None, period_us: None };
            args.chosen(None).unwrap().id
        };
        let rival = Rival::VariableGain;
        let mut other = rival.tuned();
        other[0] *= 1.01;
        let with = |values: Option<Vec<f32>>| chosen(rival.name().into(), values);
        assert_eq!(with(None), with(Some(rival.tuned())));
        assert_ne!(with(None), with(Some(other)));

        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("authors.safetensors");
        let saved = |p: f32| {
            let gains = PidGains { p, ..KNOWN_GOOD };
            let controller = AuthorsController::pid_law(Pid::new(gains, 1000).unwrap(), 1000).unwrap();
            Learned { controller, origin: Origin::default() }.save(&file).unwrap();
            chosen(file.clone(), None)
        };
        let (first, second) = (saved(3.0), saved(4.0));
        assert_ne!(first, second, "the same file with another controller");
        assert_eq!(first, saved(3.0));
    }
}
