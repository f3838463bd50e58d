//! The ventilator's settings as flags: one per field of the schema, with its unit, bounds and default.
//!
//! The flags are built from [`TEMPLATE_FIELDS`], so a new setting appears here automatically. PIP is excluded: commands
//! that run several waveforms take a list of PIPs.

use anyhow::bail;
use clap::{Arg, ArgAction, ArgMatches, Args, Command, FromArgMatches, value_parser};
use shared::settings::{Field, Settings, SettingsError, TEMPLATE_FIELDS};

/// All settings except PIP, as typed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SettingsArgs {
    settings: Settings,
}

impl SettingsArgs {
    /// The settings, checked with each of these PIPs.
    ///
    /// # Errors
    /// A setting outside its bounds, or a PIP that does not go with the others.
    pub fn checked(&self, pips: &[f32]) -> Result<Settings, SettingsError> {
        pips.iter().try_for_each(|pip| Settings { pip: *pip, ..self.settings }.validate())?;
        Ok(self.settings)
    }

    /// The same, checked for a training too.
    ///
    /// # Errors
    /// The same, or a rise, which no training supports.
    pub fn for_training(&self, pips: &[f32]) -> anyhow::Result<Settings> {
        let settings = self.checked(pips)?;
        if settings.rise_time > 0.0 {
            bail!("training supports only the paper's square rise: leave --rise-time at 0");
        }
        Ok(settings)
    }
}

fn flag(field: &Field) -> Arg {
    let (unit, min, max) = (field.unit, field.min, field.max);
    Arg::new(field.name)
        .long(field.name.replace('_', "-"))
        .value_name(unit.to_uppercase().replace('%', "PERCENT"))
        .help(format!("{}, {min} to {max} {unit}", field.description))
        .help_heading("Settings")
        .allow_negative_numbers(true)
        .action(ArgAction::Set)
        .value_parser(value_parser!(f32))
        .default_value(field.default.to_string())
}

impl Args for SettingsArgs {
    fn augment_args(command: Command) -> Command {
        command.args(TEMPLATE_FIELDS.iter().map(flag))
    }

    fn augment_args_for_update(command: Command) -> Command {
        Self::augment_args(command)
    }
}

impl FromArgMatches for SettingsArgs {
    fn from_arg_matches(matches: &ArgMatches) -> Result<Self, clap::Error> {
        let typed =
            |field: &Field| Some((field.name.to_owned(), (*matches.get_one::<f32>(field.name)?).into()));
        // JSON turns a number it cannot represent into null, which the schema refuses as not a number.
        let values: serde_json::Map<_, _> = TEMPLATE_FIELDS.iter().filter_map(typed).collect();
        let settings = serde_json::from_value(values.into());
        let refused =
            |e| clap::Error::raw(clap::error::ErrorKind::ValueValidation, format!("settings: {e}\n"));
        Ok(Self { settings: settings.map_err(refused)? })
    }

    fn update_from_arg_matches(&mut self, matches: &ArgMatches) -> Result<(), clap::Error> {
        *self = Self::from_arg_matches(matches)?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Debug, Parser)]
    struct Line {
        #[command(flatten)]
        settings: SettingsArgs,
    }

    fn parse(arguments: &[&str]) -> Settings {
        let line = std::iter::once("test").chain(arguments.iter().copied());
        Line::try_parse_from(line).unwrap().settings.settings
    }

    #[test]
    fn without_flags_the_settings_are_the_schemas_defaults() {
        assert_eq!(parse(&[]), Settings::default());
    }

    #[test]
    fn every_setting_but_pip_has_a_flag_that_sets_it() {
        for field in TEMPLATE_FIELDS {
            let flag = format!("--{}", field.name.replace('_', "-"));
            let settings = parse(&[&flag, "17.3"]);
            assert!((field.value(&settings) - 17.3).abs() < f32::EPSILON, "{flag}");
            let others = TEMPLATE_FIELDS.iter().filter(|other| other.name != field.name);
            others.for_each(|other| assert!(other.value(&settings).total_cmp(&other.default).is_eq()));
        }
        assert!(TEMPLATE_FIELDS.iter().all(|field| field.name != "pip"));
        assert_eq!(TEMPLATE_FIELDS.len(), shared::settings::FIELDS.len() - 1);
    }

    #[test]
    fn the_help_gives_bounds_and_default() {
        let mut command = Line::augment_args(Command::new("test"));
        // The terminal's width determines the line breaks.
        let help = command.render_help().to_string().split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(help.contains("--pressure-limit") && help.contains("15 to 70 cmH2O"), "{help}");
        assert!(help.contains("[default: 60]"), "{help}");
    }

    #[test]
    fn one_impossible_pip_among_possible_ones_is_found() {
        let line = SettingsArgs { settings: parse(&["--peep", "12"]) };
        assert!(line.checked(&[15.0, 20.0]).is_ok());
        assert!(matches!(line.checked(&[15.0, 10.0]), Err(SettingsError::PipBelowPeep { .. })));
    }

    #[test]
    fn a_setting_that_is_no_number_is_refused() {
        assert!(Line::try_parse_from(["test", "--peep", "nan"]).is_err());
        assert!(Line::try_parse_from(["test", "--peep", "much"]).is_err());
    }
}
