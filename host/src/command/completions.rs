//! `completions`: a script with which a shell completes the program's commands and options.

use std::marker::PhantomData;

use anyhow::Context as _;
use clap_complete::{Shell, generate};

use super::help::grouped;
use super::{Command, Context, Program};

/// Print a script with which your shell completes commands
#[derive(Debug, clap::Args)]
#[command(after_help = examples(P::NAME))]
pub struct Args<P: Program> {
    /// The shell
    #[arg(value_name = "SHELL")]
    shell: Shell,
    #[arg(skip)]
    program: PhantomData<P>,
}

/// How each shell finds its script.
fn examples(program: &str) -> String {
    format!(
        "\
Examples:
  {program} completions bash > ~/.local/share/bash-completion/completions/{program}
  {program} completions zsh > ~/.zfunc/_{program}
  {program} completions fish > ~/.config/fish/completions/{program}.fish
  {program} completions powershell >> $PROFILE

The shells read these places when they start, zsh if ~/.zshrc has the line `fpath+=~/.zfunc` before
that of compinit. They complete the name `{program}`: put the program on the path under it."
    )
}

impl<P: Program> Command for Args<P> {
    type Outcome = String;

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<String>> {
        let mut script = Vec::new();
        generate(self.shell, &mut grouped(P::command(), P::groups()), P::NAME, &mut script);
        let script = String::from_utf8(script).context("the script is no text")?;
        context.line(script.trim_end());
        Ok(Some(script))
    }
}
