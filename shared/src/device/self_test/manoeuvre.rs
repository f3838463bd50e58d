//! The checks that move the valves, in standby and on request only.
//!
//! *Circuit*, with a test lung: rest; fill until the pressure has risen by [`RISE`]; close both valves and let the gas spread;
//! hold; release. *Relief*, with a closed patient port: rest; fill until the pressure rises no more; release. It ends at once if the
//! flow sensor shows that the port is open: a patient may be connected. Every command goes
//! through [`ValveCommand::of_test`], which makes the valves safe above [`CEILING`] and without a reading.

use super::{Finding, Outcome, StepResult};
use crate::safety::filter::ValveCommand;
use crate::sensor::Readings;

/// Inspiratory valve while it fills, percent: about 0.15 L/s.
const FILL: f32 = 20.0;
/// Pressure above which the valves are made safe, cmH2O.
const CEILING: f32 = 85.0;
/// Rise of the pressure in the check of the circuit, cmH2O.
const RISE: f32 = 15.0;
/// Highest rise: beyond it the inspiratory valve does not close, cmH2O.
const RISE_MAX: f32 = 30.0;
/// Time of rest before, s.
const REST: f32 = 0.2;
/// Longest time to fill a test lung, s.
const FILL_MAX: f32 = 8.0;
/// Time in which the gas spreads in the test lung, s.
const SPREAD: f32 = 0.5;
/// Time for which the pressure is held, s.
const HOLD: f32 = 1.0;
/// Largest change of the pressure while it is held, cmH2O.
const CHANGE: f32 = 3.0;
/// Time to release the pressure, s.
const RELEASE: f32 = 2.0;
/// Largest pressure that is left then, above that before, cmH2O.
const LEFT: f32 = 3.0;
/// Compliance of a plausible test lung with its circuit, mL/cmH2O.
const COMPLIANCE: (f32, f32) = (0.5, 120.0);
/// Smallest share of the fill in which the flow sensor must give numbers.
const FLOW_SHARE: f32 = 0.9;

/// Longest time to reach the opening of the relief valve with a closed port, s.
const RELIEF_MAX: f32 = 3.0;
/// Time over which the pressure rises no more once the relief valve is open, s.
const PLATEAU: f32 = 0.1;
/// Rise in that time below which it counts as open, cmH2O.
const PLATEAU_RISE: f32 = 1.0;
/// Opening pressure of a sound relief valve, cmH2O.
const RELIEF: (f32, f32) = (60.0, 80.0);
/// Gas that flows through an open patient port early in the rise, L, and a flow that a sensor shows at rest, L/s.
const THROUGH_PORT: (f32, f32) = (0.01, 0.04);
/// Rise above the pressure at rest from which a plateau counts, cmH2O.
const PLATEAU_FROM: f32 = 10.0;

/// What is checked.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Kind {
    Circuit,
    Relief,
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Stage {
    Rest,
    Fill,
    Spread,
    Hold,
    Release,
}

/// A running check.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Manoeuvre {
    kind: Kind,
    stage: Stage,
    /// Time in the stage, s.
    time: f32,
    /// Pressure at the end of the rest, at the start of the hold, and at the start of a plateau, cmH2O.
    base: f32,
    held: f32,
    plateau: (f32, f32),
    /// Time of the rise, s.
    rise_time: f32,
    /// Volume that the flow sensor measured while the circuit filled, L, and the seconds in which it gave numbers.
    volume: f32,
    metered: f32,
    /// Results so far.
    valves: StepResult,
    second: StepResult,
}

/// Result of a tick.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Progress {
    /// It goes on with this command.
    Command(ValveCommand),
    /// The check of the circuit has ended.
    Circuit { valves: StepResult, circuit: StepResult },
    /// The check of the relief valve has ended.
    Relief(StepResult),
}

fn failed(finding: Finding, value: f32) -> StepResult {
    StepResult { outcome: Outcome::Failed(finding), value }
}

fn passed(value: f32) -> StepResult {
    StepResult { outcome: Outcome::Passed, value }
}

impl Manoeuvre {
    /// Valves, leak and compliance.
    pub(super) fn circuit() -> Self {
        Self::new(Kind::Circuit)
    }

    /// The relief valve.
    pub(super) fn relief() -> Self {
        Self::new(Kind::Relief)
    }

    fn new(kind: Kind) -> Self {
        let none = StepResult::from(Outcome::NotRun);
        Self {
            kind,
            stage: Stage::Rest,
            time: 0.0,
            base: 0.0,
            held: 0.0,
            plateau: (0.0, 0.0),
            rise_time: 0.0,
            volume: 0.0,
            metered: 0.0,
            valves: none,
            second: none,
        }
    }

