//! `cargo xtask firmware`: builds the firmware's images and shows how much flash and RAM they use.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, ensure};
use object::read::elf::{ElfFile32, FileHeader, SectionHeader};
use object::{Object, ObjectSection, elf};
use xshell::{PushEnv, Shell, cmd};

use crate::memory::{self, Region};
use crate::{CHIP_PROFILE, CHIP_TARGET, checksum};

/// A section of an image.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Section {
    name: String,
    address: u64,
    bytes: u64,
    /// Whether it is stored in flash: code, constants and initial values of variables, but not zeroed variables.
    stored: bool,
}

/// An image that users flash.
pub struct Board {
    /// Name of board and image.
    pub name: &'static str,
    /// Name of the file that is built, without its ending.
    file: &'static str,
    features: &'static [&'static str],
    /// Memory regions.
    pub map: &'static str,
    /// What the image is.
    pub about: &'static str,
}

/// The images of the main board, with sensors and valves and for the desk, then those of the other board.
pub const BOARDS: [Board; 4] = [
    Board {
        name: "stm32f405",
        file: "board",
        features: &[],
        map: "firmware/memory/stm32f405.x",
        about: "ventilator with sensors and valves",
    },
    Board {
        name: "stm32f405-desk",
        file: "desk",
        features: &["--features", "desk"],
        map: "firmware/memory/stm32f405-desk.x",
        about: "ventilator that simulates lung, sensors and valves",
    },
    Board {
        name: "stm32f446",
        file: "stm32f446",
        features: &["--no-default-features", "--features", "stm32f446"],
        map: "firmware/memory/stm32f446.x",
        about: "ventilator with sensors and valves",
    },
    Board {
        name: "stm32f446-desk",
        file: "stm32f446-desk",
        features: &["--no-default-features", "--features", "stm32f446,desk"],
        map: "firmware/memory/stm32f446-desk.x",
        about: "ventilator that simulates lung, sensors and valves, for a Nucleo board without anything else",
    },
];
/// Memory regions of the main board, and of its image for the desk.
pub const MAIN_BOARD: &str = BOARDS[0].map;
pub const DESK: &str = BOARDS[1].map;

impl Board {
    /// Builds the image; returns its path.
    pub fn build(&self, shell: &Shell) -> Result<PathBuf> {
        compile(shell, self.file, self.features)
    }
}

/// Variable with the public key whose weights the firmware runs.
const KEY: &str = "EUPNEA_WEIGHTS_KEY";
/// Variable with the plant for which these weights must be.
const PLANT: &str = "EUPNEA_WEIGHTS_PLANT";
/// Public key of the seed of 32 bytes 42, with which the tests in QEMU sign.
const TEST_KEY: &str = "197f6b23e16c8532c6abc838facd5ea789be0c76b2920334039bfa8b3d368d61";
/// Plant of the weights in these tests.
const TEST_PLANT: &str = "family adult";

/// Images of the main board.
pub struct Images {
    /// Image with sensors and valves.
    pub board: PathBuf,
    /// Image with a plant on a serial line in their place.
    pub hil: PathBuf,
    /// Image that simulates a plant in their place.
    pub desk: PathBuf,
    /// The shim, for QEMU.
    pub shim: PathBuf,
}

impl Images {
    /// Folder of all images.
    pub fn folder(&self) -> &Path {
        self.board.parent().unwrap_or(Path::new("."))
    }
}

/// Size of an image, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size {
    /// In flash.
    pub flash: u64,
    /// In RAM, without the stack.
    pub ram: u64,
}

/// Builds all images and prints their sizes.
pub fn run(shell: &Shell) -> Result<()> {
    let images = build(shell)?;
    for (image, map) in [(&images.board, MAIN_BOARD), (&images.hil, MAIN_BOARD), (&images.desk, DESK)] {
        println!("{}", image.display());
        let regions = memory::regions(&shell.read_file(map)?)?;
        print!("{}", report(&sections(&read(image)?)?, &regions)?);
    }
    println!("{}: for QEMU", images.shim.display());
    for board in &BOARDS[2..] {
        let image = board.build(shell)?;
        let Size { flash, ram } = size(&image, Path::new(board.map))?;
        println!("{}: flash {flash}, RAM {ram} bytes", image.display());
    }
    Ok(())
}

/// Builds the images of the main board, and the shim with which they run in QEMU.
pub fn build(shell: &Shell) -> Result<Images> {
    let hil = compile(shell, "hil", &["--features", "hil"])?;
    let board = BOARDS[0].build(shell)?;
    let desk = BOARDS[1].build(shell)?;
    build_for_chip(shell, &["-p", "shim", "--bin", "shim"])?;
    let shim = keep(shell, "shim", "shim", Ok)?;
    Ok(Images { board, hil, desk, shim })
}

/// Builds the images like [`build`] without a key, whatever the environment says.
pub fn build_unsigned(shell: &Shell) -> Result<Images> {
    let _variables = without_key(shell);
    build(shell)
}

/// Variables with which an image runs weights without a signature.
pub fn without_key(shell: &Shell) -> [PushEnv<'_>; 2] {
    [KEY, PLANT].map(|variable| shell.push_env(variable, ""))
}

