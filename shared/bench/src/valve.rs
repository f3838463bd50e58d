//! Inspiratory proportional valve: dead time, lag, backlash of the stem, dead zone, curved characteristic,
//! back-pressure.

use super::blower::Blower;
use super::branch::{Branch, parabolic_conductance};
use super::config::ValveConfig;
use super::lag::Lag;
use crate::characteristic::Characteristic;
use crate::math::{round, sqrt};
use crate::storage::List;

/// Longest dead time with the spread between units, steps.
const MOST_DELAY: usize = 150;
/// Pressure difference to the supply, in cmH2O, below which a straight line replaces the square root of the flow.
const LEAST_DRIVE_CMH2O: f64 = 1.0;
/// Resistance at small flow of a valve behind a blower, cmH2O/(L/s): it keeps the slope finite where the pressures are equal.
const LAMINAR_CMH2O_PER_L_S: f64 = 0.3;

/// Delayed commands, newest last: a ring as long as the dead time.
#[derive(Clone, Debug)]
struct DeadTime {
    ring: List<f64, { MOST_DELAY + 2 }>,
    newest: usize,
    /// The two commands that take effect in this step, the older one first.
    due: [f64; 2],
    /// Sub-steps of a step in which the older of the two commands is still in force.
    remainder: u32,
}

impl DeadTime {
    fn new(dead_time_ms: f64, sub_steps: u32) -> Self {
        let total = round(dead_time_ms * f64::from(sub_steps)) as u32;
        let whole_steps = (total / sub_steps) as usize;
        let ring = core::iter::repeat_n(0.0, whole_steps.min(MOST_DELAY) + 2).collect();
        Self { ring, newest: 0, due: [0.0; 2], remainder: total % sub_steps }
    }

    fn push(&mut self, command: f64) {
        // The ring is two steps longer than the dead time: the entry after the newest is due.
        let after = |place: usize| if place + 1 < self.ring.len() { place + 1 } else { 0 };
        self.newest = after(self.newest);
        let older = after(self.newest);
        let newer = after(older);
        self.ring[self.newest] = command;
        self.due = [self.ring[older], self.ring[newer]];
    }

    fn delayed(&self, sub_step: u32) -> f64 {
        self.due[usize::from(sub_step >= self.remainder)]
    }
}

/// Position of the stem after backlash, in percent. Opening, the actuator carries the stem; closing, the stem lags by
/// the backlash. Near the seat the closing spring takes up the backlash, so that no command means no flow.
fn follow_with_play(stem: f64, actuator: f64, play: f64) -> f64 {
    stem.max(actuator).min(actuator + play.min(actuator))
}

/// The valve and its state.
#[derive(Clone, Debug)]
pub(super) struct Valve {
    dead_time: DeadTime,
    actuator: Lag,
    /// Backlash, and that of a valve without a failure, percent.
    play: f64,
    sound_play: f64,
    stem: f64,
    characteristic: Characteristic,
    /// Flow through the stem where it is, as a share of the full flow.
    opening: f64,
    full_flow_l_s: f64,
    /// The same while there is a gas supply.
    supplied_flow_l_s: f64,
    supply: f64,
    /// Whether the stem is stuck.
    stuck: bool,
}

impl Valve {
    /// A closed valve with the unit's `dead_time_ms` and `gain` (on the flow).
    #[inline(never)]
    pub(super) fn new(
        config: &ValveConfig,
        dead_time_ms: f64,
        gain: f64,
        sub_steps: u32,
        sub_step_s: f64,
    ) -> Self {
        let full_flow_l_s = config.max_flow_l_per_s * gain;
        Self {
            dead_time: DeadTime::new(dead_time_ms, sub_steps),
            actuator: Lag::new(config.lag_ms * 1e-3, sub_step_s, 0.0),
            play: config.backlash_percent,
            sound_play: config.backlash_percent,
            stem: 0.0,
            characteristic: Characteristic::new(config.dead_zone_percent, config.curve_exponent),
            opening: 0.0,
            full_flow_l_s,
            supplied_flow_l_s: full_flow_l_s,
            supply: config.supply_pressure_cmh2o,
            stuck: false,
        }
    }

