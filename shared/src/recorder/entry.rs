//! Entries of the flight recorder: a control tick in 6 bytes, an event in 12.

use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

use crate::breath::Phase;
use crate::control::memory::Lesson;
use crate::reset::ResetCause;
use crate::safety::alarms::Fault;
use crate::settings::Settings;

/// Length of a tick's entry, 16-bit halves.
pub(super) const TICK_HALVES: usize = 3;
/// Length of a tick's entry, bytes.
pub const TICK_BYTES: usize = 2 * TICK_HALVES;
/// Length of an event's entry, 16-bit halves.
pub(super) const EVENT_HALVES: usize = 6;
/// Length of an event's entry, bytes.
pub const EVENT_BYTES: usize = 2 * EVENT_HALVES;

/// Offset of the pressure code; lower pressures are recorded as -99.99, cmH2O.
const PRESSURE_OFFSET: f32 = -100.0;
/// Resolution of pressure and target, steps per cmH2O.
const PRESSURE_STEPS: f32 = 100.0;
/// Resolution of a valve command, steps per percent.
const COMMAND_STEPS: f32 = 10.0;
/// Highest code of a pressure, 15 bits; 0 means not a number.
const PRESSURE_CODE: u32 = 32_767;
/// Highest code of a target, 13 bits; 0 means no target.
const TARGET_CODE: u32 = 8_191;
/// Highest code of a valve command, 10 bits.
const COMMAND_CODE: u32 = 1_023;
/// Code for no phase, 2 bits; the other codes are the numbers of [`Phase`]'s variants.
const NO_PHASE: u16 = 3;
/// Resolution of a setting in an event's argument, steps per unit.
const SETTING_STEPS: f32 = 10.0;

/// Activity of the ventilator in a tick. The order of the variants is part of the recording's format: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum Activity {
    /// In standby.
    Standby,
    /// Ventilating.
    Ventilating,
    /// In the latched safe state.
    Fault,
}

/// Record of a control tick.
///
/// | value | bits | resolution, range |
/// |---|---|---|
/// | pressure | 15 | 0.01 cmH2O, -99.99 to 227.67; one code for NaN |
/// | expiratory valve | 1 | open or closed |
/// | target | 13 | 0.01 cmH2O, 0 to 81.9; one code for "none" |
/// | phase | 2 | one code for "no breath" |
/// | explored | 1 | whether exploration changed the command |
/// | inspiratory valve | 10 | 0.1 % |
/// | activity | 2 | one code for a gap |
/// | breath | 4 | lowest bits of the breath's number |
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct TickEntry {
    /// Pressure as read, cmH2O; NaN if the reading was not a number.
    pub pressure: f32,
    /// Target, cmH2O; none outside a breath.
    pub target: Option<f32>,
    /// Command of the inspiratory valve, percent.
    pub u_in: f32,
    /// Whether the expiratory valve was open.
    pub u_out: bool,
    /// Phase of the breath; none outside a breath.
    pub phase: Option<Phase>,
    /// Whether exploration changed the command of the inspiratory valve.
    pub explored: bool,
    /// Activity of the ventilator.
    pub activity: Activity,
    /// Number of the breath, modulo 16.
    pub breath: u8,
}

/// Entry between ticks that are not consecutive.
pub(super) const GAP: [u16; TICK_HALVES] = [0, 0, 3 << 4];

impl TickEntry {
    /// Packs the entry; values out of range are limited to it.
    #[inline]
    pub(super) fn pack(&self) -> [u16; TICK_HALVES] {
        let pressure = (self.pressure - PRESSURE_OFFSET) * PRESSURE_STEPS;
        let pressure = if self.pressure.is_nan() { 0 } else { code(pressure, 1, PRESSURE_CODE) };
        let target = self.target.map_or(0, |target| code(target * PRESSURE_STEPS + 1.0, 1, TARGET_CODE));
        let phase = self.phase.map_or(NO_PHASE, |phase| phase as u16);
        let u_in = code(self.u_in * COMMAND_STEPS, 0, COMMAND_CODE);
        [
            pressure << 1 | u16::from(self.u_out),
            target << 3 | phase << 1 | u16::from(self.explored),
            u_in << 6 | (self.activity as u16) << 4 | u16::from(self.breath & 15),
        ]
    }

