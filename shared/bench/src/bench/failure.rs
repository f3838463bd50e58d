//! Failures of the bench's parts in the middle of a breath.

use super::Bench;
use crate::config::Failure;

/// Flow of an open end at 30 cmH2O, L/s: the tube is disconnected.
const OPEN_END_L_PER_S: f64 = 20.0;
/// Factor on the lung's resistance when the tube is occluded.
const OCCLUDED: f64 = 1e4;
/// Share of the expiratory flow that a clogged filter lets through.
const CLOGGED: f64 = 0.01;

impl Bench {
    /// Makes a part fail.
    pub fn fail(&mut self, failure: Failure) {
        match failure {
            Failure::TubeOccluded => self.parts.lung.occlude(OCCLUDED),
            Failure::TubeNarrowed(factor) => self.parts.lung.occlude(factor),
            Failure::FilterClogged => self.parts.expiratory.clog(CLOGGED),
            Failure::FilterNarrowed(share) => self.parts.expiratory.clog(share),
            Failure::Disconnected => self.parts.circuit.fail(OPEN_END_L_PER_S),
            Failure::Leak(flow) => self.parts.circuit.fail(flow),
            Failure::InspiratoryValveStuck(percent) => self.valve.stick_at(percent),
            Failure::ValveLoose(percent) => self.valve.loosen(percent),
            Failure::BothValvesStuck(percent) => {
                self.valve.stick_at(percent);
                self.parts.expiratory.stay_closed();
            }
            Failure::ExpiratoryValveClosed => self.parts.expiratory.stay_closed(),
            Failure::PeepValveStuck(peep) => self.parts.expiratory.stick_at(peep),
            Failure::SupplyLost => self.valve.supply(0.0),
            Failure::SupplyFalls(share) => self.valve.supply(share),
        }
    }

    /// Ends every failure: the tube is connected and open, the valves move, the gas supply is back. The PEEP valve takes
    /// the pressure to which it was last turned, the leak what it would be now without a failure.
    pub fn restore(&mut self) {
        self.parts.lung.occlude(1.0);
        self.parts.circuit.repair();
        self.parts.expiratory.repair();
        self.valve.repair();
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BenchConfig;
    use crate::tests::BIAS;

    fn bench() -> Bench {
        Bench::new(&BenchConfig::paper(20.0, 20.0), 5.0, 1).unwrap()
    }

    fn hold(bench: &mut Bench, u_in: f32, u_out: bool, steps: u32) -> f64 {
        for _ in 0..steps {
            bench.step(u_in, u_out);
        }
        bench.airway_pressure()
    }

    /// Pressure after 1 s of inspiration at 20 %, then after 1 s of expiration.
    fn breath(bench: &mut Bench) -> (f64, f64) {
        (hold(bench, 20.0, false, 1000), hold(bench, 0.0, true, 1000))
    }

    /// The pressures of a breath with a failure at the start.
    fn breathe(failure: Option<Failure>) -> (f64, f64) {
        let mut bench = bench();
        if let Some(failure) = failure {
            bench.fail(failure);
        }
        breath(&mut bench)
    }

    #[test]
    fn every_failure_shows_in_the_pressures_as_it_must() {
        let (plateau, rest) = breathe(None);
        assert!((10.0..25.0).contains(&plateau) && (rest - 5.0).abs() < 0.5, "{plateau} {rest}");
        let with = |failure| breathe(Some(failure));
        assert!(with(Failure::TubeOccluded).0 > plateau + 15.0);
        let narrowed = with(Failure::TubeNarrowed(3.0)).0;
        assert!(narrowed > plateau + 1.0 && narrowed < with(Failure::TubeOccluded).0, "{narrowed} {plateau}");
        assert!(with(Failure::FilterClogged).1 > rest + 3.0);
        let slow = with(Failure::FilterNarrowed(0.05)).1;
        assert!(slow > rest + 0.5 && slow < with(Failure::FilterClogged).1, "{slow} {rest}");
        assert!(with(Failure::Disconnected).0 < 2.0);
        assert!(with(Failure::Leak(0.2)).0 < plateau - 0.8);
        assert!(with(Failure::Leak(0.5)).0 < with(Failure::Leak(0.2)).0 - 0.8);
        assert!(with(Failure::InspiratoryValveStuck(60.0)).0 > plateau + 10.0);
        assert!(with(Failure::InspiratoryValveStuck(0.0)).0 < 5.5);
        assert!(with(Failure::BothValvesStuck(80.0)).1 > 65.0);
        assert!(with(Failure::ExpiratoryValveClosed).1 > plateau - 5.0);
        assert!((with(Failure::PeepValveStuck(12.0)).1 - 12.0).abs() < 1.0);
        assert!(with(Failure::SupplyLost).0 < 5.5);
        let falls = with(Failure::SupplyFalls(0.6)).0;
        assert!(falls > 6.0 && falls < plateau - 2.0, "{falls}");
    }

    /// The pressures of a breath with this failure, and of one after the restoration.
    fn breathe_twice(failure: Option<Failure>) -> [f64; 4] {
        let mut bench = bench();
        if let Some(failure) = failure {
            bench.fail(failure);
        }
        let (failed_plateau, failed_rest) = breath(&mut bench);
        bench.restore();
        // Gas for the lung that a disconnection emptied, then back to PEEP.
        hold(&mut bench, 20.0, true, 2000);
        hold(&mut bench, BIAS, true, 8000);
        let (plateau, rest) = breath(&mut bench);
        [failed_plateau, failed_rest, plateau, rest]
    }

    #[test]
    fn after_a_restoration_it_breathes_as_before_the_failure() {
        let sound = breathe_twice(None);
        for failure in [
            Failure::TubeOccluded,
            Failure::TubeNarrowed(3.0),
            Failure::FilterClogged,
            Failure::FilterNarrowed(0.05),
            Failure::Disconnected,
            Failure::Leak(0.5),
            Failure::InspiratoryValveStuck(60.0),
            Failure::InspiratoryValveStuck(0.0),
            Failure::BothValvesStuck(80.0),
            Failure::ExpiratoryValveClosed,
            Failure::PeepValveStuck(12.0),
            Failure::SupplyLost,
            Failure::SupplyFalls(0.6),
        ] {
            let found = breathe_twice(Some(failure));
            let off = |place: usize| (found[place] - sound[place]).abs();
            assert!(off(0).max(off(1)) > 0.8, "{failure:?}: {found:?}");
            assert!(off(2).max(off(3)) < 0.05, "{failure:?}: {found:?} {sound:?}");
        }
    }

    #[test]
    fn a_loose_valve_gives_more_than_a_lower_command_asks_for_until_it_is_restored() {
        let lowered = |bench: &mut Bench| {
            hold(bench, 40.0, true, 300);
            hold(bench, 20.0, true, 300);
            bench.truth().flow_valve
        };
        let mut bench = bench();
        let sound = lowered(&mut bench);
        bench.fail(Failure::ValveLoose(15.0));
        assert!(lowered(&mut bench) > 1.3 * sound);
        bench.restore();
        assert!((lowered(&mut bench) / sound - 1.0).abs() < 0.01);
    }

    #[test]
    fn restoring_a_sound_bench_changes_nothing() {
        let (mut restored, mut other) = (bench(), bench());
        for ms in 0..2000 {
            if ms % 100 == 0 {
                restored.restore();
            }
            assert_eq!(restored.step(20.0, ms > 1000).to_bits(), other.step(20.0, ms > 1000).to_bits());
        }
    }
}
