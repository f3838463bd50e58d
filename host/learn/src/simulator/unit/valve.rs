//! The inspiratory valve of a unit: from commands to the share of its full flow.
//!
//! ```text
//! u_d  = command a dead time ago, between two ticks        a' = a + (u_d - a)(1 - exp(-tick / lag))
//! s'   = s held within [a', a' + min(play, a')]            w  = max((s' - zone) / (100 - zone), 0) ^ exponent
//! ```

use super::VALVE;
use crate::simulator::{COMMAND_SCALE, CommandLog};
use engine::{LANES, Lane};

pub(super) const DEAD_TIME: usize = 0;
pub(super) const LAG: usize = 1;
pub(super) const PLAY: usize = 2;
pub(super) const ZONE: usize = 3;
pub(super) const EXPONENT: usize = 4;
pub(super) const FULL_FLOW: usize = 5;
pub(super) const SUPPLY: usize = 6;
const MS_PER_S: f32 = 1e3;
/// Highest command, percent.
pub(super) const FULL: f32 = 100.0;
/// Travel beyond the dead zone, as a share, below which nothing flows.
pub(super) const LEAST: f32 = 1e-4;

/// Share of the full flow of a unit with these parameters that a held command gives, percent.
pub(super) fn opening(parameters: &[f32], command: f32) -> f32 {
    let (zone, exponent) = (parameters[ZONE].exp(), parameters[EXPONENT].exp());
    ((command - zone) / (FULL - zone)).max(0.0).powf(exponent)
}

/// The valves of a shard.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct ValveLanes {
    /// Dead time, ticks.
    dead_time: Lane,
    /// Tick over lag.
    rate: Lane,
    /// Share of the remaining way that the actuator moves in a tick.
    share: Lane,
    play: Lane,
    zone: Lane,
    exponent: Lane,
    /// L/s.
    pub full_flow: Lane,
    /// cmH2O.
    pub supply: Lane,
}

impl ValveLanes {
    pub fn new(numbers: &[Lane; VALVE], tick_s: f32) -> Self {
        let rate = numbers[LAG].map(|lag| MS_PER_S * tick_s / lag);
        Self {
            dead_time: numbers[DEAD_TIME].map(|time| time / (MS_PER_S * tick_s)),
            rate,
            share: rate.map(|rate| 1.0 - (-rate).exp()),
            play: numbers[PLAY],
            zone: numbers[ZONE],
            exponent: numbers[EXPONENT],
            full_flow: numbers[FULL_FLOW],
            supply: numbers[SUPPLY],
        }
    }
}

/// What holds the stem.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Contact {
    /// The actuator pushes it open.
    Opening,
    /// It hangs behind the closing actuator by the play.
    Closing,
    /// The same near the seat, where the play is that of the actuator's position.
    Seat,
    /// Nothing: it rests within the play.
    Free,
}

#[derive(Clone, Debug)]
struct Step {
    delayed: Lane,
    /// Older minus newer of the two commands around the dead time, percent.
    slope: Lane,
    before: Lane,
    travel: Lane,
    contact: [Contact; LANES],
}

/// Forward values and backward gradients of a rollout.
#[derive(Clone, Debug)]
pub(super) struct ValveTape {
    pub lanes: ValveLanes,
    steps: Vec<Step>,
    /// Share of the full flow after each tick.
    pub openings: Vec<Lane>,
    actuator: Lane,
    stem: Lane,
    d_actuator: Lane,
    d_stem: Lane,
    /// Gradients with respect to the logarithms of the numbers.
    d: [Lane; VALVE],
}

impl ValveTape {
    pub fn new(ticks: usize) -> Self {
        let step = Step {
            delayed: Lane::ZERO,
            slope: Lane::ZERO,
            before: Lane::ZERO,
            travel: Lane::ZERO,
            contact: [Contact::Free; LANES],
        };
        Self {
            lanes: ValveLanes::default(),
            steps: vec![step; ticks],
            openings: vec![Lane::ZERO; ticks],
            actuator: Lane::ZERO,
            stem: Lane::ZERO,
            d_actuator: Lane::ZERO,
            d_stem: Lane::ZERO,
            d: [Lane::ZERO; VALVE],
        }
    }

    pub fn begin(&mut self, lanes: &ValveLanes) {
        self.lanes = *lanes;
        (self.d_actuator, self.d_stem, self.d) = (Lane::ZERO, Lane::ZERO, [Lane::ZERO; VALVE]);
    }

