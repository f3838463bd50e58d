//! A lung on a circuit in additions, multiplications and comparisons of f32, which IEEE 754 defines to the last bit.
//!
//! The virtual bench of `host` is the better model, but it uses powers and roots that differ between platforms, so
//! its traces have no hash that holds everywhere. This lung is as simple as one can be that still makes a controller
//! work:
//!
//! ```text
//! valve:    x' = (u_in / 100 - x) / tau                 opening, follows its command
//! circuit:  p' = (q_max x - (p - p_lung) / R - q_out) / C_circuit
//! lung:     p_lung' = (p - p_lung) / (R C)
//! outlet:   q_out = (p - PEEP) / R_out, only while open and above PEEP
//! ```

/// Step, s.
const STEP: f32 = 0.001;
/// Part of the way to its command that the valve goes in a step: a lag of 25 ms.
const VALVE_STEP: f32 = STEP * 40.0;
/// Flow of the open valve, L/s.
const FLOW_MAX: f32 = 1.2;
/// Conductance of the airway, L/s/cmH2O: a resistance of 20 cmH2O/(L/s).
const AIRWAY: f32 = 0.05;
/// Conductance of the outlet, L/s/cmH2O.
const OUTLET: f32 = 0.2;
/// Pressure of the circuit per volume, cmH2O/L: a compliance of 2 mL/cmH2O.
const CIRCUIT_ELASTANCE: f32 = 500.0;
/// Pressure of the lung per volume, cmH2O/L: a compliance of 20 mL/cmH2O.
const LUNG_ELASTANCE: f32 = 50.0;

/// The lung and its circuit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExactLung {
    opening: f32,
    pressure: f32,
    lung_pressure: f32,
    peep: f32,
}

impl ExactLung {
    /// At rest at a PEEP in cmH2O.
    pub fn new(peep: f32) -> Self {
        Self { opening: 0.0, pressure: peep, lung_pressure: peep, peep }
    }

    /// Turns the knob of the mechanical PEEP valve, cmH2O.
    pub fn set_peep(&mut self, peep: f32) {
        self.peep = peep;
    }

    /// Airway pressure, cmH2O.
    pub fn pressure(&self) -> f32 {
        self.pressure
    }

    /// One millisecond with the inspiratory valve at `u_in` percent, the expiratory valve open or not.
    pub fn step(&mut self, u_in: f32, u_out: bool) {
        self.opening += VALVE_STEP * (u_in * 0.01 - self.opening);
        let into_lung = AIRWAY * (self.pressure - self.lung_pressure);
        let above_peep = self.pressure - self.peep;
        let out = if u_out && above_peep > 0.0 { OUTLET * above_peep } else { 0.0 };
        self.pressure += STEP * CIRCUIT_ELASTANCE * (FLOW_MAX * self.opening - into_lung - out);
        self.lung_pressure += STEP * LUNG_ELASTANCE * into_lung;
    }
}
