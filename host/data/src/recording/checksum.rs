//! A checksum stored inside the bytes that it covers.
//!
//! It is computed while its own digits are zeros, then written over them.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::ops::Range;
use std::path::Path;

use crc::{CRC_32_ISO_HDLC, Crc};

/// Key of the checksum in the metadata of a Parquet file.
pub(super) const KEY: &str = "eupnea_checksum";
/// Text before the digits.
const MARK: &str = "eupnea-crc32:";
const DIGITS: usize = 8;
const CRC: Crc<u32> = Crc::<u32>::new(&CRC_32_ISO_HDLC);

/// The placeholder to write into the file, for [`seal`] to fill in.
pub(super) fn blank() -> String {
    format!("{MARK}{}", "0".repeat(DIGITS))
}

/// Number of bytes at the end of a file that are searched for its last [`blank`].
const TAIL: u64 = 1 << 16;

/// Writes the checksum over the last [`blank`] of a file, which may be larger than memory.
pub(super) fn seal(path: &Path) -> io::Result<()> {
    let mut file = File::options().read(true).write(true).open(path)?;
    let length = file.seek(SeekFrom::End(0))?;
    let start = length.saturating_sub(TAIL);
    file.seek(SeekFrom::Start(start))?;
    let mut tail = Vec::new();
    file.read_to_end(&mut tail)?;
    let Some(place) = find(&tail) else { return Ok(()) };
    file.rewind()?;
    let mut digest = CRC.digest();
    let mut bytes = vec![0; TAIL as usize];
    loop {
        match file.read(&mut bytes)? {
            0 => break,
            count => digest.update(&bytes[..count]),
        }
    }
    file.seek(SeekFrom::Start(start + place.start as u64))?;
    file.write_all(format!("{:08x}", digest.finalize()).as_bytes())?;
    file.sync_all()
}

/// Whether the last checksum is correct; also true without a checksum, as in files of other programs. Replaces its
/// digits by zeros.
pub(super) fn matches(bytes: &mut [u8]) -> bool {
    let Some(place) = find(bytes) else { return true };
    let stored = bytes[place.clone()].to_vec();
    bytes[place].fill(b'0');
    format!("{:08x}", CRC.checksum(bytes)).as_bytes() == stored
}

fn find(bytes: &[u8]) -> Option<Range<usize>> {
    let start = bytes.windows(MARK.len()).rposition(|window| window == MARK.as_bytes())? + MARK.len();
    (start + DIGITS <= bytes.len()).then_some(start..start + DIGITS)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sealed(bytes: &[u8]) -> Vec<u8> {
        let file = tempfile::NamedTempFile::new().unwrap();
        std::fs::write(file.path(), bytes).unwrap();
        seal(file.path()).unwrap();
        std::fs::read(file.path()).unwrap()
    }

    #[test]
    fn any_change_of_sealed_bytes_shows_or_hides_the_mark() {
        let sealed = sealed(format!("head {} tail", blank()).as_bytes());
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
        let mut sealed = sealed(format!("{} and {}", blank(), blank()).as_bytes());
        assert!(sealed.starts_with(blank().as_bytes()) && matches(&mut sealed));
    }

    #[test]
    fn bytes_without_a_mark_or_with_half_of_one_pass() {
        assert!(matches(&mut b"PAR1PAR1".to_vec()));
        assert!(matches(&mut format!("{MARK}123").into_bytes()));
        assert_eq!(sealed(b"PAR1"), b"PAR1");
    }
}
