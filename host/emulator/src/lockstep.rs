//! The plant's end of the plant line.

use std::thread::sleep;
use std::time::{Duration, Instant};

use plant::{Plant, Reading};
use shared::link::plant_link::{FRAME_BYTES, PlantDecoder, PlantFrame, PlantMessage, VERSION};
use shared::settings::Settings;

/// Largest delay of virtual time that is caught up.
const SLACK: Duration = Duration::from_millis(100);

/// Pressure that no plant exceeds, cmH2O: far above a sensor's range.
const HIGHEST: u16 = 1000;
/// Period in the greeting of a plant that supports any control period; one that it cannot run reads NaN.
const ANY_PERIOD: u32 = 0;

/// The other end of the board's plant line.
pub trait PlantEnd {
    /// The answer to the bytes sent; empty for silence. Virtual time stops meanwhile. A board that does not use the line sends
    /// no bytes, once every [`shim::plant_port::PACE_TICKS`] ticks.
    fn answer(&mut self, request: &[u8]) -> Vec<u8>;
}

/// A plant that speaks the frames of the plant link. A repeated frame gets the same answer without a step. If the plant
/// fails, the answer is NaN.
#[derive(Clone, Debug)]
pub struct LockstepPlant<P> {
    plant: P,
    decoder: PlantDecoder,
    /// Seed of the next resets.
    seed: u64,
    /// Setting of the mechanical PEEP valve, cmH2O, unaffected by resets.
    peep: f32,
    /// The plant's last reading, cmH2O.
    pressure: f32,
    /// The last frame answered, and its answer.
    last: Option<[[u8; FRAME_BYTES]; 2]>,
}

impl<P: Plant> LockstepPlant<P> {
    /// Connects a plant to the end of the line.
    pub fn new(plant: P) -> Self {
        let peep = Settings::default().peep;
        Self { plant, decoder: PlantDecoder::default(), seed: 0, peep, pressure: 0.0, last: None }
    }

    fn reply(&mut self, frame: &PlantFrame) -> Option<[u8; FRAME_BYTES]> {
        let request = frame.encode();
        if let Some([answered, answer]) = self.last
            && answered == request
        {
            return Some(answer);
        }
        match frame.message {
            PlantMessage::Reset { period_us } => {
                self.pressure = pressure(self.plant.reset(period_us, self.seed, self.peep));
            }
            PlantMessage::Step { u_in, u_out } => self.pressure = pressure(self.plant.step(u_in, u_out)),
            PlantMessage::Peep { pressure } if !pressure.is_nan() => {
                self.peep = pressure;
                if self.plant.set_peep(pressure).is_err() {
                    self.pressure = f32::NAN;
                }
            }
            PlantMessage::Seed { seed } => self.seed = seed,
            PlantMessage::Peep { .. } | PlantMessage::Hello { .. } => {}
            // Messages that only a plant sends.
            PlantMessage::Ready { .. }
            | PlantMessage::Pressure { .. }
            | PlantMessage::Greeting { .. }
            | PlantMessage::Truth { .. } => return None,
        }
        let pressure = self.pressure;
        let message = match frame.message {
            PlantMessage::Hello { .. } => {
                PlantMessage::Greeting { version: VERSION, highest: HIGHEST, period_us: ANY_PERIOD }
            }
            PlantMessage::Step { .. } => PlantMessage::Pressure { pressure },
            _ => PlantMessage::Ready { pressure },
        };
        let answer = PlantFrame { tick: frame.tick, message }.encode();
        self.last = Some([request, answer]);
        Some(answer)
    }
}

/// The pressure of a reading, cmH2O.
fn pressure<E>(reading: Result<Reading, E>) -> f32 {
    reading.map_or(f32::NAN, |reading| reading.pressure)
}

impl<P: Plant> PlantEnd for LockstepPlant<P> {
    fn answer(&mut self, request: &[u8]) -> Vec<u8> {
        let mut answer = Vec::new();
        for &byte in request {
            if let Some(frame) = self.decoder.push(byte) {
                answer.extend(self.reply(&frame).into_iter().flatten());
            }
        }
        answer
    }
}

/// Slows virtual time to real time, for human observers: each exchange takes at least its period.
#[derive(Clone, Debug)]
pub struct Paced<E> {
    end: E,
    period: Duration,
    due: Option<Instant>,
}

impl<E: PlantEnd> Paced<E> {
    /// Limits an end of the line to one exchange per `period`.
    pub fn new(end: E, period: Duration) -> Self {
        Self { end, period, due: None }
    }
}