    /// Runs one tick; returns the share of the full flow after it.
    pub fn step(&mut self, tick: usize, log: &CommandLog) -> Lane {
        if tick == 0 {
            // At rest for long enough, the actuator has reached the command. The valve was closed before, so the stem was last pushed
            // open and follows without play.
            self.actuator = log.block(None)[0].map(|u| COMMAND_SCALE * u);
            self.stem = self.actuator;
        }
        let ValveLanes { share, play, zone, exponent, .. } = &self.lanes;
        let step = &mut self.steps[tick];
        step.before = self.actuator;
        let mut opening = Lane::ZERO;
        for l in 0..LANES {
            let (newer, older, part) = delayed(log, tick, self.lanes.dead_time[l], l);
            step.slope[l] = older - newer;
            step.delayed[l] = newer + part * step.slope[l];
            let actuator = self.actuator[l] + share[l] * (step.delayed[l] - self.actuator[l]);
            let hangs = actuator + play[l].min(actuator);
            (step.contact[l], self.stem[l]) = if self.stem[l] <= actuator {
                (Contact::Opening, actuator)
            } else if self.stem[l] < hangs {
                (Contact::Free, self.stem[l])
            } else if play[l] < actuator {
                (Contact::Closing, hangs)
            } else {
                (Contact::Seat, hangs)
            };
            self.actuator[l] = actuator;
            let travel = (self.stem[l] - zone[l]) / (FULL - zone[l]);
            step.travel[l] = travel;
            opening[l] = if travel > LEAST { travel.powf(exponent[l]) } else { 0.0 };
        }
        self.openings[tick] = opening;
        opening
    }

    /// Backward pass of [`Self::step`]: `d` is the gradient with respect to the opening, full flow and supply (as logarithms).
    pub fn step_back(&mut self, tick: usize, d: &[Lane; 3], d_log: &mut CommandLog) {
        let lanes = &self.lanes;
        self.d[FULL_FLOW].add_scaled(1.0, &d[1]);
        self.d[SUPPLY].add_scaled(1.0, &d[2]);
        let step = &self.steps[tick];
        for (l, d_opening) in d[0].0.iter().enumerate() {
            let (travel, opening) = (step.travel[l], self.openings[tick][l]);
            if travel > LEAST {
                let by_logarithm = d_opening * opening * lanes.exponent[l];
                self.d[EXPONENT][l] += by_logarithm * travel.ln();
                let d_travel = by_logarithm / travel;
                let width = FULL - lanes.zone[l];
                self.d_stem[l] += d_travel / width;
                self.d[ZONE][l] += d_travel * (travel - 1.0) / width * lanes.zone[l];
            }
            let d_stem = self.d_stem[l];
            match step.contact[l] {
                Contact::Opening => self.d_actuator[l] += d_stem,
                Contact::Closing => {
                    self.d_actuator[l] += d_stem;
                    self.d[PLAY][l] += d_stem * lanes.play[l];
                }
                Contact::Seat => self.d_actuator[l] += 2.0 * d_stem,
                Contact::Free => {}
            }
            if step.contact[l] != Contact::Free {
                self.d_stem[l] = 0.0;
            }
            let d_actuator = self.d_actuator[l];
            let way = step.delayed[l] - step.before[l];
            // share = 1 - exp(-rate), and the rate falls as the lag grows
            self.d[LAG][l] -= d_actuator * way * (1.0 - lanes.share[l]) * lanes.rate[l];
            self.d_actuator[l] = (1.0 - lanes.share[l]) * d_actuator;
            let d_delayed = lanes.share[l] * d_actuator;
            self.d[DEAD_TIME][l] += d_delayed * step.slope[l] * lanes.dead_time[l];
            give_back(d_log, tick, lanes.dead_time[l], l, d_delayed);
        }
    }

    /// Gradients with respect to the logarithms of the numbers.
    pub fn gradient(&self) -> [Lane; VALVE] {
        self.d
    }
}

/// The two commands around a dead time ago, percent, and the weight of the older one.
fn delayed(log: &CommandLog, tick: usize, dead_time: f32, l: usize) -> (f32, f32, f32) {
    let whole = dead_time as usize;
    let at = |age: usize| COMMAND_SCALE * log.block(tick.checked_sub(age))[0][l];
    (at(whole), at(whole + 1), dead_time - whole as f32)
}

/// Backward pass of [`delayed`]: adds the gradient with respect to the two commands.
fn give_back(d_log: &mut CommandLog, tick: usize, dead_time: f32, l: usize, d: f32) {
    let whole = dead_time as usize;
    let part = dead_time - whole as f32;
    for (age, weight) in [(whole, 1.0 - part), (whole + 1, part)] {
        if let Some(block) = tick.checked_sub(age) {
            d_log.block_mut(block)[0][l] += COMMAND_SCALE * weight * d;
        }
    }
}