    /// Unpacks an entry; none if it marks a gap, where the next tick does not follow the previous one.
    pub fn read(bytes: [u8; TICK_BYTES]) -> Option<Self> {
        let [first, second, third] = halves(bytes);
        // Activity 3 marks a gap.
        let activity = variant((third >> 4 & 3) as u8)?;
        let pressure = match first >> 1 {
            0 => f32::NAN,
            code => f32::from(code) / PRESSURE_STEPS + PRESSURE_OFFSET,
        };
        let target = match second >> 3 {
            0 => None,
            code => Some(f32::from(code - 1) / PRESSURE_STEPS),
        };
        Some(Self {
            pressure,
            target,
            u_in: f32::from(third >> 6) / COMMAND_STEPS,
            u_out: first & 1 != 0,
            phase: variant((second >> 1 & 3) as u8),
            explored: second & 1 != 0,
            activity,
            breath: (third & 15) as u8,
        })
    }
}

/// Rounds `value` and limits it to `low..=high`. Limiting the integer takes fewer instructions: the cast converts negative
/// values and NaN to 0, and values that are too large to the largest integer.
#[inline]
fn code(value: f32, low: u32, high: u32) -> u16 {
    ((value + 0.5) as u32).clamp(low, high) as u16
}

/// An event of the chip itself. The order of the variants is part of the log's format: append only.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum ChipEvent {
    /// The crystal did not start, and the device runs on its internal oscillator: all times may be off by some percent.
    NoCrystal,
    /// The crystal has stopped, and the device runs on its internal oscillator since.
    CrystalStopped,
    /// The supply voltage was low, and the valves were made safe.
    SupplyLow,
    /// The brown-out level was not the one that the board needs and has been programmed.
    BrownOutLevelSet,
    /// The brown-out level is not the one that the board needs and has not been programmed.
    BrownOutLevelWrong,
    /// The recorder's memory had lost its content; its newest copy in flash was read back.
    RecorderRestored,
    /// An interrupted ventilation was not resumed: the interruption was too long.
    AbsentTooLong,
    /// An interrupted ventilation was not resumed: no clock tells how long the supply was away.
    AbsenceUnknown,
    /// An interrupted ventilation was not resumed: its settings are damaged.
    PrescriptionDamaged,
    /// An interrupted ventilation was not resumed: the program failed in each of several resumptions.
    ResumedTooOften,
}

/// An event of the log.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub enum Happening {
    /// The device started.
    Boot {
        /// Cause of the start.
        cause: ResetCause,
        /// Whether a failure of the program caused the start.
        failed: bool,
    },
    /// Weights with this id were loaded at the start.
    Weights(u32),
    /// Ventilation started.
    Start,
    /// Ventilation was stopped.
    Stop,
    /// A fault was latched.
    Fault(Fault),
    /// The fault was acknowledged.
    Acknowledged,
    /// The controller changed.
    Controller {
        /// Whether learned weights run; otherwise a PID.
        learned: bool,
    },
    /// Settings of a breath, with a resolution of a tenth of their unit.
    Settings {
        /// Peak inspiratory pressure, cmH2O.
        pip: f32,
        /// Positive end-expiratory pressure, cmH2O.
        peep: f32,
        /// Breaths per minute.
        rate: f32,
    },
    /// Control ticks were missed.
    Missed {
        /// Number of ticks that have not run since the start.
        ticks: u32,
    },
    /// A host cleared the recording.
    Cleared,
    /// A monitor raised an alarm that did not end ventilation.
    Alarm(Fault),
    /// The chip reports on itself.
    Chip(ChipEvent),
    /// What the controller learned from a breath has changed: it adopts breaths, leaves them out, or has forgotten all.
    Lesson(Lesson),
}

impl Happening {
    /// The logged settings of a breath.
    pub(super) fn settings(settings: &Settings) -> Self {
        Self::Settings { pip: settings.pip, peep: settings.peep, rate: settings.rate }
    }

