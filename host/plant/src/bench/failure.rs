//! Failures of the bench's parts in the middle of a breath.

use serde::{Deserialize, Serialize};

use super::Bench;

/// Flow of an open end at 30 cmH2O, L/s: the tube is disconnected.
const OPEN_END_L_PER_S: f64 = 20.0;
/// Factor on the lung's resistance when the tube is occluded.
const OCCLUDED: f64 = 1e4;
/// Share of the expiratory flow that a clogged filter lets through.
const CLOGGED: f64 = 0.01;

/// A permanent failure of a part.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Failure {
    /// Occluded tube: no flow between machine and lung.
    TubeOccluded,
    /// Clogged expiratory filter: almost no flow.
    FilterClogged,
    /// Disconnected tube.
    Disconnected,
    /// A leak of this flow in L/s at 30 cmH2O.
    Leak(f64),
    /// The stem of the inspiratory valve is stuck at this percentage.
    InspiratoryValveStuck(f64),
    /// The stem of the inspiratory valve is stuck at this percentage, and the expiratory valve stays closed.
    BothValvesStuck(f64),
    /// The expiratory valve stays closed.
    ExpiratoryValveClosed,
    /// The PEEP valve is stuck at this pressure, cmH2O.
    PeepValveStuck(f64),
    /// The gas supply is lost.
    SupplyLost,
}

impl Bench {
    /// Makes a part fail.
    pub fn fail(&mut self, failure: Failure) {
        match failure {
            Failure::TubeOccluded => self.lung.change(OCCLUDED, 1.0),
            Failure::FilterClogged => self.expiratory.clog(CLOGGED),
            Failure::Disconnected => self.circuit.set_leak(OPEN_END_L_PER_S),
            Failure::Leak(flow) => self.circuit.set_leak(flow),
            Failure::InspiratoryValveStuck(percent) => self.valve.stick_at(percent),
            Failure::BothValvesStuck(percent) => {
                self.valve.stick_at(percent);
                self.expiratory.stay_closed();
            }
            Failure::ExpiratoryValveClosed => self.expiratory.stay_closed(),
            Failure::PeepValveStuck(peep) => self.expiratory.stick_at(peep),
            Failure::SupplyLost => self.valve.lose_supply(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::BenchConfig;

    /// Pressure after 1 s of inspiration at 20 %, then after 1 s of expiration, with a failure at the start.
    fn breathe(failure: Option<Failure>) -> (f64, f64) {
        let mut bench = Bench::new(&BenchConfig::paper(20.0, 20.0), 5.0, 1).unwrap();
        if let Some(failure) = failure {
            bench.fail(failure);
        }
        let mut run = |u_in: f32, u_out: bool| {
            for _ in 0..1000 {
                bench.step(u_in, u_out);
            }
            bench.airway_pressure()
        };
        (run(20.0, false), run(0.0, true))
    }

    #[test]
    fn every_failure_shows_in_the_pressures_as_it_must() {
        let (plateau, rest) = breathe(None);
        assert!((10.0..25.0).contains(&plateau) && (rest - 5.0).abs() < 0.5, "{plateau} {rest}");
        let with = |failure| breathe(Some(failure));
        assert!(with(Failure::TubeOccluded).0 > plateau + 15.0);
        assert!(with(Failure::FilterClogged).1 > rest + 3.0);
        assert!(with(Failure::Disconnected).0 < 2.0);
        assert!(with(Failure::Leak(0.5)).0 < plateau - 2.0);
        assert!(with(Failure::InspiratoryValveStuck(60.0)).0 > plateau + 10.0);
        assert!(with(Failure::InspiratoryValveStuck(0.0)).0 < 5.5);
        assert!(with(Failure::BothValvesStuck(80.0)).1 > 65.0);
        assert!(with(Failure::ExpiratoryValveClosed).1 > plateau - 5.0);
        assert!((with(Failure::PeepValveStuck(12.0)).1 - 12.0).abs() < 1.0);
        assert!(with(Failure::SupplyLost).0 < 5.5);
    }
}
