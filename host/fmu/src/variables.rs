//! The variables of an FMU: the settings, the seed of the sensor's noise, and what the ventilator and the bench do.

use shared::settings::FIELDS;
use shared::ventilator::opening;
use ventilator::Tick;

/// Reference of the seed, the only integer.
pub const SEED: u32 = 0;
/// Number of settings, and so the reference of the first output.
pub const SETTINGS: usize = FIELDS.len();
/// Seed unless another one is set, as that of `trainer collect`.
pub const DEFAULT_SEED: i32 = 1;

/// An output.
pub struct Output {
    /// Name.
    pub name: &'static str,
    /// Unit.
    pub unit: &'static str,
    /// Description.
    pub description: &'static str,
    /// Value in a tick; not a number where the bench has none.
    pub of: fn(&Tick) -> f32,
}

/// The outputs, of the last control tick.
pub const OUTPUTS: [Output; 6] = [
    Output { name: "target", unit: "cmH2O", description: "Target pressure", of: |tick| tick.sample.target },
    Output {
        name: "pressure",
        unit: "cmH2O",
        description: "Pressure as the airway sensor reads it",
        of: |tick| tick.sample.pressure,
    },
    Output {
        name: "u_in",
        unit: "%",
        description: "Command of the inspiratory valve",
        of: |tick| tick.sample.u_in,
    },
    Output {
        name: "u_out",
        unit: "%",
        description: "Expiratory valve, 0 or 100",
        of: |tick| opening(tick.sample.u_out),
    },
    Output {
        name: "flow",
        unit: "L/s",
        description: "Flow towards the patient as the flow sensor reads it",
        of: |tick| tick.sample.flow.unwrap_or(f32::NAN),
    },
    Output {
        name: "volume",
        unit: "mL",
        description: "Gas in the lung above its volume at rest",
        of: |tick| tick.truth.map_or(f32::NAN, |truth| truth.lung_volume),
    },
];

/// A real variable by its reference: the settings in the order of [`FIELDS`], then the outputs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Real {
    /// Index of a setting.
    Setting(usize),
    /// Index of an output.
    Output(usize),
}

impl Real {
    /// The variable with a reference.
    pub fn of(reference: u32) -> Option<Self> {
        let reference = reference as usize;
        match reference.checked_sub(SETTINGS) {
            None => Some(Self::Setting(reference)),
            Some(output) => (output < OUTPUTS.len()).then_some(Self::Output(output)),
        }
    }
}
