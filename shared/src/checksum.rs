//! The project's checksum, CRC-32 as in zip and Ethernet (`zlib.crc32` in Python), for the weights image and both
//! links; and a hash for layouts.

use crc::{CRC_32_ISO_HDLC, Crc};

/// The checksum algorithm, for callers that feed it piece by piece.
pub static CRC_32: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// Length of a checksum in a frame or image, bytes.
pub const CHECKSUM_BYTES: usize = 4;

/// CRC-32 of `bytes`.
pub fn crc32(bytes: &[u8]) -> u32 {
    CRC_32.checksum(bytes)
}

/// Checks the little-endian checksum at the end of `bytes`; returns the bytes before it if it matches.
pub fn verified(bytes: &[u8]) -> Option<&[u8]> {
    let (covered, stored) = bytes.split_last_chunk::<CHECKSUM_BYTES>()?;
    (crc32(covered) == u32::from_le_bytes(*stored)).then_some(covered)
}

/// Hash of `words` (Fowler, Noll and Vo), to distinguish memory layouts; it is too weak to detect damage.
pub const fn fnv(words: &[u32]) -> u32 {
    let (mut hash, mut index) = (0x811C_9DC5_u32, 0);
    while index < words.len() {
        hash = (hash ^ words[index]).wrapping_mul(0x0100_0193);
        index += 1;
    }
    hash
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_checksum_is_that_of_zip() {
        assert_eq!(crc32(b"123456789"), 0xCBF4_3926);
    }

    #[test]
    fn other_numbers_in_another_order_have_another_hash() {
        assert_ne!(fnv(&[1, 2]), fnv(&[2, 1]));
        assert_ne!(fnv(&[1, 2]), fnv(&[1, 3]));
    }

    #[test]
    fn only_the_matching_checksum_is_accepted() {
        let mut bytes = *b"123456789\x26\x39\xF4\xCB";
        assert_eq!(verified(&bytes), Some(&b"123456789"[..]));
        bytes[0] ^= 1;
        assert_eq!(verified(&bytes), None);
        assert_eq!(verified(&[0; 3]), None);
    }
}