    /// Makes the stem stick at this percentage of its travel.
    pub(super) fn stick_at(&mut self, percent: f64) {
        (self.stem, self.stuck) = (percent, true);
    }

    /// Gives the stem this backlash, percent.
    pub(super) fn loosen(&mut self, percent: f64) {
        self.play = percent;
    }

    /// Leaves this share of the flow that the gas supply normally gives.
    pub(super) fn supply(&mut self, share: f64) {
        self.full_flow_l_s = share * self.supplied_flow_l_s;
    }

    /// Ends every failure: the stem follows the actuator as before, the supply is back.
    pub(super) fn repair(&mut self) {
        (self.stuck, self.play, self.full_flow_l_s) = (false, self.sound_play, self.supplied_flow_l_s);
    }

    /// Takes the command of a new step, in percent. A command outside the driver's range is limited; one that is not a
    /// number leaves the valve without current.
    pub(super) fn command(&mut self, u_in: f32) {
        let percent = if u_in.is_finite() { u_in.clamp(0.0, 100.0) } else { 0.0 };
        self.dead_time.push(f64::from(percent));
    }

    /// Moves actuator and stem by one sub-step.
    pub(super) fn advance(&mut self, sub_step: u32) {
        let actuator = self.actuator.advance(self.dead_time.delayed(sub_step));
        if !self.stuck {
            self.stem = follow_with_play(self.stem, actuator, self.play);
        }
        self.opening = self.characteristic.share(self.stem);
    }

    /// The valve as a branch towards its supply while the airway is at `pressure`: the flow falls with the
    /// square root of the pressure left across the valve.
    pub(super) fn branch(&self, pressure: f64) -> Branch {
        let free_flow = self.full_flow_l_s * self.opening;
        let drive = (self.supply - pressure).max(LEAST_DRIVE_CMH2O);
        Branch { conductance: free_flow / sqrt(self.supply * drive), source: self.supply }
    }

    /// The same behind a blower, whose own loss adds to that of the valve.
    pub(super) fn branch_behind(&self, blower: &Blower, pressure: f64) -> Branch {
        let free_flow = self.full_flow_l_s * self.opening;
        // Infinite for a closed valve: its conductance is then zero.
        let quadratic = self.supply / (free_flow * free_flow) + blower.drop();
        let source = blower.source();
        Branch {
            conductance: parabolic_conductance(LAMINAR_CMH2O_PER_L_S, quadratic, source - pressure),
            source,
        }
    }

