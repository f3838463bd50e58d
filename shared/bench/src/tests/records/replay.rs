//! The bench under the commands of a record.

use super::breaths::Breath;
use crate::blower::Blower;
use crate::lag::Lag;
use crate::{Bench, BenchConfig, BlowerConfig, STEP_S};

/// Number of parameters.
pub(super) const COUNT: usize = 18;
/// Pressure at which the full flow of the valve is stated, cmH2O.
pub(super) const STATED_AT_CMH2O: f64 = 60.0;
/// Band of the patient valve, cmH2O: so wide that its opening hardly depends on how the pressure changes in a step.
const BAND_CMH2O: f64 = 20.0;

/// A parameter: its name, range and the value from which a fit starts.
pub(super) struct Parameter(pub(super) &'static str, pub(super) f64, pub(super) f64, pub(super) f64);

/// What is fitted. Backlash, leak and sag of the speed are zero: the records do not show them.
pub(super) const PARAMETERS: [Parameter; COUNT] = [
    Parameter("blower.shut_off_cmh2o", 20.0, 160.0, 60.0),
    Parameter("blower.drop_cmh2o_per_l2_s2", 0.0, 200.0, 20.0),
    Parameter("blower.exponent_of_pressure_over_speed", 0.5, 2.5, 1.0),
    Parameter("blower.speed_lag_ms", 20.0, 2000.0, 300.0),
    Parameter("valve.dead_time_ms", 0.0, 80.0, 24.0),
    Parameter("valve.lag_ms", 2.0, 100.0, 22.0),
    Parameter("valve.dead_zone_percent", 0.0, 50.0, 22.0),
    Parameter("valve.curve_exponent", 0.5, 4.0, 1.1),
    Parameter("valve.max_flow_l_per_s", 0.3, 5.0, 4.3),
    Parameter("lung.resistance_cmh2o_per_l_s", 0.5, 60.0, 8.0),
    Parameter("lung.turbulence_s_per_l", 0.0, 5.0, 2.0),
    Parameter("lung.compliance_ml_per_cmh2o", 5.0, 80.0, 20.0),
    Parameter("circuit.compliance_ml_per_cmh2o", 0.3, 5.0, 1.5),
    Parameter("expiratory.lag_ms", 2.0, 100.0, 50.0),
    Parameter("expiratory.dead_zone_percent", 0.0, 60.0, 20.0),
    Parameter("expiratory.curve_exponent", 0.5, 4.0, 0.6),
    Parameter("expiratory.orifice_l_per_s_per_sqrt_cmh2o", 0.05, 2.0, 0.25),
    Parameter("flow_sensor.lag_ms", 2.0, 100.0, 15.0),
];

/// Parameters of a machine and a lung, in the order of [`PARAMETERS`].
pub(super) type Values = [f64; COUNT];

/// Pressure and flow that the bench shows after each step, cmH2O and L/s.
pub(super) type Shown = Vec<(f64, f64)>;

/// The bench at the pressure with which a breath starts, inspiratory and patient valve closed, the blower at the speed set before it.
fn bench(values: &Values, breath: &Breath) -> Bench {
    let [
        shut_off,
        drop,
        exponent,
        speed_lag,
        dead_time,
        lag,
        dead_zone,
        curve,
        max_flow,
        resistance,
        turbulence,
        compliance,
        tubing,
        closing,
        _,
        _,
        orifice,
        _,
    ] = *values;
    let mut config = BenchConfig::default();
    config.valve.dead_time_ms = dead_time;
    config.valve.lag_ms = lag;
    config.valve.backlash_percent = 0.0;
    config.valve.dead_zone_percent = dead_zone;
    config.valve.curve_exponent = curve;
    config.valve.max_flow_l_per_s = max_flow;
    config.valve.supply_pressure_cmh2o = STATED_AT_CMH2O;
    config.expiratory.lag_ms = closing;
    config.expiratory.orifice_l_per_s_per_sqrt_cmh2o = orifice;
    config.expiratory.peep_band_cmh2o = Some(BAND_CMH2O);
    config.circuit.compliance_ml_per_cmh2o = tubing;
    config.circuit.leak_l_per_s_at_30_cmh2o = 0.0;
    config.lung.first.resistance_cmh2o_per_l_s = resistance;
    config.lung.first.turbulence_s_per_l = turbulence;
    config.lung.first.compliance_ml_per_cmh2o = compliance;
    let mut bench = Bench::new(&config, breath.start.max(0.0) as f32, 1).unwrap();
    let blower =
        BlowerConfig { drop_cmh2o_per_l2_s2: drop, sag_percent_per_l_per_s: 0.0, speed_lag_ms: speed_lag };
    let sub_step_s = STEP_S / f64::from(config.sub_steps);
    // Blower::new takes the present speed for the set one.
    bench.parts.blower =
        Some(Blower::new(&blower, shut_off * breath.speed_before.powf(exponent), sub_step_s));
    for _ in 0..10 * closing as usize * config.sub_steps as usize {
        bench.parts.expiratory.advance(false, breath.start);
    }
    bench
}

/// What the bench shows in so many steps of a breath.
pub(super) fn replay(values: &Values, breath: &Breath, steps: usize) -> Shown {
    let [_, _, exponent, _, .., dead_zone, curve, _, flow_lag] = *values;
    let mut bench = bench(values, breath);
    let mut sensor = Lag::new(flow_lag * 1e-3, STEP_S, 0.0);
    let mut commands = breath.commands.iter().peekable();
    let (mut u_in, mut opening) = (0.0, 0.0);
    let mut shown = Vec::with_capacity(steps);
    for step in 0..steps {
        while let Some(command) = commands.next_if(|command| command.from <= step) {
            u_in = command.u_in as f32;
            let beyond = (command.u_out - dead_zone) / (100.0 - dead_zone);
            opening = if beyond > 0.0 { beyond.powf(curve) } else { 0.0 };
            let speed = (command.speed / breath.speed_before).powf(exponent / 2.0);
            bench.parts.blower.as_mut().unwrap().set_speed(speed);
        }
        // With this PEEP the valve opens as the record says.
        let pressure = bench.airway_pressure();
        bench.parts.expiratory.set_peep(pressure + BAND_CMH2O * (1.0 - opening));
        bench.step(u_in, opening > 0.0);
        let flow = sensor.advance(bench.truth().flow_valve);
        shown.push((bench.airway_pressure(), flow));
    }
    shown
}
