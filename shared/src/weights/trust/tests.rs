//! Verifies: weights-trust.

use ed25519_compact::{KeyPair, Seed};
use proptest::prelude::*;

use super::*;
use crate::control::features::FeatureSpec;
use crate::control::network::Network;
use crate::control::pid::PidGains;
use crate::control::residual::{Residual, ResidualSpec};
use crate::weights::{self, Identity, Image, ImageProblem, decode, encode};

/// The key pair of a seed.
pub fn pair(seed: u8) -> KeyPair {
    KeyPair::from_seed(Seed::new([seed; 32]))
}

/// A device that trusts the key of a seed.
pub fn trust(seed: u8) -> Trust {
    Trust::Key { key: *pair(seed).pk, plant: None }
}

/// An unsigned image for a plant.
pub fn unsigned(plant: u8) -> [u8; IMAGE_BYTES] {
    let spec = ResidualSpec {
        period_us: 1000,
        gains: PidGains { p: 2.0, i: 20.0, d: 0.01 },
        lambda: 1.0,
        authority: 50.0,
        features: FeatureSpec::default(),
    };
    let identity = Identity { training: [1; 16], plant: [plant; 16] };
    let mut bytes = [0; IMAGE_BYTES];
    encode(&Residual::new(spec, Network::zero()).unwrap(), &identity, &mut bytes).unwrap();
    bytes
}

/// An image for a plant with this version, signed with the key of a seed.
pub fn signed(plant: u8, version: u32, seed: u8) -> [u8; IMAGE_BYTES] {
    let mut image = unsigned(plant);
    seal(&mut image, version, |bytes| *pair(seed).sk.sign(bytes, None));
    image
}

/// Corrects the checksum, as a packer would that alters an image.
fn mended(mut image: [u8; IMAGE_BYTES]) -> [u8; IMAGE_BYTES] {
    let checksum = crc32(&image[..IMAGE_BYTES - CHECKSUM_BYTES]);
    image[IMAGE_BYTES - CHECKSUM_BYTES..].copy_from_slice(&checksum.to_le_bytes());
    image
}

/// The image as a device decodes it.
fn decode_trusted(bytes: &[u8], trust: &Trust) -> Result<Image, WeightsError> {
    weights::decode_trusted(bytes, trust, Image::clone)
}

#[test]
fn a_signed_image_is_accepted_with_its_key_alone() {
    let image = signed(1, 7, 1);
    assert_eq!(decode_trusted(&image, &trust(1)).unwrap().version, 7);
    assert_eq!(decode_trusted(&image, &trust(2)).unwrap_err(), WeightsError::Signature);
    assert_eq!(decode_trusted(&unsigned(1), &trust(1)).unwrap_err(), WeightsError::Unsigned);
    assert_eq!(trust(1).verify(&image[..100]), Err(WeightsError::Length { have: 100, need: IMAGE_BYTES }));
}

#[test]
fn a_signature_is_seen_by_any_of_its_bytes() {
    assert!(!is_signed(&unsigned(1)) && is_signed(&signed(1, 7, 1)));
    assert!(!is_signed(&signed(1, 7, 1)[..IMAGE_BYTES - 5]), "incomplete");
    for at in [SIGNED_BYTES, SIGNED_BYTES + SIGNATURE_BYTES - 1] {
        let mut image = unsigned(1);
        image[at] = 1;
        assert!(is_signed(&image));
        assert_eq!(trust(1).verify(&image), Err(WeightsError::Signature));
    }
}

#[test]
fn a_development_build_accepts_signed_and_unsigned_images() {
    for image in std::vec![unsigned(1), signed(1, 7, 1), signed(1, 7, 2)] {
        assert_eq!(decode_trusted(&image, &Trust::Development), decode(&image));
        assert!(decode(&image).is_ok());
    }
    assert_eq!((Trust::Development.key(), Trust::default()), (None, Trust::Development));
    assert_eq!(trust(1).key(), Some(KeyId(*pair(1).pk.first_chunk().unwrap())));
}

