//! The texts of `--help`, word by word.

use clap::CommandFactory;
use host::cli::Cli;
use host::command::Program;

use super::support::Place;

/// Most commands that the program may have, and most options of all commands together: --prescriptions is one that four commands have,
/// `import` takes the format of a file and proposes a column map, `margins` chooses a source, a controller and the sine, `export` the
/// bench of an FMU, and `flash` file, board, key and line of a release.
const MOST: (usize, usize) = (23, 232);

#[test]
fn every_command_explains_itself() {
    let place = Place::new();
    for command in [
        "demo",
        "train",
        "train-family",
        "commission",
        "farm",
        "collect",
        "tune-pid",
        "fit",
        "evaluate",
        "completions",
        "export",
        "inspect",
        "import",
        "judge",
        "margins",
        "identify",
        "monitor",
        "serve",
        "selftest",
        "blackbox",
        "keys",
        "flash",
        "qemu",
    ] {
        let help = place.ok(&format!("{command} --help"));
        assert!(help.contains("Examples:"), "{command}");
        insta::assert_snapshot!(command, help);
    }
}

#[test]
fn every_command_is_in_a_group_on_a_line_of_its_own() {
    let place = Place::new();
    let help = place.ok("--help");
    insta::assert_snapshot!("trainer", help);
    let program = Cli::command();
    let commands: Vec<&str> = program.get_subcommands().map(clap::Command::get_name).collect();
    assert_eq!(Cli::groups().len(), commands.len());
    let listed = help.lines().filter(|line| line.starts_with("  ") && !line.trim_start().starts_with('-'));
    let listed: Vec<&str> = listed.filter_map(|line| line.split_whitespace().next()).collect();
    assert_eq!(listed, commands, "one line each, in the order of the groups");
    let list = help.lines().skip_while(|line| *line != "Start:").take_while(|line| *line != "Options:");
    assert!(list.map(str::len).all(|columns| columns <= 80), "{help}");
    for group in ["Start", "Learn", "Judge", "Data", "Device"] {
        assert!(help.contains(&format!("\n{group}:\n")) && Cli::groups().contains(&group), "{group}");
    }
}

#[test]
fn commands_and_options_are_few() {
    let program = Cli::command();
    let commands: Vec<&clap::Command> = program.get_subcommands().collect();
    assert!(commands.iter().all(|command| !command.has_subcommands()), "no commands within commands");
    let options = commands.iter().flat_map(|command| command.get_arguments());
    let options = options.filter(|option| option.get_long().is_some()).count();
    assert!(commands.len() <= MOST.0 && options <= MOST.1, "{} commands, {options} options", commands.len());
}

#[test]
fn a_wrong_flag_is_a_usage_error() {
    let place = Place::new();
    let output = place.run("collect --out a.parquet --breath 3");
    assert_eq!(output.status.code(), Some(2));
    assert!(super::support::text(&output.stderr).contains("--breaths"), "it suggests the right one");
}

/// The examples in the help of commands that need no file, at the same size or smaller.
#[test]
fn examples_work() {
    let place = Place::new();
    place.ok("collect --out stiff.parquet --bench R50C10 --gains 2,30 --exploration boundary_probability=0.3 --breaths 6");
    place.ok(
        "collect --out slow.parquet --period-us 30000 --pips 15,25 --exploration triangle_height=-20:20 --breaths 30",
    );
    place.ok("fit slow.parquet --out paper.safetensors --architecture stitched --epochs 2");
    place.ok("evaluate --gains 2,30,0.01 --bench R5C50 --pips 15 --breaths 1");
    let bench = place.ok("inspect --bench R20C20");
    std::fs::write(place.path("bench.toml"), bench).unwrap();
    place.ok("evaluate --bench bench.toml --pips 15 --breaths 1");
}
