//! The running bench.

mod failure;
mod faults;

use faults::Faults;

use crate::blower::Blower;
use crate::branch::Junction;
use crate::circuit::Circuit;
use crate::config::{self, BenchConfig, BenchError, PEEP_RANGE_CMH2O, Signal};
use crate::expiratory::Expiratory;
use crate::flow_sensor::FlowSensor;
use crate::lung::Lung;
use crate::outlet_sensor::OutletSensor;
use crate::patient::Patient;
use crate::random::stream;
use crate::sensor::Sensor;
use crate::step::{STEP_S, STEP_US};
use crate::unit::Unit;
use crate::valve::Valve;

/// `ChaCha` stream of the outlet sensor's noise. That of the airway sensor is 0.
const OUTLET_STREAM: u64 = 4;
/// `ChaCha` stream of the flow sensor's noise.
const FLOW_STREAM: u64 = 5;

/// Number of bench steps in a control period of `period_us` microseconds.
///
/// # Errors
/// [`BenchError::Period`] for a period that is not a multiple of [`STEP_US`].
pub fn steps_per_period(period_us: u32) -> Result<u32, BenchError> {
    if period_us == 0 || !period_us.is_multiple_of(STEP_US) {
        return Err(BenchError::Period { period_us });
    }
    Ok(period_us / STEP_US)
}

/// The PEEP setting limited by the valve's end stops, cmH2O.
pub fn end_stops(peep: f32) -> f64 {
    f64::from(peep).clamp(*PEEP_RANGE_CMH2O.start(), *PEEP_RANGE_CMH2O.end())
}

/// The PEEP, cmH2O, of a bench that can be built.
fn valid(config: &BenchConfig, peep: f32) -> Result<f64, BenchError> {
    config.validate()?;
    config::check("peep", f64::from(peep), PEEP_RANGE_CMH2O)?;
    Ok(f64::from(peep))
}

/// The true state. Pressures, volume and positions are those at the end of the step; flows are means over it, so that
/// flow times duration is the volume moved.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Truth {
    /// Pressure at the airway opening, cmH2O.
    pub airway_pressure: f64,
    /// Pressure after the sensor's lag, before offset, noise and quantum, cmH2O.
    pub sensor_pressure: f64,
    /// Pressure in the lung, cmH2O; with two compartments, the mean weighted by compliance.
    pub alveolar_pressure: f64,
    /// Pressure of the respiratory muscles, cmH2O; positive draws gas in.
    pub muscle_pressure: f64,
    /// Flow through the inspiratory valve, L/s.
    pub flow_valve: f64,
    /// Flow into the lung, L/s.
    pub flow_lung: f64,
    /// Flow out through the expiratory valve, L/s.
    pub flow_expiratory: f64,
    /// Flow out through the leak, L/s.
    pub flow_leak: f64,
    /// Flow out through the relief valve, L/s.
    pub flow_relief: f64,
    /// Gas in the lung above its volume at rest, mL.
    pub lung_volume_ml: f64,
    /// Stem of the inspiratory valve, percent of its travel.
    pub valve_position: f64,
    /// Opening of the expiratory valve, 0 to 1.
    pub expiratory_opening: f64,
    /// Breaths started so far; one starts when `u_out` goes from true to false.
    pub breath: u32,
    /// When the patient's last effort began, s; `None` before the first.
    pub effort_started_s: Option<f64>,
    /// Efforts of the patient begun so far.
    pub efforts: u32,
}

/// The part of the true state that recordings store. NaN marks values that a plant does not report.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickTruth {
    /// Pressure at the airway, cmH2O.
    pub airway_pressure: f32,
    /// Pressure behind the sensor's lag, before noise and quantum, cmH2O.
    pub sensor_pressure: f32,
    /// Gas in the lung above its volume at rest, mL.
    pub lung_volume: f32,
}

/// A running bench.
#[derive(Clone, Debug)]
pub struct Bench {
    pub(crate) parts: Parts,
    // Apart from the other parts, since a start replaces one after another: on a chip they are most of a bench.
    valve: Valve,
    faults: Faults,
}

