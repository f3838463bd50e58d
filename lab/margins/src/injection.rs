//! Sine injection: a control law that adds a sine to the command of another one.

use std::f64::consts::TAU;

use shared::control::{COMMAND_MAX, ControlLaw, ControlOutput, Observation};
use shared::math;

/// A sine that starts at zero.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sine {
    /// Amplitude, percent.
    pub amplitude: f64,
    /// Ticks of [`Self::periods`] periods together.
    pub ticks: u32,
    /// Whole periods in [`Self::ticks`].
    pub periods: u32,
}

impl Sine {
    /// Angle at a tick, radians.
    pub fn angle(&self, tick: u32) -> f64 {
        // The remainder keeps the angle small, so that the last period is as exact as the first.
        let turns = u64::from(tick) * u64::from(self.periods) % u64::from(self.ticks);
        TAU * turns as f64 / f64::from(self.ticks)
    }
}

/// Adds a sine to the command of another law, whose state it must not change: the law is told that its own command was applied.
///
/// The loop is thereby broken at the valve. The ratio of the command just before the sine to that just after it is the loop gain,
/// with a minus sign; what a law makes of its own past commands is part of the law.
#[derive(Clone, Copy, Debug)]
pub struct SineInjection<'a, C> {
    law: &'a C,
    sine: Sine,
    /// Last tick that the law sees: the time since the start of the breath stops here.
    held_tick: u32,
}

/// State of an [`SineInjection`].
#[derive(Clone, Debug)]
pub struct InjectionState<S> {
    law: S,
    /// Ticks since the sine started.
    tick: u32,
    /// Command of the law in the last tick, before the sine, percent.
    pub before: f32,
    /// Command in the last tick, after the sine and all limits, percent.
    pub after: f32,
}

impl<S> InjectionState<S> {
    /// The state with the sine at its start.
    #[must_use]
    pub fn restarted(self) -> Self {
        Self { tick: 0, ..self }
    }
}

impl<'a, C> SineInjection<'a, C> {
    /// Adds `sine` to the command of `law`, whose time stops at `held_tick`.
    pub fn new(law: &'a C, sine: Sine, held_tick: u32) -> Self {
        Self { law, sine, held_tick }
    }
}

impl<C: ControlLaw> ControlLaw for SineInjection<'_, C> {
    type State = InjectionState<C::State>;

    fn initial_state(&self) -> Self::State {
        InjectionState { law: self.law.initial_state(), tick: 0, before: 0.0, after: 0.0 }
    }

    fn start_breath(&self, state: &mut Self::State, command: f32) {
        self.law.start_breath(&mut state.law, command);
    }

    fn step(&self, state: &mut Self::State, seen: &Observation) -> ControlOutput {
        let held = Observation { tick: seen.tick.min(self.held_tick), ..*seen };
        let command = self.law.step(&mut state.law, &held).command;
        state.before = math::limit(command, 0.0, COMMAND_MAX);
        let sine = self.sine.amplitude * self.sine.angle(state.tick).sin();
        ControlOutput::plain(state.before + sine as f32)
    }

    fn applied(&self, state: &mut Self::State, command: f32) {
        state.after = command;
        self.law.applied(&mut state.law, state.before);
        state.tick += 1;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Commands 40 percent, more by the tick that it sees, and keeps the command that was applied.
    struct Counter;

    impl ControlLaw for Counter {
        type State = f32;

        fn initial_state(&self) -> f32 {
            -1.0
        }

        fn start_breath(&self, state: &mut f32, command: f32) {
            *state = command;
        }

        fn step(&self, _: &mut f32, seen: &Observation) -> ControlOutput {
            ControlOutput::plain(40.0 + 10.0 * seen.tick as f32)
        }

        fn applied(&self, state: &mut f32, command: f32) {
            *state = command;
        }
    }

    fn seen(tick: u32) -> Observation {
        Observation { pressure: 20.0, target: 20.0, pip: 20.0, peep: 5.0, tick, rise_ticks: 0 }
    }

    #[test]
    fn the_sine_is_added_after_the_law_which_knows_only_its_own_command() {
        let law = SineInjection::new(&Counter, Sine { amplitude: 4.0, ticks: 8, periods: 2 }, 3);
        let mut state = law.initial_state();
        assert!((state.law + 1.0).abs() < 1e-6);
        law.start_breath(&mut state, 7.0);
        assert!((state.law - 7.0).abs() < 1e-6);
        // Two periods in eight ticks; the law's clock stops at tick 3.
        for (tick, own, sine) in
            [(0, 40.0, 0.0), (1, 50.0, 4.0), (2, 60.0, 0.0), (3, 70.0, -4.0), (4, 70.0, 0.0)]
        {
            let output = law.step(&mut state, &seen(tick));
            assert!((output.command - own - sine).abs() < 1e-4, "{tick}: {output:?}");
            law.applied(&mut state, output.command - 1.0);
            assert!((state.before - own).abs() < 1e-6 && (state.law - own).abs() < 1e-6, "{tick}");
            assert!((state.after - (own + sine - 1.0)).abs() < 1e-4, "{tick}");
        }
        let again = law.step(&mut state.restarted(), &seen(0));
        assert!((again.command - 40.0).abs() < 1e-6, "the sine starts at zero");
    }

    #[test]
    fn a_law_beyond_the_valves_range_counts_as_at_its_limit() {
        let law = SineInjection::new(&Counter, Sine { amplitude: 0.0, ticks: 1, periods: 1 }, 90);
        let mut state = law.initial_state();
        law.step(&mut state, &seen(80));
        assert!((state.before - COMMAND_MAX).abs() < 1e-6);
    }

    #[test]
    fn the_last_period_of_a_long_sine_is_as_exact_as_the_first() {
        let sine = Sine { amplitude: 1.0, ticks: 333, periods: 7 };
        assert!((sine.angle(333 * 9_000_000 + 5) - sine.angle(5)).abs() < 1e-12);
        assert!((sine.angle(5) - TAU * 35.0 / 333.0).abs() < 1e-12);
    }
}
