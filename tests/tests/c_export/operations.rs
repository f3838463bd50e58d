//! Operations on controllers, and the core's answers to them.

use learn::c_export::standalone::{Standalone, StandaloneState};
use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use shared::breath::Breath;
use shared::control::features::{FeatureSpec, TAP_MAX};
use shared::control::network::Network;
use shared::control::pid::PidGains;
use shared::control::residual::{Residual, ResidualSpec};
use shared::sensor::HIGHEST_PRESSURE;
use shared::settings::{FIELDS, LEAST_RISE, Settings, SettingsError};
use shared::weights::{IMAGE_BYTES, Identity, Image, decode, encode};

/// Operations of the driver.
const INIT: u32 = 0;
const START: u32 = 1;
const STEP: u32 = 2;
const DISTURB: u32 = 3;
const CHECK: u32 = 4;

/// Settings that the C file has: the first ones of [`FIELDS`].
const SETTINGS: usize = 8;
/// Breaths of a controller, and one more for each of these microseconds of its control period: long ticks cost little.
const BREATHS: (u32, u32) = (14, 500);
/// Readings that no sensor gives, and ones at the ends of its range, cmH2O.
const STRANGE: [f32; 9] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    1.0e30,
    -1.0e30,
    HIGHEST_PRESSURE,
    -HIGHEST_PRESSURE,
    -0.0,
    1.0e-41,
];

/// The shipped controllers with their names.
pub fn shipped() -> impl Iterator<Item = (String, Image)> {
    learn::controller::shipped::names().map(|name| {
        let image = learn::controller::shipped::image(name).and_then(|image| decode(image).ok());
        (name.to_owned(), image.expect("a shipped image is sound"))
    })
}

/// Random numbers.
pub struct Draw(ChaCha8Rng);

impl Draw {
    fn between(&mut self, low: f32, high: f32) -> f32 {
        // 24 bits are exact in f32.
        low + (high - low) * ((self.0.next_u32() >> 8) as f32 / 16_777_216.0)
    }

    fn below(&mut self, end: u32) -> u32 {
        self.0.next_u32() % end
    }
}

/// A controller with drawn weights, features, gains and control period.
pub fn drawn(seed: u64) -> (String, Image) {
    let mut draw = Draw(ChaCha8Rng::seed_from_u64(seed));
    let mut network = Network::zero();
    for weight in network.parameters_mut() {
        *weight = draw.between(-0.6, 0.6);
    }
    let tap = |draw: &mut Draw| draw.below(u32::from(TAP_MAX)) as u8;
    let features = FeatureSpec {
        error_taps: [(); 7].map(|()| tap(&mut draw)),
        command_taps: [(); 6].map(|()| 1 + tap(&mut draw)),
        error_averages: [(); 2].map(|()| draw.between(0.001, 1.0)),
        command_averages: [(); 2].map(|()| draw.between(0.001, 1.0)),
        times: [(); 3].map(|()| draw.between(0.001, 1.0)),
        target_ahead: [(); 2].map(|()| tap(&mut draw)),
    };
    let spec = ResidualSpec {
        period_us: [1000, 2300, 50_000][seed as usize % 3],
        gains: PidGains { p: draw.between(0.0, 5.0), i: draw.between(0.0, 50.0), d: draw.between(0.0, 0.1) },
        lambda: draw.between(0.1, 1.0),
        authority: draw.between(5.0, 100.0),
        features,
    };
    let residual = Residual::new(spec, network).expect("it is in bounds");
    let mut bytes = [0; IMAGE_BYTES];
    encode(&residual, &Identity::default(), &mut bytes).expect("it fits");
    (format!("drawn_{seed}"), decode(&bytes).expect("it is sound"))
}

/// Operations in the driver's format, and the answers that it must give.
#[derive(Default)]
pub struct Operations {
    bytes: Vec<u8>,
    answers: Vec<[u32; 3]>,
}

impl Operations {
    /// Two runs of every controller, and its self-check.
    pub fn of(controllers: &[(String, Image)]) -> Self {
        let mut operations = Self::default();
        for (number, (_, image)) in (0..).zip(controllers) {
            let mut draw = Draw(ChaCha8Rng::seed_from_u64(u64::from(number)));
            let controller = Standalone::new(&image.residual);
            let mut run = Run { operations: &mut operations, number, controller: &controller };
            run.all(image.residual.spec().period_us, &mut draw);
            operations.add(number, CHECK, &[], [0; 3]);
        }
        operations
    }

    /// The self-check of the first controller.
    pub fn check() -> Self {
        let mut operations = Self::default();
        operations.add(0, CHECK, &[], [0; 3]);
        operations
    }

    pub fn bytes(&self) -> &[u8] {
        &self.bytes
    }

    fn add(&mut self, controller: u32, operation: u32, numbers: &[f32], answer: [u32; 3]) {
        self.bytes.extend([controller, operation].into_iter().flat_map(u32::to_ne_bytes));
        self.bytes.extend(numbers.iter().flat_map(|number| number.to_ne_bytes()));
        self.answers.push(answer);
    }