    /// Runs a tick.
    pub(super) fn step(&mut self, readings: &Readings, period_us: u32) -> Progress {
        let (pressure, period) = (readings.airway, period_us as f32 * 1e-6);
        self.time += period;
        debug_assert!(self.time > 0.0 && self.time <= FILL_MAX + 1.0, "every stage ends");
        if (pressure.is_nan() || pressure >= CEILING) && self.stage != Stage::Release {
            let finding = match (pressure.is_nan(), self.kind) {
                (true, _) => Finding::NoReading,
                (false, Kind::Relief) => Finding::ReliefLate,
                (false, Kind::Circuit) => Finding::RisesByItself,
            };
            self.fail(finding, pressure);
        }
        if self.kind == Kind::Circuit && self.stage != Stage::Rest && self.stage != Stage::Release {
            // Overshoot of a sound valve is far less.
            if pressure - self.base > RISE_MAX {
                self.fail(Finding::RisesByItself, pressure);
            }
        }
        match self.stage {
            Stage::Rest if self.time >= REST => {
                self.base = pressure;
                self.plateau = (pressure, 0.0);
                self.enter(Stage::Fill);
            }
            Stage::Fill => self.fill(readings, period),
            Stage::Spread if self.time >= SPREAD => {
                self.held = pressure;
                self.judge_fill(pressure);
            }
            Stage::Hold if self.time >= HOLD => self.judge_hold(pressure),
            Stage::Release if self.time >= RELEASE => return self.end(pressure),
            Stage::Rest | Stage::Spread | Stage::Hold | Stage::Release => {}
        }
        let (u_in, u_out) = match self.stage {
            Stage::Rest | Stage::Release => (0.0, true),
            Stage::Fill => (FILL, false),
            Stage::Spread | Stage::Hold => (0.0, false),
        };
        Progress::Command(ValveCommand::of_test(u_in, u_out, pressure, CEILING))
    }

    fn enter(&mut self, stage: Stage) {
        use Stage::{Fill, Hold, Release, Rest, Spread};
        let legal = [(Rest, Fill), (Fill, Spread), (Spread, Hold)].contains(&(self.stage, stage));
        debug_assert!(legal || (self.stage != Release && stage == Release), "{:?} to {stage:?}", self.stage);
        (self.stage, self.time) = (stage, 0.0);
    }

    /// Records a failure and releases the pressure.
    fn fail(&mut self, finding: Finding, value: f32) {
        match self.kind {
            Kind::Circuit => self.valves = failed(finding, value),
            Kind::Relief => self.second = failed(finding, value),
        }
        self.enter(Stage::Release);
    }

    fn fill(&mut self, readings: &Readings, period: f32) {
        let pressure = readings.airway;
        self.meter(readings.flow, period);
        if self.kind == Kind::Relief {
            return self.fill_to_relief(pressure);
        }
        if pressure - self.base >= RISE {
            self.rise_time = self.time;
            self.enter(Stage::Spread);
        } else if self.time >= FILL_MAX {
            self.fail(Finding::NoRise, self.time);
        }
    }

    fn meter(&mut self, flow: f32, period: f32) {
        if flow.is_finite() {
            self.volume += flow * period;
            self.metered += period;
        }
    }

    fn fill_to_relief(&mut self, pressure: f32) {
        let (from, since) = self.plateau;
        if self.volume > THROUGH_PORT.0 + THROUGH_PORT.1 * self.metered {
            self.fail(Finding::PortOpen, pressure);
        } else if pressure - from >= PLATEAU_RISE {
            self.plateau = (pressure, self.time);
        } else if self.time - since >= PLATEAU && pressure - self.base >= PLATEAU_FROM {
            self.second = match pressure {
                pressure if pressure < RELIEF.0 => failed(Finding::ReliefEarly, pressure),
                pressure if pressure > RELIEF.1 => failed(Finding::ReliefLate, pressure),
                pressure => passed(pressure),
            };
            self.enter(Stage::Release);
        } else if self.time >= RELIEF_MAX {
            self.fail(Finding::NoRise, pressure);
        }
    }

    /// After the gas has spread: the valve has closed, and the flow sensor has seen the gas.
    fn judge_fill(&mut self, pressure: f32) {
        let rise = pressure - self.base;
        self.valves = passed(self.rise_time);
        let compliance = 1000.0 * self.volume / rise;
        self.second = if self.metered < FLOW_SHARE * self.rise_time {
            passed(f32::NAN)
        } else if compliance.is_nan() || compliance < COMPLIANCE.0 {
            failed(Finding::NoFlow, compliance)
        } else if compliance > COMPLIANCE.1 {
            failed(Finding::Compliance, compliance)
        } else {
            passed(compliance)
        };
        self.enter(Stage::Hold);
    }

    fn judge_hold(&mut self, pressure: f32) {
        let change = pressure - self.held;
        if change > CHANGE {
            self.valves = failed(Finding::RisesByItself, change);
        } else if (change.is_nan() || change < -CHANGE) && self.second.outcome == Outcome::Passed {
            self.second = failed(Finding::Leak, -change);
        }
        self.enter(Stage::Release);
    }

    /// After the release: the expiratory valve has opened.
    fn end(&mut self, pressure: f32) -> Progress {
        let left = pressure - self.base;
        let fell = left <= LEFT;
        match self.kind {
            Kind::Circuit => {
                if !fell && self.valves.outcome == Outcome::Passed {
                    self.valves = failed(Finding::NoFall, left);
                }
                Progress::Circuit { valves: self.valves, circuit: self.second }
            }
            Kind::Relief => {
                if !fell && self.second.outcome == Outcome::Passed {
                    self.second = failed(Finding::NoFall, left);
                }
                Progress::Relief(self.second)
            }
        }
    }
}
