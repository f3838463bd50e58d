//! A third party's policy, in any language, in the place of a learned controller (`docs/POLICY_LINK.md`).
//!
//! The plant, the ventilator, the supervisor and the safety filter are here; the policy answers each observation with a command of
//! the inspiratory valve. Underneath it runs a PID: [`PolicyLaw`] gives the supervisor both commands, as the learned controller does,
//! so the supervisor can bound the change and fall back to the PID. A policy that hangs, dies or answers nonsense is a policy that
//! does not command; the ventilation goes on.

pub mod account;
pub mod frame;
pub mod link;
#[cfg(test)]
mod tests;

use std::fmt;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use rayon::{ThreadPoolBuildError, ThreadPoolBuilder};
use shared::control::memory::Lesson;
use shared::control::pid::{Pid, PidState};
use shared::control::{ControlLaw, ControlOutput, Observation};

use account::Account;
use link::{Place, PolicyLink};
use ventilator::law::Law;

/// A policy over a PID. All clones use the same policy, which runs one ventilation at a time.
#[derive(Clone)]
pub struct PolicyLaw {
    link: Arc<Mutex<PolicyLink>>,
    pid: Pid,
    period_us: u32,
}

/// State of a ventilation with a policy.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PolicyState {
    pid: PidState,
    /// Where the ventilation is; none before the first breath.
    place: Option<Place>,
    /// Whether the policy knows of the running breath.
    started: bool,
    /// Last applied command, percent.
    applied: f32,
    /// Commands of the running tick: the PID's and, if it is usable, the policy's.
    asked: Option<(f32, Option<f32>)>,
}

impl PolicyLaw {
    /// A policy over a PID with this control period, microseconds.
    pub fn new(link: PolicyLink, pid: Pid, period_us: u32) -> Self {
        Self { link: Arc::new(Mutex::new(link)), pid, period_us }
    }

    /// What is known of the policy so far.
    pub fn account(&self) -> Account {
        self.link().account().clone()
    }

    fn link(&self) -> MutexGuard<'_, PolicyLink> {
        self.link.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Runs work on one thread, so that the ventilations in it take turns.
///
/// # Errors
/// The system gives no thread.
pub fn in_turns<T: Send>(work: impl FnOnce() -> T + Send) -> Result<T, ThreadPoolBuildError> {
    Ok(ThreadPoolBuilder::new().num_threads(1).build()?.install(work))
}

impl Law for PolicyLaw {
    fn pid(&self) -> &Pid {
        &self.pid
    }
}

impl ControlLaw for PolicyLaw {
    type State = PolicyState;

    fn initial_state(&self) -> PolicyState {
        PolicyState::default()
    }

    /// Sends the lesson. A policy that was not asked for a command in this breath has nothing to learn from it, and before the first
    /// breath of a ventilation it has nothing to forget.
    fn learn(&self, state: &mut PolicyState, lesson: Lesson) -> Lesson {
        if let Some(place) = state.place.filter(|_| state.started || lesson == Lesson::Forget) {
            self.link().learn(place, lesson, state.applied);
        }
        lesson
    }

    fn start_breath(&self, state: &mut PolicyState, command: f32) {
        let mut link = self.link();
        let place = match state.place {
            Some(Place { run, breath, .. }) => Place { run, breath: breath.wrapping_add(1), tick: 0 },
            None => Place { run: link.reset(self.period_us), ..Place::default() },
        };
        link.breath_begins();
        *state = PolicyState { place: Some(place), applied: command, ..PolicyState::default() };
    }

    /// The policy learns of a breath in the first tick that needs it: before, PIP and PEEP are not known here.
    fn step(&self, state: &mut PolicyState, seen: &Observation) -> ControlOutput {
        let base = self.pid.step(&mut state.pid, seen, 0.0).base;
        let place = Place { tick: seen.tick, ..state.place.unwrap_or_default() };
        let mut link = self.link();
        if !state.started {
            link.start(place, seen, state.applied);
            state.started = true;
        }
        let command = link.command(place, seen, state.applied);
        state.asked = Some((base, command));
        ControlOutput { base, command: command.unwrap_or(base) }
    }

    fn applied(&self, state: &mut PolicyState, command: f32) {
        self.link().count(command, state.asked.take());
        state.applied = command;
    }
}

/// Two laws are equal if they are the same policy over the same PID.
impl PartialEq for PolicyLaw {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.link, &other.link) && (self.pid, self.period_us) == (other.pid, other.period_us)
    }
}

impl fmt::Debug for PolicyLaw {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "PolicyLaw({})", self.link().address())
    }
}