impl<E: PlantEnd> PlantEnd for Paced<E> {
    fn answer(&mut self, request: &[u8]) -> Vec<u8> {
        let answer = self.end.answer(request);
        let now = Instant::now();
        // A small delay is caught up; a long one is not.
        let due = self.due.filter(|due| now.saturating_duration_since(*due) < SLACK).unwrap_or(now);
        sleep(due.saturating_duration_since(now));
        self.due = Some(due + self.period);
        answer
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::convert::Infallible;

    /// A plant that counts its requests.
    #[derive(Default)]
    struct Counter {
        steps: u32,
        peep: f32,
    }

    impl Plant for Counter {
        type Error = Infallible;

        fn name(&self) -> String {
            "counter".to_owned()
        }

        fn reset(&mut self, period_us: u32, seed: u64, peep: f32) -> Result<Reading, Infallible> {
            (self.steps, self.peep) = (0, peep);
            Ok(reading(period_us as f32 + seed as f32))
        }

        fn set_peep(&mut self, peep: f32) -> Result<(), Infallible> {
            self.peep = peep;
            Ok(())
        }

        fn step(&mut self, u_in: f32, _: bool) -> Result<Reading, Infallible> {
            self.steps += 1;
            Ok(reading(u_in + self.peep))
        }
    }

    fn reading(pressure: f32) -> Reading {
        Reading::of_pressure(pressure)
    }

    fn frame(tick: u16, message: PlantMessage) -> [u8; FRAME_BYTES] {
        PlantFrame { tick, message }.encode()
    }

    fn step(tick: u16, u_in: f32) -> [u8; FRAME_BYTES] {
        frame(tick, PlantMessage::Step { u_in, u_out: false })
    }

    fn pressure(tick: u16, pressure: f32) -> [u8; FRAME_BYTES] {
        frame(tick, PlantMessage::Pressure { pressure })
    }

    #[test]
    fn each_request_is_answered_in_its_tick() {
        let mut plant = LockstepPlant::new(Counter::default());
        let reset = frame(1, PlantMessage::Reset { period_us: 1000 });
        assert_eq!(plant.answer(&reset), frame(1, PlantMessage::Ready { pressure: 1000.0 }));
        let peep = frame(2, PlantMessage::Peep { pressure: 5.0 });
        assert_eq!(plant.answer(&peep), frame(2, PlantMessage::Ready { pressure: 1000.0 }), "no time passes");
        assert_eq!(plant.answer(&step(3, 20.0)), pressure(3, 25.0));
    }

    #[test]
    fn the_peep_valve_stays_where_it_was_turned() {
        let mut plant = LockstepPlant::new(Counter::default());
        for (tick, pressure) in [(1, 8.0), (2, f32::NAN)] {
            plant.answer(&frame(tick, PlantMessage::Peep { pressure }));
        }
        plant.answer(&frame(3, PlantMessage::Reset { period_us: 1000 }));
        assert_eq!(plant.answer(&step(4, 20.0)), pressure(4, 28.0));
    }

    #[test]
    fn a_seed_holds_for_every_reset_until_the_next() {
        let mut plant = LockstepPlant::new(Counter::default());
        let ready = |tick, pressure| frame(tick, PlantMessage::Ready { pressure });
        let reset = |tick| frame(tick, PlantMessage::Reset { period_us: 1000 });
        assert_eq!(plant.answer(&frame(1, PlantMessage::Seed { seed: 7 })), ready(1, 0.0));
        assert_eq!(plant.answer(&reset(2)), ready(2, 1007.0));
        assert_eq!(plant.answer(&reset(3)), ready(3, 1007.0));
        assert_eq!(plant.answer(&frame(4, PlantMessage::Seed { seed: 8 })), ready(4, 1007.0));
        assert_eq!(plant.answer(&reset(5)), ready(5, 1008.0));
    }

    #[test]
    fn a_repeated_frame_gets_the_same_answer_and_nothing_moves() {
        let mut plant = LockstepPlant::new(Counter::default());
        for _ in 0..3 {
            assert_eq!(plant.answer(&step(9, 20.0)), pressure(9, 20.0));
        }
        assert_eq!(plant.plant.steps, 1);
    }

    #[test]
    fn a_board_that_starts_anew_is_not_given_an_old_answer() {
        let mut plant = LockstepPlant::new(Counter::default());
        plant.answer(&step(1, 20.0));
        let reset = frame(1, PlantMessage::Reset { period_us: 1000 });
        assert_eq!(plant.answer(&reset), frame(1, PlantMessage::Ready { pressure: 1000.0 }));
    }

    #[test]
    fn a_plants_own_words_are_not_answered() {
        let mut plant = LockstepPlant::new(Counter::default());
        assert!(plant.answer(&pressure(1, 20.0)).is_empty());
    }

    proptest! {
        #[test]
        fn frames_are_found_however_they_are_cut(cut in 0..FRAME_BYTES, garbage in prop::collection::vec(0..0xA5_u8, 0..40)) {
            let mut plant = LockstepPlant::new(Counter::default());
            prop_assert!(plant.answer(&garbage).is_empty());
            let request = step(4, 30.0);
            prop_assert!(plant.answer(&request[..cut]).is_empty());
            prop_assert_eq!(plant.answer(&request[cut..]), pressure(4, 30.0).to_vec());
        }
    }

    #[test]
    fn a_paced_line_takes_its_time() {
        let mut plant = Paced::new(LockstepPlant::new(Counter::default()), Duration::from_millis(5));
        let begun = Instant::now();
        for tick in 0..5 {
            plant.answer(&step(tick, 0.0));
        }
        assert!(begun.elapsed() >= Duration::from_millis(20));
    }
}
