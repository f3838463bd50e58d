//! The change of the pressure that the machine's own commands must bring.
//!
//! A reading that repeats itself to the last bit shows nothing where the pressure may stand still: on a plateau, at PEEP. It
//! shows a frozen sensor where the machine drives gas in and the pressure has yet to reach its target, or lets gas out and
//! it is far above PEEP.

/// Distance below the target from which the pressure rises while gas flows in, cmH2O. A controller near its target may hold
/// the pressure to within a quantum of the sensor.
pub const AWAY: f32 = 2.0;
/// Distance above PEEP from which it falls by a quantum of 0.1 cmH2O in less than the monitor's time, cmH2O: it takes an
/// expiratory flow that only a short time constant allows.
pub const ABOVE: f32 = 5.0;
/// Smallest rise in [`super::lung_estimator::WINDOW`] ticks that the lung estimate predicts for flowing gas, cmH2O.
const RISING: f32 = 1.5;
/// Flow out of the lung while it empties, L/s.
const OUTFLOW: f32 = 0.1;

/// The course of the pressure that the last commands predict.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Expected {
    /// No breath runs.
    #[default]
    Rest,
    /// A breath runs; the pressure may stand still.
    Any,
    /// Gas flows in, up to this pressure, cmH2O.
    RiseTo(f32),
    /// Gas flows out, down to this pressure, cmH2O.
    FallTo(f32),
}

impl Expected {
    /// In an inspiration with this target, cmH2O, for which the lung estimate predicts this rise in its window, cmH2O.
    pub fn inspiration(target: f32, predicted_rise: f32) -> Self {
        if predicted_rise > RISING { Self::RiseTo(target) } else { Self::Any }
    }

    /// With an open expiratory valve, at this PEEP, cmH2O, and flow towards the patient, L/s, NaN if it is not measured: a
    /// valve that is stuck closed stops the flow, and the pressure does not change.
    pub fn expiration(peep: f32, flow: f32) -> Self {
        if flow.is_nan() || flow < -OUTFLOW { Self::FallTo(peep) } else { Self::Any }
    }

    /// Whether a breath runs.
    pub fn breathes(self) -> bool {
        self != Self::Rest
    }

    /// Whether the pressure cannot stay where it is, cmH2O.
    pub fn moves(self, pressure: f32) -> bool {
        match self {
            Self::Rest | Self::Any => false,
            Self::RiseTo(target) => pressure < target - AWAY,
            Self::FallTo(peep) => pressure > peep + ABOVE,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn driven_gas_raises_a_pressure_below_its_target() {
        assert_eq!(Expected::inspiration(25.0, 1.6), Expected::RiseTo(25.0));
        assert_eq!(Expected::inspiration(25.0, 1.5), Expected::Any);
        let rises = Expected::RiseTo(25.0);
        assert!(rises.moves(22.9) && !rises.moves(23.0) && !rises.moves(30.0));
    }

    #[test]
    fn flowing_out_it_lowers_a_pressure_far_above_peep() {
        assert_eq!(Expected::expiration(5.0, -0.11), Expected::FallTo(5.0));
        assert_eq!(Expected::expiration(5.0, -0.1), Expected::Any, "a valve that is stuck closed");
        assert_eq!(
            Expected::expiration(5.0, f32::NAN),
            Expected::FallTo(5.0),
            "a machine without the sensor"
        );
        let falls = Expected::FallTo(5.0);
        assert!(falls.moves(10.1) && !falls.moves(10.0) && !falls.moves(0.0));
    }

    #[test]
    fn otherwise_the_pressure_may_stand_still() {
        assert!(![Expected::Rest, Expected::Any].into_iter().any(|expected| expected.moves(20.0)));
        assert!(Expected::Any.breathes() && Expected::RiseTo(5.0).breathes() && !Expected::Rest.breathes());
    }
}
