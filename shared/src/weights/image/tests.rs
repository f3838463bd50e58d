use std::vec::Vec;

use proptest::prelude::*;
use rand_chacha::ChaCha8Rng;
use rand_core::{Rng, SeedableRng};

use super::*;
use crate::control::residual::ResidualError;
use crate::weights::VERSION_AT;

/// Offset of the length of the parameters.
const PARAMETER_BYTES_AT: usize = 123;

const IDENTITY: Identity = Identity { training: *b"training 0000001", plant: *b"virtual bench   " };

/// Changes bytes and corrects the checksum, as a faulty or malicious packer would.
fn forged(change: impl Fn(&mut [u8])) -> Vec<u8> {
    let mut bytes = packed(&residual(1));
    change(&mut bytes);
    let checksum = crc32(&bytes[..IMAGE_BYTES - CHECKSUM_BYTES]);
    bytes[IMAGE_BYTES - CHECKSUM_BYTES..].copy_from_slice(&checksum.to_le_bytes());
    bytes
}

/// A random controller, determined by the seed.
fn residual(seed: u64) -> Residual {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut unit = || (rng.next_u32() >> 8) as f32 / 16_777_216.0;
    let mut network = Network::zero();
    for weight in network.parameters_mut() {
        *weight = 2.0 * unit() - 1.0;
    }
    let features = FeatureSpec {
        error_taps: [(); 7].map(|()| (127.0 * unit()) as u8),
        command_taps: [(); 6].map(|()| 1 + (126.0 * unit()) as u8),
        error_averages: [0.001 + unit(), 0.001 + unit()],
        command_averages: [0.001 + unit(), 0.001 + unit()],
        times: [0.001 + unit(), 0.001 + unit(), 0.001 + unit()],
        target_ahead: [(); 2].map(|()| (127.0 * unit()) as u8),
    };
    let gains = PidGains { p: 5.0 * unit(), i: 50.0 * unit(), d: 0.1 * unit() };
    let spec = ResidualSpec {
        period_us: 250 + (49_000.0 * unit()) as u32,
        gains,
        lambda: unit(),
        authority: 100.0 * unit(),
        features,
    };
    Residual::new(spec, network).unwrap()
}

fn packed(residual: &Residual) -> Vec<u8> {
    let mut bytes = std::vec![0; IMAGE_BYTES];
    assert_eq!(encode(residual, &IDENTITY, &mut bytes), Ok(IMAGE_BYTES));
    bytes
}

fn put(bytes: &mut [u8], at: usize, value: f32) {
    bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
}

#[test]
fn the_fields_lie_where_the_table_says() {
    let residual = residual(1);
    let (bytes, spec) = (packed(&residual), residual.spec());
    let real = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()).to_bits();
    assert_eq!(&bytes[..16], b"EUPN\x04\0\x03\0\x21\0\x20\0\x10\0\x01\0");
    assert_eq!(bytes[16..20], spec.period_us.to_le_bytes());
    assert_eq!(real(28), spec.gains.d.to_bits());
    assert_eq!((real(32), real(36)), (spec.lambda.to_bits(), spec.authority.to_bits()));
    assert_eq!(
        (&bytes[40..47], &bytes[47..53]),
        (&spec.features.error_taps[..], &spec.features.command_taps[..])
    );
    assert_eq!(real(53), spec.features.error_averages[0].to_bits());
    assert_eq!(real(65), spec.features.command_averages[1].to_bits());
    assert_eq!(real(77), spec.features.times[2].to_bits());
    assert_eq!(bytes[81..83], spec.features.target_ahead);
    assert_eq!((&bytes[83..99], &bytes[99..115]), (&IDENTITY.training[..], &IDENTITY.plant[..]));
    assert_eq!(bytes[115..119], golden(&residual).last.to_le_bytes());
    assert_eq!(bytes[119..123], golden(&residual).all.to_le_bytes());
    assert_eq!(bytes[123..127], (PARAMETER_BYTES as u32).to_le_bytes());
    assert_eq!(real(HEADER_BYTES), residual.network().hidden_1.weights[0][0].to_bits());
    assert_eq!(bytes[VERSION_AT..HEADER_BYTES], [0; 4]);
    assert_eq!(real(SIGNED_BYTES - 4), residual.network().output.bias[0].to_bits());
    assert_eq!(bytes[SIGNED_BYTES..IMAGE_BYTES - CHECKSUM_BYTES], [0; SIGNATURE_BYTES], "unsigned");
    assert_eq!(bytes.len(), IMAGE_BYTES);
}

/// Verifies: weights-checks.
#[test]
fn every_flipped_bit_is_refused() {
    let mut bytes = packed(&residual(1));
    for bit in 0..8 * IMAGE_BYTES {
        bytes[bit / 8] ^= 1 << (bit % 8);
        assert!(decode(&bytes).is_err(), "bit {bit}");
        bytes[bit / 8] ^= 1 << (bit % 8);
    }
    assert!(decode(&bytes).is_ok());
}

#[test]
fn every_truncation_is_refused_for_its_length() {
    let bytes = packed(&residual(1));
    for have in 0..IMAGE_BYTES {
        let need = IMAGE_BYTES;
        assert_eq!(decode(&bytes[..have]), Err(WeightsError::Length { have, need }));
    }
}

#[test]
fn an_erased_slot_is_no_image_and_the_rest_of_a_slot_is_ignored() {
    let mut slot = std::vec![0xFF; 16 * 1024];
    assert_eq!(decode(&slot), Err(WeightsError::Magic));
    encode(&residual(1), &IDENTITY, &mut slot).unwrap();
    assert_eq!(decode(&slot).unwrap().residual, residual(1));
}

