//! The operator's settings: names, units, bounds and defaults, defined once for firmware, command line and documents.
//!
//! [`Settings`] holds values as typed or received; a `Breath` is the validated form that the control loop sees.

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Settings of pressure-controlled ventilation as typed or received, not yet validated.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// Peak inspiratory pressure, cmH2O.
    pub pip: f32,
    /// Positive end-expiratory pressure, cmH2O.
    pub peep: f32,
    /// Breaths per minute.
    pub rate: f32,
    /// Inspiratory time, s.
    pub inspiratory_time: f32,
    /// Time of the linear rise from PEEP to PIP, s; 0 is the square rise of the paper.
    pub rise_time: f32,
    /// Time of the linear fall from PIP to PEEP after the inspiration, s.
    pub fall_time: f32,
    /// Command of the inspiratory valve while the expiratory valve is open, percent.
    pub expiratory_bias: f32,
    /// Airway pressure above which the inspiration is cut, cmH2O.
    pub pressure_limit: f32,
    /// Fall of the airway pressure by which a patient's effort starts the breath, cmH2O; 0 for none.
    pub trigger_pressure: f32,
    /// Change of the flow by which a patient's effort starts the breath, L/min; 0 for none.
    pub trigger_flow: f32,
    /// Expired tidal volume below which an alarm is raised, mL; 0 for none.
    pub tidal_volume_low: f32,
    /// Expired tidal volume above which an alarm is raised, mL; 0 for none.
    pub tidal_volume_high: f32,
    /// Expired minute volume below which an alarm is raised, L/min; 0 for none.
    pub minute_volume_low: f32,
    /// Expired minute volume above which an alarm is raised, L/min; 0 for none.
    pub minute_volume_high: f32,
}

/// Description of one setting.
#[derive(Clone, Copy, Debug)]
pub struct Field {
    /// Name as in [`Settings`].
    pub name: &'static str,
    /// Description, as printed.
    pub description: &'static str,
    /// Unit, as printed.
    pub unit: &'static str,
    /// Lowest accepted value.
    pub min: f32,
    /// Highest accepted value.
    pub max: f32,
    /// Default value; together the defaults are the paper's protocol.
    pub default: f32,
    get: fn(&Settings) -> f32,
}

impl Field {
    /// Value of this setting in `settings`.
    pub fn value(&self, settings: &Settings) -> f32 {
        (self.get)(settings)
    }
}

/// Index of a setting in [`FIELDS`]. A device of another version may have settings that this list lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct FieldIndex(pub u8);

impl FieldIndex {
    /// The index of the setting of this name; one past the last if there is none.
    fn of(name: &str) -> Self {
        Self(FIELDS.iter().take_while(|field| field.name != name).count() as u8)
    }

    fn name(self) -> &'static str {
        FIELDS.get(usize::from(self.0)).map_or("a setting of another version", |field| field.name)
    }

    fn unit(self) -> &'static str {
        FIELDS.get(usize::from(self.0)).map_or("", |field| field.unit)
    }
}

macro_rules! fields {
    ($($name:ident, $unit:literal, $min:literal ..= $max:literal, $default:literal, $description:literal;)*) => {
        /// All settings with unit, bounds and default.
        pub const FIELDS: &[Field] = &[$(Field {
            name: stringify!($name), description: $description, unit: $unit, min: $min, max: $max,
            default: $default, get: |s| s.$name,
        }),*];

        impl Default for Settings {
            fn default() -> Self {
                Self { $($name: $default),* }
            }
        }

        impl Settings {
            /// Their values, in the order of [`FIELDS`].
            pub fn values(&self) -> [f32; FIELDS.len()] {
                [$(self.$name),*]
            }

            /// The settings with these values, in the order of [`FIELDS`].
            pub fn from_values(values: [f32; FIELDS.len()]) -> Self {
                let [$($name),*] = values;
                Self { $($name),* }
            }
        }
    };
}

