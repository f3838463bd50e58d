//! A third-party policy in place of a controller: its options, and the report of its commands and failures.

use std::time::Duration;

use anyhow::{Context as _, bail};
use laws::policy::PolicyLaw;
use laws::policy::account::{Account, Event};
use laws::policy::link::PolicyLink;
use plant::line::Address;
use plant::link::PATIENCE;
use ventilator::law::AnyLaw;

use host::command::Context;
use host::command::bounds::within;

/// The choice of a policy.
#[derive(Debug, clap::Args)]
pub struct PolicyArgs {
    /// Your own policy in place of a controller, behind the safety envelope: tcp:HOST:PORT, or 'pipe:COMMAND' to start it; --gains sets
    /// the PID underneath
    #[arg(long, value_name = "POLICY", conflicts_with = "controller")]
    pub policy: Option<Address>,
    /// Longest time the policy may take to answer, s
    #[arg(long, value_name = "SECONDS", requires = "policy", default_value_t = PATIENCE.as_secs_f64(), value_parser = within::<f64>(0.001, 86_400.0))]
    policy_timeout: f64,
}

impl PolicyArgs {
    /// The connected policy, if one is chosen.
    ///
    /// # Errors
    /// A policy that does not answer.
    pub fn connect(&self) -> anyhow::Result<Option<PolicyLink>> {
        let Some(address) = &self.policy else { return Ok(None) };
        let patience = Duration::from_secs_f64(self.policy_timeout);
        let link = PolicyLink::open(address, patience);
        Ok(Some(link.with_context(|| format!("cannot use the policy {address}"))?))
    }
}

/// The account of the policy, if the controller is one.
pub fn account(controller: &AnyLaw) -> Option<Account> {
    controller.downcast().map(PolicyLaw::account)
}

/// Prints the shares of the policy's commands, its answer times and its failure.
pub fn print(context: &Context<'_>, account: Option<&Account>) {
    account.map_or_else(Vec::new, lines).iter().for_each(|line| context.line(line));
}

/// Refuses a policy that has commanded no tick, unless kept results were all that was needed.
///
/// # Errors
/// Such a policy.
pub fn check(account: Option<&Account>) -> anyhow::Result<()> {
    match account {
        Some(account) if account.runs > 0 && account.commanded == 0 => {
            let reason = account.failure.as_ref().or(account.first_refused.as_ref());
            let reason = reason.map_or_else(|| "it was never trusted".to_owned(), at);
            bail!("the policy commanded no tick, so the scores are those of the PID: {reason}")
        }
        _ => Ok(()),
    }
}

fn lines(account: &Account) -> Vec<String> {
    let Account { ticks, commanded, limited, pid, refused, .. } = *account;
    let share = |of| account.percent(of);
    let mut lines = vec![format!(
        "the policy commanded {:.1} % of {ticks} ticks, the PID {:.1} %; in {:.1} % the rate of change was limited",
        share(commanded),
        share(pid),
        share(limited)
    )];
    let times = account.answers.quantiles();
    if let (Some(median), Some(p99)) = (times.answer_median_us, times.answer_p99_us) {
        lines.push(format!("answer times: median {median:.0} us, 99 % within {p99:.0} us"));
    }
    if let Some(first) = &account.first_refused {
        let share = share(refused);
        lines.push(format!("{refused} commands ({share:.1} %) were not usable; the first {}", at(first)));
    }
    if let Some(failure) = &account.failure {
        lines.push(format!("the policy failed {}; the PID commanded from there on", at(failure)));
    }
    lines
}

/// An event with its place.
pub fn at(event: &Event) -> String {
    let Event { run, breath, tick, what } = event;
    format!("in ventilation {run}, breath {breath}, tick {tick}: {what}")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn event(what: &str) -> Event {
        Event { run: 2, breath: 3, tick: 210, what: what.to_owned() }
    }

    #[test]
    fn a_failure_is_printed_with_its_place_and_the_share_of_the_pid() {
        let account = Account {
            ticks: 1000,
            commanded: 590,
            pid: 410,
            failure: Some(event("it is gone")),
            ..Account::default()
        };
        let text = lines(&account).join("\n");
        assert!(text.contains("the policy commanded 59.0 % of 1000 ticks, the PID 41.0 %"), "{text}");
        assert!(text.contains("failed in ventilation 2, breath 3, tick 210: it is gone;"), "{text}");
        assert!(check(Some(&account)).is_ok());
    }

    #[test]
    fn a_policy_that_commanded_nothing_is_refused_with_the_reason() {
        let account = Account {
            runs: 1,
            ticks: 9,
            pid: 9,
            first_refused: Some(event("a command of NaN percent")),
            ..Account::default()
        };
        let refused = check(Some(&account)).unwrap_err().to_string();
        assert!(
            refused.contains("NaN percent") && refused.contains("scores are those of the PID"),
            "{refused}"
        );
        assert!(check(None).is_ok());
    }
}
