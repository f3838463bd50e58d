//! Resistance and compliance of a lung, from the commands and pressures of one inspiration.
//!
//! There is no flow sensor in the loop, so the flow is that of the nominal valve under the commands. With `V` the gas that has entered
//! the lung and `dp` the pressure above that at the start, a lung of one compartment obeys `V + R C dV/dt = C dp`. Integrated over
//! time it needs no derivative of a noisy signal: `int V = -R C V + C int dp`, which is linear in `R C` and `C`.
//!
//! A valve that gives more flow than the nominal one makes C too small and R too large by the same factor. A feed-forward that inverts
//! the same nominal valve cancels that error.

use engine::least_squares;
use shared::breath::period_s;

use super::lung::Lung;
use super::machine::{Machine, ModelValve};

/// Allowed resistances and compliances: those of any patient, with a wide margin.
const RESISTANCES: (f32, f32) = (1.0, 500.0);
const COMPLIANCES: (f32, f32) = (0.2, 200.0);
/// Distance between the rows of the fit, ticks.
const EVERY: usize = 5;
/// Largest number of rows.
const MOST_ROWS: usize = 2000;

/// The rows of a fit over a running inspiration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LungFit {
    valve: ModelValve,
    start: Option<f32>,
    ticks: usize,
    /// Gas through the valve, mL.
    delivered: f64,
    /// Integrals of the lung's volume in mL s and of the pressure in cmH2O s.
    volume_time: f64,
    pressure_time: f64,
    rows: Vec<[f64; 2]>,
    values: Vec<f64>,
}

impl LungFit {
    /// The start of an inspiration, with the valve closed.
    pub fn begun(machine: &Machine, period_us: u32) -> Self {
        Self { valve: ModelValve::closed(machine, period_us), ..Self::default() }
    }

    /// Adds a tick: the pressure at its start, cmH2O, and the command, percent.
    pub fn add(&mut self, machine: &Machine, period_us: u32, pressure: f32, command: f32) {
        let period = f64::from(period_s(period_us));
        let above = f64::from(pressure - *self.start.get_or_insert(pressure));
        let volume = self.delivered - f64::from(machine.circuit) * above;
        self.volume_time += volume * period;
        self.pressure_time += above * period;
        if self.ticks.is_multiple_of(EVERY) && self.rows.len() < MOST_ROWS {
            self.rows.push([-volume, self.pressure_time]);
            self.values.push(self.volume_time);
        }
        self.ticks += 1;
        let flow = self.valve.advance(machine, period_us, command, pressure);
        self.delivered += 1e3 * f64::from(flow) * period;
    }

    /// The lung; none if the inspiration does not tell one.
    pub fn lung(&self) -> Option<Lung> {
        let [time_constant, compliance] = least_squares::solve(&self.rows, &self.values)?.coefficients;
        let resistance = 1e3 * time_constant / compliance;
        let within =
            |value: f64, (least, most): (f32, f32)| (value > 0.0).then(|| (value as f32).clamp(least, most));
        Some(Lung {
            resistance: within(resistance, RESISTANCES)?,
            compliance: within(compliance, COMPLIANCES)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::bench::{Bench, BenchConfig};
    use shared::breath::DEFAULT_PERIOD_US;

    /// The lung fitted to 0.8 s on a bench: 0.5 s of filling, then a lower command.
    fn fitted(bench: &BenchConfig) -> Option<Lung> {
        let machine = Machine::of(bench);
        let mut running = Bench::new(bench, 5.0, 1).unwrap();
        let mut fit = LungFit::begun(&machine, DEFAULT_PERIOD_US);
        let mut pressure = 5.0;
        for tick in 0..800 {
            let command = if tick < 500 { 35.0 } else { 12.0 };
            fit.add(&machine, DEFAULT_PERIOD_US, pressure, command);
            pressure = running.step(command, false);
        }
        fit.lung()
    }

    #[test]
    fn the_lung_of_a_nominal_machine_is_found() {
        for (r, c) in [(5.0_f32, 50.0_f32), (20.0, 20.0), (50.0, 10.0)] {
            let lung = fitted(&BenchConfig::paper(r.into(), c.into())).unwrap();
            assert!((lung.compliance / c - 1.0).abs() < 0.15, "R {r} C {c}: {lung:?}");
            assert!((lung.resistance - r).abs() < 0.2 * r + 2.0, "R {r} C {c}: {lung:?}");
        }
    }

    #[test]
    fn an_inspiration_without_flow_or_with_a_pressure_that_is_no_number_tells_no_lung() {
        let machine = Machine::of(&BenchConfig::default());
        for pressure in [5.0, f32::NAN] {
            let mut fit = LungFit::begun(&machine, DEFAULT_PERIOD_US);
            (0..500).for_each(|_| fit.add(&machine, DEFAULT_PERIOD_US, pressure, 0.0));
            assert_eq!(fit.lung(), None);
        }
    }

    #[test]
    fn an_estimate_moves_part_of_the_way() {
        let lung = |resistance, compliance| Lung { resistance, compliance };
        assert_eq!(lung(10.0, 40.0).towards(lung(20.0, 20.0), 0.5), lung(15.0, 30.0));
    }
}