fields! {
    pip,              "cmH2O", 5.0 ..= 60.0,  20.0, "Peak inspiratory pressure";
    peep,             "cmH2O", 0.0 ..= 20.0,  5.0,  "Positive end-expiratory pressure";
    rate,             "1/min", 4.0 ..= 80.0,  20.0, "Breaths per minute";
    inspiratory_time, "s",     0.2 ..= 5.0,   1.0,  "Length of the inspiration";
    rise_time,        "s",     0.0 ..= 1.0,   0.0,  "Time of the rise from PEEP to PIP, 0 for the paper's square waveform";
    fall_time,        "s",     0.0 ..= 2.0,   0.5,  "Time of the fall from PIP to PEEP";
    expiratory_bias,  "%",     0.0 ..= 20.0,  5.0,  "Inspiratory valve while the expiratory valve is open";
    pressure_limit,   "cmH2O", 15.0 ..= 70.0, 60.0, "Pressure above which a breath is ended";
    trigger_pressure, "cmH2O", 0.0 ..= 10.0,  0.4,  "Fall of the pressure by which an effort starts a breath, 0 for none";
    trigger_flow,     "L/min", 0.0 ..= 20.0,  0.6,  "Change of the flow by which an effort starts a breath, 0 for none";
    tidal_volume_low,   "mL",    0.0 ..= 3000.0, 0.0, "Expired volume below which an alarm is raised, 0 for none";
    tidal_volume_high,  "mL",    0.0 ..= 3000.0, 0.0, "Expired volume above which an alarm is raised, 0 for none";
    minute_volume_low,  "L/min", 0.0 ..= 60.0,   0.0, "Expired minute volume below which an alarm is raised, 0 for none";
    minute_volume_high, "L/min", 0.0 ..= 60.0,   0.0, "Expired minute volume above which an alarm is raised, 0 for none";
}

/// Every setting except PIP, which is first: the settings that the waveforms of a run have in common.
pub const TEMPLATE_FIELDS: &[Field] = FIELDS.split_at(1).1;

/// Reason for refusing settings. The order of variants and fields is part of the link's protocol: append only. Fulfils: settings-bounds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Error)]
pub enum SettingsError {
    /// A value is outside its bounds or not a number.
    #[error("{} is {value} {1}, allowed are {min} to {max} {1}", .field.name(), .field.unit())]
    OutOfBounds {
        /// The setting.
        field: FieldIndex,
        /// Requested value.
        value: f32,
        /// Lowest accepted value.
        min: f32,
        /// Highest accepted value.
        max: f32,
    },
    /// PIP is below PEEP or too close to it.
    #[error(
        "PIP ({pip} cmH2O) must be at least {} cmH2O above PEEP ({peep} cmH2O); raise pip or lower peep",
        LEAST_RISE
    )]
    PipBelowPeep {
        /// Requested PIP, cmH2O.
        pip: f32,
        /// Requested PEEP, cmH2O.
        peep: f32,
    },
    /// The pressure limit is too close to PIP.
    #[error("pressure limit ({limit} cmH2O) must be at least {margin} cmH2O above PIP ({pip} cmH2O)")]
    LimitTooLow {
        /// Requested limit, cmH2O.
        limit: f32,
        /// Requested PIP, cmH2O.
        pip: f32,
        /// Required distance, cmH2O.
        margin: f32,
    },
    /// Inspiration and fall are longer than the breath.
    #[error(
        "inspiration and fall take {inspiration} s of a breath of {breath} s; lower the rate or shorten them"
    )]
    BreathTooShort {
        /// Inspiratory and fall time together, s.
        inspiration: f32,
        /// Length of a breath at the requested rate, s.
        breath: f32,
    },
    /// The control period is out of bounds.
    #[error("control period of {period_us} us is outside 250 to 50000 us")]
    Period {
        /// Requested period, microseconds.
        period_us: u32,
    },
    /// A trigger is so sensitive that a sensor's noise would start breaths.
    #[error(
        "{} of {value} {1} is within the noise of a working sensor; use {lowest} {1} or more, or 0 for none",
        .field.name(), .field.unit()
    )]
    TriggerInNoise {
        /// The setting.
        field: FieldIndex,
        /// Requested value.
        value: f32,
        /// Lowest accepted value above zero.
        lowest: f32,
    },
    /// The lower alarm limit of a volume is not below its upper one.
    #[error(
        "{} of {low} {2} must be below {} of {high} {2}; lower the one, raise the other, or use 0 for none",
        .field.name(), .upper.name(), .field.unit()
    )]
    LimitsCrossed {
        /// The setting of the lower limit.
        field: FieldIndex,
        /// The setting of the upper limit.
        upper: FieldIndex,
        /// Requested lower limit.
        low: f32,
        /// Requested upper limit.
        high: f32,
    },
}

