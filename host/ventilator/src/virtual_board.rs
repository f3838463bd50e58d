//! The virtual board as a source: the real firmware image in QEMU, the bench as its lung, and the link between them.
//!
//! It gives the same samples as [`super::BenchSource`] with the same seed, bit for bit.

use std::sync::{Arc, Mutex};

use super::{PortSource, SourceError, TickTruth};
use device::Device;
use device::port::Address;
use emulator::{Emulator, EmulatorConfig, LockstepPlant};
use plant::bench::{BenchConfig, BenchPlant};
use plant::{Plant, Reading, locked};

impl PortSource {
    /// Switches on a board whose plant is this bench with the noise of `seed`; it runs while the source lives.
    ///
    /// # Errors
    /// A bench that cannot be built, missing QEMU or images, or a device that does not answer.
    pub fn virtual_board(
        config: EmulatorConfig,
        bench: &BenchConfig,
        seed: u64,
    ) -> Result<Self, SourceError> {
        let truths = TruthLog::default();
        let plant = Logged { plant: BenchPlant::new(bench)?, truths: Arc::clone(&truths) };
        let emulator = Emulator::start(config, LockstepPlant::new(plant))?;
        let device = Device::connect(&Address::Tcp(emulator.address().to_string()))?;
        let truth = move |tick| locked(&truths).get(tick).copied();
        let name = format!("{} on the virtual board", bench.name);
        Ok(Self::new(device, seed)?.with_plant(name, bench.to_toml(), truth).with_board(emulator))
    }
}

/// The true states since the last reset: entry `n` belongs to the `n`-th reading, at tick `n`. It is logged before the
/// board receives the reading.
type TruthLog = Arc<Mutex<Vec<TickTruth>>>;

/// A plant that logs its true states.
struct Logged<P> {
    plant: P,
    truths: TruthLog,
}

impl<P: Plant> Plant for Logged<P> {
    type Error = P::Error;

    fn name(&self) -> String {
        self.plant.name()
    }

    fn reset(&mut self, period_us: u32, seed: u64, peep: f32) -> Result<Reading, P::Error> {
        let reading = self.plant.reset(period_us, seed, peep)?;
        let mut truths = locked(&self.truths);
        truths.clear();
        truths.extend(reading.truth);
        Ok(reading)
    }

    fn set_peep(&mut self, peep: f32) -> Result<(), P::Error> {
        self.plant.set_peep(peep)
    }

    fn step(&mut self, u_in: f32, u_out: bool) -> Result<Reading, P::Error> {
        let reading = self.plant.step(u_in, u_out)?;
        locked(&self.truths).extend(reading.truth);
        Ok(reading)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{BenchSource, Source, Tick};
    use emulator::PlantEnd;
    use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
    use shared::control::Controller;
    use shared::control::pid::{Pid, PidGains};
    use shared::link::plant_link::{PlantFrame, PlantMessage};
    use shared::settings::Settings;

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
    fn behind_the_plant_line_the_bench_gives_the_bits_of_the_in_process_bench() {
        for period_us in [DEFAULT_PERIOD_US, 30_000] {
            let ticks = ticks(period_us);
            let truths = TruthLog::default();
            let plant = Logged { plant: BenchPlant::new(&bench()).unwrap(), truths: Arc::clone(&truths) };
            let (mut line, mut number) = (LockstepPlant::new(plant), 0);
            let mut ask = |message| {
                number += 1;
                let answer = line.answer(&PlantFrame { tick: number, message }.encode());
                match PlantFrame::decode(answer.as_slice().try_into().unwrap()).unwrap().message {
                    PlantMessage::Ready { pressure } | PlantMessage::Pressure { pressure } => {
                        pressure.to_bits()
                    }
                    other => panic!("{other:?}"),
                }
            };
            ask(PlantMessage::Seed { seed: SEED });
            ask(PlantMessage::Peep { pressure: 5.0 });
            let mut reading = ask(PlantMessage::Reset { period_us });
            let mut breath = ticks[0].sample.breath;
            for tick in &ticks {
                if tick.sample.breath != breath {
                    breath = tick.sample.breath;
                    ask(PlantMessage::Peep { pressure: 8.0 });
                }
                assert_eq!(reading, tick.sample.pressure.to_bits(), "{tick:?}");
                reading = ask(PlantMessage::Step { u_in: tick.sample.u_in, u_out: tick.sample.u_out });
            }
            let logged: Vec<_> = locked(&truths).iter().copied().map(Some).collect();
            let expected: Vec<_> = ticks.iter().map(|tick| tick.truth).collect();
            assert_eq!(logged[..ticks.len()], expected);
        }
    }
}
