//! The ventilator's settings as one option with names and values.
//!
//! Names, units, bounds and defaults are those of [`TEMPLATE_FIELDS`], so a new setting appears here automatically. PIP is excluded:
//! commands that run several waveforms take a list of PIPs.

use anyhow::bail;
use shared::settings::{FIELDS, Field, Settings, SettingsError, TEMPLATE_FIELDS};

/// All settings except PIP, as typed.
#[derive(Clone, Debug, PartialEq, clap::Args)]
pub struct SettingsArgs {
    #[arg(long, value_name = "NAME=VALUE,..", value_delimiter = ',', value_parser = setting, help = help())]
    settings: Vec<Typed>,
}

/// A setting: its place among [`FIELDS`], and its value.
type Typed = (usize, f32);

impl SettingsArgs {
    fn settings(&self) -> Settings {
        self.over(&Settings::default())
    }

    /// Other defaults with the settings that were given.
    pub fn over(&self, base: &Settings) -> Settings {
        let mut values = base.values();
        self.settings.iter().for_each(|(field, value)| values[*field] = *value);
        Settings::from_values(values)
    }

    /// Whether a setting was given.
    pub fn any(&self) -> bool {
        !self.settings.is_empty()
    }

    /// The settings, checked with each of these PIPs.
    ///
    /// # Errors
    /// A setting outside its bounds, or a PIP that does not go with the others.
    pub fn checked(&self, pips: &[f32]) -> Result<Settings, SettingsError> {
        let settings = self.settings();
        pips.iter().try_for_each(|pip| Settings { pip: *pip, ..settings }.validate())?;
        Ok(settings)
    }

    /// The same, checked for a training too.
    ///
    /// # Errors
    /// The same, or a rise, which no training supports.
    pub fn for_training(&self, pips: &[f32]) -> anyhow::Result<Settings> {
        let settings = self.checked(pips)?;
        if settings.rise_time > 0.0 {
            bail!(
                "listed waveforms are trained with a square rise: leave rise_time at 0, or draw rises with --prescriptions"
            );
        }
        Ok(settings)
    }
}

/// Parses a setting, such as `peep=8`.
fn setting(text: &str) -> Result<Typed, String> {
    let (name, value) = text.split_once('=').ok_or("write NAME=VALUE, such as peep=8")?;
    let allowed = |field: &Field| TEMPLATE_FIELDS.iter().any(|allowed| allowed.name == field.name);
    let place = FIELDS.iter().position(|field| allowed(field) && field.name == name).ok_or_else(|| {
        let names: Vec<&str> = TEMPLATE_FIELDS.iter().map(|field| field.name).collect();
        format!("there is no setting {name}: choose from {}", names.join(", "))
    })?;
    let Field { min, max, unit, .. } = FIELDS[place];
    match value.parse() {
        Ok(number) if min <= number && number <= max => Ok((place, number)),
        _ => Err(format!("{name} is {value}, allowed are {min} to {max} {unit}")),
    }
}

/// All names with bounds, units and defaults.
fn help() -> String {
    let one = |Field { name, unit, min, max, default, .. }: &Field| {
        format!("{name} {min} to {max} {unit} [{default}]")
    };
    let all: Vec<String> = TEMPLATE_FIELDS.iter().map(one).collect();
    format!(
        "Settings of the breaths, such as peep=8,rate=15, with their [defaults]: {}; 0 switches a trigger or an alarm limit off",
        all.join(", ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::{CommandFactory, Parser};

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        settings: SettingsArgs,
    }

    fn parse(arguments: &[&str]) -> SettingsArgs {
        let line = std::iter::once("test").chain(arguments.iter().copied());
        Line::try_parse_from(line).unwrap().settings
    }

    #[test]
    fn settings_that_are_not_typed_are_the_schemas_defaults() {
        assert_eq!(parse(&[]).settings(), Settings::default());
        let several = parse(&["--settings", "peep=8,rate=15", "--settings", "fall_time=0.4"]).settings();
        let expected = Settings { peep: 8.0, rate: 15.0, fall_time: 0.4, ..Settings::default() };
        assert_eq!(several, expected);
    }

    #[test]
    fn every_setting_but_pip_is_set_by_its_name() {
        for field in TEMPLATE_FIELDS {
            let value = 0.3 * field.min + 0.7 * field.max;
            let settings = parse(&["--settings", &format!("{}={value}", field.name)]).settings();
            assert!(field.value(&settings).total_cmp(&value).is_eq(), "{}", field.name);
            let others = TEMPLATE_FIELDS.iter().filter(|other| other.name != field.name);
            others.for_each(|other| assert!(other.value(&settings).total_cmp(&other.default).is_eq()));
        }
        let refused = setting("pip=20").unwrap_err();
        assert!(refused.contains("there is no setting pip") && refused.contains("rise_time"), "{refused}");
        assert_eq!(TEMPLATE_FIELDS.len(), FIELDS.len() - 1);
    }

    #[test]
    fn the_help_gives_bounds_and_default() {
        let mut command = Line::command();
        // The terminal's width determines the line breaks.
        let help = command.render_help().to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(help.contains("pressure_limit 15 to 70 cmH2O [60]"), "{help}");
    }

    #[test]
    fn one_impossible_pip_among_possible_ones_is_found() {
        let line = parse(&["--settings", "peep=12"]);
        assert!(line.checked(&[15.0, 20.0]).is_ok());
        assert!(matches!(line.checked(&[15.0, 10.0]), Err(SettingsError::PipBelowPeep { .. })));
    }

    #[test]
    fn a_setting_that_is_no_number_within_its_bounds_is_refused_with_them() {
        for wrong in ["peep=much", "peep", "peep=", "peep=nan", "peep=-1", "peep=21", "peep=inf"] {
            let refused = Line::try_parse_from(["test", "--settings", wrong]).unwrap_err().to_string();
            assert!(wrong == "peep" || refused.contains("allowed are 0 to 20 cmH2O"), "{refused}");
        }
    }
}
