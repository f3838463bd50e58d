//! Reads the regions in `firmware/memory/`, so that the linker map is the only place that defines their sizes.

use anyhow::{Context, Result, bail};

/// One line of the linker map's `MEMORY` block.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Region {
    /// Name, such as `FLASH`.
    pub name: String,
    /// First address.
    pub origin: u64,
    /// Length in bytes.
    pub length: u64,
}

impl Region {
    /// Whether an address is in the region.
    pub fn contains(&self, address: u64) -> bool {
        (self.origin..self.origin + self.length).contains(&address)
    }
}

/// All regions of a linker map, in order.
pub fn regions(linker_map: &str) -> Result<Vec<Region>> {
    let lines = linker_map.lines().filter(|line| line.contains("ORIGIN =") && line.contains("LENGTH ="));
    lines
        .map(|line| region(line).with_context(|| format!("cannot read the memory region `{}`", line.trim())))
        .collect()
}

/// The region with this name.
pub fn find<'a>(regions: &'a [Region], name: &str) -> Result<&'a Region> {
    let found = regions.iter().find(|region| region.name == name);
    found.with_context(|| format!("the linker map has no region {name}; add it to the MEMORY block"))
}

fn region(line: &str) -> Result<Region> {
    let words = line.split(|character: char| !(character.is_ascii_alphanumeric() || character == '_'));
    let words: Vec<&str> = words.filter(|word| !word.is_empty()).collect();
    let [name, "ORIGIN", origin, "LENGTH", length, ..] = words[..] else {
        bail!("expected `NAME : ORIGIN = number, LENGTH = number`");
    };
    Ok(Region { name: name.to_owned(), origin: number(origin)?, length: number(length)? })
}