    /// Travel of the stem in percent.
    pub(super) fn stem(&self) -> f64 {
        self.stem
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SUB_STEPS: u32 = 4;
    const SUB_STEP_S: f64 = 0.000_25;

    fn valve(config: &ValveConfig) -> Valve {
        Valve::new(config, config.dead_time_ms, 1.0, SUB_STEPS, SUB_STEP_S)
    }

    fn run(valve: &mut Valve, u_in: f32, steps: u32) {
        for _ in 0..steps {
            valve.command(u_in);
            for sub_step in 0..SUB_STEPS {
                valve.advance(sub_step);
            }
        }
    }

    fn settled_flow(config: &ValveConfig, u_in: f32, pressure: f64) -> f64 {
        let mut valve = valve(config);
        run(&mut valve, u_in, 1_000);
        valve.branch(pressure).flow(pressure)
    }

    #[test]
    fn dead_time_is_exact_to_the_step() {
        for dead_time_ms in [0_u32, 1, 12, 30] {
            let mut valve =
                valve(&ValveConfig { dead_time_ms: f64::from(dead_time_ms), ..ValveConfig::default() });
            run(&mut valve, 50.0, dead_time_ms);
            assert!(valve.stem() <= 0.0, "moved before {dead_time_ms} ms");
            run(&mut valve, 50.0, 1);
            assert!(valve.stem() > 0.0, "did not move after {dead_time_ms} ms");
        }
    }

    #[test]
    fn dead_time_resolves_sub_steps() {
        let config = ValveConfig { lag_ms: 0.0, dead_time_ms: 2.5, ..ValveConfig::default() };
        let mut valve = valve(&config);
        run(&mut valve, 50.0, 2);
        valve.command(50.0);
        let stems = [0, 1, 2, 3].map(|sub_step| {
            valve.advance(sub_step);
            valve.stem()
        });
        assert!(stems[1] <= 0.0 && stems[2] > 49.9, "{stems:?}");
    }

    #[test]
    fn a_short_pulse_passes_the_dead_time_whole() {
        let config = ValveConfig { lag_ms: 0.0, backlash_percent: 0.0, ..ValveConfig::default() };
        let mut valve = valve(&config);
        run(&mut valve, 50.0, 1);
        let mut open_ms = 0;
        for _ in 0..40 {
            run(&mut valve, 0.0, 1);
            open_ms += u32::from(valve.stem() > 0.0);
        }
        assert_eq!(open_ms, 1);
    }

    #[test]
    fn actuator_lags_with_its_time_constant() {
        let mut valve = valve(&ValveConfig::default());
        run(&mut valve, 60.0, 12 + 25);
        assert!((valve.stem() / 60.0 - (1.0 - (-1.0_f64).exp())).abs() < 1e-6);
    }

    #[test]
    fn play_shows_as_hysteresis_of_its_width() {
        let mut valve = valve(&ValveConfig::default());
        run(&mut valve, 40.0, 1_000);
        let opening = valve.stem();
        run(&mut valve, 80.0, 1_000);
        run(&mut valve, 40.0, 1_000);
        assert!((valve.stem() - opening - 4.0).abs() < 1e-6, "{opening} {}", valve.stem());
        // Within the backlash the stem does not move.
        run(&mut valve, 43.0, 1_000);
        assert!((valve.stem() - 44.0).abs() < 1e-6);
    }

    #[test]
    fn no_command_closes_the_valve_in_spite_of_the_play() {
        let config = ValveConfig { dead_zone_percent: 0.0, ..ValveConfig::default() };
        let mut valve = valve(&config);
        run(&mut valve, 80.0, 500);
        run(&mut valve, 0.0, 2_000);
        assert!(valve.branch(5.0).flow(5.0).abs() < 1e-12);
    }

    #[test]
    fn nothing_flows_within_the_dead_zone() {
        let config = ValveConfig::default();
        assert!(settled_flow(&config, 4.0, 0.0).abs() < 1e-12);
        assert!(settled_flow(&config, 5.0, 0.0) > 1e-3);
    }

    #[test]
    fn characteristic_follows_the_power_law_up_to_full_flow() {
        let config = ValveConfig::default();
        assert!((settled_flow(&config, 100.0, 0.0) - 1.67).abs() < 1e-9);
        for percent in [5.0_f32, 12.3, 31.0, 52.0, 77.7] {
            let expected = 1.67 * ((f64::from(percent) - 4.0) / 96.0).powf(1.3);
            let found = settled_flow(&config, percent, 0.0);
            assert!((found - expected).abs() < 2e-5, "{percent} %: {found} L/s, expected {expected}");
        }
    }

    #[test]
    fn flow_falls_with_back_pressure() {
        let config = ValveConfig::default();
        let free = settled_flow(&config, 50.0, 0.0);
        for pressure in [10.0, 35.0, 70.0] {
            let expected = free * (1.0 - pressure / config.supply_pressure_cmh2o).sqrt();
            assert!((settled_flow(&config, 50.0, pressure) - expected).abs() < 1e-9);
        }
    }

    #[test]
    fn commands_no_driver_can_output_are_limited_or_closed() {
        let config = ValveConfig::default();
        assert!((settled_flow(&config, 250.0, 0.0) - 1.67).abs() < 1e-9);
        for bad in [-20.0, f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            assert!(settled_flow(&config, bad, 0.0).abs() < 1e-12, "{bad}");
        }
    }
}
