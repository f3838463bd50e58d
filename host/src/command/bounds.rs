//! Numbers within bounds. The bounds stand once, where an option is declared; its help and its errors both state them.

use std::ffi::OsStr;
use std::fmt::{self, Display};
use std::str::FromStr;

use clap::builder::{PossibleValue, StringValueParser, StyledStr, TypedValueParser};
use clap::error::Error;
use clap::{Arg, Command};

/// Most breaths, steps or rows that an option can ask for.
pub const MOST: usize = 100_000_000;

/// A parser of numbers from `low` to `high`, both included.
pub const fn within<T>(low: T, high: T) -> Within<T> {
    Within { low, high }
}

/// A parser of counts of at least one.
pub const fn some() -> Within<usize> {
    within(1, MOST)
}

/// A parser of numbers of at least zero.
pub const fn not_negative() -> Within<f64> {
    within(0.0, 1e6)
}

/// Bounds, and a parser of numbers within them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Within<T> {
    low: T,
    high: T,
}

impl<T: Display> Display for Within<T> {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} to {}", self.low, self.high)
    }
}

impl<T> TypedValueParser for Within<T>
where
    T: FromStr + PartialOrd + Display + Copy + Send + Sync + 'static,
{
    type Value = T;

    fn parse_ref(&self, command: &Command, argument: Option<&Arg>, value: &OsStr) -> Result<T, Error> {
        let bounds = *self;
        let within = move |text: String| match text.trim().parse() {
            // NaN is within no bounds.
            Ok(number) if bounds.low <= number && number <= bounds.high => Ok(number),
            _ => Err(format!("write a number from {bounds}")),
        };
        StringValueParser::new().try_map(within).parse_ref(command, argument, value)
    }

    /// The bounds, hidden from the list of values: [`stated`] puts them into the help.
    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(std::iter::once(PossibleValue::new(self.to_string()).hide(true))))
    }
}

/// A program whose options state the bounds of their numbers in their help.
pub fn stated(program: Command) -> Command {
    program.mut_subcommands(|command| command.mut_args(with_bounds))
}

fn with_bounds(argument: Arg) -> Arg {
    let values = argument.get_possible_values();
    let [bounds] = &values[..] else { return argument };
    if !bounds.is_hide_set() {
        return argument;
    }
    let bounds = format!("[{}]", bounds.get_name());
    let argument = argument.hide_possible_values(true);
    let beside = |help: &StyledStr| format!("{help} {bounds}");
    let (short, long) = (argument.get_help().map(beside), argument.get_long_help().map(beside));
    let argument = short.into_iter().fold(argument, Arg::help);
    long.into_iter().fold(argument, Arg::long_help)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn program() -> Command {
        let share = Arg::new("share").long("share").help("Share of it").value_parser(within(0.0_f32, 1.0));
        let breaths = Arg::new("breaths").long("breaths").value_parser(some());
        stated(Command::new("program").subcommand(Command::new("run").args([share, breaths])))
    }

    #[test]
    fn help_and_error_state_the_bounds() {
        let mut program = program();
        let help = program.find_subcommand_mut("run").unwrap().render_help().to_string();
        assert!(help.contains("Share of it [0 to 1]") && !help.contains("possible values"), "{help}");
        let refused =
            program.try_get_matches_from(["program", "run", "--share", "2"]).unwrap_err().to_string();
        assert!(refused.contains("--share") && refused.contains("from 0 to 1"), "{refused}");
    }

    #[test]
    fn the_bounds_are_included_and_nothing_beyond_them_is() {
        let share = |text: &str| {
            let typed = ["program", "run", &format!("--share={text}")].map(str::to_owned);
            let matches = program().try_get_matches_from(typed).ok()?;
            matches.subcommand_matches("run").unwrap().get_one::<f32>("share").copied()
        };
        assert_eq!(["0", "1", " 0.5"].map(share), [Some(0.0), Some(1.0), Some(0.5)]);
        for beyond in ["-0.001", "1.001", "nan", "NaN", "inf", "-inf", "1e30", "", "half", "1,2"] {
            assert_eq!(share(beyond), None, "{beyond}");
        }
    }
}