    /// Compares all answers with the core's.
    #[track_caller]
    pub fn compare(&self, answers: &[u8]) {
        let words: Vec<u32> = answers.as_chunks().0.iter().map(|word| u32::from_ne_bytes(*word)).collect();
        let (answers, _) = words.as_chunks::<3>();
        let differ = answers.iter().zip(&self.answers).position(|(found, wanted)| found != wanted);
        if let Some(at) = differ {
            panic!("operation {at} gives {:x?}, the core {:x?}", answers[at], self.answers[at]);
        }
        assert_eq!(answers.len(), self.answers.len());
        let inspired = self.answers.iter().filter(|[u_in, ..]| f32::from_bits(*u_in) > 1.0).count();
        assert!(inspired > 1000, "too few commands to prove anything: {inspired}");
    }
}

/// Other settings: a small step of a pressure, an inspiration that at long control periods is too short to learn from, or any valid ones.
fn other(now: Settings, draw: &mut Draw) -> Settings {
    let close = match draw.below(4) {
        0 => Some(Settings { pip: now.pip + draw.between(-3.5, 3.5), ..now }),
        1 => Some(Settings { inspiratory_time: draw.between(0.2, 0.35), ..now }),
        _ => None,
    };
    if let Some(close) = close {
        return if close.validate().is_ok() { close } else { now };
    }
    loop {
        let mut values = Settings::default().values();
        for (value, field) in values.iter_mut().zip(FIELDS).take(SETTINGS) {
            *value = draw.between(field.min, field.max);
        }
        let drawn = Settings::from_values(values);
        if drawn.validate().is_ok() {
            return drawn;
        }
    }
}

/// The same settings but for one, which is any number or any in its range: mostly refused.
fn spoiled(now: Settings, draw: &mut Draw) -> Settings {
    let mut values = now.values();
    let field = draw.below(SETTINGS as u32) as usize;
    values[field] = match draw.below(3) {
        0 => f32::from_bits(draw.0.next_u32()),
        1 => draw.between(FIELDS[field].min, FIELDS[field].max),
        _ => return Settings { pip: now.peep.max(5.0) + draw.between(0.0, LEAST_RISE), ..now },
    };
    Settings::from_values(values)
}

/// The run of one controller.
struct Run<'a> {
    operations: &'a mut Operations,
    number: u32,
    controller: &'a Standalone,
}

impl Run<'_> {
    fn all(&mut self, period_us: u32, draw: &mut Draw) {
        let mut state = self.controller.initial_state();
        self.operations.add(self.number, INIT, &[], [0; 3]);
        self.step(&mut state, 5.0);
        let mut settings = Settings::default();
        let mut pressure = 0.0;
        for breath in 0..BREATHS.0 + period_us / BREATHS.1 {
            // Five alike, so that the controller learns enough to be surprised, then any.
            if breath >= 5 && draw.below(3) == 0 {
                settings = other(settings, draw);
            }
            for asked in [spoiled(settings, draw), settings] {
                self.start(&mut state, &asked);
            }
            self.breathe(&mut state, period_us, draw, breath, &mut pressure);
        }
    }

    /// A breath on a lung with a lag, in one of these ways: undisturbed, with strange readings, said to be disturbed, cut short.
    fn breathe(
        &mut self,
        state: &mut StandaloneState,
        period_us: u32,
        draw: &mut Draw,
        breath: u32,
        pressure: &mut f32,
    ) {
        let Some(inspiration) = state.breath().map(Breath::inspiration_ticks) else { return };
        let way = if breath < 5 { 0 } else { draw.below(6) };
        let (strange, disturbed, short) = (way == 1, way == 2, way == 3);
        let ticks = if short { 1 + draw.below(inspiration) } else { inspiration + 20 };
        let gain = if way == 0 { 0.9 } else { draw.between(0.3, 1.2) };
        let share = (period_us as f32 / 50_000.0).min(1.0);
        for tick in 0..ticks {
            if strange && draw.below(1 + ticks / 8) == 0 {
                self.step(state, STRANGE[draw.below(STRANGE.len() as u32) as usize]);
            }
            if disturbed && tick == inspiration / 2 {
                state.disturb();
                self.operations.add(self.number, DISTURB, &[], [0; 3]);
            }
            let command = self.step(state, *pressure + draw.between(-0.2, 0.2));
            let end = if command.u_out { 5.0 } else { 5.0 + gain * command.u_in };
            *pressure += share * (end - *pressure);
        }
    }

    fn start(&mut self, state: &mut StandaloneState, settings: &Settings) {
        let answer = match self.controller.start_breath(state, settings) {
            Ok(()) => 0,
            Err(SettingsError::OutOfBounds { .. }) => 1,
            Err(SettingsError::PipBelowPeep { .. }) => 2,
            Err(SettingsError::LimitTooLow { .. }) => 3,
            Err(SettingsError::BreathTooShort { .. }) => 4,
            Err(other) => panic!("the controller has no such setting: {other}"),
        };
        self.operations.add(self.number, START, &settings.values()[..SETTINGS], [answer, 0, 0]);
    }

    fn step(&mut self, state: &mut StandaloneState, pressure: f32) -> learn::c_export::standalone::Command {
        let command = self.controller.step(state, pressure);
        let flags = u32::from(command.u_out) | u32::from(state.is_due()) << 1;
        let answer = [command.u_in.to_bits(), flags, command.target.to_bits()];
        self.operations.add(self.number, STEP, &[pressure], answer);
        command
    }
}