/// A number of a linker map: decimal or hexadecimal, optionally with K or M.
fn number(text: &str) -> Result<u64> {
    let (digits, unit) = match text.strip_suffix(['K', 'M']) {
        Some(digits) if text.ends_with('K') => (digits, 1024),
        Some(digits) => (digits, 1024 * 1024),
        None => (text, 1),
    };
    let parsed = match digits.strip_prefix("0x") {
        Some(hexadecimal) => u64::from_str_radix(hexadecimal, 16),
        None => digits.parse(),
    };
    match parsed.ok().and_then(|value| value.checked_mul(unit)) {
        Some(value) => Ok(value),
        None => bail!("`{text}` is not a number in the format of a linker map"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The regions of each board and image, and the size of its flash, bytes. The last two are images for the desk.
    const CHIPS: [(&str, u64); 4] = [
        (include_str!("../../firmware/memory/stm32f405.x"), 1024 * 1024),
        (include_str!("../../firmware/memory/stm32f446.x"), 512 * 1024),
        (include_str!("../../firmware/memory/stm32f405-desk.x"), 1024 * 1024),
        (SMALL_DESK, 512 * 1024),
    ];
    const SMALL_DESK: &str = include_str!("../../firmware/memory/stm32f446-desk.x");

    #[test]
    fn units_and_bases_are_read() {
        for (text, value) in [("48K", 49_152), ("1M", 1_048_576), ("0x20000000", 0x2000_0000), ("7", 7)] {
            assert_eq!(number(text).unwrap(), value);
        }
        assert!(number("lots").is_err());
    }

    #[test]
    fn a_broken_line_is_quoted() {
        let error = regions("  RAM : ORIGIN = 0x20000000, LENGTH = many").unwrap_err();
        assert!(format!("{error:#}").contains("LENGTH = many"));
    }

    #[test]
    fn the_weight_slots_are_the_flashs_last_two_sectors() {
        const SECTOR: u64 = 128 * 1024;
        for (map, bytes) in CHIPS.into_iter().filter(|(map, _)| *map != SMALL_DESK) {
            let regions = regions(map).unwrap();
            let [flash, a, b] = ["FLASH", "SLOT_A", "SLOT_B"].map(|name| find(&regions, name).unwrap());
            let end = flash.origin + bytes;
            assert_eq!((a.origin, a.length), (end - 2 * SECTOR, SECTOR));
            assert_eq!((b.origin, b.length), (end - SECTOR, SECTOR));
            let calibrations =
                regions.iter().find(|region| region.name == "CALIBRATIONS" && region.length > 0);
            let after = calibrations.unwrap_or(a).origin;
            assert_eq!(flash.origin + flash.length, after, "the program ends where its data begins");
        }
    }

    #[test]
    fn the_weight_slots_of_a_small_desk_are_the_flashs_second_and_third_sector() {
        const SECTOR: u64 = 16 * 1024;
        let regions = regions(SMALL_DESK).unwrap();
        let [flash, a, b] = ["FLASH", "SLOT_A", "SLOT_B"].map(|name| find(&regions, name).unwrap());
        assert_eq!((a.origin, a.length), (flash.origin + SECTOR, SECTOR));
        assert_eq!((b.origin, b.length), (flash.origin + 2 * SECTOR, SECTOR));
        assert!(SECTOR >= u64::from(shared::weights::slots::SLOT_BYTES));
        assert!(
            SMALL_DESK.contains("\n_stext = ORIGIN(SLOT_B) + LENGTH(SLOT_B);\n"),
            "the code is behind them"
        );
    }

    #[test]
    fn the_desks_have_the_same_stack_and_room_for_variables() {
        let [main, small] = [CHIPS[2].0, SMALL_DESK].map(|map| regions(map).unwrap());
        for name in ["STACK", "RAM"] {
            assert_eq!(find(&main, name).unwrap(), find(&small, name).unwrap(), "QEMU tests both");
        }
    }

    #[test]
    fn each_copy_of_the_flight_recorder_has_a_sector_of_its_own_on_the_main_board() {
        let regions = regions(CHIPS[0].0).unwrap();
        let [a, b, slots] = ["COPY_A", "COPY_B", "SLOT_A"].map(|name| find(&regions, name).unwrap());
        assert_eq!((b.origin - a.origin, slots.origin - b.origin), (128 * 1024, 128 * 1024));
        for copy in [a, b] {
            assert_eq!(copy.length, 128 * 1024);
            assert!(copy.length >= u64::from(shared::recorder::keeper::Keeper::BYTES));
        }
    }

    #[test]
    fn the_calibrations_have_the_sector_before_the_copies_on_the_main_board() {
        let regions = regions(CHIPS[0].0).unwrap();
        let [calibrations, copies] = ["CALIBRATIONS", "COPY_A"].map(|name| find(&regions, name).unwrap());
        assert_eq!((calibrations.length, copies.origin - calibrations.origin), (128 * 1024, 128 * 1024));
    }

    #[test]
    fn the_flight_recorder_fits_into_its_region_on_every_board() {
        use shared::recorder::entry::TICK_BYTES;
        use shared::recorder::{RecorderMemory, SHORT_SLOW_ENTRIES, SLOW_ENTRIES};
        let whole = size_of::<RecorderMemory>();
        let short = whole - TICK_BYTES * (SLOW_ENTRIES - SHORT_SLOW_ENTRIES);
        for ((map, _), needed) in CHIPS.into_iter().zip([whole, whole, short, short]) {
            let room = find(&regions(map).unwrap(), "RECORDER").unwrap().length;
            assert!(room >= needed as u64 && room <= 64 * 1024, "{room} bytes");
        }
    }

    #[test]
    fn the_prescription_fits_into_its_region_on_every_board() {
        for (map, _) in CHIPS {
            let room = find(&regions(map).unwrap(), "PRESCRIPTION").unwrap().length;
            assert!(
                room >= size_of::<shared::device::prescription::PrescriptionMemory>() as u64,
                "{room} bytes"
            );
        }
    }

    #[test]
    fn a_stack_that_overflows_leaves_ram() {
        const START_OF_RAM: u64 = 0x2000_0000;
        for (map, _) in CHIPS {
            assert_eq!(find(&regions(map).unwrap(), "STACK").unwrap().origin, START_OF_RAM);
        }
    }

    #[test]
    fn no_two_regions_overlap() {
        for (map, _) in CHIPS {
            let mut regions = regions(map).unwrap();
            assert_eq!(regions.len(), 10);
            regions.retain(|region| region.length > 0);
            if map == SMALL_DESK {
                // The program has a gap for them.
                regions.retain(|region| !region.name.starts_with("SLOT"));
            }
            regions.sort_by_key(|region| region.origin);
            for pair in regions.windows(2) {
                assert!(pair[0].origin + pair[0].length <= pair[1].origin, "{pair:?}");
            }
        }
    }
}
