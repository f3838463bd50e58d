//! The flash of a connected chip, as its boot loader describes it.

use crate::error::DfuError;

/// Sectors of a chip's flash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layout(Vec<Sector>);

/// Address and length, bytes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Sector {
    address: u32,
    bytes: u32,
}

impl Layout {
    /// Reads the name of the interface (UM0424, section 10.3.2), for example
    /// `@Internal Flash  /0x08000000/04*016Kg,01*064Kg,07*128Kg`.
    ///
    /// # Errors
    /// [`DfuError::NoFlash`].
    pub fn parse(name: &str) -> Result<Self, DfuError> {
        sectors(name).map(Self).ok_or_else(|| DfuError::NoFlash(name.to_owned()))
    }

    /// Length of the flash, KiB.
    pub fn kib(&self) -> u32 {
        self.0.iter().map(|sector| sector.bytes >> 10).sum()
    }

    /// Addresses of the sectors that contain a block of at least one byte.
    ///
    /// # Errors
    /// [`DfuError::Outside`].
    pub(crate) fn sectors(&self, address: u32, bytes: u32) -> Result<Vec<u32>, DfuError> {
        let (mut next, end) = (u64::from(address), u64::from(address) + u64::from(bytes));
        let mut found = Vec::new();
        while next < end {
            let inside = |sector: &&Sector| {
                (u64::from(sector.address)..u64::from(sector.address) + u64::from(sector.bytes))
                    .contains(&next)
            };
            let sector = self.0.iter().find(inside).ok_or(DfuError::Outside(next as u32))?;
            found.push(sector.address);
            next = u64::from(sector.address) + u64::from(sector.bytes);
        }
        Ok(found)
    }
}

fn sectors(name: &str) -> Option<Vec<Sector>> {
    let mut fields = name.strip_prefix("@Internal Flash")?.split('/').map(str::trim);
    fields.next().filter(|rest| rest.is_empty())?;
    let address = fields.next()?.strip_prefix("0x")?;
    let mut address = u32::from_str_radix(address, 16).ok()?;
    let mut sectors = Vec::new();
    for group in fields.next()?.split(',') {
        let (count, kind) = group.split_once('*')?;
        // Of the kinds of memory only this one can be read, erased and written.
        let kib: u32 = kind.strip_suffix("Kg")?.parse().ok()?;
        for _ in 0..count.parse::<u8>().ok()? {
            let bytes = kib.checked_mul(1 << 10).filter(|bytes| *bytes > 0)?;
            sectors.push(Sector { address, bytes });
            address = address.checked_add(bytes)?;
        }
    }
    Some(sectors).filter(|sectors| !sectors.is_empty())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;
    use crate::rom::{F405, F446};

    #[test]
    fn the_sectors_of_the_boards_chips_are_known() {
        let [main, nucleo] = [F405, F446].map(|name| Layout::parse(name).unwrap());
        assert_eq!([main.kib(), nucleo.kib()], [1024, 512]);
        assert_eq!(main.sectors(0x0800_0000, 0x8001).unwrap(), [0x0800_0000, 0x0800_4000, 0x0800_8000]);
        assert_eq!(main.sectors(0x080E_0000, 0x2_0000).unwrap(), [0x080E_0000]);
        assert_eq!(main.sectors(0x080E_0000, 0x2_0001), Err(DfuError::Outside(0x0810_0000)));
        assert_eq!(nucleo.sectors(0x080C_0000, 1), Err(DfuError::Outside(0x080C_0000)));
        assert_eq!(nucleo.sectors(u32::MAX, u32::MAX), Err(DfuError::Outside(u32::MAX)));
    }

    #[test]
    fn another_memory_is_no_flash() {
        for name in [
            "",
            "@Option Bytes  /0x1FFFC000/01*016 e",
            "@Internal Flash  /0x08000000/04*016Ka",
            "@Internal Flash  /0x08000000/",
            "@Internal Flash  /0xFFFFFFFF/04*016Kg",
            "@Internal Flash  /0x08000000/01*999999999Kg",
        ] {
            assert_eq!(Layout::parse(name), Err(DfuError::NoFlash(name.to_owned())));
        }
    }

    proptest! {
        #[test]
        fn no_name_causes_a_panic(name in "@Internal Flash {0,2}/0x[0-9A-F]{0,9}/[0-9*Kg,]{0,12}", at: u32, bytes in 1_u32..) {
            if let Ok(layout) = Layout::parse(&name) {
                let _ = layout.sectors(at, bytes);
            }
        }
    }
}
