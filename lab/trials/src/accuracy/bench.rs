//! Accuracy of the pressure on the bench: true airway pressure at the end of inspiration and expiration, with and without a leak.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use shared::breath::{PAPER_PIPS, Phase, paper_settings};
use shared::control::ControlLaw;
use shared::settings::{LEAST_RISE, Settings};

use super::{Accuracy, Measured};
use plant::bench::BenchConfig;
use progress::{Progress, Stage, Task};
use ventilator::{BenchSource, SourceError, Tick};

/// Measuring the accuracy of the pressure: plants.
pub const ACCURACY: Stage = Stage("measure accuracy, plants");

/// Leak of the measurements with a leak, L/s at 30 cmH2O: the largest of the adult family.
pub const LEAK_L_PER_S: f64 = 0.1;
/// PEEP settings, cmH2O.
const PEEPS: [f32; 2] = [5.0, 10.0];
/// Breaths before the measured one: by then the ventilator compensates for the leak.
const WARM_UP: usize = 5;
/// Time at the end of a phase over which the pressure is averaged, s.
const MEAN_OVER_S: f32 = 0.05;

/// Measurements of one phase's end, over all settings and plants.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PhaseEnd {
    /// PIP and true pressure at the end of the inspiration, cmH2O.
    pub inspiration: Vec<Measured>,
    /// PEEP and true pressure at the end of the expiration, cmH2O.
    pub expiration: Vec<Measured>,
}

/// Noise and control period of a measurement.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Setup {
    /// Control period, microseconds.
    pub period_us: u32,
    /// Seed of the sensor noise.
    pub seed: u64,
}

/// Measures a controller on a bench at the paper's PIPs and two PEEPs, without a leak or with one of 0.1 L/s at 30 cmH2O. The
/// ventilator runs with all its monitors.
///
/// # Errors
/// A bench that cannot be built, or a fault of the ventilator.
pub fn measure<C: ControlLaw + Clone>(
    bench: &BenchConfig,
    controller: &C,
    leak: bool,
    setup: Setup,
) -> Result<PhaseEnd, SourceError> {
    let mut bench = bench.clone();
    bench.circuit.leak_l_per_s_at_30_cmh2o = if leak { LEAK_L_PER_S } else { 0.0 };
    let mut ends = PhaseEnd::default();
    for peep in PEEPS {
        for pip in PAPER_PIPS.into_iter().filter(|pip| *pip >= peep + LEAST_RISE) {
            let settings = Settings { peep, ..paper_settings(pip) };
            let mut source =
                BenchSource::new(&bench, controller.clone(), &settings, setup.period_us, setup.seed)?;
            for _ in 0..WARM_UP {
                source.breathe(&settings, &mut |_| ())?;
            }
            let (mut inspiration, mut expiration) = (Vec::new(), Vec::new());
            source.breathe(&settings, &mut |tick: &Tick| {
                let pressure = tick.truth.map_or(f64::NAN, |truth| f64::from(truth.airway_pressure));
                match tick.sample.phase {
                    Phase::Inspiration => inspiration.push(pressure),
                    Phase::Fall | Phase::Expiration => expiration.push(pressure),
                }
            })?;
            let last = shared::math::ticks(MEAN_OVER_S, setup.period_us).max(1) as usize;
            ends.inspiration
                .push(Measured { target: f64::from(pip), value: mean_of_last(&inspiration, last) });
            ends.expiration
                .push(Measured { target: f64::from(peep), value: mean_of_last(&expiration, last) });
        }
    }
    Ok(ends)
}

/// The accuracy of a controller over several benches at one phase's end.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Declared {
    /// The phase.
    pub phase: &'static str,
    /// Whether the circuit leaks.
    pub leak: bool,
    /// Number of benches measured; on the others the ventilator stopped.
    pub plants: usize,
    /// The accuracy; none without a measurement.
    pub accuracy: Option<Accuracy>,
}

/// The accuracy of a controller over several benches, by leak and phase. Benches on which the ventilator stops, and those that are left
/// when it is stopped, do not count.
///
/// # Errors
/// A bench that cannot be built.
pub fn declared<C: ControlLaw + Clone + Sync>(
    benches: &[BenchConfig],
    controller: &C,
    setup: Setup,
    progress: &Progress<'_>,
) -> Result<Vec<Declared>, SourceError> {
    let task = progress.task(ACCURACY, 2 * benches.len());
    let mut declared = Vec::new();
    for leak in [false, true] {
        let ends = measure_all(benches, controller, leak, setup, &task)?;
        let mut declare = |phase, of: fn(&PhaseEnd) -> &Vec<Measured>| {
            let measured: Vec<_> = ends.iter().flat_map(of).copied().collect();
            let accuracy = Accuracy::declared(&measured);
            declared.push(Declared { phase, leak, plants: ends.len(), accuracy });
        };
        declare("inspiration", |end| &end.inspiration);
        declare("expiration", |end| &end.expiration);
    }
    Ok(declared)
}

/// Measures a controller on several benches, on all threads. Benches on which the ventilator stops are left out, and so are those that
/// are not measured when the task is stopped.
fn measure_all<C: ControlLaw + Clone + Sync>(
    benches: &[BenchConfig],
    controller: &C,
    leak: bool,
    setup: Setup,
    task: &Task<'_>,
) -> Result<Vec<PhaseEnd>, SourceError> {
    let measured = |bench: &BenchConfig| {
        if task.stopped() {
            return Ok(None);
        }
        let ends = match measure(bench, controller, leak, setup) {
            Err(SourceError::Fault { .. }) => None,
            ends => Some(ends?),
        };
        task.advance(1);
        Ok(ends)
    };
    let ends: Result<Vec<_>, SourceError> = benches.par_iter().map(measured).collect();
    Ok(ends?.into_iter().flatten().collect())
}

/// Mean of the last values; NaN without any.
fn mean_of_last(values: &[f64], last: usize) -> f64 {
    let end = &values[values.len().saturating_sub(last)..];
    end.iter().sum::<f64>() / end.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::control::Controller;
    use shared::control::pid::{Pid, PidGains};

    #[test]
    fn the_end_of_both_phases_is_measured_at_every_setting_and_a_leak_shows() {
        let pid = Controller::Pid(Pid::new(PidGains { p: 3.0, i: 60.0, d: 0.0 }, 1000).unwrap());
        let setup = Setup { period_us: 1000, seed: 1 };
        let ends = |leak| measure(&BenchConfig::paper(20.0, 20.0), &pid, leak, setup).unwrap();
        let (tight, leaking) = (ends(false), ends(true));
        assert_eq!((tight.inspiration.len(), tight.expiration.len()), (11, 11), "no PIP of 10 at PEEP 10");
        for end in [&tight, &leaking] {
            let inspiration = Accuracy::declared(&end.inspiration).unwrap();
            let expiration = Accuracy::declared(&end.expiration).unwrap();
            assert!(
                inspiration.at(35.0) < 1.0 && expiration.at(10.0) < 1.0,
                "{inspiration:?} {expiration:?}"
            );
        }
        assert_ne!(tight, leaking);
    }

    #[test]
    fn the_mean_is_taken_over_the_last_values() {
        assert!((mean_of_last(&[9.0, 9.0, 1.0, 2.0], 2) - 1.5).abs() < 1e-12);
        assert!((mean_of_last(&[3.0], 2) - 3.0).abs() < 1e-12);
        assert!(mean_of_last(&[], 2).is_nan());
    }
}
