//! Release files of the boards: each image as ELF, Intel HEX, raw binary and DFU, with the adult controller's weights.

use std::collections::BTreeMap;
use std::path::Path;

use anyhow::{Context, Result, ensure};
use firmware_file::{Content, Firmware, KeyPair, Part, ReleaseKey, Seed, chip_of, dfuse};
use ihex::Record;
use object::elf;
use object::read::elf::{ElfFile32, FileHeader, ProgramHeader};
use shared::weights::IMAGE_BYTES;
use shared::weights::slots::after_first_store;

use super::{Release, VERSION, archives};
use crate::firmware::{self, BOARDS, Board, Images, without_key};
use crate::memory::{self, Region};
use crate::web_demo::remapped;

/// Weights that a new board runs.
const WEIGHTS: &str = "host/learn/controllers/adult.bin";
/// Value of an erased byte.
const ERASED: u8 = 0xFF;
/// Bytes of a line of Intel HEX.
const LINE: usize = 32;
/// Bytes that one address record of Intel HEX serves.
const BANK: u32 = 1 << 16;

/// What is written to flash without a gap.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Block {
    content: Content,
    address: u32,
    data: Vec<u8>,
}

impl Block {
    fn end(&self) -> u32 {
        self.address + self.data.len() as u32
    }
}

/// Builds the file of every board. Its owner may run own weights, so the images ask for no signature of theirs.
pub fn build(release: &Release<'_>) -> Result<()> {
    let _variables = without_key(release.shell);
    let _flags = release.shell.push_env("RUSTFLAGS", remapped(release.shell)?);
    let weights = release.shell.read_binary_file(WEIGHTS)?;
    let weights = weights.as_array().with_context(|| format!("{WEIGHTS} is no weights image"))?;
    for board in &BOARDS {
        let file = file(release, board, weights).with_context(|| board.name.to_owned())?;
        let path = release.folder.join(format!("eupnea-{VERSION}-{}.zip", board.name));
        release.shell.write_file(path, file)?;
    }
    emulated(release)
}

/// The images that `trainer qemu --images` and `demo --board` start.
fn emulated(release: &Release<'_>) -> Result<()> {
    let Images { hil, desk, shim, .. } = firmware::build(release.shell)?;
    let name = |path: &Path| path.file_name().map(|name| name.to_string_lossy().into_owned());
    let files = [hil, desk, shim].into_iter().filter_map(|path| Some((name(&path)?, path))).collect();
    archives::zip(&release.folder.join(format!("eupnea-{VERSION}-qemu.zip")), &files, release.time_s)
}

/// A board's release file.
fn file(release: &Release<'_>, board: &Board, weights: &[u8; IMAGE_BYTES]) -> Result<Vec<u8>> {
    let image = release.shell.read_binary_file(board.build(release.shell)?)?;
    let regions = memory::regions(&release.shell.read_file(board.map)?)?;
    let [a, b] = ["SLOT_A", "SLOT_B"].map(|name| memory::find(&regions, name));
    let slots = [a?, b?];
    let mut blocks = program(&image, &slots)?;
    // Both slots, so that no weights of an earlier program run with this one.
    for (slot, data) in slots.iter().zip(after_first_store(weights)) {
        ensure!(data.len() as u64 <= slot.length, "the weights do not fit into a slot");
        blocks.push(Block { content: Content::Weights, address: slot.origin as u32, data: data.to_vec() });
    }
    blocks.sort_by_key(|block| block.address);
    let name = |block: &Block| format!("{}-{:08x}.bin", board.name, block.address);
    let part = |block: &Block| Part {
        content: block.content,
        file: name(block),
        address: block.address,
        bytes: block.data.len() as u32,
    };
    let firmware = Firmware {
        version: VERSION.to_owned(),
        revision: release.revision.clone(),
        board: board.name.to_owned(),
        chip: chip_of(board.name).context("no chip is known of this board")?.to_owned(),
        image: board.about.to_owned(),
        // Both chips have it in ROM.
        usb_dfu: true,
        parts: blocks.iter().map(part).collect(),
    };
    let mut files: BTreeMap<String, Vec<u8>> =
        blocks.iter().map(|block| (name(block), block.data.clone())).collect();
    files.insert(format!("{}.hex", board.name), hex(&blocks)?.into_bytes());
    files.insert(format!("{}.dfu", board.name), dfuse::encode(&elements(&blocks))?);
    files.insert(format!("{}.elf", board.name), image);
    Ok(firmware_file::write(&firmware, &files, &release.key.0)?)
}

fn elements(blocks: &[Block]) -> Vec<dfuse::Element> {
    let element = |block: &Block| dfuse::Element { address: block.address, data: block.data.clone() };
    blocks.iter().map(element).collect()
}