/// What a start replaces at once.
#[derive(Clone, Debug)]
pub(crate) struct Parts {
    sub_steps: u32,
    /// Share of a sub-step in a step.
    share: f64,
    steps: u64,
    unit: Unit,
    pub(crate) blower: Option<Blower>,
    pub(crate) expiratory: Expiratory,
    pub(crate) circuit: Circuit,
    lung: Lung,
    sensor: Sensor,
    outlet: Option<OutletSensor>,
    flow: Option<FlowSensor>,
    patient: Patient,
    flows: Flows,
}

/// Flows of one step, in L/s, summed over the sub-steps.
#[derive(Clone, Copy, Debug, Default)]
struct Flows {
    valve: f64,
    lung: f64,
    expiratory: f64,
    leak: f64,
    relief: f64,
}

/// Duration of a sub-step, s.
fn sub_step_s(config: &BenchConfig) -> f64 {
    STEP_S / f64::from(config.sub_steps)
}

/// The closed inspiratory valve of the unit.
fn valve(config: &BenchConfig) -> Valve {
    let unit = Unit::draw(&config.unit, STEP_S);
    let dead_time_ms = (config.valve.dead_time_ms + unit.dead_time_ms).max(0.0);
    Valve::new(&config.valve, dead_time_ms, unit.flow_gain, config.sub_steps, sub_step_s(config))
}

impl Parts {
    /// The parts of a valid bench at rest at `peep` cmH2O. Neither this nor the parts' own functions are inlined: each part is built in
    /// its place.
    #[inline(never)]
    fn new(config: &BenchConfig, peep: f64, seed: u64) -> Self {
        let sub_step_s = sub_step_s(config);
        let noise = stream(seed, 0);
        Self {
            sub_steps: config.sub_steps,
            share: 1.0 / f64::from(config.sub_steps),
            steps: 0,
            unit: Unit::draw(&config.unit, STEP_S),
            blower: config
                .blower
                .as_ref()
                .map(|blower| Blower::new(blower, config.valve.supply_pressure_cmh2o, sub_step_s)),
            expiratory: Expiratory::new(&config.expiratory, peep, sub_step_s),
            circuit: Circuit::new(&config.circuit, peep, sub_step_s),
            lung: Lung::new(&config.lung, peep, sub_step_s),
            sensor: Sensor::new(&config.sensor, peep, sub_step_s, noise),
            outlet: OutletSensor::new(&config.outlet_sensor, peep, stream(seed, OUTLET_STREAM)),
            flow: FlowSensor::new(&config.flow_sensor, stream(seed, FLOW_STREAM)),
            patient: Patient::new(config.patient, seed),
            flows: Flows::default(),
        }
    }
}

impl Bench {
    /// A bench at rest at `peep` cmH2O, expiratory valve open, inspiratory valve closed. The same `config`, `peep`,
    /// `seed` (of the sensors' noise and the patient's irregularity) and commands give the same bits on every platform.
    ///
    /// # Errors
    /// As in [`BenchConfig::validate`], and [`BenchError::OutOfRange`] for `peep` outside [`PEEP_RANGE_CMH2O`].
    pub fn new(config: &BenchConfig, peep: f32, seed: u64) -> Result<Self, BenchError> {
        let peep = valid(config, peep)?;
        Ok(Self::of_valid(config, peep, seed))
    }

    /// Not inlined, and apart from the errors: it is built in the caller's place.
    #[inline(never)]
    fn of_valid(config: &BenchConfig, peep: f64, seed: u64) -> Self {
        Self {
            parts: Parts::new(config, peep, seed),
            valve: valve(config),
            faults: Faults::new(&config.faults, seed),
        }
    }

    /// Makes it the bench that [`Bench::new`] gives, in its place: on a chip a second one would take most of the stack.
    ///
    /// # Errors
    /// As in [`Bench::new`]; the bench then runs on as it was.
    pub fn restart(&mut self, config: &BenchConfig, peep: f32, seed: u64) -> Result<(), BenchError> {
        let peep = valid(config, peep)?;
        self.replace_parts(config, peep, seed);
        self.replace_valve(config);
        self.faults.plan(&config.faults, seed);
        Ok(())
    }

