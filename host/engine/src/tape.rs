//! Gradients of equations. They are recorded once, operation by operation; a [`Tape`] then computes them for
//! any numbers, forward from the first operation to the last, and the gradient with respect to all of them
//! backward.
#![expect(
    clippy::inline_always,
    reason = "vector operations are compiled for the unit detected at run time only where they are inlined"
)]

use std::cell::{Cell, RefCell};
use std::ops::Range;

use pulp::{Arch, Simd, WithSimd};

use crate::lane::Lane;
use crate::number::{Binary, Number, Unary, each};
use crate::{operators, power};

/// Place of a number on its tape.
pub type Place = usize;

/// Where a number comes from.
#[derive(Clone, Copy, Debug)]
enum Operation {
    Given,
    Constant(f32),
    One(Unary, Place),
    Two(Binary, Place, Place),
    /// The first one where the second is greater than the third.
    WhereGreater(Place, Place, Place),
}

impl Operation {
    /// Computes the number, if it is not given, from those before it.
    #[inline(always)]
    fn compute(self, before: &[Lane], number: &mut Lane) {
        let at = |place: Place| before[place];
        *number = match self {
            Self::Given | Self::Constant(_) => return,
            Self::One(operation, a) => at(a).one(operation),
            Self::Two(operation, a, b) => at(a).two(operation, at(b)),
            Self::WhereGreater(a, left, right) => at(a).where_greater(at(left), at(right)),
        };
    }

    /// Adds the gradient with respect to the number to those with respect to the ones that it is made of.
    #[inline(always)]
    fn give_back(self, value: &Lane, slope: &Lane, values: &[Lane], slopes: &mut [Lane]) {
        let (value, slope) = (*value, *slope);
        let at = |place: Place| values[place];
        let mut give = |to: Place, slope: Lane| slopes[to] = slopes[to] + slope;
        match self {
            Self::Given | Self::Constant(_) => {}
            Self::One(operation, a) => match operation {
                Unary::Sqrt => give(a, slope / (value + value)),
                Unary::Abs => give(a, slope.zip(&at(a), |slope, a| slope * a.signum())),
                Unary::Exp => give(a, slope * value),
                Unary::Floor => {}
            },
            Self::Two(operation, a, b) => {
                let mut both = |of_a: Lane, of_b: Lane| {
                    give(a, of_a);
                    give(b, of_b);
                };
                match operation {
                    Binary::Add => both(slope, slope),
                    Binary::Sub => both(slope, Lane::ZERO - slope),
                    Binary::Mul => both(slope * at(b), slope * at(a)),
                    Binary::Div => both(slope / at(b), Lane::ZERO - slope / at(b) * value),
                    Binary::Min => {
                        let first = slope.where_greater(at(b), at(a));
                        both(first, slope - first);
                    }
                    Binary::Max => {
                        let first = slope.where_greater(at(a), at(b));
                        both(first, slope - first);
                    }
                    Binary::Pow => {
                        let (base, exponent) = (at(a), at(b));
                        let logarithm = each(|l| power::ln(base[l]));
                        both(slope * value * exponent / base, slope * value * logarithm);
                    }
                }
            }
            Self::WhereGreater(a, left, right) => give(a, slope.where_greater(at(left), at(right))),
        }
    }
}

/// Equations being recorded.
#[derive(Debug, Default)]
pub struct Recorder(RefCell<Vec<Operation>>);

impl Recorder {
    /// A number that will be given.
    pub fn given(&self) -> Recorded<'_> {
        self.record(Operation::Given)
    }

    /// Place of the next number.
    pub fn next(&self) -> Place {
        self.0.borrow().len()
    }

    fn record(&self, operation: Operation) -> Recorded<'_> {
        let place = self.next();
        self.0.borrow_mut().push(operation);
        Recorded { recorder: self, place }
    }
}

/// A number of an equation that is being recorded.
#[derive(Clone, Copy, Debug)]
pub struct Recorded<'r> {
    recorder: &'r Recorder,
    place: Place,
}

impl Recorded<'_> {
    /// Its place on the tape.
    pub fn place(self) -> Place {
        self.place
    }
}

operators!(Recorded<'_>);

impl Number for Recorded<'_> {
    fn constant(self, value: f32) -> Self {
        self.recorder.record(Operation::Constant(value))
    }

    fn one(self, operation: Unary) -> Self {
        self.recorder.record(Operation::One(operation, self.place))
    }

    fn two(self, operation: Binary, other: Self) -> Self {
        self.recorder.record(Operation::Two(operation, self.place, other.place))
    }

    fn where_greater(self, left: Self, right: Self) -> Self {
        self.recorder.record(Operation::WhereGreater(self.place, left.place, right.place))
    }
}

/// Recorded equations with their numbers, and the gradient with respect to each.
#[derive(Clone, Debug)]
pub struct Tape {
    operations: Vec<Operation>,
    /// The numbers.
    pub values: Vec<Lane>,
    /// The gradient with respect to each number.
    pub slopes: Vec<Lane>,
}

impl Tape {
    /// The tape of recorded equations.
    pub fn new(recorder: Recorder) -> Self {
        let operations = recorder.0.into_inner();
        let value = |operation: &Operation| match operation {
            Operation::Constant(value) => Lane::splat(*value),
            _ => Lane::ZERO,
        };
        let values = operations.iter().map(value).collect();
        Self { slopes: vec![Lane::ZERO; operations.len()], values, operations }
    }

