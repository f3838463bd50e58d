//! Expiratory valve: on/off, with a mechanical PEEP valve behind it, or proportional, which holds PEEP by closing partly.

use super::branch::{Branch, parabolic_conductance};
use super::config::ExpiratoryConfig;
use super::lag::Lag;

/// The valves and their state.
#[derive(Clone, Debug)]
pub(super) struct Expiratory {
    /// Pressure below PEEP at which a proportional valve has closed, cmH2O.
    band: Option<f64>,
    opening: Lag,
    linear: f64,
    quadratic: f64,
    /// Linear and quadratic part without a clogged filter.
    clear: [f64; 2],
    /// Threshold in force, cmH2O.
    peep: f64,
    /// Threshold to which the PEEP valve was last turned, cmH2O.
    setting: f64,
    /// Whether the valve is stuck closed.
    shut: bool,
    /// Whether the PEEP valve is stuck.
    held: bool,
}

impl Expiratory {
    /// An open valve.
    pub(super) fn new(config: &ExpiratoryConfig, peep: f64, sub_step_s: f64) -> Self {
        let linear = config.laminar_resistance_cmh2o_per_l_s;
        let quadratic = 1.0 / (config.orifice_l_per_s_per_sqrt_cmh2o * config.orifice_l_per_s_per_sqrt_cmh2o);
        Self {
            band: config.peep_band_cmh2o,
            opening: Lag::new(config.lag_ms * 1e-3, sub_step_s, 1.0),
            linear,
            quadratic,
            clear: [linear, quadratic],
            peep,
            setting: peep,
            shut: false,
            held: false,
        }
    }

    pub(super) fn set_peep(&mut self, peep: f64) {
        self.setting = peep;
        if !self.held {
            self.peep = peep;
        }
    }

    /// The threshold to which the PEEP valve was last turned, cmH2O.
    pub(super) fn setting(&self) -> f64 {
        self.setting
    }

    /// Makes the PEEP valve stick at this pressure, cmH2O.
    pub(super) fn stick_at(&mut self, peep: f64) {
        (self.peep, self.held) = (peep, true);
    }

    /// Makes the valve stay closed.
    pub(super) fn stay_closed(&mut self) {
        self.shut = true;
    }

    /// Reduces the flow to this share.
    pub(super) fn clog(&mut self, part: f64) {
        let [linear, quadratic] = self.clear;
        (self.linear, self.quadratic) = (linear / part, quadratic / (part * part));
    }

    /// Ends every failure; the PEEP valve takes the pressure to which it was last turned.
    pub(super) fn repair(&mut self) {
        [self.linear, self.quadratic] = self.clear;
        (self.peep, self.held, self.shut) = (self.setting, false, false);
    }

    /// Moves the valve by one sub-step towards open (`u_out`) or closed; a proportional one closes as the `pressure` falls below PEEP.
    pub(super) fn advance(&mut self, u_out: bool, pressure: f64) {
        let open = match self.band {
            None => 1.0,
            Some(band) => (1.0 + (pressure - self.peep) / band).clamp(0.0, 1.0),
        };
        self.opening.advance(if u_out && !self.shut { open } else { 0.0 });
    }

    /// The valves as a branch while the airway is at `pressure`: towards PEEP, closed below it; that of a proportional valve leads to
    /// the room.
    pub(super) fn branch(&self, pressure: f64) -> Branch {
        let source = if self.band.is_some() { 0.0 } else { self.peep };
        let above = pressure - source;
        let conductance = if above > 0.0 {
            self.opening.output() * parabolic_conductance(self.linear, self.quadratic, above)
        } else {
            0.0
        };
        Branch { conductance, source }
    }

    /// Share of the full opening, 0 to 1.
    pub(super) fn opening(&self) -> f64 {
        self.opening.output()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SUB_STEP_S: f64 = 0.000_25;

    fn open() -> Expiratory {
        Expiratory::new(&ExpiratoryConfig::default(), 5.0, SUB_STEP_S)
    }

    fn outflow(valve: &Expiratory, pressure: f64) -> f64 {
        -valve.branch(pressure).flow(pressure)
    }

    #[test]
    fn flow_grows_with_the_square_root_above_peep() {
        let config =
            ExpiratoryConfig { laminar_resistance_cmh2o_per_l_s: 0.01, ..ExpiratoryConfig::default() };
        let valve = Expiratory::new(&config, 5.0, SUB_STEP_S);
        let expected = config.orifice_l_per_s_per_sqrt_cmh2o;
        assert!((outflow(&valve, 6.0) / expected - 1.0).abs() < 0.01);
        assert!((outflow(&valve, 30.0) / (5.0 * expected) - 1.0).abs() < 0.01);
    }

    #[test]
    fn nothing_leaves_at_or_below_peep() {
        let valve = open();
        for pressure in [5.0, 4.9, 0.0, -20.0] {
            assert!(outflow(&valve, pressure).abs() < 1e-12);
        }
    }

    #[test]
    fn the_peep_setting_moves_the_threshold() {
        let mut valve = open();
        valve.set_peep(10.0);
        assert!(outflow(&valve, 9.0).abs() < 1e-12);
        assert!(outflow(&valve, 11.0) > 0.1);
    }

    #[test]
    fn a_freed_peep_valve_takes_the_last_setting() {
        let mut valve = open();
        valve.stick_at(0.0);
        valve.set_peep(10.0);
        assert!(outflow(&valve, 3.0) > 0.1);
        valve.repair();
        assert!(outflow(&valve, 9.0).abs() < 1e-12 && outflow(&valve, 11.0) > 0.1);
    }

    #[test]
    fn closes_and_opens_with_its_lag() {
        let mut valve = open();
        let open_flow = outflow(&valve, 20.0);
        for _ in 0..60 {
            valve.advance(false, 20.0);
        }
        let after_one_lag = (-1.0_f64).exp();
        assert!((outflow(&valve, 20.0) / open_flow - after_one_lag).abs() < 1e-9);
        for _ in 0..60 {
            valve.advance(true, 20.0);
        }
        assert!((valve.opening() - (1.0 - after_one_lag * (1.0 - after_one_lag))).abs() < 1e-9);
    }

    /// A proportional valve that closes over 2 cmH2O below PEEP.
    fn proportional() -> Expiratory {
        let config = ExpiratoryConfig { peep_band_cmh2o: Some(2.0), ..ExpiratoryConfig::default() };
        Expiratory::new(&config, 5.0, SUB_STEP_S)
    }

    #[test]
    fn a_proportional_valve_closes_below_peep_in_proportion() {
        for (pressure, expected) in [(20.0, 1.0), (5.0, 1.0), (4.0, 0.5), (3.0, 0.0), (-9.0, 0.0)] {
            let mut valve = proportional();
            for _ in 0..4_000 {
                valve.advance(true, pressure);
            }
            assert!((valve.opening() - expected).abs() < 1e-9, "{pressure}: {}", valve.opening());
        }
        let mut valve = proportional();
        for _ in 0..4_000 {
            valve.advance(false, 30.0);
        }
        assert!(valve.opening() < 1e-9, "closed in inspiration");
    }

    #[test]
    fn a_proportional_valve_leads_to_the_room_and_only_there() {
        let valve = proportional();
        assert!(outflow(&valve, 4.0) > 0.1, "its lag lets the pressure fall below PEEP");
        assert!(outflow(&valve, 0.0).abs() < 1e-12 && outflow(&valve, -3.0).abs() < 1e-12);
    }
}