    /// Not inlined, so that the new parts are on the stack only meanwhile.
    #[inline(never)]
    fn replace_parts(&mut self, config: &BenchConfig, peep: f64, seed: u64) {
        self.parts = Parts::new(config, peep, seed);
    }

    /// As [`Self::replace_parts`].
    #[inline(never)]
    fn replace_valve(&mut self, config: &BenchConfig) {
        self.valve = valve(config);
    }

    /// Turns the mechanical PEEP valve to `peep` cmH2O. Its end stops limit it to [`PEEP_RANGE_CMH2O`]; a value that is
    /// not a number leaves it unchanged.
    pub fn set_peep(&mut self, peep: f32) {
        if !peep.is_nan() {
            self.parts.expiratory.set_peep(end_stops(peep));
        }
    }

    /// The PEEP to which the mechanical valve was last turned, cmH2O.
    pub fn peep(&self) -> f32 {
        self.parts.expiratory.setting() as f32
    }

    /// Makes the patient cough now, with this peak pressure, cmH2O.
    pub fn cough(&mut self, peak: f64) {
        let now = self.time_s();
        self.parts.patient.cough(peak, now);
    }

    /// Changes the lung now: factors on its resistances and compliances. Its pressure stays.
    pub fn change_lung(&mut self, resistance: f64, compliance: f64) {
        self.parts.lung.change(resistance, compliance);
    }

    /// Draws this flow out of the circuit from now on, L/s, whatever the pressure: a plateau then needs an open valve for as long as
    /// a measurement takes. No sensor sees the flow.
    pub fn draw(&mut self, flow: f64) {
        self.parts.circuit.draw(flow);
    }

    /// Runs 1 ms with the inspiratory valve commanded to `u_in` percent and the expiratory valve open if `u_out`;
    /// returns the sensor's pressure at its end, cmH2O. A command outside 0 to 100 is limited; one that is not finite
    /// closes the valve.
    pub fn step(&mut self, u_in: f32, u_out: bool) -> f32 {
        if let Some((resistance_factor, compliance_factor)) = self.parts.patient.observe(u_out) {
            self.parts.lung.change(resistance_factor, compliance_factor);
        }
        let now = self.time_s();
        if !self.faults.are_none() {
            self.run_faults(now, u_out);
        }
        let muscle_pressure = self.parts.patient.muscle_pressure(now);
        self.parts.circuit.change_leak(now);
        if let Some(factor) = self.parts.patient.secretions(now) {
            self.parts.lung.set_secretions(factor);
        }
        self.valve.command(u_in);
        self.parts.flows = Flows::default();
        for sub_step in 0..self.parts.sub_steps {
            self.valve.advance(sub_step);
            self.parts.expiratory.advance(u_out, self.parts.circuit.pressure());
            self.move_gas(muscle_pressure);
            self.parts.sensor.advance(self.parts.circuit.pressure());
        }
        self.parts.steps += 1;
        self.parts.patient.advance(self.time_s());
        if let Some(outlet) = &mut self.parts.outlet {
            outlet.advance(self.parts.circuit.pressure(), self.parts.flows.valve * self.parts.share);
        }
        if let Some(sensor) = &mut self.parts.flow {
            sensor.advance((self.parts.flows.lung + self.parts.flows.leak) * self.parts.share);
        }
        let reading = self.parts.sensor.sample(self.parts.unit.offset_after(self.parts.steps));
        self.distorted(Signal::Airway, reading)
    }

    /// A sensor's reading, after the faults that are present.
    fn distorted(&mut self, signal: Signal, reading: f32) -> f32 {
        if self.faults.are_none() { reading } else { self.faults.reading(signal, reading, self.time_s()) }
    }