#[test]
fn an_image_made_for_something_else_is_refused_with_the_reason() {
    assert_eq!(decode(&forged(|b| b[4] = 1)), Err(WeightsError::Version(1)));
    assert_eq!(decode(&forged(|b| b[6] = 9)), Err(WeightsError::Architecture(9)));
    assert_eq!(
        decode(&forged(|b| b[10] = 64)),
        Err(WeightsError::Shape([Network::SHAPE[0] as u16, 64, 16, 1]))
    );
    assert_eq!(decode(&forged(|b| b[16..20].fill(0))), Err(WeightsError::Spec(ResidualError::Period(0))));
    let (have, need) = (IMAGE_BYTES, IMAGE_BYTES + 0x40);
    let longer = decode(&forged(|b| b[PARAMETER_BYTES_AT] ^= 0x40));
    assert_eq!(longer, Err(WeightsError::Length { have, need }));
}

#[test]
fn a_smaller_sound_image_of_another_architecture_is_not_called_damaged() {
    let mut bytes = packed(&residual(1));
    let end = HEADER_BYTES + SIGNATURE_BYTES;
    bytes.truncate(end);
    bytes[6] = 1;
    bytes[PARAMETER_BYTES_AT..PARAMETER_BYTES_AT + 2].fill(0);
    let checksum = crc32(&bytes);
    bytes.extend(checksum.to_le_bytes());
    assert_eq!(decode(&bytes), Err(WeightsError::Architecture(1)));
    bytes[6] = ARCHITECTURE as u8;
    let checksum = crc32(&bytes[..end]);
    bytes[end..].copy_from_slice(&checksum.to_le_bytes());
    assert_eq!(decode(&bytes), Err(WeightsError::Shape(Network::SHAPE.map(|size| size as u16))));
}

#[test]
fn a_weight_that_is_no_number_is_refused_in_spite_of_its_checksum() {
    for bad in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 2.0 * WEIGHT_MAX] {
        let bytes = forged(|b| put(b, HEADER_BYTES + 4 * 1000, bad));
        assert_eq!(decode(&bytes), Err(WeightsError::Weight(1000)));
    }
}

#[test]
fn a_specification_out_of_bounds_is_refused_in_spite_of_its_checksum() {
    let spec_error = |at, value| decode(&forged(|b| put(b, at, value)));
    assert!(matches!(spec_error(20, f32::NAN), Err(WeightsError::Spec(ResidualError::Gain(_)))));
    assert!(matches!(spec_error(32, 1.5), Err(WeightsError::Spec(ResidualError::OutOfBounds { .. }))));
    assert!(matches!(spec_error(36, f32::NAN), Err(WeightsError::Spec(ResidualError::OutOfBounds { .. }))));
    assert!(matches!(spec_error(69, 0.0), Err(WeightsError::Spec(ResidualError::Features(_)))));
    let tap = decode(&forged(|b| b[47] = 0));
    assert!(matches!(tap, Err(WeightsError::Spec(ResidualError::Features(_)))));
}

#[test]
fn an_altered_golden_value_or_controller_is_refused_in_spite_of_its_checksum() {
    for at in [115, 119] {
        assert_eq!(decode(&forged(|b| b[at] ^= 1)), Err(WeightsError::Golden));
    }
    assert_eq!(decode(&forged(|b| put(b, 24, 3.0))), Err(WeightsError::Golden));
    assert_eq!(decode(&forged(|b| put(b, SIGNED_BYTES - 4, 0.123))), Err(WeightsError::Golden));
}

#[test]
fn nothing_is_packed_that_could_not_be_unpacked() {
    let mut bytes = std::vec![0; IMAGE_BYTES];
    let need = IMAGE_BYTES;
    let have = need - 1;
    let refused = encode(&residual(1), &IDENTITY, &mut bytes[..have]);
    assert_eq!(refused, Err(WeightsError::Length { have, need }));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn what_is_packed_is_unpacked_bit_for_bit(seed: u64, training: [u8; 16], plant: [u8; 16]) {
        let (residual, identity) = (residual(seed), Identity { training, plant });
        let mut bytes = std::vec![0xFF; IMAGE_BYTES + 100];
        encode(&residual, &identity, &mut bytes).unwrap();
        let image = decode(&bytes).unwrap();
        prop_assert_eq!(&image.residual, &residual);
        prop_assert_eq!(image.identity, identity);
        prop_assert_eq!(image.golden, golden(&residual));
        prop_assert_eq!(image.id, crc32(&bytes[..IMAGE_BYTES - CHECKSUM_BYTES]));
        let mut again = std::vec![0xFF; IMAGE_BYTES + 100];
        encode(&image.residual, &image.identity, &mut again).unwrap();
        prop_assert_eq!(again, bytes);
    }

    #[test]
    fn random_bytes_are_refused(mut bytes in prop::collection::vec(any::<u8>(), 0..2 * IMAGE_BYTES), with_magic: bool) {
        if with_magic && bytes.len() > 5 {
            bytes[..6].copy_from_slice(b"EUPN\x02\0");
        }
        prop_assert!(decode(&bytes).is_err());
    }

    /// Even with the right checksum nothing panics, and accepted values are in bounds.
    #[test]
    fn forged_headers_are_refused_or_in_bounds(at in 6usize..HEADER_BYTES, value: u8) {
        if let Ok(image) = decode(&forged(|b| b[at] = value)) {
            prop_assert!(image.residual.network().is_bounded());
            prop_assert!((0.0..=1.0).contains(&image.residual.spec().lambda));
        }
    }
}
