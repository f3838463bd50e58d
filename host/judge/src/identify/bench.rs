//! A bench made from a lung that was identified, so that a real lung can be trained on.

use super::{BehindCircuit, Identified};
use data::recording::Recording;
use data::recording::quality;
use plant::bench::{BenchConfig, BenchError};

/// Least compliance of a bench's circuit, mL/cmH2O.
const LEAST_CIRCUIT: f64 = 0.1;
/// Most `k` of a bench's parabolic resistor `R q (1 + k |q|)`, s/L.
const MOST_TURBULENCE: f64 = 5.0;
/// Pressures with less noise than this, cmH2O, come from no sensor but from somebody's model; the bench keeps its own sensor.
const LEAST_NOISE: f64 = 0.02;
/// Rows over which quantum and noise of the pressure are estimated.
const ROWS: usize = 200_000;

/// The bench with this lung and circuit, and with the noise and quantum of the recording's pressure.
///
/// Valves and everything else that the equation of motion says nothing about stay at the defaults.
///
/// # Errors
/// A value that no bench can have.
pub fn bench(lung: &Identified, recording: &Recording) -> Result<BenchConfig, BenchError> {
    let behind = &lung.behind_circuit;
    let mut bench = BenchConfig { name: lung.id.to_string(), ..BenchConfig::default() };
    let (resistance, turbulence) = resistor(behind);
    bench.lung.first.resistance_cmh2o_per_l_s = resistance;
    bench.lung.first.turbulence_s_per_l = turbulence;
    bench.lung.first.compliance_ml_per_cmh2o = behind.compliance.value;
    bench.circuit.compliance_ml_per_cmh2o = behind.circuit_compliance.max(LEAST_CIRCUIT);
    let pressure = &recording.pressure[..recording.len().min(ROWS)];
    let noise = quality::noise(pressure);
    if noise >= LEAST_NOISE {
        bench.sensor.noise_sd_cmh2o = noise;
        bench.sensor.quantum_cmh2o = quality::quantum(pressure);
    }
    bench.validate()?;
    Ok(bench)
}

/// `R` and `k` with the pressure drop that was measured at the flow of the inspirations. Where `k` would leave what a
/// resistor can be, the nearest one takes its place and R makes up for it.
fn resistor(behind: &BehindCircuit) -> (f64, f64) {
    let (linear, square) = (behind.resistance.value, behind.turbulence.value);
    let turbulence = if linear > 0.0 { square / linear } else { MOST_TURBULENCE };
    if linear > 0.0 && (0.0..=MOST_TURBULENCE).contains(&turbulence) {
        return (linear, turbulence);
    }
    let turbulence = turbulence.clamp(0.0, MOST_TURBULENCE);
    let flow = behind.inspiratory_flow;
    ((linear + square * flow) / (1.0 + turbulence * flow), turbulence)
}

/// The bench as TOML, with what in it was measured and how surely.
pub fn to_toml(bench: &BenchConfig, lung: &Identified) -> String {
    let behind = &lung.behind_circuit;
    let estimate = |e: &super::Estimate| format!("{:.2} ({:.2} to {:.2})", e.value, e.low, e.high);
    format!(
        "# LungCycles {} as `trainer identify` found it in {} breaths; estimates with their 95 % intervals.\n\
         # C {} mL/cmH2O, R {} cmH2O/(L/s), R2 {} cmH2O/(L/s)^2, residual {:.2} cmH2O.\n\
         # Measured: [lung.first] but for its inflection, the circuit's compliance, the sensor's noise and quantum.\n\
         # Everything else is the default of the virtual bench.\n\n{}",
        lung.id,
        lung.breaths,
        estimate(&behind.compliance),
        estimate(&behind.resistance),
        estimate(&behind.turbulence),
        behind.residual,
        bench.to_toml(),
    )
}

#[cfg(test)]
mod tests {
    use super::super::Estimate;
    use super::*;

    fn behind(resistance: f64, turbulence: f64) -> BehindCircuit {
        let exact = |value| Estimate { value, low: value, high: value };
        BehindCircuit {
            circuit_compliance: 1.0,
            compliance: exact(20.0),
            resistance: exact(resistance),
            turbulence: exact(turbulence),
            residual: 0.5,
            inspiratory_flow: 0.4,
        }
    }

    #[test]
    fn a_resistor_drops_what_was_measured_at_the_flow_of_the_inspirations() {
        for (linear, square) in [(20.0, 10.0), (12.0, 53.2), (2.0, 53.0), (30.0, -9.0), (-1.0, 40.0)] {
            let (resistance, turbulence) = resistor(&behind(linear, square));
            let drop = resistance * 0.4 * (1.0 + turbulence * 0.4);
            assert!((drop - (linear * 0.4 + square * 0.16)).abs() < 1e-9, "{linear} {square}");
            assert!((0.0..=MOST_TURBULENCE).contains(&turbulence));
        }
    }
}
