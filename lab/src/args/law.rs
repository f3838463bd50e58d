//! The choice of a control law: a controller as the trainer takes it, a rival, or a third-party policy.

use std::path::Path;

use anyhow::bail;
use shared::control::pid::Pid;
use shared::device::KNOWN_GOOD;

use host::args::controller::{Chosen, ControllerArgs};
use host::args::gains::format_gains;
use host::args::plant::{own_period_us, period_us};
use host::command::bounds::within;
use laws::policy::PolicyLaw;
use laws::policy::link::PolicyLink;
use laws::rivals::Rival;
use laws::rivals::machine::Machine;
use plant::bench::BenchConfig;
use plant::bench::family::Family;
use ventilator::SharedLink;
use ventilator::law::AnyLaw;

/// The choice of a controller or a rival.
#[derive(Debug, clap::Args)]
pub struct LawArgs {
    #[command(flatten)]
    controller: ControllerArgs,
    /// Values of the parameters of a rival (--controller variable-gain, iterative, feed-forward or gated), in the order in which
    /// `lab tune-rival` prints them [default: those tuned for adults]
    #[arg(long, value_name = "VALUE,..", value_delimiter = ',', requires = "controller", value_parser = within::<f32>(-1e4, 1e4))]
    parameters: Option<Vec<f32>>,
}

impl LawArgs {
    /// The chosen law, built for `plant` if there is one. A rival knows the nominal machine for adults.
    ///
    /// # Errors
    /// Arguments or a file that make no law, or none for this plant.
    pub fn chosen(&self, plant: Option<&SharedLink>) -> anyhow::Result<Chosen> {
        let chosen = self.built(plant, &BenchConfig::default())?;
        chosen.suits(plant)?;
        Ok(chosen)
    }

    /// The chosen law for the plants of a family. A rival knows the nominal machine of the family.
    ///
    /// # Errors
    /// Arguments or a file that make no law.
    pub fn chosen_for(&self, family: &Family) -> anyhow::Result<Chosen> {
        self.built(None, &family.nominal())
    }

    /// A policy over the PID with the given gains. It runs at its own control period, if it has one, which must be that of `plant`.
    ///
    /// # Errors
    /// Different control periods, or gains that no PID has.
    pub fn chosen_with(&self, policy: PolicyLink, plant: Option<&SharedLink>) -> anyhow::Result<Chosen> {
        let (name, own) = (format!("policy at {}", policy.address()), policy.period_us());
        let asked = self.controller.period_us;
        if let (Some(asked), Some(own)) = (asked, own)
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
        let period_us = period_us(asked.or(own), plant)?;
        let pid = Pid::new(self.controller.gains.unwrap_or(KNOWN_GOOD), period_us)?;
        let id = format!("{name} over {}", format_gains(&pid.gains()));
        let controller = AnyLaw::new(PolicyLaw::new(policy, pid, period_us));
        Ok(Chosen {
            beside_pid: Some("policy".to_owned()),
            ..Chosen::host_only(controller, period_us, name, id)
        })
    }

    fn built(&self, plant: Option<&SharedLink>, nominal: &BenchConfig) -> anyhow::Result<Chosen> {
        let named = self.controller.controller.as_deref().and_then(Path::to_str);
        match (named.and_then(Rival::find), &self.parameters) {
            (Some(rival), _) => {
                let period_us = period_us(self.controller.period_us, plant)?;
                self.rival(rival, Machine::of(nominal), period_us)
            }
            (None, Some(_)) => {
                bail!("--parameters are those of a rival: name one with --controller, {}", rival_names())
            }
            (None, None) => self.controller.built(plant, &Rival::ALL.map(Rival::name)),
        }
    }

    /// A rival that knows this machine.
    fn rival(&self, rival: Rival, machine: Machine, period_us: u32) -> anyhow::Result<Chosen> {
        let values = self.parameters.clone().unwrap_or_else(|| rival.tuned());
        let name = rival.name().to_owned();
        let id = format!("{name} {}", values.iter().map(f32::to_string).collect::<Vec<_>>().join(","));
        Ok(Chosen::host_only(rival.law(&values, machine, period_us)?, period_us, name, id))
    }
}

/// The names of the rivals.
pub fn rival_names() -> String {
    Rival::ALL.map(Rival::name).join(", ")
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use shared::breath::DEFAULT_PERIOD_US;

    use super::*;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        law: LawArgs,
    }

    fn typed(words: &str) -> LawArgs {
        Line::parse_from(format!("lab {words}").split_whitespace()).law
    }

    #[test]
    fn on_a_family_a_rival_knows_the_machine_of_that_family() {
        let args = typed("--controller feed-forward");
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
    fn kept_results_distinguish_a_rivals_parameters() {
        let id = |parameters: &[f32]| {
            let values: Vec<String> = parameters.iter().map(f32::to_string).collect();
            let line = format!("--controller variable-gain --parameters {}", values.join(","));
            typed(&line).chosen(None).unwrap().id
        };
        let tuned = Rival::VariableGain.tuned();
        let mut other = tuned.clone();
        other[0] *= 1.01;
        assert_eq!(typed("--controller variable-gain").chosen(None).unwrap().id, id(&tuned));
        assert_ne!(id(&tuned), id(&other));
    }
}
