//! The help of a program: its commands in groups, a line each.

use clap::Command;

/// A program whose help lists the commands in groups; `groups` has that of each command.
pub fn grouped(program: Command, groups: &[&str]) -> Command {
    let header = program.get_styles().get_header();
    let list = list(&program, groups);
    let template = format!(
        "{{about-with-newline}}\n{{usage-heading}} {{usage}}\n\n{list}{header}Options:{header:#}\n{{options}}{{after-help}}"
    );
    program.help_template(template)
}

/// The commands under the headings of their groups.
fn list(program: &Command, groups: &[&str]) -> String {
    let (header, literal) = (program.get_styles().get_header(), program.get_styles().get_literal());
    let width = program.get_subcommands().map(|command| command.get_name().len()).max().unwrap_or_default();
    let (mut lines, mut heading) = (Vec::new(), "");
    for (command, group) in program.get_subcommands().zip(groups) {
        if *group != heading {
            let gap = if heading.is_empty() { "" } else { "\n" };
            lines.push(format!("{gap}{header}{group}:{header:#}\n"));
            heading = group;
        }
        let about = command.get_about().map(ToString::to_string).unwrap_or_default();
        lines.push(format!("  {literal}{:width$}{literal:#}  {about}\n", command.get_name()));
    }
    lines.concat() + "\n"
}