    /// The sample of the last step from the sensor at the machine's outlet, cmH2O; NaN if there is none. A bench that
    /// has not run yet has a sample too. Its noise is drawn only when it is asked for.
    pub fn outlet_reading(&mut self) -> f32 {
        let reading = self.parts.outlet.as_mut().map_or(f32::NAN, |outlet| outlet.sample(self.parts.steps));
        self.distorted(Signal::Outlet, reading)
    }

    /// The sample of the last step from the flow sensor at the airway opening, L/s, positive towards the patient; NaN
    /// if there is none. A bench that has not run yet has a sample too. Its noise is drawn only when it is asked for.
    pub fn flow_reading(&mut self) -> f32 {
        let reading = self.parts.flow.as_mut().map_or(f32::NAN, FlowSensor::sample);
        self.distorted(Signal::Flow, reading)
    }

    /// Moves the gas for one sub-step.
    fn move_gas(&mut self, muscle_pressure: f64) {
        let pressure = self.parts.circuit.pressure();
        let mut junction = Junction {
            storage: self.parts.circuit.storage(),
            valve: match &self.parts.blower {
                Some(blower) => self.valve.branch_behind(blower, pressure),
                None => self.valve.branch(pressure),
            },
            expiratory: self.parts.expiratory.branch(pressure),
            relief: self.parts.circuit.relief(),
            leak: self.parts.circuit.leak(),
            lung: self.parts.lung.branches(pressure, muscle_pressure),
        };
        let pressure = junction.solve();
        // Flow into the lung is flow out of the junction.
        let into_lung = junction.lung.map(|compartment| -compartment.flow(pressure));
        self.parts.circuit.set_pressure(pressure);
        self.parts.lung.advance(into_lung);
        if let Some(blower) = &mut self.parts.blower {
            blower.advance(junction.valve.flow(pressure));
        }
        self.parts.flows.valve += junction.valve.flow(pressure);
        self.parts.flows.lung += into_lung[0] + into_lung[1];
        self.parts.flows.expiratory -= junction.expiratory.flow(pressure);
        self.parts.flows.leak -= junction.leak.flow(pressure);
        self.parts.flows.relief -= junction.relief.flow(pressure);
    }

    /// The true state.
    pub fn truth(&self) -> Truth {
        let share = self.parts.share;
        let muscle_pressure = self.parts.patient.muscle_pressure(self.time_s());
        let (effort_started_s, efforts) = self.parts.patient.efforts(self.time_s());
        Truth {
            airway_pressure: self.parts.circuit.pressure(),
            sensor_pressure: self.parts.sensor.lagged(),
            alveolar_pressure: self.parts.lung.alveolar_pressure(muscle_pressure),
            muscle_pressure,
            flow_valve: self.parts.flows.valve * share,
            flow_lung: self.parts.flows.lung * share,
            flow_expiratory: self.parts.flows.expiratory * share,
            flow_leak: self.parts.flows.leak * share,
            flow_relief: self.parts.flows.relief * share,
            lung_volume_ml: self.parts.lung.volume_ml(),
            valve_position: self.valve.stem(),
            expiratory_opening: self.parts.expiratory.opening(),
            breath: self.parts.patient.breath(),
            effort_started_s,
            efforts,
        }
    }

    /// The part of the true state that recordings store.
    pub fn pressures(&self) -> TickTruth {
        TickTruth {
            airway_pressure: self.parts.circuit.pressure() as f32,
            sensor_pressure: self.parts.sensor.lagged() as f32,
            lung_volume: self.parts.lung.volume_ml() as f32,
        }
    }

    /// Airway pressure only, cmH2O, as in [`Bench::truth`].
    pub fn airway_pressure(&self) -> f64 {
        self.parts.circuit.pressure()
    }

    /// The present leak, L/s at 30 cmH2O; that of a failure if there is one.
    pub fn leak(&self) -> f64 {
        self.parts.circuit.stated_leak()
    }

    /// Time since the start, s.
    pub fn time_s(&self) -> f64 {
        self.parts.steps as f64 * STEP_S
    }
}
