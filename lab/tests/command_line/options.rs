//! The options of both programs: one meaning, one value and one unit for each name.

use std::any::TypeId;
use std::collections::{BTreeMap, BTreeSet};
use std::path::PathBuf;

use clap::error::ErrorKind;
use clap::{Arg, ArgAction, Command, CommandFactory};
use host::command::OutFile;

/// Units as the help writes them, and what value names say of them.
const UNITS: [(&str, &str); 9] = [
    ("cmH2O", "CMH2O"),
    ("cmH2O/s", "CMH2O/S"),
    ("s", "SECONDS"),
    ("ms", "MS"),
    ("microseconds", "US"),
    ("percent", "PERCENT"),
    ("h", "HOURS"),
    ("mL", "ML"),
    ("L/min", "L/MIN"),
];

/// What an option takes.
#[derive(Debug, PartialEq, Eq, PartialOrd, Ord)]
struct Taken {
    /// Its value name; none for a flag.
    value: Option<String>,
    kind: String,
    units: BTreeSet<&'static str>,
}

impl Taken {
    fn by(option: &Arg) -> Self {
        let flag = matches!(option.get_action(), ArgAction::SetTrue);
        let names = option.get_value_names().into_iter().flatten().map(ToString::to_string);
        let value = (!flag).then(|| names.collect::<Vec<_>>().join(" "));
        Self { value, kind: kind(option), units: units(option) }
    }
}

/// What a value is, whatever its width.
fn kind(option: &Arg) -> String {
    let id = option.get_value_parser().type_id();
    let is = |types: &[TypeId]| types.iter().any(|kind| id == *kind);
    let whole = [TypeId::of::<u16>(), TypeId::of::<u32>(), TypeId::of::<u64>(), TypeId::of::<usize>()];
    if is(&whole) {
        "whole number".to_owned()
    } else if is(&[TypeId::of::<f32>(), TypeId::of::<f64>()]) {
        "number".to_owned()
    } else if is(&[TypeId::of::<String>(), TypeId::of::<PathBuf>(), TypeId::of::<OutFile>()]) {
        "text".to_owned()
    } else {
        format!("{id:?}")
    }
}

/// The units that the help of an option names.
fn units(option: &Arg) -> BTreeSet<&'static str> {
    let help = option.get_help().map(ToString::to_string).unwrap_or_default();
    let words = help.split(|letter: char| letter.is_whitespace() || ",;:()[]".contains(letter));
    let words: BTreeSet<&str> = words.map(|word| word.trim_end_matches('.')).collect();
    UNITS.iter().map(|(unit, _)| *unit).filter(|unit| words.contains(unit)).collect()
}

/// All options of a command and its subcommands, with the places where they are.
fn walk(command: &Command, path: &str, found: &mut BTreeMap<String, BTreeMap<Taken, Vec<String>>>) {
    for option in command.get_arguments().filter(|option| option.get_long().is_some()) {
        let name = option.get_long().unwrap_or_default().to_owned();
        found.entry(name).or_default().entry(Taken::by(option)).or_default().push(path.to_owned());
    }
    for inner in command.get_subcommands() {
        walk(inner, &format!("{path} {}", inner.get_name()), found);
    }
}

fn options() -> BTreeMap<String, BTreeMap<Taken, Vec<String>>> {
    let mut found = BTreeMap::new();
    walk(&host::cli::Cli::command(), "trainer", &mut found);
    walk(&lab::cli::Cli::command(), "lab", &mut found);
    found
}

#[test]
fn an_option_name_has_one_value_and_one_unit_in_all_commands_of_both_programs() {
    let options = options();
    assert!(options.len() > 100 && options["bench"].len() == 1, "{:?}", options["bench"]);
    let several: Vec<_> = options.iter().filter(|(_, taken)| taken.len() > 1).collect();
    assert!(several.is_empty(), "{several:#?}");
}

#[test]
fn a_unit_in_a_value_name_is_in_the_help_too() {
    for (name, taken) in options() {
        for Taken { value, units, .. } in taken.keys() {
            let value = value.as_deref().unwrap_or_default();
            let unit = UNITS.iter().find(|(_, named)| value.split(',').any(|part| part == *named));
            assert!(unit.is_none_or(|(unit, _)| units.contains(unit)), "--{name} {value}: {units:?}");
        }
    }
}

#[test]
fn value_names_are_from_one_list() {
    for (name, taken) in options() {
        for value in taken.keys().filter_map(|taken| taken.value.as_deref()) {
            let alike = ["FOLDER", "DIRECTORY", "COUNT", "NUMBER", "VALUE", "S"];
            let own = name.to_uppercase().replace('-', "_");
            assert!(!value.is_empty() && !alike.contains(&value), "--{name} {value}");
            let fine = ["SEED", "PORT", "PLANT", "POLICY", "OPTION", "HOURS"];
            assert!(value != own || fine.contains(&value), "--{name} has no value name");
        }
    }
}

/// The commands of both programs with their options that take numbers: those that refuse a word and accept some number.
fn numeric_options() -> Vec<(Command, String)> {
    let programs = [host::cli::Cli::command(), lab::cli::Cli::command()];
    let commands = programs.iter().flat_map(Command::get_subcommands).flat_map(|command| {
        let inner = command.get_subcommands().cloned();
        std::iter::once(command.clone()).chain(inner)
    });
    let numeric = commands.flat_map(|command| {
        let names = command.get_arguments().filter(|option| option.get_action().takes_values());
        let names: Vec<String> = names.filter_map(|option| option.get_long().map(str::to_owned)).collect();
        let is_number = |name: &String| {
            let accepts = |value: &str| refused(&command, name, value).is_none();
            // A port is a number too, with an error of its own.
            name != "listen" && !accepts("word") && ["1", "8", "20", "45", "1000"].into_iter().any(accepts)
        };
        let numeric: Vec<String> = names.into_iter().filter(is_number).collect();
        numeric.into_iter().map(move |name| (command.clone(), name))
    });
    numeric.collect()
}

/// Why a command refuses a value of an option, if it does.
fn refused(command: &Command, option: &str, value: &str) -> Option<String> {
    let typed = [command.get_name(), &format!("--{option}={value}")].map(str::to_owned);
    let error = command.clone().try_get_matches_from(typed).err()?;
    let is_of_value = matches!(error.kind(), ErrorKind::ValueValidation | ErrorKind::InvalidValue);
    is_of_value.then(|| error.to_string())
}

#[test]
fn every_number_of_every_command_has_bounds_that_its_errors_state() {
    let numeric = numeric_options();
    assert!(numeric.len() > 60, "{}", numeric.len());
    for (command, option) in numeric {
        for value in ["nan", "inf", "-inf", "-1e30", "1e300", "", "99999999999999999999999"] {
            let refused = refused(&command, &option, value);
            let refused = refused.unwrap_or_else(|| panic!("{} --{option}={value}", command.get_name()));
            // A seed has all whole numbers.
            let bounds = refused.contains(" from ") || refused.contains("allowed") || option.contains("seed");
            assert!(refused.contains(&format!("--{option}")) && bounds, "{refused}");
        }
    }
}
