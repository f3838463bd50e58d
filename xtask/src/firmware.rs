//! `cargo xtask firmware`: builds the image for the board and shows how much of the chip it takes.

use std::path::PathBuf;

use anyhow::{Context, Result, ensure};
use object::read::elf::{ElfFile32, FileHeader, SectionHeader};
use object::{Object, ObjectSection, elf};
use xshell::{Shell, cmd};

use crate::memory::{self, Region};
use crate::{CHIP_TARGET, setup};

/// What of a section matters for its size.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Section {
    name: String,
    address: u64,
    bytes: u64,
    /// Held in flash: code, constants and the initial values of variables, but not zeroed variables.
    stored: bool,
}

/// Builds the release image and prints its sizes.
pub fn run(shell: &Shell) -> Result<()> {
    ensure!(setup::can_build(shell)?, "the toolchain cannot build for {CHIP_TARGET}; run: cargo xtask setup");
    cmd!(shell, "cargo build --release -p firmware --target {CHIP_TARGET}").quiet().run()?;
    let path = image(shell);
    let file = std::fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
    let regions = memory::regions(&shell.read_file("memory.x")?)?;
    println!("{}", path.display());
    print!("{}", report(&sections(&file)?, &regions)?);
    Ok(())
}

/// Where cargo puts the image.
fn image(shell: &Shell) -> PathBuf {
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from);
    shell.current_dir().join(target).join(CHIP_TARGET).join("release/firmware")
}

/// The sections that take room on the chip.
fn sections(file: &[u8]) -> Result<Vec<Section>> {
    let elf: ElfFile32 = ElfFile32::parse(file).context("the image is no 32-bit ELF file")?;
    let endian = elf.elf_header().endian()?;
    let mut sections = Vec::new();
    for section in elf.sections() {
        let header = section.elf_section_header();
        if header.sh_flags(endian).contains(elf::SHF_ALLOC) && section.size() > 0 {
            sections.push(Section {
                name: section.name()?.to_owned(),
                address: section.address(),
                bytes: section.size(),
                stored: header.sh_type(endian) != elf::SHT_NOBITS,
            });
        }
    }
    Ok(sections)
}

/// A table of sections, then what flash and RAM have left.
fn report(sections: &[Section], regions: &[Region]) -> Result<String> {
    let flash = memory::find(regions, "FLASH")?;
    let ram = memory::find(regions, "RAM")?;
    let head = format!("{:<16} {:>10} {:>9}\n", "section", "address", "bytes");
    let line = |section: &Section| {
        let Section { name, address, bytes, .. } = section;
        format!("{name:<16} {address:#010x} {bytes:>9}\n")
    };
    let lines: String = sections.iter().map(line).collect();
    let in_flash = used("flash", sections.iter().filter(|section| section.stored), flash);
    let in_ram = sections.iter().filter(|section| ram.contains(section.address));
    let in_ram = used("RAM", in_ram, ram);
    let note = "RAM does not count the stack, which takes what is left.\n";
    Ok([head, lines, in_flash, in_ram, note.into()].concat())
}

fn used<'a>(name: &str, sections: impl Iterator<Item = &'a Section>, region: &Region) -> String {
    let bytes: u64 = sections.map(|section| section.bytes).sum();
    let percent = 100.0 * bytes as f64 / region.length as f64;
    format!("{name:<5} {bytes:>7} of {:>7} bytes, {percent:.1} %\n", region.length)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn initialised_variables_take_flash_and_ram_zeroed_ones_ram_alone() {
        let section =
            |name: &str, address, bytes, stored| Section { name: name.into(), address, bytes, stored };
        let region = |name: &str, origin, length| Region { name: name.into(), origin, length };
        let sections = [
            section(".text", 0x100, 500, true),
            section(".data", 0x2000, 20, true),
            section(".bss", 0x2014, 300, false),
        ];
        let regions = [region("FLASH", 0, 1040), region("RAM", 0x2000, 640)];
        let text = report(&sections, &regions).unwrap();
        assert!(text.contains("flash     520 of    1040 bytes, 50.0 %"), "{text}");
        assert!(text.contains("RAM       320 of     640 bytes, 50.0 %"), "{text}");
    }

    #[test]
    fn what_is_no_image_is_refused() {
        assert!(sections(b"not an image").is_err());
    }
}
