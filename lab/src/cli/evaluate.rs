//! `lab evaluate`: `trainer evaluate`, also for rivals and third-party policies.

use host::args::controller::Chosen;
use host::cli::evaluate;
use host::command::Context;
use laws::policy::account::Account;
use ventilator::SharedLink;

use crate::args::law::LawArgs;
use crate::args::policy::{PolicyArgs, account, check, print};

/// The arguments of the command.
pub type Args = evaluate::Args<Choice>;

/// A controller, a rival or a policy.
#[derive(Debug, clap::Args)]
pub struct Choice {
    #[command(flatten)]
    law: LawArgs,
    #[command(flatten)]
    policy: PolicyArgs,
}

impl evaluate::Choice for Choice {
    type Account = Account;

    const HELP: &'static str = "\
Examples:
  lab evaluate --controller iterative --against 6,250,0.15 --bench R5C50 --breaths-of-learning 20
  lab evaluate --controller feed-forward --bench R20C20 --report evaluation.html
  lab evaluate --policy tcp:localhost:7100 --gains 6,250,0.15 --bench R5C50
  lab evaluate --policy 'pipe:python3 examples/python/policy.py --onnx policy.onnx'
  lab evaluate --policy tcp:localhost:7100 --plant tcp:localhost:7000 --json -

The command is `trainer evaluate`, whose help explains scores and options, with more controllers to
choose from. A rival is compared with the PID underneath it, or with --against.

With --policy, a controller of your own, in any language, commands the valve over the policy link
(docs/POLICY_LINK.md), behind the same safety envelope as a learned controller. If it fails, the PID
goes on; the result names the failure and the share of the ticks that each commanded. The exit code
is 1 if the policy commanded none.";

    const NOT_WHILE_BREATHING: &'static [&'static str] = &["port", "plant", "report", "policy"];

    fn chosen(&self, plant: Option<&SharedLink>) -> anyhow::Result<Chosen> {
        match self.policy.connect()? {
            Some(policy) => self.law.chosen_with(policy, plant),
            None => self.law.chosen(plant),
        }
    }

    fn takes_turns(&self) -> bool {
        self.policy.policy.is_some()
    }

    fn account(&self, chosen: &Chosen, context: &Context<'_>) -> Option<Account> {
        let account = account(&chosen.controller);
        print(context, account.as_ref());
        account
    }

    fn check(account: Option<&Account>) -> anyhow::Result<()> {
        check(account)
    }
}
