//! The tables of docs/COMMANDS.md are the commands of both programs, as their help has them.

use std::fs;
use std::path::Path;

use clap::Command;
use clap::CommandFactory;
use host::command::Program;

/// Rewrites the page where it differs; set to anything.
const BLESS: &str = "EUPNEA_BLESS";

/// The table of a program's commands.
fn table(program: &Command, groups: &[&str]) -> String {
    let mut rows = vec!["| group | command | purpose |".to_owned(), "|---|---|---|".to_owned()];
    let mut last = "";
    for (command, group) in program.get_subcommands().zip(groups) {
        let about = command.get_about().map(ToString::to_string).unwrap_or_default();
        let shown = if *group == last { "" } else { group };
        rows.push(format!("| {shown} | `{}` | {about} |", command.get_name()));
        last = group;
    }
    rows.join("\n")
}

/// A page with the table of a program between its marks.
fn with(page: &str, name: &str, table: &str) -> String {
    let (begin, end) = (format!("<!-- {name} -->\n"), format!("\n<!-- end of {name} -->"));
    let (before, rest) = page.split_once(&begin).expect("the page has the mark of each table");
    let (_, after) = rest.split_once(&end).expect("the page has the mark of each table's end");
    format!("{before}{begin}{table}{end}{after}")
}

#[test]
fn the_page_of_commands_lists_those_of_the_help() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../docs/COMMANDS.md");
    let page = fs::read_to_string(&path).unwrap();
    let trainer = table(&host::cli::Cli::command(), host::cli::Cli::groups());
    let lab = table(&lab::cli::Cli::command(), lab::cli::Cli::groups());
    let expected = with(&with(&page, "trainer", &trainer), "lab", &lab);
    if std::env::var_os(BLESS).is_some() {
        fs::write(&path, &expected).unwrap();
        return;
    }
    assert!(page == expected, "docs/COMMANDS.md differs from the help: run this test with {BLESS}=1");
}
