//! Converts the counts of the analogue-to-digital converter to pressure and flow.
//!
//! Over its range every sensor outputs 0.5 to 4.5 V at a supply of 5 V (as the MPXV7000 series does), and a divider of 2/3
//! adapts that to the converter's 3.3 V. A count far outside that range means a broken wire or a short circuit, not a
//! pressure, and is read as NaN.
//!
//! | channel | range | example |
//! |---|---|---|
//! | airway pressure | -71.4 to 71.4 cmH2O | MPXV7007DP |
//! | pressure at the machine's outlet, to check the airway sensor | the same | MPXV7007DP |
//! | pressure across the flow meter's orifice | -20.4 to 20.4 cmH2O | MPXV7002DP |

use crate::math;

/// Converter counts at the reference voltage of 3.3 V.
const FULL_SCALE: f32 = 4095.0;
/// Converter counts per volt at a sensor's output, before the divider.
const COUNTS_PER_VOLT: f32 = FULL_SCALE / 3.3 * (2.0 / 3.0);
/// Sensor voltage at zero pressure, V.
const ZERO: f32 = 2.5;
/// Change of the sensor voltage from zero to the end of the range, V.
const SPAN: f32 = 2.0;
/// Lowest and highest voltage that a working sensor can output, V.
const PLAUSIBLE: (f32, f32) = (0.25, 4.75);
/// End of the pressure sensors' range, cmH2O (7 kPa).
pub const PRESSURE_SPAN: f32 = 71.4;
/// Highest pressure that a working sensor can show, beyond the end of its range, cmH2O.
pub const HIGHEST_PRESSURE: f32 = (PLAUSIBLE.1 - ZERO) / SPAN * PRESSURE_SPAN;
/// End of the flow meter's range, cmH2O (2 kPa).
pub const ORIFICE_SPAN: f32 = 20.4;
/// Flow through the orifice at 1 cmH2O, L/s.
pub const ORIFICE_FLOW: f32 = 0.66;
/// Converter counts of one tick, 12 bits each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Counts {
    /// Airway pressure.
    pub airway: u16,
    /// Pressure at the machine's outlet.
    pub outlet: u16,
    /// Pressure across the flow meter's orifice.
    pub flow: u16,
}

/// Values of all sensors in one tick; NaN where a sensor gives none or does not exist.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Readings {
    /// Airway pressure, cmH2O.
    pub airway: f32,
    /// Pressure at the machine's outlet, cmH2O: that of the airway plus the drop in the tube between them.
    pub outlet: f32,
    /// Flow at the airway, towards the patient, L/s.
    pub flow: f32,
}

impl From<f32> for Readings {
    /// The reading of a machine that has only the airway sensor.
    fn from(airway: f32) -> Self {
        Self { airway, outlet: f32::NAN, flow: f32::NAN }
    }
}

impl From<Counts> for Readings {
    fn from(counts: Counts) -> Self {
        Self {
            airway: value(counts.airway, PRESSURE_SPAN),
            outlet: value(counts.outlet, PRESSURE_SPAN),
            flow: orifice_flow(value(counts.flow, ORIFICE_SPAN)),
        }
    }
}

/// Converts a sensor's counts to the unit of its span; NaN outside [`PLAUSIBLE`].
fn value(counts: u16, span: f32) -> f32 {
    let volts = f32::from(counts) / COUNTS_PER_VOLT;
    if volts >= PLAUSIBLE.0 && volts <= PLAUSIBLE.1 { (volts - ZERO) / SPAN * span } else { f32::NAN }
}

/// Flow through the orifice, L/s, from the pressure across it, cmH2O: proportional to its square root, with its sign.
fn orifice_flow(pressure: f32) -> f32 {
    let flow = ORIFICE_FLOW * math::square_root(pressure.abs());
    if pressure < 0.0 { -flow } else { flow }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Counts of a working sensor at a value.
    fn counts(value: f32, span: f32) -> u16 {
        ((ZERO + value / span * SPAN) * COUNTS_PER_VOLT + 0.5) as u16
    }

    fn at(airway: f32, outlet: f32) -> Counts {
        let pressure = |value| counts(value, PRESSURE_SPAN);
        Counts { airway: pressure(airway), outlet: pressure(outlet), flow: counts(5.0, ORIFICE_SPAN) }
    }

    #[test]
    fn a_sensor_at_its_zero_gives_half_of_the_supply() {
        assert_eq!(counts(0.0, PRESSURE_SPAN), 2068);
        assert!(Readings::from(at(0.0, 0.0)).airway.abs() < 0.05);
    }

    /// Verifies: broken-wire.
    #[test]
    fn a_broken_wire_and_a_short_circuit_give_no_number() {
        for broken in [0, 100, 4000, 4095, u16::MAX] {
            let readings = Readings::from(Counts { airway: broken, ..at(20.0, 20.0) });
            assert!(readings.airway.is_nan() && !readings.outlet.is_nan() && !readings.flow.is_nan());
            assert!(Readings::from(Counts { flow: broken, ..at(20.0, 20.0) }).flow.is_nan());
        }
    }

    #[test]
    fn plausible_voltages_are_a_quarter_of_a_volt_inside_the_supply() {
        // After the divider 0.25 V are 206.8 counts, and 4.75 V are 3929.5.
        for (counts, sound) in [(206, false), (207, true), (3929, true), (3930, false)] {
            let readings = Readings::from(Counts { airway: counts, outlet: counts, ..at(0.0, 0.0) });
            assert_eq!([!readings.airway.is_nan(), !readings.outlet.is_nan()], [sound; 2], "{counts} counts");
        }
    }

    proptest! {
        #[test]
        fn a_pressure_survives_its_counts(pressure in -70.0f32..70.0) {
            let readings = Readings::from(at(pressure, pressure));
            prop_assert!((readings.airway - pressure).abs() < 0.03, "half a count");
            prop_assert_eq!(readings.airway.to_bits(), readings.outlet.to_bits());
        }

        #[test]
        fn flow_has_the_sign_of_its_pressure_and_its_root(pressure in -20.0f32..20.0) {
            let flow = orifice_flow(pressure);
            let exact = 0.66 * f64::from(pressure.abs()).sqrt();
            prop_assert!((f64::from(flow.abs()) - exact).abs() <= 1e-4 * exact);
            prop_assert!(flow * pressure >= 0.0);
        }

        #[test]
        fn no_counts_panic(airway: u16, outlet: u16, flow: u16) {
            let readings = Readings::from(Counts { airway, outlet, flow });
            prop_assert!([readings.airway, readings.outlet].iter().all(|p| p.is_nan() || p.abs() < 90.0));
        }
    }
}
