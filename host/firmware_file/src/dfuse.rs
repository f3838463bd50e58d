//! Files for ST's DFU (`.dfu`): what ST's tools and `dfu-util` load into flash by USB (ST UM0391, section 2.1).
//!
//! | bytes | content, numbers little-endian |
//! |---|---|
//! | 11 | `DfuSe`, version 1, length of the file without suffix (u32), number of targets (u8) |
//! | 274 | for each target: `Target`, alternate setting (u8), whether it has a name (u32), name (255), length of its elements (u32), their number (u32) |
//! | 8 and data | for each element: address (u32), length (u32) |
//! | 16 | suffix: device, product, vendor, DFU version 0x011A (u16 each), `UFD`, 16 (u8), CRC-32 of all before it, not inverted (u32) |
//!
//! The boot loader of an STM32 has its flash as target 0, so files here have that one target.

use crc::{CRC_32_JAMCRC, Crc};
use thiserror::Error;

use crate::manifest::overlapping;

/// USB vendor of ST.
pub const VENDOR: u16 = 0x0483;
/// USB product of the boot loader of STM32 chips.
pub const PRODUCT: u16 = 0xDF11;

const PREFIX: &[u8] = b"DfuSe\x01";
const PREFIX_BYTES: usize = 11;
const TARGET: &[u8] = b"Target";
const TARGET_BYTES: usize = 274;
const NAME: &[u8] = b"Internal Flash";
const NAME_BYTES: usize = 255;
const ELEMENT_BYTES: usize = 8;
const SUFFIX_BYTES: usize = 16;
/// Version of the standard DFU with ST's extension.
const DFU_VERSION: u16 = 0x011A;
const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_JAMCRC);

/// Bytes for an address of the chip's memory.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Element {
    /// Where they begin.
    pub address: u32,
    /// The bytes.
    pub data: Vec<u8>,
}

/// Why a `.dfu` file cannot be written or read.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum DfuseError {
    /// Another file, or not all of it.
    #[error("it is no DfuSe file for a chip's flash, or not all of it: download it again")]
    Format,
    /// The checksum is wrong.
    #[error("the DfuSe file is damaged: download it again")]
    Checksum,
    /// Nothing to write, or two elements for one address.
    #[error(
        "the DfuSe file has no element, an empty one, or elements that overlap or do not fit into memory"
    )]
    Elements,
}

/// Writes a file for the flash of an STM32.
///
/// # Errors
/// [`DfuseError::Elements`].
pub fn encode(elements: &[Element]) -> Result<Vec<u8>, DfuseError> {
    check(elements)?;
    let length = |bytes: usize| u32::try_from(bytes).map_err(|_| DfuseError::Elements);
    let data: usize = elements.iter().map(|element| ELEMENT_BYTES + element.data.len()).sum();
    let mut file = PREFIX.to_vec();
    file.extend(length(PREFIX_BYTES + TARGET_BYTES + data)?.to_le_bytes());
    file.push(1);
    file.extend(TARGET);
    file.push(0);
    file.extend(1_u32.to_le_bytes());
    file.extend(NAME);
    file.resize(file.len() + NAME_BYTES - NAME.len(), 0);
    file.extend(length(data)?.to_le_bytes());
    file.extend(length(elements.len())?.to_le_bytes());
    for Element { address, data } in elements {
        file.extend(address.to_le_bytes());
        file.extend(length(data.len())?.to_le_bytes());
        file.extend(data);
    }
    for number in [0, PRODUCT, VENDOR, DFU_VERSION] {
        file.extend(number.to_le_bytes());
    }
    file.extend(b"UFD");
    file.push(SUFFIX_BYTES as u8);
    file.extend(CHECKSUM.checksum(&file).to_le_bytes());
    Ok(file)
}

/// Reads a file for the flash of an STM32.
///
/// # Errors
/// [`DfuseError`].
pub fn decode(file: &[u8]) -> Result<Vec<Element>, DfuseError> {
    let (body, checksum) = file.split_last_chunk().ok_or(DfuseError::Format)?;
    if !file.starts_with(PREFIX) {
        return Err(DfuseError::Format);
    }
    if CHECKSUM.checksum(body) != u32::from_le_bytes(*checksum) {
        return Err(DfuseError::Checksum);
    }
    let elements = elements(body).ok_or(DfuseError::Format)?;
    check(&elements)?;
    Ok(elements)
}

/// The elements of a file without its checksum; none if a field is not as [`encode`] writes it. Name and device are free.
fn elements(body: &[u8]) -> Option<Vec<Element>> {
    let (body, suffix) = body.split_at_checked(body.len().checked_sub(SUFFIX_BYTES - 4)?)?;
    let [vendor, version] = [4, 6].map(|at| u16::from_le_bytes([suffix[at], suffix[at + 1]]));
    let known = vendor == VENDOR && version == DFU_VERSION && suffix.ends_with(b"UFD\x10");
    let mut rest = Bytes(body);
    rest.expect(PREFIX)?;
    let whole = rest.number()? == body.len();
    rest.expect(&[1])?;
    rest.expect(TARGET)?;
    rest.expect(&[0])?;
    rest.take(4 + NAME_BYTES)?;
    let fits = rest.number()? == body.len() - PREFIX_BYTES - TARGET_BYTES;
    let count = rest.number()?;
    let mut elements = Vec::new();
    for _ in 0..count {
        let address = rest.number()? as u32;
        let length = rest.number()?;
        elements.push(Element { address, data: rest.take(length)?.to_vec() });
    }
    (known && whole && fits && rest.0.is_empty()).then_some(elements)
}

