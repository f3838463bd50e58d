//! A bench description made from an identified lung, to train on a model of a real lung.

use super::{BehindCircuit, Identified};
use data::recording::Recording;
use data::recording::quality;
use plant::bench::{BenchConfig, BenchError};

/// Lowest compliance of a bench's circuit, mL/cmH2O.
const LEAST_CIRCUIT: f64 = 0.1;
/// Highest `k` of a bench's parabolic resistor `R q (1 + k |q|)`, s/L.
const MOST_TURBULENCE: f64 = 5.0;
/// Pressures with less noise than this, cmH2O, come from a model, not from a sensor; the bench keeps its own sensor.
const LEAST_NOISE: f64 = 0.02;
/// Number of rows used to estimate quantum and noise of the pressure.
const ROWS: usize = 200_000;

/// The bench with this lung and circuit, and with the noise and quantum of the recording's pressure.
///
/// Valves, and everything else that the equation of motion does not determine, stay at the defaults.
///
/// # Errors
/// A value outside the bench's limits.
pub fn bench(lung: &Identified, recording: &Recording) -> Result<BenchConfig, BenchError> {
    let behind = &lung.behind_circuit;
    let mut bench = BenchConfig { name: lung.id.to_string(), ..BenchConfig::default() };
    let (resistance, turbulence) = resistor(behind);
    bench.lung.first.resistance_cmh2o_per_l_s = resistance;
    bench.lung.first.turbulence_s_per_l = turbulence;
    bench.lung.first.compliance_ml_per_cmh2o = behind.compliance.value;
    bench.circuit.compliance_ml_per_cmh2o = behind.circuit_compliance.max(LEAST_CIRCUIT);
    if lung.taken_out.leak > 0.0 {
        bench.circuit.leak_l_per_s_at_30_cmh2o = (30.0 * lung.taken_out.leak / 1000.0).min(1.0);
    }
    let pressure = &recording.pressure[..recording.len().min(ROWS)];
    let noise = quality::noise(pressure);
    if noise >= LEAST_NOISE {
        bench.sensor.noise_sd_cmh2o = noise;
        bench.sensor.quantum_cmh2o = quality::quantum(pressure);
    }
    bench.validate()?;
    Ok(bench)
}

/// `R` and `k` with the measured pressure drop at the flow of the inspirations. If `k` is outside a resistor's limits,
/// the nearest allowed value is used and R compensates for it.
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

/// The bench as TOML, with comments on the measured values and their intervals.
pub fn to_toml(bench: &BenchConfig, lung: &Identified) -> String {
    let behind = &lung.behind_circuit;
    let estimate = |e: &super::Estimate| format!("{:.2} ({:.2} to {:.2})", e.value, e.low, e.high);
    let remarks: Vec<_> = lung.remarks.iter().map(|remark| format!("# Beware: {remark}.\n")).collect();
    let remarks = remarks.concat();
    format!(
        "{remarks}# Lung {}, identified by `trainer identify` from {} breaths; estimates with their 95 % intervals.\n\
         # C {} mL/cmH2O, R {} cmH2O/(L/s), R2 {} cmH2O/(L/s)^2, residual {:.2} cmH2O.\n\
         # Measured: [lung.first] except its inflection, the circuit's compliance, the sensor's noise and quantum.\n\
         # All other values are the defaults of the virtual bench.\n\n{}",
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
