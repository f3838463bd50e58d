//! The waveforms of an evaluation: PIPs with settings, or prescriptions.

use crate::command::bounds::{Within, within};
use shared::breath::PAPER_PIPS;
use shared::settings::{FIELDS, Settings};

use super::settings::SettingsArgs;
use plant::prescriptions::Prescriptions;
use score::evaluate::{Plan, at_pips};

/// Waveforms that are drawn from prescriptions without a list: four times the paper's six, so that high and low values of PEEP, PIP,
/// rise and inspiratory time meet each other.
const DRAWN: u32 = 24;

/// A parser of PIPs within the bounds of the setting, which is the first one, cmH2O.
pub fn pips() -> Within<f32> {
    within(FIELDS[0].min, FIELDS[0].max)
}

/// The waveforms of an evaluation.
#[derive(Debug, clap::Args)]
pub struct WaveformsArgs {
    /// PIPs of the waveforms, cmH2O
    #[arg(long, value_name = "CMH2O,..", value_delimiter = ',', default_values_t = PAPER_PIPS, value_parser = pips())]
    pips: Vec<f32>,
    #[command(flatten)]
    settings: SettingsArgs,
    /// Prescriptions, in place of --pips and --settings: paper, bedside, or a TOML file; 24 waveforms, by the seed, of those that are
    /// drawn
    #[arg(long, value_name = "NAME|FILE", conflicts_with_all = ["pips", "settings"])]
    pub prescriptions: Option<String>,
}

impl WaveformsArgs {
    /// The plan with these waveforms in place of its own; `seed` is that of drawn prescriptions.
    ///
    /// # Errors
    /// Settings or prescriptions that are refused.
    pub fn on(&self, plan: Plan, seed: u64) -> anyhow::Result<Plan> {
        Ok(match &self.prescriptions {
            Some(name) => plan.prescribed(&Prescriptions::find(name)?, seed, DRAWN),
            None => Plan { waveforms: at_pips(&self.pips, &self.checked()?), ..plan },
        })
    }

    /// The settings beside the PIPs, checked with each of them.
    fn checked(&self) -> anyhow::Result<Settings> {
        Ok(self.settings.checked(&self.pips)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        waveforms: WaveformsArgs,
    }

    fn plan(arguments: &[&str]) -> anyhow::Result<Plan> {
        let line = std::iter::once("test").chain(arguments.iter().copied());
        Line::try_parse_from(line)?.waveforms.on(Plan::default(), 5)
    }

    #[test]
    fn without_an_option_they_are_the_papers() {
        assert_eq!(plan(&[]).unwrap(), Plan::default());
        assert_eq!(plan(&["--prescriptions", "paper"]).unwrap(), Plan::default());
        let other = plan(&["--pips", "15", "--settings", "peep=8"]).unwrap();
        assert_eq!(other.waveforms, [Settings { pip: 15.0, peep: 8.0, ..Settings::default() }]);
    }

    #[test]
    fn those_of_the_bedside_are_drawn_by_the_seed() {
        let drawn = plan(&["--prescriptions", "bedside"]).unwrap().waveforms;
        assert_eq!(drawn.len(), DRAWN as usize);
        assert_eq!(drawn[3], Prescriptions::find("bedside").unwrap().draw(5, 3));
    }

    #[test]
    fn prescriptions_take_the_place_of_pips_and_settings() {
        for other in [["--pips", "15"], ["--settings", "peep=8"]] {
            let refused =
                plan(&[&["--prescriptions", "bedside"], &other[..]].concat()).unwrap_err().to_string();
            assert!(refused.contains("'--prescriptions <NAME|FILE>' cannot be used with"), "{refused}");
        }
        let unknown = plan(&["--prescriptions", "aliens"]).unwrap_err().to_string();
        assert!(unknown.contains("there are no prescriptions aliens"), "{unknown}");
    }
}
