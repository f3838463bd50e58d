//! `disconnection` at any PEEP, rise and inspiratory time: it comes by its own name, first, and within two breaths.
//! Verifies: disconnection.

use super::hostile::sound_controller;
use super::injection::Injection;
use super::trial::{Trial, TrialOutcome, run};
use plant::bench::{BenchConfig, Failure};
use rayon::prelude::*;
use shared::control::Controller;
use shared::safety::alarms::Fault;
use shared::safety::monitors::Monitors;
use shared::settings::Settings;

/// Rates, 1/min, and inspiratory times, s.
const TIMINGS: [(f32, f32); 3] = [(40.0, 0.4), (20.0, 1.0), (10.0, 3.0)];

/// A trial with a patient who is disconnected at a time, ms.
fn disconnected(settings: Settings, lung: (f64, f64), at_ms: u32, controller: &Controller) -> TrialOutcome {
    let trial = Trial {
        bench: &BenchConfig::paper(lung.0, lung.1),
        settings,
        controller,
        monitors: Monitors::ALL,
        injection: Injection::Part(Failure::Disconnected),
        onset_ms: at_ms,
        watched_ms: 15_000,
        judged_after_ms: 0,
        seed: 3,
    };
    run(&trial).unwrap()
}

#[test]
fn a_disconnection_comes_first_and_within_two_breaths_at_any_peep_rise_and_time() {
    let controller = sound_controller().unwrap();
    let mut cases = Vec::new();
    for peep in [0.0, 1.0, 2.0, 5.0, 20.0] {
        for (rate, inspiratory_time) in TIMINGS {
            for rise_time in [0.0, 0.3] {
                for lung in [(5.0, 10.0), (5.0, 50.0), (50.0, 50.0)] {
                    // At the start of a breath, and in mid-breath.
                    for at_ms in [30_000, 30_700] {
                        let settings = Settings {
                            pip: peep + 15.0,
                            peep,
                            rate,
                            inspiratory_time,
                            rise_time,
                            fall_time: 0.2,
                            pressure_limit: 50.0,
                            ..Settings::default()
                        };
                        cases.push((settings, lung, at_ms));
                    }
                }
            }
        }
    }
    cases.par_iter().for_each(|(settings, lung, at_ms)| {
        let alarms = disconnected(*settings, *lung, *at_ms, &controller).alarms;
        let two_breaths = (120_000.0 / settings.rate) as u32;
        let case = format!("PEEP {}, {settings:?}, {lung:?}, {at_ms} ms: {alarms:?}", settings.peep);
        let first = alarms.first().unwrap_or_else(|| panic!("{case}"));
        assert_eq!(first.0, Fault::Disconnection, "{case}");
        assert!(first.1 <= two_breaths.min(15_000), "{case}");
    });
}
