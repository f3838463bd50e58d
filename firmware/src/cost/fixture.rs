//! Networks and inputs of the cost measurements, for the chip and for the host, which checks the chip's bits.

use shared::control::network::Perceptron;

/// Number of runs of each part.
pub const RUNS: u32 = 64;

/// The network with which other implementations were measured.
pub type Reference = Perceptron<40, 32, 32>;

/// Pseudo-random numbers between -1 and 1, the same on every machine.
pub struct Numbers(pub u32);

impl Numbers {
    /// The next number.
    pub fn next(&mut self) -> f32 {
        self.0 = self.0.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        // 23 bits are exact in f32.
        (self.0 >> 9) as f32 / 4_194_304.0 - 1.0
    }

    /// The next `N` numbers.
    pub fn array<const N: usize>(&mut self) -> [f32; N] {
        core::array::from_fn(|_| self.next())
    }

    /// Sets every parameter of a network to a random number.
    pub fn fill<'a>(&mut self, parameters: impl Iterator<Item = &'a mut f32>) {
        for parameter in parameters {
            *parameter = 0.3 * self.next();
        }
    }
}

/// The activation of the other implementations, without a comparison: the sign bit masks negative numbers to zero.
pub fn relu(x: f32) -> f32 {
    f32::from_bits(x.to_bits() & !((x.to_bits() as i32 >> 31) as u32))
}

/// Runs the reference network with `relu` and with `softsign` on changing inputs; returns the exclusive or of each one's
/// output bits, to compare machines.
pub fn reference_bits(
    mut with_relu: impl FnMut(&Reference, &[f32; 40]) -> f32,
    mut with_softsign: impl FnMut(&Reference, &[f32; 40]) -> f32,
) -> [u32; 2] {
    let mut numbers = Numbers(1);
    let mut network = Reference::zero();
    numbers.fill(network.parameters_mut());
    let mut bits = [0; 2];
    for _ in 0..RUNS {
        let inputs = numbers.array();
        bits[0] ^= with_relu(&network, &inputs).to_bits();
        bits[1] ^= with_softsign(&network, &inputs).to_bits();
    }
    bits
}