/// Smallest rise from PEEP to PIP, cmH2O: a smaller one moves too little gas, and the monitors cannot distinguish it from noise.
pub const LEAST_RISE: f32 = 2.0;
/// Smallest distance of the pressure limit above PIP, cmH2O.
pub const LIMIT_MARGIN: f32 = 5.0;
/// Lowest trigger sensitivities: pressure, cmH2O, and flow, L/min.
const LOWEST_TRIGGERS: (f32, f32) = (0.2, 0.5);

impl Settings {
    /// Checks all bounds and the relations between settings.
    ///
    /// # Errors
    /// The first violated rule, with the allowed range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        for (index, field) in (0..).zip(FIELDS) {
            let (value, min, max) = (field.value(self), field.min, field.max);
            if !(value >= min && value <= max) {
                return Err(SettingsError::OutOfBounds { field: FieldIndex(index), value, min, max });
            }
        }
        if self.pip < self.peep + LEAST_RISE {
            return Err(SettingsError::PipBelowPeep { pip: self.pip, peep: self.peep });
        }
        if self.pressure_limit < self.pip + LIMIT_MARGIN {
            let (limit, pip, margin) = (self.pressure_limit, self.pip, LIMIT_MARGIN);
            return Err(SettingsError::LimitTooLow { limit, pip, margin });
        }
        for (name, value, lowest) in [
            ("trigger_pressure", self.trigger_pressure, LOWEST_TRIGGERS.0),
            ("trigger_flow", self.trigger_flow, LOWEST_TRIGGERS.1),
        ] {
            if value > 0.0 && value < lowest {
                return Err(SettingsError::TriggerInNoise { field: FieldIndex::of(name), value, lowest });
            }
        }
        for (names, low, high) in [
            (["tidal_volume_low", "tidal_volume_high"], self.tidal_volume_low, self.tidal_volume_high),
            (["minute_volume_low", "minute_volume_high"], self.minute_volume_low, self.minute_volume_high),
        ] {
            if high > 0.0 && low >= high {
                let [field, upper] = names.map(FieldIndex::of);
                return Err(SettingsError::LimitsCrossed { field, upper, low, high });
            }
        }
        let breath = 60.0 / self.rate;
        let inspiration = self.inspiratory_time + self.fall_time;
        if inspiration > breath {
            return Err(SettingsError::BreathTooShort { inspiration, breath });
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::string::ToString;

    #[test]
    fn the_defaults_are_valid() {
        assert_eq!(Settings::default().validate(), Ok(()));
    }

    #[test]
    fn every_default_lies_within_its_bounds() {
        for field in FIELDS {
            assert!(field.default >= field.min && field.default <= field.max, "{}", field.name);
        }
    }

    #[test]
    fn a_nan_is_refused_by_name() {
        let settings = Settings { peep: f32::NAN, ..Settings::default() };
        assert!(settings.validate().unwrap_err().to_string().starts_with("peep is NaN cmH2O"));
    }

    #[test]
    fn pip_must_be_above_peep_by_a_rise_that_ventilates() {
        let settings = |pip| Settings { pip, peep: 10.0, ..Settings::default() };
        assert_eq!(settings(12.0).validate(), Ok(()));
        for pip in [11.9, 10.0, 6.0] {
            let refused = settings(pip).validate().unwrap_err();
            assert!(refused.to_string().contains("at least 2 cmH2O above PEEP (10 cmH2O)"), "{refused}");
        }
    }

    #[test]
    fn the_limit_must_leave_room_above_pip() {
        let settings = Settings { pip: 40.0, pressure_limit: 44.0, ..Settings::default() };
        assert!(matches!(settings.validate(), Err(SettingsError::LimitTooLow { .. })));
    }

    #[test]
    fn a_breath_must_hold_its_inspiration() {
        let settings = Settings { rate: 60.0, ..Settings::default() };
        assert!(matches!(settings.validate(), Err(SettingsError::BreathTooShort { .. })));
    }

    #[test]
    fn a_trigger_is_off_or_above_the_noise() {
        let with = |trigger_pressure, trigger_flow| {
            Settings { trigger_pressure, trigger_flow, ..Settings::default() }.validate()
        };
        assert_eq!((with(0.0, 0.0), with(0.2, 0.5)), (Ok(()), Ok(())));
        let refused = with(0.19, 0.0).unwrap_err().to_string();
        assert!(refused.starts_with("trigger_pressure of 0.19 cmH2O is within the noise"), "{refused}");
        let refused = with(0.0, 0.49).unwrap_err().to_string();
        assert!(refused.contains("use 0.5 L/min or more, or 0 for none"), "{refused}");
    }

    #[test]
    fn alarm_limits_of_a_volume_are_off_or_in_order() {
        let with = |[tidal_volume_low, tidal_volume_high, minute_volume_low, minute_volume_high]: [f32;
                        4]| {
            let volumes = Settings {
                tidal_volume_low,
                tidal_volume_high,
                minute_volume_low,
                minute_volume_high,
                ..Settings::default()
            };
            volumes.validate().map_err(|error| error.to_string())
        };
        for sound in [[0.0; 4], [300.0, 0.0, 4.0, 0.0], [0.0, 600.0, 0.0, 9.0], [300.0, 301.0, 4.0, 4.1]] {
            assert_eq!(with(sound), Ok(()));
        }
        let refused = with([500.0, 500.0, 0.0, 0.0]).unwrap_err();
        assert!(
            refused.starts_with("tidal_volume_low of 500 mL must be below tidal_volume_high of 500 mL;"),
            "{refused}"
        );
        let refused = with([0.0, 0.0, 9.0, 8.0]).unwrap_err();
        assert!(
            refused.starts_with("minute_volume_low of 9 L/min must be below minute_volume_high of 8"),
            "{refused}"
        );
    }

    #[test]
    fn values_and_settings_convert_both_ways() {
        let settings =
            Settings { pip: 31.0, trigger_flow: 2.0, minute_volume_high: 9.0, ..Settings::default() };
        assert_eq!(Settings::from_values(settings.values()), settings);
        let listed: std::vec::Vec<_> = FIELDS.iter().map(|field| field.value(&settings)).collect();
        assert_eq!(listed, settings.values());
    }

    proptest! {
        #[test]
        fn accepted_settings_lie_within_all_bounds(
            pip in -10.0f32..80.0, peep in -5.0f32..40.0, rate in 0.0f32..100.0, inspiratory_time in 0.0f32..6.0,
        ) {
            let settings = Settings { pip, peep, rate, inspiratory_time, ..Settings::default() };
            if settings.validate().is_ok() {
                prop_assert!(FIELDS.iter().all(|f| f.value(&settings) >= f.min && f.value(&settings) <= f.max));
                prop_assert!(pip >= peep + LEAST_RISE);
            }
        }
    }
}
