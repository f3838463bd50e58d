//! Equations of a simulator over the ticks of a rollout: forward on lanes, and backward over a tape of one
//! tick.
#![expect(
    clippy::inline_always,
    reason = "vector operations are compiled for the unit detected at run time only where they are inlined"
)]

use std::marker::PhantomData;
use std::ops::Range;

use engine::Lane;
use engine::number::Number;
use engine::tape::{Pen, Place, Recorded, Recorder, Tape};
use pulp::{Arch, Simd, WithSimd};

/// Equations with `G` numbers that are given for a breath, `N` numbers that hold during it, `S` of state, and
/// `I` inputs of a tick.
pub(super) trait Equations<const G: usize, const N: usize, const S: usize, const I: usize> {
    /// The numbers of a breath, and the state in which it starts, from what is given.
    fn begin<Q: Number>(&self, given: [Q; G]) -> ([Q; N], [Q; S]);

    /// The state after a tick.
    fn tick<Q: Number>(numbers: [Q; N], before: [Q; S], inputs: [Q; I]) -> [Q; S];
}

/// Forward values and backward gradients of a rollout.
///
/// The tape has first what is given for a breath, with the equations of its begin, then state and inputs of a
/// tick, with its equations.
#[derive(Clone, Debug)]
pub(super) struct Trajectory<E, const G: usize, const N: usize, const S: usize, const I: usize> {
    pub equations: E,
    tape: Tape,
    /// Place on the tape where the tick begins.
    tick: Place,
    places: Places<N, S>,
    numbers: [Lane; N],
    /// State before each tick, and its inputs.
    ticks: Vec<([Lane; S], [Lane; I])>,
    /// Present state.
    pub state: [Lane; S],
    d_state: [Lane; S],
}

/// Places of results on the tape.
#[derive(Clone, Copy, Debug)]
struct Places<const N: usize, const S: usize> {
    numbers: [Place; N],
    /// State at the begin of a breath.
    first: [Place; S],
    /// State after a tick.
    after: [Place; S],
}

impl<E, const G: usize, const N: usize, const S: usize, const I: usize> Trajectory<E, G, N, S, I>
where
    E: Equations<G, N, S, I>,
{
    /// Memory for a rollout.
    pub fn new(equations: E, ticks: usize) -> Self {
        let recorder = Recorder::default();
        let (numbers, first) = equations.begin(std::array::from_fn(|_| recorder.given()));
        let tick = recorder.next();
        let before = std::array::from_fn(|_| recorder.given());
        let after = E::tick(numbers, before, std::array::from_fn(|_| recorder.given()));
        let place = Recorded::place;
        let places = Places { numbers: numbers.map(place), first: first.map(place), after: after.map(place) };
        Self {
            equations,
            tape: Tape::new(recorder),
            tick,
            places,
            numbers: [Lane::ZERO; N],
            ticks: vec![([Lane::ZERO; S], [Lane::ZERO; I]); ticks],
            state: [Lane::ZERO; S],
            d_state: [Lane::ZERO; S],
        }
    }

    /// Starts a breath.
    pub fn begin(&mut self, given: &[Lane; G]) {
        self.tape.values[..G].copy_from_slice(given);
        self.tape.run(0..self.tick);
        self.tape.slopes[..self.tick].fill(Lane::ZERO);
        self.numbers = self.places.numbers.map(|place| self.tape.values[place]);
        self.state = self.places.first.map(|place| self.tape.values[place]);
        self.d_state = [Lane::ZERO; S];
    }

    /// Runs one tick; returns the state after it.
    pub fn step(&mut self, tick: usize, inputs: &[Lane; I]) -> &[Lane; S] {
        self.ticks[tick] = (self.state, *inputs);
        let (numbers, equations) = (&self.numbers, PhantomData::<E>);
        self.state = Arch::new().dispatch(Tick { equations, numbers, before: &self.state, inputs });
        &self.state
    }

    /// Backward pass of [`Self::step`], from the gradient with respect to one piece of its state; returns
    /// that with respect to its inputs.
    pub fn step_back(&mut self, tick: usize, piece: usize, d: &Lane) -> [Lane; I] {
        self.d_state[piece].add_scaled(1.0, d);
        let (before, inputs) = &self.ticks[tick];
        let (state_at, inputs_at) = (self.tick, self.tick + S);
        self.tape.values[state_at..inputs_at].copy_from_slice(before);
        self.tape.values[inputs_at..inputs_at + I].copy_from_slice(inputs);
        let (pen, numbers) = (self.tape.pen(inputs_at + I), &self.numbers);
        Arch::new()
            .dispatch(Rewrite { pen, tick: Tick { equations: PhantomData::<E>, numbers, before, inputs } });
        let end = self.tape.values.len();
        self.tape.slopes[self.tick..].fill(Lane::ZERO);
        self.walk_back(self.places.after, self.tick..end);
        let slopes = &self.tape.slopes;
        self.d_state = std::array::from_fn(|n| slopes[state_at + n]);
        let d_inputs = std::array::from_fn(|n| slopes[inputs_at + n]);
        if tick == 0 {
            self.walk_back(self.places.first, 0..self.tick);
        }
        d_inputs
    }

    /// Walks back through places from the gradient with respect to a state in them.
    fn walk_back(&mut self, state: [Place; S], places: Range<Place>) {
        for (place, d) in state.into_iter().zip(&self.d_state) {
            self.tape.slopes[place].add_scaled(1.0, d);
        }
        self.tape.walk_back(places);
    }

    /// Gradient with respect to what was given for the breath, after the backward pass of all ticks.
    pub fn gradient(&self) -> [Lane; G] {
        std::array::from_fn(|place| self.tape.slopes[place])
    }
}

/// A tick.
struct Tick<'a, E, const G: usize, const N: usize, const S: usize, const I: usize> {
    equations: PhantomData<E>,
    numbers: &'a [Lane; N],
    before: &'a [Lane; S],
    inputs: &'a [Lane; I],
}

impl<E, const G: usize, const N: usize, const S: usize, const I: usize> WithSimd for Tick<'_, E, G, N, S, I>
where
    E: Equations<G, N, S, I>,
{
    type Output = [Lane; S];

    #[inline(always)]
    fn with_simd<V: Simd>(self, _: V) -> [Lane; S] {
        E::tick(*self.numbers, *self.before, *self.inputs)
    }
}

/// A tick that writes its numbers on the tape.
struct Rewrite<'a, E, const G: usize, const N: usize, const S: usize, const I: usize> {
    pen: Pen<'a>,
    tick: Tick<'a, E, G, N, S, I>,
}

impl<E, const G: usize, const N: usize, const S: usize, const I: usize> WithSimd
    for Rewrite<'_, E, G, N, S, I>
where
    E: Equations<G, N, S, I>,
{
    type Output = ();

    #[inline(always)]
    fn with_simd<V: Simd>(self, _: V) {
        let Self { pen, tick: Tick { numbers, before, inputs, .. } } = self;
        let known = |value: Lane| pen.known(value);
        E::tick(numbers.map(known), before.map(known), inputs.map(known));
    }
}
