//! A control law of any kind behind one type: what a program runs when its user chooses the law.
//!
//! A new law is one type that implements [`ControlLaw`] and [`Law`]; nothing else has to list it.

use std::any::Any;
use std::fmt::Debug;
use std::sync::Arc;

use shared::control::memory::Lesson;
use shared::control::pid::Pid;
use shared::control::{ControlLaw, ControlOutput, Controller, Observation};

/// What a program asks a control law beside its commands.
pub trait Law: ControlLaw<State: Kept> + Any + Debug + PartialEq + Send + Sync {
    /// Its PID: alone, or the one underneath.
    fn pid(&self) -> &Pid;

    /// The controller, if a device can run it.
    fn chip(&self) -> Option<&Controller> {
        None
    }
}

impl Law for Controller {
    fn pid(&self) -> &Pid {
        Self::pid(self)
    }

    fn chip(&self) -> Option<&Controller> {
        Some(self)
    }
}

/// A control law whose kind is known at run time only. Clones share the law, never its state.
#[derive(Clone, Debug)]
pub struct AnyLaw(Arc<dyn Erased>);

/// The state of an [`AnyLaw`].
#[derive(Debug)]
pub struct AnyState(Box<dyn Kept>);

impl AnyLaw {
    /// A law of any kind.
    pub fn new(law: impl Law) -> Self {
        Self(Arc::new(law))
    }

    /// The law, if it is of this kind.
    pub fn downcast<L: Law>(&self) -> Option<&L> {
        (self.0.as_ref() as &dyn Any).downcast_ref()
    }

    /// See [`Law::pid`].
    pub fn pid(&self) -> &Pid {
        self.0.pid()
    }

    /// See [`Law::chip`].
    pub fn chip(&self) -> Option<&Controller> {
        self.0.chip()
    }
}

impl PartialEq for AnyLaw {
    fn eq(&self, other: &Self) -> bool {
        self.0.equals(other.0.as_ref())
    }
}

impl Clone for AnyState {
    fn clone(&self) -> Self {
        Self(self.0.copy())
    }
}

impl ControlLaw for AnyLaw {
    type State = AnyState;

    fn initial_state(&self) -> AnyState {
        AnyState(self.0.initial())
    }

    fn learn(&self, state: &mut AnyState, lesson: Lesson) -> Lesson {
        self.0.learn(state, lesson)
    }

    fn start_breath(&self, state: &mut AnyState, command: f32) {
        self.0.start_breath(state, command);
    }

    fn step(&self, state: &mut AnyState, seen: &Observation) -> ControlOutput {
        self.0.step(state, seen)
    }

    fn applied(&self, state: &mut AnyState, command: f32) {
        self.0.applied(state, command);
    }
}

/// A state of any kind.
pub trait Kept: Any + Debug + Send + Sync {
    /// A clone of it.
    fn copy(&self) -> Box<dyn Kept>;
}

impl<S: Any + Clone + Debug + Send + Sync> Kept for S {
    fn copy(&self) -> Box<dyn Kept> {
        Box::new(self.clone())
    }
}

/// [`Law`] without its types.
trait Erased: Any + Debug + Send + Sync {
    fn pid(&self) -> &Pid;
    fn chip(&self) -> Option<&Controller>;
    fn equals(&self, other: &dyn Any) -> bool;
    fn initial(&self) -> Box<dyn Kept>;
    fn learn(&self, state: &mut AnyState, lesson: Lesson) -> Lesson;
    fn start_breath(&self, state: &mut AnyState, command: f32);
    fn step(&self, state: &mut AnyState, seen: &Observation) -> ControlOutput;
    fn applied(&self, state: &mut AnyState, command: f32);
}

impl<L: Law> Erased for L {
    fn pid(&self) -> &Pid {
        Law::pid(self)
    }

    fn chip(&self) -> Option<&Controller> {
        Law::chip(self)
    }

    fn equals(&self, other: &dyn Any) -> bool {
        other.downcast_ref::<L>() == Some(self)
    }

    fn initial(&self) -> Box<dyn Kept> {
        Box::new(self.initial_state())
    }

    fn learn(&self, state: &mut AnyState, lesson: Lesson) -> Lesson {
        ControlLaw::learn(self, own(self, state), lesson)
    }

    fn start_breath(&self, state: &mut AnyState, command: f32) {
        ControlLaw::start_breath(self, own(self, state), command);
    }

    fn step(&self, state: &mut AnyState, seen: &Observation) -> ControlOutput {
        ControlLaw::step(self, own(self, state), seen)
    }

    fn applied(&self, state: &mut AnyState, command: f32) {
        ControlLaw::applied(self, own(self, state), command);
    }
}

/// The state as that of `law`. A law that replaces one of another kind within a breath starts with its own initial state.
fn own<'a, L: Law>(law: &L, state: &'a mut AnyState) -> &'a mut L::State {
    if !(state.0.as_ref() as &dyn Any).is::<L::State>() {
        state.0 = law.initial();
    }
    (state.0.as_mut() as &mut dyn Any).downcast_mut().expect("the state is of this kind")
}