    /// Packs the event into its kind, never 0, and its argument.
    fn pack(self) -> (u8, u32) {
        match self {
            Self::Boot { cause, failed } => (1, u32::from(cause as u8) | u32::from(failed) << 8),
            Self::Weights(id) => (2, id),
            Self::Start => (3, 0),
            Self::Stop => (4, 0),
            Self::Fault(fault) => (5, u32::from(fault as u8)),
            Self::Acknowledged => (6, 0),
            Self::Controller { learned } => (7, u32::from(learned)),
            Self::Settings { pip, peep, rate } => {
                let tenths = |value: f32, highest: u32| u32::from(code(value * SETTING_STEPS, 0, highest));
                (8, tenths(pip, 1023) | tenths(peep, 1023) << 10 | tenths(rate, 4095) << 20)
            }
            Self::Missed { ticks } => (9, ticks),
            Self::Cleared => (10, 0),
            Self::Alarm(fault) => (11, u32::from(fault as u8)),
            Self::Chip(event) => (12, u32::from(event as u8)),
            Self::Lesson(lesson) => (13, u32::from(lesson as u8)),
        }
    }

    fn unpack(kind: u8, argument: u32) -> Option<Self> {
        let tenths = |shift: u32, bits: u32| (argument >> shift & ((1 << bits) - 1)) as f32 / SETTING_STEPS;
        Some(match kind {
            1 => Self::Boot { cause: variant(argument as u8)?, failed: argument >> 8 != 0 },
            2 => Self::Weights(argument),
            3 => Self::Start,
            4 => Self::Stop,
            5 => Self::Fault(variant(argument as u8)?),
            6 => Self::Acknowledged,
            7 => Self::Controller { learned: argument != 0 },
            8 => Self::Settings { pip: tenths(0, 10), peep: tenths(10, 10), rate: tenths(20, 12) },
            9 => Self::Missed { ticks: argument },
            10 => Self::Cleared,
            11 => Self::Alarm(variant(argument as u8)?),
            12 => Self::Chip(variant(argument as u8)?),
            13 => Self::Lesson(variant(argument as u8)?),
            _ => return None,
        })
    }
}

/// The variant with this number, as postcard numbers them.
pub(super) fn variant<V: DeserializeOwned>(number: u8) -> Option<V> {
    postcard::from_bytes(&[number]).ok()
}

/// An entry of the log: an event with its time.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct LogEntry {
    /// Control tick since the device started.
    pub tick: u32,
    /// Number of that start, counted since the memory last lost power.
    pub boot: u16,
    /// The event.
    pub happening: Happening,
}

impl LogEntry {
    /// Packs the entry: tick, argument, boot, kind and check.
    pub(super) fn pack(&self) -> [u16; EVENT_HALVES] {
        let (kind, argument) = self.happening.pack();
        let check = check(self.tick, argument, self.boot, kind);
        [
            self.tick as u16,
            (self.tick >> 16) as u16,
            argument as u16,
            (argument >> 16) as u16,
            self.boot,
            u16::from(kind) | u16::from(check) << 8,
        ]
    }

    /// Unpacks an entry; none if it is damaged or from a newer device.
    pub fn read(bytes: [u8; EVENT_BYTES]) -> Option<Self> {
        let [tick, tick_high, argument, argument_high, boot, last] = halves(bytes);
        let tick = u32::from(tick) | u32::from(tick_high) << 16;
        let argument = u32::from(argument) | u32::from(argument_high) << 16;
        let [kind, stored] = last.to_le_bytes();
        if stored != check(tick, argument, boot, kind) {
            return None;
        }
        Some(Self { tick, boot, happening: Happening::unpack(kind, argument)? })
    }
}

/// An 8-bit checksum that changes with every single bit of an event.
fn check(tick: u32, argument: u32, boot: u16, kind: u8) -> u8 {
    let mixed = tick ^ argument.rotate_left(7) ^ (u32::from(boot) << 8 | u32::from(kind));
    (mixed.wrapping_mul(0x9E37_79B1) >> 24) as u8
}

/// Converts bytes to little-endian halves.
fn halves<const BYTES: usize, const HALVES: usize>(bytes: [u8; BYTES]) -> [u16; HALVES] {
    let (pairs, _) = bytes.as_chunks::<2>();
    core::array::from_fn(|index| pairs.get(index).map_or(0, |pair| u16::from_le_bytes(*pair)))
}
