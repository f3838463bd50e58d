//! The columns of a recording by name, so that files, checks and joins treat them the same.

use std::fmt;

use super::table::Recording;

/// An optional column of a recording.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Extra {
    /// True airway pressure, without sensor, cmH2O.
    PressureTrue,
    /// Pressure after the sensor's lag, before noise and rounding, cmH2O.
    PressureSensorTrue,
    /// Flow into the patient circuit, L/s.
    FlowIn,
    /// Flow out of the patient circuit, L/s.
    FlowOut,
    /// Airway resistance of the lung, cmH2O/(L/s).
    Resistance,
    /// Compliance of the lung, mL/cmH2O.
    Compliance,
    /// Command of a second inspiratory valve (oxygen), percent.
    UPsol,
    /// Index into the provenance's `groups`.
    Group,
}

impl Extra {
    /// Every optional column, in file order.
    pub const ALL: [Self; 8] = [
        Self::PressureTrue,
        Self::PressureSensorTrue,
        Self::FlowIn,
        Self::FlowOut,
        Self::Resistance,
        Self::Compliance,
        Self::UPsol,
        Self::Group,
    ];

    /// The columns that only a bench knows.
    pub const TRUTH: [Self; 6] = [
        Self::PressureTrue,
        Self::PressureSensorTrue,
        Self::FlowIn,
        Self::FlowOut,
        Self::Resistance,
        Self::Compliance,
    ];

    /// Name of the column in files, equal to the field of [`Recording`].
    pub const fn name(self) -> &'static str {
        match self {
            Self::PressureTrue => "pressure_true",
            Self::PressureSensorTrue => "pressure_sensor_true",
            Self::FlowIn => "flow_in",
            Self::FlowOut => "flow_out",
            Self::Resistance => "resistance",
            Self::Compliance => "compliance",
            Self::UPsol => "u_psol",
            Self::Group => "group",
        }
    }
}

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

impl Recording {
    /// The columns that are present, in file order.
    pub(super) fn columns(&self) -> Vec<(&'static str, Values<'_>)> {
        let mut columns = vec![
            ("breath", Values::U32(&self.breath)),
            ("tick", Values::U32(&self.tick)),
            ("phase", Values::U8(&self.phase)),
            ("target", Values::F32(&self.target)),
            ("pressure", Values::F32(&self.pressure)),
            ("u_in", Values::F32(&self.u_in)),
            ("u_out", Values::F32(&self.u_out)),
            ("explore", Values::F32(&self.explore)),
            ("pip", Values::F32(&self.pip)),
            ("peep", Values::F32(&self.peep)),
        ];
        for extra in Extra::ALL {
            let values = match extra {
                Extra::PressureTrue => self.pressure_true.as_deref().map(Values::F32),
                Extra::PressureSensorTrue => self.pressure_sensor_true.as_deref().map(Values::F32),
                Extra::FlowIn => self.flow_in.as_deref().map(Values::F32),
                Extra::FlowOut => self.flow_out.as_deref().map(Values::F32),
                Extra::Resistance => self.resistance.as_deref().map(Values::F32),
                Extra::Compliance => self.compliance.as_deref().map(Values::F32),
                Extra::UPsol => self.u_psol.as_deref().map(Values::F32),
                Extra::Group => self.group.as_deref().map(Values::U32),
            };
            columns.extend(values.map(|values| (extra.name(), values)));
        }
        columns
    }

    /// Like [`Self::columns`], with mutable access.
    pub(super) fn columns_mut(&mut self) -> Vec<(&'static str, ValuesMut<'_>)> {
        let mut columns = vec![
            ("breath", ValuesMut::U32(&mut self.breath)),
            ("tick", ValuesMut::U32(&mut self.tick)),
            ("phase", ValuesMut::U8(&mut self.phase)),
            ("target", ValuesMut::F32(&mut self.target)),
            ("pressure", ValuesMut::F32(&mut self.pressure)),
            ("u_in", ValuesMut::F32(&mut self.u_in)),
            ("u_out", ValuesMut::F32(&mut self.u_out)),
            ("explore", ValuesMut::F32(&mut self.explore)),
            ("pip", ValuesMut::F32(&mut self.pip)),
            ("peep", ValuesMut::F32(&mut self.peep)),
        ];
        let numbers = [
            (Extra::PressureTrue, &mut self.pressure_true),
            (Extra::PressureSensorTrue, &mut self.pressure_sensor_true),
            (Extra::FlowIn, &mut self.flow_in),
            (Extra::FlowOut, &mut self.flow_out),
            (Extra::Resistance, &mut self.resistance),
            (Extra::Compliance, &mut self.compliance),
            (Extra::UPsol, &mut self.u_psol),
        ];
        for (extra, values) in numbers {
            columns.extend(values.as_mut().map(|values| (extra.name(), ValuesMut::F32(values))));
        }
        let group = self.group.as_mut();
        columns.extend(group.map(|values| (Extra::Group.name(), ValuesMut::U32(values))));
        columns
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::provenance::Provenance;

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