    /// Computes the numbers in a range of places, which are not given, from those before them.
    pub fn run(&mut self, places: Range<Place>) {
        Arch::new().dispatch(Run { tape: self, places });
    }

    /// A pen that writes numbers at the places from here on.
    pub fn pen(&mut self, first: Place) -> Pen<'_> {
        Pen { values: Cell::from_mut(&mut self.values[..]).as_slice_of_cells(), next: Cell::new(first) }
    }

    /// Walks back through a range of places: adds the gradient with respect to each number to those with
    /// respect to the ones that it is made of.
    pub fn walk_back(&mut self, places: Range<Place>) {
        Arch::new().dispatch(WalkBack { tape: self, places });
    }
}

/// Writes the numbers of equations on their tape while these compute, in the order in which they were recorded: the same as
/// [`Tape::run`], without looking up operation by operation.
#[derive(Debug)]
pub struct Pen<'t> {
    values: &'t [Cell<Lane>],
    next: Cell<Place>,
}

impl Pen<'_> {
    /// A number that is on the tape already.
    #[inline(always)]
    pub fn known(&self, value: Lane) -> Written<'_> {
        Written { pen: self, value }
    }

    #[inline(always)]
    fn write(&self, value: Lane) -> Written<'_> {
        let place = self.next.get();
        self.values[place].set(value);
        self.next.set(place + 1);
        Written { pen: self, value }
    }
}

/// A number of an equation that is being written.
#[derive(Clone, Copy, Debug)]
pub struct Written<'p> {
    pen: &'p Pen<'p>,
    value: Lane,
}

operators!(Written<'_>);

impl Number for Written<'_> {
    #[inline(always)]
    fn constant(self, value: f32) -> Self {
        // It is on the tape from the beginning.
        self.pen.next.update(|place| place + 1);
        Self { pen: self.pen, value: Lane::splat(value) }
    }

    #[inline(always)]
    fn one(self, operation: Unary) -> Self {
        self.pen.write(self.value.one(operation))
    }

    #[inline(always)]
    fn two(self, operation: Binary, other: Self) -> Self {
        self.pen.write(self.value.two(operation, other.value))
    }

    #[inline(always)]
    fn where_greater(self, left: Self, right: Self) -> Self {
        self.pen.write(self.value.where_greater(left.value, right.value))
    }
}

struct Run<'t> {
    tape: &'t mut Tape,
    places: Range<Place>,
}

impl WithSimd for Run<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Tape { operations, values, .. } = self.tape;
        for place in self.places {
            let (before, number) = values.split_at_mut(place);
            operations[place].compute(before, &mut number[0]);
        }
    }
}

struct WalkBack<'t> {
    tape: &'t mut Tape,
    places: Range<Place>,
}

impl WithSimd for WalkBack<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Tape { operations, values, slopes } = self.tape;
        for place in self.places.rev() {
            let (before, slope) = slopes.split_at_mut(place);
            operations[place].give_back(&values[place], &slope[0], values, before);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lane::LANES;

    /// Every operation, on both sides of its kinks; the lanes differ.
    fn equation<N: Number>([a, b, c]: [N; 3]) -> N {
        let root = (a * a + b * b).sqrt() - (a - b).abs();
        let limited = a.min(b) * c + a.max(c) / (b * b);
        let gated = (a * c).where_greater(b, c) + (a + b.exp()).pow(c);
        root * limited + gated / (c + c.floor())
    }

    fn given(step: f32, varied: usize) -> [Lane; 3] {
        let number = |n: usize, l: usize| 1.3 + ((5 * n + 3 * l) as f32).sin();
        std::array::from_fn(|n| Lane::from_fn(|l| number(n, l) + if n == varied { step } else { 0.0 }))
    }

    #[test]
    fn slopes_of_every_operation_agree_with_finite_differences() {
        let recorder = Recorder::default();
        let numbers: [Recorded<'_>; 3] = std::array::from_fn(|_| recorder.given());
        let (result, places) = (equation(numbers).place(), numbers.map(Recorded::place));
        let mut tape = Tape::new(recorder);
        for (place, value) in places.into_iter().zip(given(0.0, 0)) {
            tape.values[place] = value;
        }
        tape.run(0..result + 1);
        assert_eq!(tape.values[result], equation(given(0.0, 0)), "tape and lanes compute the same");
        let run = tape.values.clone();
        for varied in [0.1, 0.0] {
            let pen = tape.pen(places.len());
            equation(given(varied, 1).map(|value| pen.known(value)));
            assert_eq!(tape.values == run, varied == 0.0, "the pen writes what the tape computes");
        }
        tape.slopes[result] = Lane::splat(1.0);
        tape.walk_back(0..result + 1);
        for (n, place) in places.into_iter().enumerate() {
            let [above, below] = [1e-3, -1e-3].map(|step| equation(given(step, n)));
            for l in 0..LANES {
                let (numeric, exact) = ((above[l] - below[l]) / 2e-3, tape.slopes[place][l]);
                assert!(
                    (numeric - exact).abs() < 0.01 + 0.01 * exact.abs(),
                    "{n},{l}: {numeric}, not {exact}"
                );
            }
        }
    }
}