#[test]
fn a_damaged_signed_image_is_called_damaged_and_one_of_another_layout_by_its_version() {
    let mut image = signed(1, 7, 1);
    image[200] ^= 1;
    assert_eq!(decode_trusted(&image, &trust(1)).unwrap_err(), WeightsError::Checksum);
    image[4] = 1;
    assert_eq!(decode_trusted(&image, &trust(1)).unwrap_err(), WeightsError::Version(1));
}

#[test]
fn the_version_and_the_plant_are_signed() {
    for at in [VERSION_AT, PLANT_AT] {
        let mut image = signed(1, 7, 1);
        image[at] ^= 1;
        assert_eq!(decode_trusted(&mended(image), &trust(1)).unwrap_err(), WeightsError::Signature);
    }
}

#[test]
fn a_device_with_a_plant_accepts_images_for_that_plant_alone() {
    let trust = |plant: [u8; PLANT_BYTES]| Trust::Key { key: *pair(1).pk, plant: Some(plant) };
    let image = signed(1, 7, 1);
    assert_eq!(trust([1; PLANT_BYTES]).verify(&image), Ok(()));
    for at in [0, PLANT_BYTES - 1] {
        let mut other = [1; PLANT_BYTES];
        other[at] = 2;
        assert_eq!(decode_trusted(&image, &trust(other)).unwrap_err(), WeightsError::Plant, "byte {at}");
    }
    assert_eq!(trust([2; PLANT_BYTES]).verify(&signed(1, 7, 2)), Err(WeightsError::Signature));
}

#[test]
fn an_image_of_another_layout_or_owner_is_not_damaged() {
    use ImageProblem::{Checksum, Golden, Plant, Signature, Unsigned, Version, Weight};
    assert!([Checksum, Weight, Golden].into_iter().all(ImageProblem::is_damage));
    assert!(![Version, Unsigned, Signature, Plant].into_iter().any(ImageProblem::is_damage));
}

#[test]
fn a_key_that_is_no_point_of_the_curve_trusts_nobody() {
    for key in [[0; KEY_BYTES], [0xFF; KEY_BYTES], [2; KEY_BYTES]] {
        assert_eq!(Trust::Key { key, plant: None }.verify(&signed(1, 7, 1)), Err(WeightsError::Signature));
    }
}

/// RFC 8032, section 7.1, test 3: what this crate calls ed25519 is what others call so.
#[test]
fn the_signatures_are_those_of_the_standard() {
    let seed = [
        0xc5, 0xaa, 0x8d, 0xf4, 0x3f, 0x9f, 0x83, 0x7b, 0xed, 0xb7, 0x44, 0x2f, 0x31, 0xdc, 0xb7, 0xb1, 0x66,
        0xd3, 0x85, 0x35, 0x07, 0x6f, 0x09, 0x4b, 0x85, 0xce, 0x3a, 0x2e, 0x0b, 0x44, 0x58, 0xf7,
    ];
    let pair = KeyPair::from_seed(Seed::new(seed));
    assert_eq!(pair.pk[..4], [0xfc, 0x51, 0xcd, 0x8e]);
    assert_eq!(pair.sk.sign([0xaf, 0x82], None)[..4], [0x62, 0x91, 0xd6, 0x57]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    /// Also with a corrected checksum: an attacker can compute it.
    #[test]
    fn any_flipped_bit_is_refused(bit in 0..8 * IMAGE_BYTES, mend: bool) {
        let mut image = signed(1, 7, 1);
        image[bit / 8] ^= 1 << (bit % 8);
        let refused = decode_trusted(&if mend { mended(image) } else { image }, &trust(1));
        // A flipped bit of the checksum itself is undone by correcting it.
        prop_assert_eq!(refused.is_err(), !mend || bit < 8 * (IMAGE_BYTES - CHECKSUM_BYTES));
    }

    #[test]
    fn random_signatures_and_those_of_other_keys_are_refused(signature in prop::array::uniform32(any::<u8>()), seed in 2u8..) {
        let mut image = unsigned(1);
        let bytes = [signature, signature].concat();
        seal(&mut image, 7, |_| bytes.try_into().unwrap());
        prop_assert!(decode_trusted(&image, &trust(1)).is_err());
        prop_assert_eq!(decode_trusted(&signed(1, 7, seed), &trust(1)).unwrap_err(), WeightsError::Signature);
    }
}
