//! The bench behind the emulator's plant line gives the bits of the bench in process.

use emulator::{BenchPlant, Plant};
use plant::bench::BenchConfig;
use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::settings::Settings;

use crate::{BenchSource, Source, Tick};

const SEED: u64 = 5;

fn bench() -> BenchConfig {
    BenchConfig::paper(20.0, 20.0)
}

/// Ticks of two breaths with different settings from the in-process source.
fn ticks(period_us: u32) -> Vec<Tick> {
    let pid = Pid::new(PidGains { p: 1.0, i: 20.0, d: 0.0 }, period_us).unwrap();
    let (first, second) = (paper_settings(20.0), Settings { peep: 8.0, ..paper_settings(25.0) });
    let mut source = BenchSource::new(&bench(), Controller::Pid(pid), &first, period_us, SEED).unwrap();
    let mut ticks = Vec::new();
    for settings in [first, second] {
        source.breath(&settings, &mut |tick| ticks.push(*tick)).unwrap();
    }
    ticks
}

#[test]
fn it_gives_the_bits_of_the_in_process_bench() {
    for period_us in [DEFAULT_PERIOD_US, 30_000] {
        let ticks = ticks(period_us);
        let mut plant = BenchPlant::new(&bench()).unwrap();
        plant.set_peep(5.0);
        let mut reading = plant.reset(period_us, SEED);
        let mut breath = ticks[0].sample.breath;
        for tick in &ticks {
            if tick.sample.breath != breath {
                breath = tick.sample.breath;
                plant.set_peep(8.0);
            }
            assert_eq!(reading.to_bits(), tick.sample.pressure.to_bits(), "{tick:?}");
            reading = plant.step(tick.sample.u_in, tick.sample.u_out);
        }
        let truths = plant.truths();
        let logged: Vec<_> = truths.lock().unwrap().iter().copied().map(Some).collect();
        let expected: Vec<_> = ticks.iter().map(|tick| tick.truth).collect();
        assert_eq!(logged[..ticks.len()], expected);
    }
}
