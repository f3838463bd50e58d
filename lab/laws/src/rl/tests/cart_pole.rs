//! The pole on a cart (Barto, Sutton, Anderson 1983), with the constants of the benchmark `CartPole-v1`: push left or
//! right; one point per step until the pole leans more than 12 degrees, the cart leaves its track or 500 steps have
//! passed.
//!
//! A mean return of 475 over 100 episodes counts as solved. An algorithm with an error in its targets, its clipping or
//! its handling of episodes does not reach it.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::{Actions, End, Environment, Transition};

const GRAVITY: f32 = 9.8;
const CART_MASS: f32 = 1.0;
const POLE_MASS: f32 = 0.1;
const TOTAL_MASS: f32 = CART_MASS + POLE_MASS;
/// Half the length of the pole, m.
const HALF_LENGTH: f32 = 0.5;
/// Force of a push, N.
const FORCE: f32 = 10.0;
/// Step of the explicit Euler integration, s.
const STEP: f32 = 0.02;
/// Largest position, m.
const POSITION_LIMIT: f32 = 2.4;
/// Largest angle, rad.
const ANGLE_LIMIT: f32 = 12.0 * std::f32::consts::PI / 180.0;
/// Scale of each quantity in an observation: its limit or, for the rates, the range of a good player. The benchmark
/// uses raw numbers, whose angle is too small for a network's first layer to use its nonlinearity.
const SCALE: [f32; 4] = [POSITION_LIMIT, 2.0, ANGLE_LIMIT, 2.0];
/// Longest episode, steps.
pub const STEPS_MAX: u32 = 500;
/// Each quantity starts uniformly within this distance of zero.
const START_SPREAD: f32 = 0.05;

/// Cart and pole: position, its rate, angle, its rate.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CartPole {
    state: [f32; 4],
    steps: u32,
}

impl Environment for CartPole {
    fn observations(&self) -> usize {
        self.state.len()
    }

    fn actions(&self) -> Actions {
        Actions::Discrete(2)
    }

    fn reset(&mut self, rng: &mut ChaCha8Rng) {
        self.state = std::array::from_fn(|_| rng.random_range(-START_SPREAD..START_SPREAD));
        self.steps = 0;
    }

    fn step(&mut self, action: f32) -> Transition {
        let force = if action > 0.5 { FORCE } else { -FORCE };
        let [position, speed, angle, spin] = self.state;
        let (sine, cosine) = angle.sin_cos();
        let push = (force + POLE_MASS * HALF_LENGTH * spin * spin * sine) / TOTAL_MASS;
        let inertia = HALF_LENGTH * (4.0 / 3.0 - POLE_MASS * cosine * cosine / TOTAL_MASS);
        let spin_rate = (GRAVITY * sine - cosine * push) / inertia;
        let acceleration = push - POLE_MASS * HALF_LENGTH * spin_rate * cosine / TOTAL_MASS;
        self.state = [
            position + STEP * speed,
            speed + STEP * acceleration,
            angle + STEP * spin,
            spin + STEP * spin_rate,
        ];
        self.steps += 1;
        let stands = self.state[0].abs() <= POSITION_LIMIT && self.state[2].abs() <= ANGLE_LIMIT;
        let end = match (stands, self.steps >= STEPS_MAX) {
            (false, _) => End::Terminal,
            (true, true) => End::TimeLimit,
            (true, false) => End::Not,
        };
        Transition { reward: 1.0, end }
    }

    fn observe(&self, observation: &mut [f32]) {
        for (seen, (value, scale)) in observation.iter_mut().zip(self.state.iter().zip(SCALE)) {
            *seen = value / scale;
        }
    }
}

fn balanced() -> CartPole {
    let mut cart = CartPole::default();
    cart.reset(&mut ChaCha8Rng::seed_from_u64(3));
    cart
}

#[test]
fn a_push_from_rest_gives_the_textbooks_accelerations() {
    let mut cart = CartPole::default();
    cart.step(1.0);
    // F / M = 10 / 1.1; spin rate = -(F / M) / (l (4/3 - m / M)).
    let push = 10.0 / 1.1;
    let spin_rate = -push / (0.5 * (4.0 / 3.0 - 0.1 / 1.1));
    let speed = 0.02 * (push - 0.1 * 0.5 * spin_rate / 1.1);
    let expected = [0.0, speed, 0.0, 0.02 * spin_rate];
    for (got, expected) in cart.state.iter().zip(expected) {
        assert!((got - expected).abs() < 1e-6, "{:?}", cart.state);
    }
}

#[test]
fn a_pole_pushed_one_way_falls_within_a_quarter_second() {
    let mut cart = balanced();
    let steps = (1..STEPS_MAX).find(|_| cart.step(1.0).end == End::Terminal).unwrap();
    assert!((7..13).contains(&steps), "{steps} steps");
}

#[test]
fn a_balanced_pole_is_cut_after_500_steps() {
    let mut cart = balanced();
    let ends: Vec<End> = (0..STEPS_MAX)
        .map(|_| {
            let [position, speed, angle, spin] = cart.state;
            let lean = 10.0 * angle + 2.0 * spin + 0.3 * position + 0.6 * speed;
            cart.step(f32::from(u8::from(lean > 0.0))).end
        })
        .collect();
    assert!(ends[..ends.len() - 1].iter().all(|end| *end == End::Not));
    assert_eq!(ends.last(), Some(&End::TimeLimit));
}

#[test]
fn episodes_start_close_to_the_balance() {
    assert!(balanced().state.iter().all(|x| x.abs() < START_SPREAD && *x != 0.0));
}
