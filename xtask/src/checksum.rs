//! Writes length and checksum of the program into a finished firmware image, for the self-test of the chip.

use anyhow::{Context, Result};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader};
use object::{Object, ObjectSymbol, elf};
use shared::checksum::crc32;

/// The firmware's variable for length and checksum, two words in flash.
const SYMBOL: &str = "PROGRAM_CHECKSUM";
const BYTES: usize = 8;
/// Value of an erased byte: between the parts of the program, and in place of the variable.
const ERASED: u8 = 0xFF;

/// A part of the program that is stored in flash.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Part {
    /// Address in flash.
    address: usize,
    /// Place in the file, and that of its program header.
    offset: usize,
    header: usize,
    bytes: usize,
}

/// Offsets in a program header of a 32-bit ELF file: sizes in the file and in memory.
const SIZES: [usize; 2] = [16, 20];

/// The image with its checksum.
pub fn sealed(mut image: Vec<u8>) -> Result<Vec<u8>> {
    let (mut parts, place) = parse(&image)?;
    close_gaps(&mut image, &mut parts)?;
    let start = parts.iter().map(|part| part.address).min().context("the image contains no program")?;
    let end = parts.iter().map(|part| part.address + part.bytes).max().unwrap_or(start);
    let mut program = vec![ERASED; end - start];
    for Part { address, offset, bytes, .. } in &parts {
        let content = image.get(*offset..offset + bytes).context("the image is cut short")?;
        program[address - start..][..*bytes].copy_from_slice(content);
    }
    let holds = |part: &&Part| (part.address..part.address + part.bytes).contains(&place);
    let part = parts.iter().find(holds).context("the checksum's place is not in flash")?;
    program[place - start..][..BYTES].fill(ERASED);
    let words = [(end - start) as u32, crc32(&program)].map(u32::to_le_bytes).concat();
    image[part.offset + place - part.address..][..BYTES].copy_from_slice(&words);
    Ok(image)
}

/// Lengthens each part up to the next one; without room for that in the file, the checksum covers the parts before. Otherwise a gap would be erased on the chip and zero in QEMU.
fn close_gaps(image: &mut [u8], parts: &mut Vec<Part>) -> Result<()> {
    parts.sort_by_key(|part| part.address);
    for index in 1..parts.len() {
        let [part, next] = [parts[index - 1], parts[index]];
        let end = part.offset + part.bytes;
        let gap =
            (next.address - part.address).checked_sub(part.bytes).context("the program overlaps itself")?;
        if gap > 0 {
            if next.offset < end + gap {
                parts.truncate(index);
                break;
            }
            image.get_mut(end..end + gap).context("the image is cut short")?.fill(ERASED);
            parts[index - 1].bytes += gap;
            let bytes = (parts[index - 1].bytes as u32).to_le_bytes();
            for place in SIZES.map(|size| part.header + size) {
                image.get_mut(place..place + 4).context("the image is cut short")?.copy_from_slice(&bytes);
            }
        }
    }
    Ok(())
}

/// The parts of the program in flash, and the address of the checksum.
fn parse(image: &[u8]) -> Result<(Vec<Part>, usize)> {
    let file: ElfFile32 = ElfFile32::parse(image).context("the image is not a 32-bit ELF file")?;
    let endian = file.elf_header().endian()?;
    let (first, length) = (file.elf_header().e_phoff(endian), file.elf_header().e_phentsize(endian));
    let headers = file.elf_program_headers().iter().zip((first as usize..).step_by(length.into()));
    let stored =
        headers.filter(|(header, _)| header.p_type(endian) == elf::PT_LOAD && header.p_filesz(endian) > 0);
    let parts = stored.map(|(header, place)| Part {
        address: header.p_paddr(endian) as usize,
        offset: header.p_offset(endian) as usize,
        header: place,
        bytes: header.p_filesz(endian) as usize,
    });
    let symbol = file.symbol_by_name(SYMBOL).with_context(|| format!("the image has no {SYMBOL}"))?;
    Ok((parts.collect(), symbol.address() as usize))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_gap_is_filled_with_erased_bytes_and_belongs_to_the_part_before_it() {
        let part = |address, offset, header, bytes| Part { address, offset, header, bytes };
        let mut image = vec![0; 100];
        let mut parts = vec![part(0x108, 58, 32, 10), part(0x100, 50, 0, 6)];
        close_gaps(&mut image, &mut parts).unwrap();
        assert_eq!(parts, [part(0x100, 50, 0, 8), part(0x108, 58, 32, 10)]);
        assert_eq!(
            (&image[54..60], image[16], image[20], image[48]),
            (&[0, 0, 0xFF, 0xFF, 0, 0][..], 8, 8, 0)
        );
        let mut close = vec![part(0x100, 50, 0, 6), part(0x108, 57, 32, 10)];
        close_gaps(&mut image, &mut close).unwrap();
        assert_eq!(close.len(), 1, "no room");
        assert!(close_gaps(&mut image, &mut vec![part(0x100, 50, 0, 9), part(0x108, 58, 32, 10)]).is_err());
    }

    #[test]
    fn what_is_no_image_is_refused() {
        assert!(sealed(b"not an image".to_vec()).is_err());
    }
}
