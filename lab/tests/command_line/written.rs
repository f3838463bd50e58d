//! The commands that the documents contain: the programs know each with all its options, so that no page outlives an option.

use std::fs;
use std::path::{Path, PathBuf};

use clap::error::ErrorKind;
use clap::{Command, CommandFactory};

/// All documents of the tree.
fn pages() -> Vec<PathBuf> {
    let top = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let files =
        [".", "docs", "python", "host/bedside/web"].map(|folder| fs::read_dir(top.join(folder)).unwrap());
    let files = files.into_iter().flatten().map(|file| file.unwrap().path());
    files.filter(|file| file.extension().is_some_and(|ending| ending == "md")).collect()
}

/// The commands of a page, each on one line: of code blocks, and of code within the text that names an option.
fn commands(page: &str) -> Vec<String> {
    let page = page.replace("\\\n", " ");
    let blocks = page.lines().filter(|line| line.starts_with("    ")).map(str::trim);
    // Text wraps within its code too.
    let text = page.replace('\n', " ");
    let within = text.split('`').skip(1).step_by(2).filter(|code| code.contains(" --")).map(str::to_owned);
    blocks.map(str::to_owned).chain(within).collect()
}

/// A command whose quotations are single words; what they say does not matter here.
fn one_word_for_each_quotation(command: &str) -> String {
    let parts = command.split(['\'', '"']).enumerate();
    parts.map(|(number, part)| if number % 2 == 0 { part } else { "quotation" }).collect()
}

/// The program and the arguments of a command; none if it is another program's.
fn called(command: &str) -> Option<(Command, Vec<String>)> {
    let command = one_word_for_each_quotation(command);
    // Not the remark, nor what a shell does with the output.
    let command = command.split([';', '&', '|', '>']).next()?.split(" #").next()?;
    let mut words = command.split_whitespace().map(str::to_owned);
    let first = words.next()?;
    let name = if first == "cargo" { words.next()? } else { first.rsplit('/').next()?.to_owned() };
    let program = match name.as_str() {
        "trainer" => host::cli::Cli::command(),
        "lab" => lab::cli::Cli::command(),
        _ => return None,
    };
    Some((program, std::iter::once(name).chain(words).collect()))
}

/// Why a program refuses a command, whatever the values in it: they may stand for the reader's own.
fn refused(program: Command, arguments: &[String]) -> Option<String> {
    let error = program.try_get_matches_from(arguments).err()?;
    let kinds = [
        ErrorKind::UnknownArgument,
        ErrorKind::InvalidSubcommand,
        ErrorKind::ArgumentConflict,
        ErrorKind::TooManyValues,
    ];
    kinds.contains(&error.kind()).then(|| error.to_string())
}

#[test]
fn the_programs_know_every_command_of_the_documents() {
    let mut seen = 0;
    for file in pages() {
        for command in commands(&fs::read_to_string(&file).unwrap()) {
            let Some((program, arguments)) = called(&command) else { continue };
            seen += 1;
            let refused = refused(program, &arguments);
            assert!(refused.is_none(), "{}: {command}\n{}", file.display(), refused.unwrap_or_default());
        }
    }
    assert!(seen > 100, "only {seen} commands");
}

#[test]
fn a_command_with_an_option_that_does_not_exist_is_found() {
    let page =
        "Text with `trainer serve --demo`, and\n\n    cargo trainer collect --breathes 20  # a remark\n";
    let found: Vec<_> = commands(page).iter().filter_map(|command| called(command)).collect();
    let refused: Vec<_> =
        found.into_iter().map(|(program, arguments)| refused(program, &arguments)).collect();
    assert!(matches!(&refused[..], [Some(why), None] if why.contains("--breathes")), "{refused:?}");
}