/// The program in flash: one block, or two around the weights slots. Smaller gaps are erased flash, as on the chip.
fn program(image: &[u8], slots: &[&Region; 2]) -> Result<Vec<Block>> {
    let elf: ElfFile32 = ElfFile32::parse(image).context("the image is not a 32-bit ELF file")?;
    let endian = elf.endian();
    let mut segments = Vec::new();
    for header in elf.elf_header().program_headers(endian, image)? {
        if header.p_type(endian) == elf::PT_LOAD && header.p_filesz(endian) > 0 {
            let data = header.data(endian, image).ok().context("the image is cut short")?;
            let address = header.p_paddr(endian);
            segments.push(Block { content: Content::Program, address, data: data.to_vec() });
        }
    }
    segments.sort_by_key(|segment| segment.address);
    let mut blocks: Vec<Block> = Vec::new();
    for segment in segments {
        let around = |end: u32| {
            slots.iter().any(|slot| (u64::from(end)..=u64::from(segment.address)).contains(&slot.origin))
        };
        match blocks.last_mut() {
            Some(last) if !around(last.end()) => {
                let gap = segment.address.checked_sub(last.end()).context("the program overlaps itself")?;
                last.data.resize(last.data.len() + gap as usize, ERASED);
                last.data.extend(segment.data);
            }
            _ => blocks.push(segment),
        }
    }
    Ok(blocks)
}

/// Intel HEX.
fn hex(blocks: &[Block]) -> Result<String> {
    let mut records = Vec::new();
    for block in blocks {
        let mut address = block.address;
        let mut bank = None;
        let mut rest = block.data.as_slice();
        while !rest.is_empty() {
            if bank != Some(address / BANK) {
                bank = Some(address / BANK);
                records.push(Record::ExtendedLinearAddress((address / BANK) as u16));
            }
            let until_bank = (BANK - address % BANK) as usize;
            let (line, others) = rest.split_at(LINE.min(until_bank).min(rest.len()));
            records.push(Record::Data { offset: (address % BANK) as u16, value: line.to_vec() });
            (address, rest) = (address + line.len() as u32, others);
        }
    }
    records.push(Record::EndOfFile);
    Ok(ihex::create_object_file_representation(&records)? + "\n")
}

/// The private key of a release.
pub struct Key(KeyPair, Secret);

/// Whether only its owner has a key.
#[derive(PartialEq, Eq)]
enum Secret {
    Yes,
    /// It is in the tests' sources.
    No,
}

impl Key {
    /// A key that `trainer keys --out` has made.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
        let seed = text.trim().rsplit(':').next().and_then(seed).with_context(|| {
            format!("{} contains no private key: make one with `trainer keys --out FILE`", path.display())
        })?;
        Ok(Self(KeyPair::from_seed(Seed::new(seed)), Secret::Yes))
    }

    /// The key of the tests, which everyone has.
    pub fn of_the_tests() -> Self {
        Self(KeyPair::from_seed(Seed::new([42; Seed::BYTES])), Secret::No)
    }

    /// Whether only its owner has it.
    pub fn is_secret(&self) -> bool {
        self.1 == Secret::Yes
    }

    /// Its public half in hexadecimal.
    pub fn public(&self) -> String {
        ReleaseKey::of(&self.0).to_string()
    }

    /// Public key and signature of a text, a line each.
    pub fn sign(&self, text: &[u8]) -> String {
        firmware_file::seal(text, &self.0)
    }
}

/// 32 bytes in hexadecimal.
fn seed(text: &str) -> Option<[u8; Seed::BYTES]> {
    let digits = text.as_bytes().chunks(2).map(|pair| std::str::from_utf8(pair).ok());
    let bytes: Option<Vec<u8>> = digits.map(|pair| u8::from_str_radix(pair?, 16).ok()).collect();
    bytes?.try_into().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn block(address: u32, bytes: usize) -> Block {
        Block { content: Content::Program, address, data: (0..bytes).map(|byte| byte as u8).collect() }
    }

    #[test]
    fn a_hex_file_gives_every_byte_its_address() {
        let blocks = [block(0x0800_FFF0, 70_000), block(0x080C_0000, 33)];
        let mut memory = BTreeMap::new();
        let mut bank = 0;
        for record in ihex::Reader::new(&hex(&blocks).unwrap()).map(Result::unwrap) {
            match record {
                Record::ExtendedLinearAddress(high) => bank = u32::from(high) << 16,
                Record::Data { offset, value } => {
                    assert!(u32::from(offset) + value.len() as u32 <= BANK);
                    let address = bank + u32::from(offset);
                    memory
                        .extend(value.into_iter().enumerate().map(|(at, byte)| (address + at as u32, byte)));
                }
                _ => {}
            }
        }
        let expected = blocks.iter().flat_map(|block| {
            block.data.iter().enumerate().map(|(at, byte)| (block.address + at as u32, *byte))
        });
        assert_eq!(memory, expected.collect());
    }

    #[test]
    fn a_key_is_what_the_trainer_writes() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("release.key");
        std::fs::write(&path, format!("eupnea-weights-key:{}\n", "2a".repeat(32))).unwrap();
        let key = Key::load(&path).unwrap();
        assert_eq!(key.public(), Key::of_the_tests().public());
        assert!(key.is_secret() && !Key::of_the_tests().is_secret());
        for wrong in ["", "eupnea-weights-key:2a", "eupnea-weights-key:äöü"] {
            std::fs::write(&path, wrong).unwrap();
            let error = Key::load(&path).err().unwrap();
            assert!(error.to_string().contains("trainer keys"), "{error}");
        }
    }
}
