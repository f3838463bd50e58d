//! The scripts for shells.

use clap::CommandFactory;
use host::cli::Cli;

use super::support::Place;

/// The script's choices for a command line whose last word is being typed, as bash itself finds them.
#[cfg(unix)]
fn completed(place: &Place, words: &str) -> Option<Vec<String>> {
    let count = words.split(' ').count();
    let script = format!(
        "source trainer.bash && COMP_WORDS=({words}) COMP_CWORD={} && _trainer trainer '{}' '{}' && printf '%s\\n' \"${{COMPREPLY[@]}}\"",
        count - 1,
        words.split(' ').next_back()?.trim_matches('\''),
        words.split(' ').nth(count.checked_sub(2)?)?
    );
    let output = place.program("bash").args(["--norc", "-c", &script]).output().ok()?;
    assert!(output.status.success(), "{}", super::support::text(&output.stderr));
    Some(super::support::text(&output.stdout).lines().map(str::to_owned).collect())
}

#[test]
fn every_shell_gets_a_script_that_names_every_command() {
    let place = Place::new();
    for shell in ["bash", "zsh", "fish", "powershell"] {
        let script = place.ok(&format!("completions {shell}"));
        for command in Cli::command().get_subcommands() {
            assert!(script.contains(command.get_name()), "{shell}: {}", command.get_name());
        }
    }
    assert_eq!(place.run("completions tcsh").status.code(), Some(2));
}

#[cfg(unix)]
#[test]
fn bash_completes_commands_and_options() {
    let place = Place::new();
    std::fs::write(place.path("trainer.bash"), place.ok("completions bash")).unwrap();
    let Some(commands) = completed(&place, "trainer tr") else {
        eprintln!("skipped: there is no bash");
        return;
    };
    assert_eq!(commands, ["train", "train-family"]);
    assert_eq!(completed(&place, "trainer collect --ben").unwrap(), ["--bench"]);
    assert_eq!(completed(&place, "trainer completions z").unwrap(), ["zsh"]);
}