fn check(elements: &[Element]) -> Result<(), DfuseError> {
    let block = |element: &Element| Some((element.address, u32::try_from(element.data.len()).ok()?));
    let blocks: Option<Vec<_>> = elements.iter().map(block).collect();
    let blocks = blocks.ok_or(DfuseError::Elements)?;
    let empty = blocks.is_empty() || blocks.iter().any(|block| block.1 == 0);
    if empty || overlapping(&blocks).is_some() { Err(DfuseError::Elements) } else { Ok(()) }
}

/// The bytes that are not read yet.
struct Bytes<'a>(&'a [u8]);

impl<'a> Bytes<'a> {
    fn take(&mut self, count: usize) -> Option<&'a [u8]> {
        let (taken, rest) = self.0.split_at_checked(count)?;
        self.0 = rest;
        Some(taken)
    }

    fn expect(&mut self, bytes: &[u8]) -> Option<()> {
        (self.take(bytes.len())? == bytes).then_some(())
    }

    fn number(&mut self) -> Option<usize> {
        let bytes = self.take(4)?.first_chunk()?;
        Some(u32::from_le_bytes(*bytes) as usize)
    }
}

#[cfg(test)]
mod tests {
    use proptest::collection::vec;
    use proptest::prelude::*;

    use super::*;

    /// Elements in flash that do not overlap.
    fn any_elements() -> impl Strategy<Value = Vec<Element>> {
        vec((0_u32..64, vec(any::<u8>(), 1..200)), 1..5).prop_map(|blocks| {
            let mut address = 0x0800_0000;
            let place = |(gap, data): (u32, Vec<u8>)| {
                let element = Element { address: address + gap, data };
                address = element.address + element.data.len() as u32;
                element
            };
            blocks.into_iter().map(place).collect()
        })
    }

    proptest! {
        #[test]
        fn a_file_is_read_as_it_was_written(elements in any_elements()) {
            prop_assert_eq!(decode(&encode(&elements).unwrap()), Ok(elements));
        }

        #[test]
        fn a_file_with_one_changed_byte_or_a_missing_end_is_refused(
            elements in any_elements(), at: prop::sample::Index, change in 1..=u8::MAX,
        ) {
            let file = encode(&elements).unwrap();
            let mut changed = file.clone();
            changed[at.index(file.len())] ^= change;
            prop_assert!(decode(&changed).is_err());
            prop_assert!(decode(&file[..at.index(file.len())]).is_err());
        }

        #[test]
        fn no_bytes_cause_a_panic(mut bytes in vec(any::<u8>(), 0..600), sealed: bool) {
            if sealed {
                bytes.splice(..0, PREFIX.iter().copied());
                bytes.extend(CHECKSUM.checksum(&bytes).to_le_bytes());
            }
            prop_assert!(decode(&bytes).is_err());
        }

        #[test]
        fn a_wrong_length_under_a_right_checksum_is_refused(
            elements in any_elements(), field in prop::sample::select(vec![6_usize, 277, 281, 289]), change in 1_u32..,
        ) {
            let mut file = encode(&elements).unwrap();
            file.truncate(file.len() - 4);
            let number = u32::from_le_bytes(*file[field..].first_chunk().unwrap());
            file[field..field + 4].copy_from_slice(&(number ^ change).to_le_bytes());
            file.extend(CHECKSUM.checksum(&file).to_le_bytes());
            prop_assert!(decode(&file).is_err());
        }
    }

    #[test]
    fn prefix_and_suffix_are_those_of_the_standard() {
        let file = encode(&[Element { address: 0x0800_0000, data: vec![1, 2, 3] }]).unwrap();
        assert_eq!(file.len(), 11 + 274 + 8 + 3 + 16);
        assert_eq!(&file[..11], b"DfuSe\x01\x28\x01\x00\x00\x01");
        assert_eq!(&file[285..296], [0, 0, 0, 8, 3, 0, 0, 0, 1, 2, 3]);
        assert_eq!(&file[296..308], [0, 0, 0x11, 0xDF, 0x83, 0x04, 0x1A, 0x01, b'U', b'F', b'D', 16]);
        // The checksum is the one of Python's zlib, not inverted: `0xFFFFFFFF ^ zlib.crc32(file[:-4])`.
        assert_eq!(CHECKSUM.checksum(b"123456789"), !0xCBF4_3926);
    }

    #[test]
    fn elements_that_are_empty_overlap_or_leave_memory_are_refused() {
        let element = |address, bytes| Element { address, data: vec![0; bytes] };
        for elements in [
            vec![],
            vec![element(0, 0)],
            vec![element(8, 4), element(10, 4)],
            vec![element(10, 4), element(8, 4)],
            vec![element(u32::MAX, 1)],
        ] {
            assert_eq!(encode(&elements), Err(DfuseError::Elements), "{elements:?}");
        }
        assert!(encode(&[element(8, 4), element(12, 4), element(4, 4)]).is_ok());
    }
}
