//! The one list of a recording's columns. The table, its rows and what files, checks and joins need of a column
//! are all made from it.

use std::fmt;

use crate::provenance::Provenance;

/// The type of a column's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Number {
    U8,
    U32,
    F32,
}

impl fmt::Display for Number {
    /// The type's name in pandas.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::U8 => "UInt8",
            Self::U32 => "UInt32",
            Self::F32 => "Float32",
        })
    }
}

/// One column, by the type of its numbers.
#[derive(Debug, Clone, Copy)]
pub(super) enum Column<A, B, C> {
    U8(A),
    U32(B),
    F32(C),
}

/// Values of one column.
pub(super) type Values<'a> = Column<&'a [u8], &'a [u32], &'a [f32]>;
/// Mutable access to the values of one column.
pub(super) type ValuesMut<'a> = Column<&'a mut Vec<u8>, &'a mut Vec<u32>, &'a mut Vec<f32>>;

impl Values<'_> {
    pub(super) fn len(&self) -> usize {
        match self {
            Self::U8(values) => values.len(),
            Self::U32(values) => values.len(),
            Self::F32(values) => values.len(),
        }
    }
}

impl<A, B, C> Column<A, B, C> {
    pub(super) fn number(&self) -> Number {
        match self {
            Self::U8(_) => Number::U8,
            Self::U32(_) => Number::U32,
            Self::F32(_) => Number::F32,
        }
    }
}

/// Makes [`Recording`], [`Row`] and [`Extra`] from the list of columns: those that every recording has, each with
/// its type; and the optional ones, each with its variant of [`Extra`], its type and the value that stands for a
/// missing one.
macro_rules! columns {
    (
        $($(#[$doc:meta])+ $name:ident: $kind:ident($number:ty);)+
        optional
        $(
            $(#[$extra_doc:meta])+
            $variant:ident $extra:ident: $extra_kind:ident($extra_number:ty) or $missing:expr;
        )+
    ) => {
        /// A recording. All columns have the same length; see [`Self::validate`] for the other rules.
        #[derive(Debug, Clone, PartialEq)]
        pub struct Recording {
            /// Origin of the rows.
            pub provenance: Provenance,
            $($(#[$doc])+ pub $name: Vec<$number>,)+
            $($(#[$extra_doc])+ pub $extra: Option<Vec<$extra_number>>,)+
        }

        /// One control tick.
        #[derive(Debug, Clone, Copy, PartialEq, Default)]
        pub struct Row {
            $($(#[$doc])+ pub $name: $number,)+
            $($(#[$extra_doc])+ pub $extra: Option<$extra_number>,)+
        }

        /// An optional column of a recording.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub enum Extra {
            $($(#[$extra_doc])+ $variant,)+
        }

        impl Extra {
            /// Every optional column, in file order.
            pub const ALL: [Self; [$(stringify!($extra)),+].len()] = [$(Self::$variant),+];

            /// Name of the column in files, equal to the field of [`Recording`].
            pub const fn name(self) -> &'static str {
                match self {
                    $(Self::$variant => stringify!($extra),)+
                }
            }
        }

        impl Recording {
            /// An empty recording with the given optional columns.
            pub fn with_extras(provenance: Provenance, extras: &[Extra]) -> Self {
                Self {
                    provenance,
                    $($name: Vec::new(),)+
                    $($extra: extras.contains(&Extra::$variant).then(Vec::new),)+
                }
            }

            /// Adds one tick. Values for columns that this recording does not have are ignored; a required value that
            /// the row lacks is stored as missing, which [`Self::validate`] refuses.
            pub fn push(&mut self, row: Row) {
                $(self.$name.push(row.$name);)+
                $(if let Some(column) = &mut self.$extra {
                    column.push(row.$extra.unwrap_or($missing));
                })+
            }

            /// A row; none beyond the last one.
            pub fn row(&self, row: usize) -> Option<Row> {
                Some(Row {
                    $($name: *self.$name.get(row)?,)+
                    $($extra: self.$extra.as_ref().and_then(|column| column.get(row).copied()),)+
                })
            }

            /// The columns that are present, in file order.
            pub(super) fn columns(&self) -> Vec<(&'static str, Values<'_>)> {
                let mut columns = vec![$((stringify!($name), Values::$kind(&self.$name))),+];
                $(if let Some(values) = &self.$extra {
                    columns.push((stringify!($extra), Values::$extra_kind(values)));
                })+
                columns
            }

            /// Like [`Self::columns`], with mutable access.
            pub(super) fn columns_mut(&mut self) -> Vec<(&'static str, ValuesMut<'_>)> {
                let mut columns = vec![$((stringify!($name), ValuesMut::$kind(&mut self.$name))),+];
                $(if let Some(values) = &mut self.$extra {
                    columns.push((stringify!($extra), ValuesMut::$extra_kind(values)));
                })+
                columns
            }
        }
    };
}

columns! {
    /// Number of the breath, ascending.
    breath: U32(u32);
    /// Control ticks since the start of the breath.
    tick: U32(u32);
    /// [`INSPIRATION`](super::INSPIRATION), [`FALL`](super::FALL) or [`EXPIRATION`](super::EXPIRATION).
    phase: U8(u8);
    /// Requested pressure, cmH2O.
    target: F32(f32);
    /// Measured pressure, cmH2O.
    pressure: F32(f32);
    /// Applied command of the inspiratory valve, percent.
    u_in: F32(f32);
    /// Command of the expiratory valve, percent from closed to open; on/off valves use 0 and 100.
    u_out: F32(f32);
    /// Part of `u_in` added by exploration, percent.
    explore: F32(f32);
    /// PIP (peak inspiratory pressure) setting, cmH2O.
    pip: F32(f32);
    /// PEEP (positive end-expiratory pressure) setting, cmH2O.
    peep: F32(f32);
    optional
    /// True airway pressure, without sensor, cmH2O. Benches only.
    PressureTrue pressure_true: F32(f32) or f32::NAN;
    /// Pressure after the sensor's lag, before noise and rounding, cmH2O. Benches only.
    PressureSensorTrue pressure_sensor_true: F32(f32) or f32::NAN;
    /// Flow into the patient circuit, L/s.
    FlowIn flow_in: F32(f32) or f32::NAN;
    /// Flow out of the patient circuit, L/s.
    FlowOut flow_out: F32(f32) or f32::NAN;
    /// Airway resistance of the lung, cmH2O/(L/s).
    Resistance resistance: F32(f32) or f32::NAN;
    /// Compliance of the lung, mL/cmH2O.
    Compliance compliance: F32(f32) or f32::NAN;
    /// Command of the second inspiratory valve (oxygen), percent.
    UPsol u_psol: F32(f32) or f32::NAN;
    /// Index into `provenance.groups`.
    Group group: U32(u32) or u32::MAX;
}

impl Extra {
    /// The columns that only a bench knows.
    pub const TRUTH: [Self; 6] = [
        Self::PressureTrue,
        Self::PressureSensorTrue,
        Self::FlowIn,
        Self::FlowOut,
        Self::Resistance,
        Self::Compliance,
    ];
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_lists_name_the_same_columns_in_the_same_order() {
        for extras in [&[][..], &Extra::TRUTH, &[Extra::Group, Extra::UPsol], &Extra::ALL] {
            let mut recording = Recording::with_extras(Provenance::new(1_000, "test"), extras);
            let read: Vec<_> = recording.columns().iter().map(|column| column.0).collect();
            let filled: Vec<_> = recording.columns_mut().iter().map(|column| column.0).collect();
            assert_eq!(read, filled);
            assert_eq!(read.len(), 10 + extras.len());
        }
    }
}
