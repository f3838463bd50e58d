//! A lung with a circuit, computed from additions, multiplications and comparisons of f32 only, whose results IEEE 754
//! defines to the last bit.
//!
//! The virtual bench of the host side is a better model, but it uses powers and roots that differ between platforms, so
//! the hashes of its traces differ too. This lung is the simplest one that is still a task for a controller:
//!
//! ```text
//! valve:    x' = (u_in / 100 - x) / tau                 opening, follows its command
//! circuit:  p' = (q_max x - (p - p_lung) / R - q_out) / C_circuit
//! lung:     p_lung' = (p - p_lung) / (R C)
//! outlet:   q_out = (p - PEEP) / R_out, only while open and above PEEP
//! ```

/// Time step, s.
const STEP: f32 = 0.001;
/// Fraction of the way to its command that the valve moves per step: a lag of 25 ms.
const VALVE_STEP: f32 = STEP * 40.0;
/// Flow of the fully open valve, L/s.
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
    /// A lung at rest at a PEEP in cmH2O.
    pub fn new(peep: f32) -> Self {
        Self { opening: 0.0, pressure: peep, lung_pressure: peep, peep }
    }

    /// Sets the mechanical PEEP valve, cmH2O.
    pub fn set_peep(&mut self, peep: f32) {
        self.peep = peep;
    }

    /// Airway pressure, cmH2O.
    pub fn pressure(&self) -> f32 {
        self.pressure
    }

    /// Simulates 1 ms with the inspiratory valve at `u_in` percent and the expiratory valve open (`u_out`) or closed.
    pub fn step(&mut self, u_in: f32, u_out: bool) {
        self.opening += VALVE_STEP * (u_in * 0.01 - self.opening);
        let into_lung = AIRWAY * (self.pressure - self.lung_pressure);
        let above_peep = self.pressure - self.peep;
        let out = if u_out && above_peep > 0.0 { OUTLET * above_peep } else { 0.0 };
        self.pressure += STEP * CIRCUIT_ELASTANCE * (FLOW_MAX * self.opening - into_lung - out);
        self.lung_pressure += STEP * LUNG_ELASTANCE * into_lung;
    }
}
