//! Golden traces: hashes of the valve commands of a long closed-loop run.

use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};
use shared::breath::{DEFAULT_PERIOD_US, ISO_ROWS, PAPER_PIPS, paper_settings};
use shared::control::Controller;
use shared::control::features::FeatureSpec;
use shared::control::network::Network;
use shared::control::pid::{Pid, PidGains};
use shared::control::residual::{Residual, ResidualSpec};
use shared::explore::Exploration;
use shared::settings::Settings;
use shared::ventilator::{Mode, Ventilator};
use shared::weights::decode;

use crate::exact_lung::ExactLung;

/// The shipped weights for adults.
pub const LEARNED: &[u8] = include_bytes!("../../host/learn/controllers/adult.bin");
/// Number of breaths of a trace.
pub const BREATHS: u32 = 100;
/// Breaths between two entries of a trace.
pub const ENTRY_BREATHS: u32 = 10;
/// Number of breaths with the same settings.
const BREATHS_PER_SETTING: u32 = 4;
/// Tick of a breath in which the next breath's settings are sent, to test that they wait.
const SETTINGS_TICK: u32 = 700;

const GAINS: PidGains = PidGains { p: 2.0, i: 30.0, d: 0.01 };

/// Hash of all commands up to the end of a breath.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Number of completed breaths.
    pub breaths: u32,
    /// FNV-1a of every command so far.
    pub hash: u64,
}

/// Result of a run.
#[derive(Clone, Debug, PartialEq)]
pub struct GoldenTrace {
    /// Hashes in order; the first different one shows where two runs diverged.
    pub entries: Vec<Entry>,
    /// Mean absolute error in the last tenth of every inspiration of 1 s or more, cmH2O, to check that the loop controls
    /// the pressure. Shorter inspirations end before a plain PID has settled.
    pub plateau_error: f32,
}

/// A PID controller.
pub fn pid() -> Controller {
    Controller::Pid(Pid::new(GAINS, DEFAULT_PERIOD_US).expect("the gains are in bounds"))
}

/// A learned controller with random weights from a seed: untrained, but every weight affects the commands.
pub fn residual(seed: u64) -> Controller {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut network = Network::zero();
    for weight in network.parameters_mut() {
        // 24 bits are exact in f32; the result is in -0.25..0.25.
        *weight = ((rng.next_u32() >> 8) as f32 / 16_777_216.0 - 0.5) * 0.5;
    }
    let spec = ResidualSpec {
        period_us: DEFAULT_PERIOD_US,
        gains: GAINS,
        lambda: 0.5,
        authority: 30.0,
        features: FeatureSpec::default(),
    };
    Controller::Residual(Residual::new(spec, network).expect("the specification is in bounds"))
}

/// The controller with the committed weights, trained on the virtual bench like one that a user would flash.
pub fn learned() -> Controller {
    Controller::Residual(decode(LEARNED).expect("the committed image is sound").residual)
}

/// Runs [`BREATHS`] breaths of changing settings on the [`ExactLung`], exploring.
///
/// # Errors
/// The ventilator's mode if it stopped ventilating: a trace of safe commands would prove nothing.
pub fn run(controller: Controller) -> Result<GoldenTrace, Mode> {
    let ventilator = Ventilator::new(DEFAULT_PERIOD_US, controller).with_exploration(Some(exploration()));
    let mut state = ventilator.standby(&settings(0)).expect("all settings of the protocol are in bounds");
    state.start();
    let mut lung = ExactLung::new(settings(0).peep);
    let (mut hash, mut entries) = (Fnv::default(), Vec::new());
    let (mut error, mut ticks) = (0.0, 0);
    while state.breath_number() < BREATHS {
        if state.tick() == 0 {
            lung.set_peep(settings(state.breath_number()).peep);
        }
        let output = ventilator.step(&mut state, lung.pressure());
        let Some(sample) = output.sample else {
            return Err(output.mode);
        };
        hash.command(output.command.u_in(), output.command.u_out());
        lung.step(output.command.u_in(), output.command.u_out());
        let inspiration = state.breath().inspiration_ticks();
        if inspiration >= 1000 && sample.tick < inspiration && sample.tick >= inspiration - inspiration / 10 {
            error += (sample.target - sample.pressure).abs();
            ticks += 1;
        }
        if sample.tick == SETTINGS_TICK.min(inspiration) {
            let next = settings(sample.breath + 1);
            ventilator.apply(&mut state, &next).expect("all settings of the protocol are in bounds");
        }
        let breaths = state.breath_number();
        if state.tick() == 0 && breaths.is_multiple_of(ENTRY_BREATHS) {
            entries.push(Entry { breaths, hash: hash.0 });
        }
    }
    Ok(GoldenTrace { entries, plateau_error: error / ticks as f32 })
}

/// Exploration in a trace.
pub fn exploration() -> Exploration {
    Exploration { seed: 7, ..Exploration::default() }
}

/// Settings of a breath: the paper's waveforms, then the rows of the test standard, repeated.
pub fn settings(breath: u32) -> Settings {
    let index = (breath / BREATHS_PER_SETTING) as usize % (PAPER_PIPS.len() + ISO_ROWS.len());
    match PAPER_PIPS.get(index) {
        Some(pip) => paper_settings(*pip),
        None => ISO_ROWS[index - PAPER_PIPS.len()].settings(),
    }
}

/// The 64-bit hash of Fowler, Noll and Vo, variant 1a.
pub struct Fnv(u64);

impl Default for Fnv {
    fn default() -> Self {
        Self(0xcbf2_9ce4_8422_2325)
    }
}

impl Fnv {
    /// Adds a command: inspiratory valve in percent, and whether the expiratory valve is open.
    pub fn command(&mut self, u_in: f32, u_out: bool) {
        for byte in u_in.to_bits().to_le_bytes() {
            self.byte(byte);
        }
        self.byte(u8::from(u_out));
    }

    /// The hash so far.
    pub fn value(&self) -> u64 {
        self.0
    }

    fn byte(&mut self, byte: u8) {
        self.0 = (self.0 ^ u64::from(byte)).wrapping_mul(0x0000_0100_0000_01b3);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_the_published_one() {
        let mut hash = Fnv::default();
        b"foobar".iter().for_each(|byte| hash.byte(*byte));
        assert_eq!(hash.0, 0x8594_4171_f739_67e8);
    }

    #[test]
    fn a_single_bit_of_a_weight_changes_the_trace() {
        let Controller::Residual(first) = residual(1) else {
            unreachable!("a residual was asked for");
        };
        let mut network = first.network().clone();
        let weight = &mut network.hidden_1.weights[5][17];
        *weight = f32::from_bits(weight.to_bits() ^ 1);
        let other = Residual::new(*first.spec(), network).unwrap();
        let last = |residual| *run(Controller::Residual(residual)).unwrap().entries.last().unwrap();
        assert_ne!(last(first), last(other));
    }
}