/// Builds the image for hardware in the loop that trusts the key of the tests, for their plant.
pub fn build_signed(shell: &Shell) -> Result<()> {
    let _variables = [(KEY, TEST_KEY), (PLANT, TEST_PLANT)].map(|(name, value)| shell.push_env(name, value));
    compile(shell, "signed", &["--features", "hil"]).map(drop)
}

/// Builds the probe, a firmware that tests the emulation, next to the other images.
pub fn build_probe(shell: &Shell) -> Result<()> {
    build_for_chip(shell, &["-p", "shim", "--example", "probe"])?;
    keep(shell, "examples/probe", "probe", Ok)?;
    Ok(())
}

/// Builds the program that counts instructions; returns its path.
pub fn build_cost(shell: &Shell) -> Result<PathBuf> {
    build_for_chip(shell, &["-p", "firmware", "--bin", "cost", "--features", "cost"])?;
    Ok(chip_folder(shell).join("cost"))
}

/// Builds the firmware with some features and keeps the image, with its checksum, under its own name.
fn compile(shell: &Shell, name: &str, features: &[&str]) -> Result<PathBuf> {
    build_for_chip(shell, &[&["-p", "firmware", "--bin", "firmware"], features].concat())?;
    keep(shell, "firmware", name, checksum::sealed)
}

/// Builds a program for the chip.
fn build_for_chip(shell: &Shell, program: &[&str]) -> Result<()> {
    cmd!(shell, "cargo build --profile {CHIP_PROFILE} --target {CHIP_TARGET} {program...}")
        .quiet()
        .run()
        .context("cannot build for the chip; if its core library is missing, run: cargo xtask setup")
}

/// Copies a built program to a folder where no build with other features overwrites it. An identical file is not
/// overwritten, so that its age shows when the image changed.
fn keep(
    shell: &Shell,
    built: &str,
    name: &str,
    finish: impl Fn(Vec<u8>) -> Result<Vec<u8>>,
) -> Result<PathBuf> {
    let folder = cargo_folder(shell).join("firmware");
    shell.create_dir(&folder)?;
    let from = chip_folder(shell).join(built);
    let to = folder.join(format!("{name}.elf"));
    let image = finish(read(&from)?).with_context(|| from.display().to_string())?;
    if std::fs::read(&to).ok().as_ref() != Some(&image) {
        shell.write_file(&to, image)?;
    }
    Ok(to)
}

/// Cargo's output folder for the chip.
fn chip_folder(shell: &Shell) -> PathBuf {
    cargo_folder(shell).join(CHIP_TARGET).join(CHIP_PROFILE)
}

/// Cargo's target folder.
pub fn cargo_folder(shell: &Shell) -> PathBuf {
    let target = std::env::var_os("CARGO_TARGET_DIR").map_or_else(|| "target".into(), PathBuf::from);
    shell.current_dir().join(target)
}

fn read(path: &Path) -> Result<Vec<u8>> {
    std::fs::read(path).with_context(|| format!("cannot read {}", path.display()))
}

/// Flash and RAM that an image uses, with the regions of a linker map.
pub fn size(image: &Path, map: &Path) -> Result<Size> {
    let text = String::from_utf8(read(map)?)?;
    let (regions, sections) = (memory::regions(&text)?, sections(&read(image)?)?);
    let [flash, ram, a, b] = ["FLASH", "RAM", "SLOT_A", "SLOT_B"].map(|name| memory::find(&regions, name));
    let ([flash, ram], slots) = ([flash?, ram?], [a?, b?]);
    // The linker takes the first map that it finds, and lays a section over the weights if it is told to.
    for section in &sections {
        let fits = [flash, ram].iter().any(|region| region.contains(section.address));
        let over = |slot: &&Region| {
            section.address < slot.origin + slot.length && slot.origin < section.address + section.bytes
        };
        ensure!(
            fits && !slots.iter().any(over),
            "{} of {} is outside the regions of {}",
            section.name,
            image.display(),
            map.display()
        );
    }
    Ok(taken(&sections, ram))
}

fn taken(sections: &[Section], ram: &Region) -> Size {
    let bytes =
        |chosen: &dyn Fn(&Section) -> bool| sections.iter().filter(|s| chosen(s)).map(|s| s.bytes).sum();
    Size { flash: bytes(&|s| s.stored), ram: bytes(&|s| ram.contains(s.address)) }
}

/// The sections that use memory on the chip.
fn sections(file: &[u8]) -> Result<Vec<Section>> {
    let elf: ElfFile32 = ElfFile32::parse(file).context("the image is not a 32-bit ELF file")?;
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

/// A table of sections, and the use of flash and RAM.
fn report(sections: &[Section], regions: &[Region]) -> Result<String> {
    let flash = memory::find(regions, "FLASH")?;
    let ram = memory::find(regions, "RAM")?;
    let head = format!("{:<16} {:>10} {:>9}\n", "section", "address", "bytes");
    let line = |section: &Section| {
        let Section { name, address, bytes, .. } = section;
        format!("{name:<16} {address:#010x} {bytes:>9}\n")
    };
    let lines: String = sections.iter().map(line).collect();
    let Size { flash: in_flash, ram: in_ram } = taken(sections, ram);
    let note = "RAM is without the stack, which has a region of its own.\n";
    Ok([head, lines, used("flash", in_flash, flash), used("RAM", in_ram, ram), note.into()].concat())
}

fn used(name: &str, bytes: u64, region: &Region) -> String {
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
