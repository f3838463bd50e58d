//! Writes length and checksum of the program into a finished firmware image, for the self-test of the chip.

use std::ops::Range;

use anyhow::{Context, Result, ensure};
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader};
use object::{Object, ObjectSymbol, elf};
use shared::checksum::crc32;

/// The firmware's variable for length and checksum, two words in flash.
const SYMBOL: &str = "PROGRAM_CHECKSUM";
/// Where the linker has the weights slots, first and end.
const SLOTS: [&str; 2] = ["__weights_a_start", "__weights_b_end"];
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
    let (mut parts, place, slots) = parse(&image)?;
    close_gaps(&mut image, &mut parts, &slots)?;
    let mut program = Vec::new();
    let mut found = None;
    for Part { address, offset, bytes, .. } in &parts {
        if (*address..address + bytes).contains(&place) {
            found = Some((program.len() + place - address, offset + place - address));
        }
        program.extend(image.get(*offset..offset + bytes).context("the image is cut short")?);
    }
    let (in_program, in_image) = found.context("the checksum's place is not in flash")?;
    program[in_program..][..BYTES].fill(ERASED);
    let words = [program.len() as u32, crc32(&program)].map(u32::to_le_bytes).concat();
    image[in_image..][..BYTES].copy_from_slice(&words);
    Ok(image)
}

/// Lengthens each part up to the next one, or up to the weights slots before that; without room for that in the file, the checksum
/// covers the parts before. Otherwise a gap would be erased on the chip and zero in QEMU.
fn close_gaps(image: &mut [u8], parts: &mut Vec<Part>, slots: &Range<usize>) -> Result<()> {
    parts.sort_by_key(|part| part.address);
    for index in 1..parts.len() {
        let [part, next] = [parts[index - 1], parts[index]];
        let end = part.offset + part.bytes;
        let around = part.address < slots.start && slots.start < next.address;
        ensure!(
            !around || next.address == slots.end,
            "the program does not go on where the weights slots end"
        );
        let until = if around { slots.start } else { next.address };
        let gap = (until - part.address).checked_sub(part.bytes).context("the program overlaps itself")?;
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

/// The parts of the program in flash, the address of the checksum, and those of the weights slots.
fn parse(image: &[u8]) -> Result<(Vec<Part>, usize, Range<usize>)> {
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
    let address = |name| {
        let symbol = file.symbol_by_name(name).with_context(|| format!("the image has no {name}"))?;
        anyhow::Ok(symbol.address() as usize)
    };
    Ok((parts.collect(), address(SYMBOL)?, address(SLOTS[0])?..address(SLOTS[1])?))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn part(address: usize, offset: usize, header: usize, bytes: usize) -> Part {
        Part { address, offset, header, bytes }
    }

    /// Weights slots behind the program.
    const BEHIND: Range<usize> = 0x200..0x300;

    #[test]
    fn weights_slots_in_the_midst_of_the_program_belong_to_no_part() {
        let mut image = vec![0; 100];
        let mut parts = vec![part(0x100, 50, 0, 6), part(0x120, 70, 32, 10)];
        close_gaps(&mut image, &mut parts, &(0x108..0x120)).unwrap();
        assert_eq!(parts, [part(0x100, 50, 0, 8), part(0x120, 70, 32, 10)]);
        assert_eq!(image[55..60], [0, 0xFF, 0xFF, 0, 0]);
        let mut beyond = vec![part(0x100, 50, 0, 6), part(0x124, 70, 32, 10)];
        assert!(close_gaps(&mut image, &mut beyond, &(0x108..0x120)).is_err());
    }

    #[test]
    fn a_gap_is_filled_with_erased_bytes_and_belongs_to_the_part_before_it() {
        let mut image = vec![0; 100];
        let mut parts = vec![part(0x108, 58, 32, 10), part(0x100, 50, 0, 6)];
        close_gaps(&mut image, &mut parts, &BEHIND).unwrap();
        assert_eq!(parts, [part(0x100, 50, 0, 8), part(0x108, 58, 32, 10)]);
        assert_eq!(
            (&image[54..60], image[16], image[20], image[48]),
            (&[0, 0, 0xFF, 0xFF, 0, 0][..], 8, 8, 0)
        );
        let mut close = vec![part(0x100, 50, 0, 6), part(0x108, 57, 32, 10)];
        close_gaps(&mut image, &mut close, &BEHIND).unwrap();
        assert_eq!(close.len(), 1, "no room");
        let mut overlapping = vec![part(0x100, 50, 0, 9), part(0x108, 58, 32, 10)];
        assert!(close_gaps(&mut image, &mut overlapping, &BEHIND).is_err());
    }

    #[test]
    fn what_is_no_image_is_refused() {
        assert!(sealed(b"not an image".to_vec()).is_err());
    }
}
