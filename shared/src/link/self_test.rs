//! The self-test in messages: its steps, their results, and the checks that a host can request.

use heapless::Vec;
use serde::{Deserialize, Serialize};
use thiserror::Error;

/// A step of the self-test. The order of the variants is part of the link's protocol: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Step {
    /// Checksum of the program in flash.
    Program,
    /// Checksums of the weights slots.
    Weights,
    /// RAM.
    Memory,
    /// Sensors at rest.
    Sensors,
    /// Zero of the pressure sensors.
    Zero,
    /// Travel of both valves.
    Valves,
    /// Leak and compliance of the circuit.
    Circuit,
    /// Relief valve.
    Relief,
}

impl Step {
    /// All steps, in their order.
    pub const ALL: [Self; 8] = [
        Self::Program,
        Self::Weights,
        Self::Memory,
        Self::Sensors,
        Self::Zero,
        Self::Valves,
        Self::Circuit,
        Self::Relief,
    ];

    /// Its name.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Program => "program",
            Self::Weights => "weights",
            Self::Memory => "memory",
            Self::Sensors => "sensors",
            Self::Zero => "zero",
            Self::Valves => "valves",
            Self::Circuit => "circuit",
            Self::Relief => "relief",
        }
    }

    /// Unit of the value that it measures; none if it measures nothing.
    pub const fn unit(self) -> Option<&'static str> {
        match self {
            Self::Program | Self::Weights | Self::Memory => None,
            Self::Sensors | Self::Zero | Self::Relief => Some("cmH2O"),
            Self::Valves => Some("s"),
            Self::Circuit => Some("mL/cmH2O"),
        }
    }
}

/// What a step has found. The order of the variants is part of the link's protocol: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Error)]
pub enum Finding {
    /// The program in flash does not match its checksum.
    #[error("the program in flash is damaged; load the firmware again")]
    Program,
    /// A completely stored weights image does not match its checksum or is refused.
    #[error("the weights stored in a slot are damaged; upload an image, then reset the device")]
    Weights,
    /// A word of RAM does not keep its value.
    #[error("RAM does not keep its content; replace the board")]
    Memory,
    /// A sensor gives too few readings.
    #[error("a pressure sensor gives no reading; check its supply and wiring")]
    NoReading,
    /// A sensor is too noisy.
    #[error("a pressure reading is noisy at rest; check the sensor's supply and ground")]
    Noisy,
    /// The pressure at rest is not between that of the air and PEEP.
    #[error(
        "the pressure at rest is implausible; disconnect the patient, open the circuit, and zero the sensors"
    )]
    NotAtRest,
    /// The pressure sensors differ at rest.
    #[error("the pressure sensors differ at rest; open the circuit and zero them, or replace one")]
    SensorsDiffer,
    /// The flow sensor shows a flow at rest.
    #[error("the flow sensor shows a flow at rest; check its tubes and its zero")]
    FlowAtRest,
    /// A zero is too far off.
    #[error(
        "a sensor's zero is off by more than 2 cmH2O; open the circuit to the air, or replace the sensor"
    )]
    ZeroTooFar,
    /// The pressure did not rise.
    #[error("the pressure does not rise; check gas supply, test lung, and both valves")]
    NoRise,
    /// The pressure went on rising with the inspiratory valve commanded closed.
    #[error("the pressure rises by itself; the inspiratory valve does not close")]
    RisesByItself,
    /// The pressure did not fall when the expiratory valve was opened.
    #[error("the pressure does not fall; the expiratory valve does not open")]
    NoFall,
    /// The flow sensor measured no flow into the test lung.
    #[error("no flow into the test lung was measured; check the flow sensor, and connect a test lung")]
    NoFlow,
    /// The pressure falls with both valves closed.
    #[error("the circuit leaks; check tubes, test lung and the expiratory valve")]
    Leak,
    /// The compliance is implausible.
    #[error(
        "the compliance of circuit and test lung is implausible; check the test lung and the flow sensor"
    )]
    Compliance,
    /// The relief valve opened too early.
    #[error("the relief valve opens too early; adjust or replace it")]
    ReliefEarly,
    /// The relief valve did not open.
    #[error("the relief valve opens too late or not at all; adjust or replace it")]
    ReliefLate,
    /// An alarm ended the step.
    #[error("an alarm ended the test; find its cause, acknowledge it and repeat the test")]
    Alarm,
    /// Gas leaves the circuit through the patient port.
    #[error("gas flows through the patient port; disconnect the patient, close the port and repeat the test")]
    PortOpen,
}

/// State of a step. The order of the variants is part of the link's protocol: append only.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub enum Outcome {
    /// It has not run.
    #[default]
    NotRun,
    /// It runs.
    Runs,
    /// It has passed.
    Passed,
    /// It has failed.
    Failed(Finding),
}

/// Result of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct StepResult {
    /// Its state.
    pub outcome: Outcome,
    /// What was measured: for `sensors` the pressure at rest and for `zero` the larger offset, cmH2O; for `valves` the time of the
    /// rise, s; for `circuit` the compliance, mL/cmH2O, NaN without a flow sensor; for `relief` the opening pressure, cmH2O.
    pub value: f32,
}

impl From<Outcome> for StepResult {
    fn from(outcome: Outcome) -> Self {
        Self { outcome, value: f32::NAN }
    }
}

/// Most steps that a report can hold; a later version may have more than [`Step::ALL`].
pub const REPORT_STEPS: usize = 16;

/// The results of all steps, in the order of [`Step`].
pub type Report = Vec<StepResult, REPORT_STEPS>;

/// A part of the self-test that runs on request. The order of the variants is part of the link's protocol: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Check {
    /// [`Step::Zero`].
    Zero,
    /// [`Step::Valves`] and [`Step::Circuit`].
    Circuit,
    /// [`Step::Relief`].
    Relief,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_step_measures_has_a_unit() {
        let units = Step::ALL.map(Step::unit);
        let none = [None; 3];
        assert_eq!(units[..3], none, "checks of the memory measure nothing");
        let expected = ["cmH2O", "cmH2O", "s", "mL/cmH2O", "cmH2O"].map(Some);
        assert_eq!(units[3..], expected);
    }
}
