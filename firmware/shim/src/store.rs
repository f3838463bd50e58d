//! Widths of loads and stores, and the effect of a narrow store on a word.

/// Width of an access.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Width {
    /// 8 bits.
    Byte = 1,
    /// 16 bits.
    Half = 2,
    /// 32 bits.
    Word = 4,
}

impl Width {
    /// Number of bytes.
    #[inline]
    pub fn bytes(self) -> u32 {
        self as u32
    }

    /// Mask for the lowest bits of this width.
    #[inline]
    pub fn mask(self) -> u32 {
        !0 >> (32 - 8 * self.bytes())
    }
}

/// A store in terms of the 32-bit word that contains its address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Store {
    value: u32,
    mask: u32,
}

impl Store {
    /// A store of the lower `width` of `value` to `address`.
    #[inline]
    pub fn new(address: u32, width: Width, value: u32) -> Self {
        let shift = 8 * (address & 3);
        let mask = width.mask() << shift;
        Self { value: value << shift & mask, mask }
    }

    /// A store of a whole word.
    #[inline]
    pub fn word(value: u32) -> Self {
        Self { value, mask: !0 }
    }

    /// The stored bits, zeros elsewhere: for registers in which ones act and zeros have no effect.
    #[inline]
    pub fn bits(self) -> u32 {
        self.value
    }

    /// Value of the word after the store.
    #[inline]
    pub fn over(self, old: u32) -> u32 {
        old & !self.mask | self.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_narrow_store_changes_its_bytes_alone() {
        assert_eq!(Store::new(0x4001, Width::Byte, 0xABCD).over(0x1122_3344), 0x1122_CD44);
        assert_eq!(Store::new(0x4002, Width::Half, 0xABCD).over(0x1122_3344), 0xABCD_3344);
        assert_eq!(Store::new(0x4000, Width::Word, 0xABCD).over(0x1122_3344), 0xABCD);
    }

    #[test]
    fn a_narrow_store_sets_no_bits_elsewhere() {
        assert_eq!(Store::new(0x4003, Width::Byte, 0xFFFF_FFFF).bits(), 0xFF00_0000);
    }
}
