//! A checksum that stands inside the bytes that it covers.
//!
//! It is taken while its own digits are zeros, then written over them.

use std::ops::Range;

use crc::{CRC_32_ISO_HDLC, Crc};

/// Key of the checksum in the metadata of a Parquet file.
pub(super) const KEY: &str = "eupnea_checksum";
/// What stands before the digits.
const MARK: &str = "eupnea-crc32:";
const DIGITS: usize = 8;

/// The text to put into the file, to be filled in by [`seal`].
pub(super) fn blank() -> String {
    format!("{MARK}{}", "0".repeat(DIGITS))
}

/// Fills in the checksum at the last [`blank`].
pub(super) fn seal(mut bytes: Vec<u8>) -> Vec<u8> {
    if let Some(place) = find(&bytes) {
        let digits = digits(&bytes);
        bytes[place].copy_from_slice(digits.as_bytes());
    }
    bytes
}

/// Whether the last checksum is right; also true where there is none, as in files of other programs. Leaves zeros in
/// its place.
pub(super) fn matches(bytes: &mut [u8]) -> bool {
    let Some(place) = find(bytes) else { return true };
    let stored = bytes[place.clone()].to_vec();
    bytes[place].fill(b'0');
    digits(bytes).as_bytes() == stored
}

fn find(bytes: &[u8]) -> Option<Range<usize>> {
    let start = bytes.windows(MARK.len()).rposition(|window| window == MARK.as_bytes())? + MARK.len();
    (start + DIGITS <= bytes.len()).then_some(start..start + DIGITS)
}

fn digits(bytes: &[u8]) -> String {
    const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);
    format!("{:08x}", CRC.checksum(bytes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn any_change_of_sealed_bytes_shows_or_hides_the_mark() {
        let sealed = seal(format!("head {} tail", blank()).into_bytes());
        assert!(matches(&mut sealed.clone()));
        assert_ne!(find(&sealed).map(|place| sealed[place].to_vec()), Some(b"00000000".to_vec()));
        for place in 0..sealed.len() {
            let mut bad = sealed.clone();
            bad[place] ^= 1;
            assert!(find(&bad).is_none() || !matches(&mut bad), "byte {place}");
        }
    }

    #[test]
    fn the_last_mark_counts() {
        let mut sealed = seal(format!("{} and {}", blank(), blank()).into_bytes());
        assert!(sealed.starts_with(blank().as_bytes()) && matches(&mut sealed));
    }

    #[test]
    fn bytes_without_a_mark_or_with_half_of_one_pass() {
        assert!(matches(&mut b"PAR1PAR1".to_vec()));
        assert!(matches(&mut format!("{MARK}123").into_bytes()));
        assert_eq!(seal(b"PAR1".to_vec()), b"PAR1");
    }
}
