//! Decodes Thumb instructions that load or store one register, and advances the program status past them.
//!
//! Encodings: `ARMv7-M` Architecture Reference Manual, A5.2.4 (16 bits), A5.3.7 to A5.3.10 (32 bits).

use crate::store::Width;

/// Stack pointer and program counter, which no supported access uses.
const SP: u16 = 13;
const PC: u16 = 15;

/// Direction of the transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// Memory to register; a narrow value is zero-extended.
    Load,
    /// Memory to register; a narrow value is sign-extended.
    LoadSigned,
    /// Register to memory.
    Store,
}

/// Offset that is added to the base register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Offset {
    /// A constant.
    Immediate(i32),
    /// The value of a register, shifted left.
    Register {
        /// Number of the register.
        number: u8,
        /// Number of bits of the shift.
        shift: u8,
    },
}

/// A load or store of one register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// Direction of the transfer.
    pub direction: Direction,
    /// Width of the transfer.
    pub width: Width,
    /// Number of the register, 0 to 12 or 14.
    pub register: u8,
    /// Number of the register with the base address, 0 to 12 or 14.
    pub base: u8,
    /// Offset from the base.
    pub offset: Offset,
    /// Length of the instruction, bytes.
    pub length: u32,
}

impl Access {
    /// Address of the access for these register values.
    #[inline]
    pub fn address(&self, mut value: impl FnMut(u8) -> u32) -> u32 {
        let offset = match self.offset {
            Offset::Immediate(offset) => offset as u32,
            Offset::Register { number, shift } => value(number) << shift,
        };
        value(self.base).wrapping_add(offset)
    }
}

/// Decodes an instruction. Returns none for forms that have further effects (write-back of the address, several registers,
/// exclusive and unprivileged access), and if the base is the stack pointer or the program counter, since no device is
/// there.
///
/// `second` is used only if `first` begins a 32-bit instruction.
#[inline]
pub fn decode(first: u16, second: u16) -> Option<Access> {
    if is_wide(first) { wide(first, second) } else { narrow(first) }
}

/// Whether a half-word begins a 32-bit instruction.
#[inline]
pub fn is_wide(first: u16) -> bool {
    first >> 11 >= 0b11101
}

#[inline]
fn narrow(first: u16) -> Option<Access> {
    use Direction::{Load, LoadSigned, Store};
    let (direction, width) = match first >> 11 {
        0b01100 => (Store, Width::Word),
        0b01101 => (Load, Width::Word),
        0b01110 => (Store, Width::Byte),
        0b01111 => (Load, Width::Byte),
        0b10000 => (Store, Width::Half),
        0b10001 => (Load, Width::Half),
        0b01010 | 0b01011 => match first >> 9 & 7 {
            0 => (Store, Width::Word),
            1 => (Store, Width::Half),
            2 => (Store, Width::Byte),
            3 => (LoadSigned, Width::Byte),
            4 => (Load, Width::Word),
            5 => (Load, Width::Half),
            6 => (Load, Width::Byte),
            _ => (LoadSigned, Width::Half),
        },
        _ => return None,
    };
    let offset = if first >> 12 == 0b0101 {
        Offset::Register { number: (first >> 6 & 7) as u8, shift: 0 }
    } else {
        Offset::Immediate(i32::from(first >> 6 & 0x1F) * width.bytes() as i32)
    };
    let (register, base) = ((first & 7) as u8, (first >> 3 & 7) as u8);
    Some(Access { direction, width, register, base, offset, length: 2 })
}

#[inline]
fn wide(first: u16, second: u16) -> Option<Access> {
    let (signed, load) = (first >> 8 & 1 == 1, first >> 4 & 1 == 1);
    let (base, register) = (first & 0xF, second >> 12);
    let width = match first >> 5 & 3 {
        0 => Width::Byte,
        1 => Width::Half,
        2 => Width::Word,
        _ => return None,
    };
    let direction = match (load, signed, width) {
        (true, false, _) => Direction::Load,
        (true, true, Width::Byte | Width::Half) => Direction::LoadSigned,
        (false, false, _) => Direction::Store,
        _ => return None,
    };
    let offset = if first >> 7 & 1 == 1 {
        Offset::Immediate((second & 0xFFF).into())
    } else if (second >> 6).trailing_zeros() >= 6 {
        Offset::Register { number: (second & 0xF) as u8, shift: (second >> 4 & 3) as u8 }
    } else if second >> 8 & 0xF == 0b1100 {
        Offset::Immediate(-i32::from(second & 0xFF))
    } else {
        // With write-back, or unprivileged.
        return None;
    };
    let single = first >> 9 == 0b111_1100;
    if !single || [base, register].iter().any(|&number| number == SP || number == PC) {
        return None;
    }
    Some(Access { direction, width, register: register as u8, base: base as u8, offset, length: 4 })
}

/// The program status register after an emulated instruction: the state of an IT (if-then) block advances by one
/// instruction.
#[inline]
pub fn behind(status: u32) -> u32 {
    const FIELD: u32 = 0x0600_FC00;
    let state = status >> 8 & 0xFC | status >> 25 & 3;
    // The lower five bits contain the remaining conditions; the block ends when the last three are zero.
    let state = if state.trailing_zeros() >= 3 { 0 } else { state & 0xE0 | state << 1 & 0x1F };
    status & !FIELD | (state & 0xFC) << 8 | (state & 3) << 25
}

#[cfg(test)]
mod tests {
    use super::*;
    use Direction::{Load, LoadSigned, Store};

    /// An access with base r0.
    fn access(
        direction: Direction,
        width: Width,
        register: u8,
        offset: Offset,
        length: u32,
    ) -> Option<Access> {
        Some(Access { direction, width, register, base: 0, offset, length })
    }

    fn by(offset: i32) -> Offset {
        Offset::Immediate(offset)
    }

    fn r1(shift: u8) -> Offset {
        Offset::Register { number: 1, shift }
    }

    #[test]
    fn narrow_forms_are_read() {
        for (code, expected) in [
            (0x6001, access(Store, Width::Word, 1, by(0), 2)), // str r1, [r0]
            (0x6842, access(Load, Width::Word, 2, by(4), 2)),  // ldr r2, [r0, #4]
            (0x7003, access(Store, Width::Byte, 3, by(0), 2)), // strb r3, [r0]
            (0x7804, access(Load, Width::Byte, 4, by(0), 2)),  // ldrb r4, [r0]
            (0x8085, access(Store, Width::Half, 5, by(4), 2)), // strh r5, [r0, #4]
            (0x8806, access(Load, Width::Half, 6, by(0), 2)),  // ldrh r6, [r0]
            (0x5047, access(Store, Width::Word, 7, r1(0), 2)), // str r7, [r0, r1]
            (0x5647, access(LoadSigned, Width::Byte, 7, r1(0), 2)), // ldrsb r7, [r0, r1]
            (0x5E47, access(LoadSigned, Width::Half, 7, r1(0), 2)), // ldrsh r7, [r0, r1]
            (0x5847, access(Load, Width::Word, 7, r1(0), 2)),  // ldr r7, [r0, r1]
        ] {
            assert_eq!(decode(code, 0xFFFF), expected, "{code:#06x}");
        }
    }

    #[test]
    fn wide_forms_are_read() {
        for (first, second, expected) in [
            (0xF8C0, 0xC004, access(Store, Width::Word, 12, by(4), 4)), // str.w r12, [r0, #4]
            (0xF8D0, 0xE004, access(Load, Width::Word, 14, by(4), 4)),  // ldr.w lr, [r0, #4]
            (0xF880, 0x8004, access(Store, Width::Byte, 8, by(4), 4)),  // strb.w r8, [r0, #4]
            (0xF8B0, 0x9004, access(Load, Width::Half, 9, by(4), 4)),   // ldrh.w r9, [r0, #4]
            (0xF990, 0x9004, access(LoadSigned, Width::Byte, 9, by(4), 4)), // ldrsb.w r9, [r0, #4]
            (0xF840, 0x1C04, access(Store, Width::Word, 1, by(-4), 4)), // str r1, [r0, #-4]
            (0xF850, 0x1021, access(Load, Width::Word, 1, r1(2), 4)),   // ldr.w r1, [r0, r1, lsl #2]
        ] {
            assert_eq!(decode(first, second), expected, "{first:#06x} {second:#06x}");
        }
    }

    #[test]
    fn forms_that_change_more_than_one_register_are_none() {
        for (first, second, name) in [
            (0xF840, 0x1B04, "str r1, [r0], #4"),
            (0xF840, 0x1F04, "str r1, [r0, #4]!"),
            (0xF850, 0x1904, "ldr r1, [r0], #-4"),
            (0xF850, 0x1E04, "ldrt r1, [r0, #4]"),
            (0xE9C0, 0x1200, "strd r1, r2, [r0]"),
            (0xE880, 0x0006, "stm.w r0, {r1, r2}"),
            (0xE850, 0x1F00, "ldrex r1, [r0]"),
            (0xC006, 0, "stm r0!, {r1, r2}"),
            (0xB406, 0, "push {r1, r2}"),
            (0xED80, 0x0A00, "vstr s0, [r0]"),
        ] {
            assert_eq!(decode(first, second), None, "{name}");
        }
    }

    #[test]
    fn the_address_is_base_and_offset() {
        let address = |first, second| decode(first, second).unwrap().address(|n| 0x1000 + u32::from(n));
        assert_eq!(address(0x6842, 0), 0x1004, "ldr r2, [r0, #4]");
        assert_eq!(address(0x8893, 0), 0x1006, "ldrh r3, [r2, #4]");
        assert_eq!(address(0xF841, 0x1C04), 0x0FFD, "str r1, [r1, #-4]");
        assert_eq!(address(0xF850, 0x1021), 0x5004, "ldr.w r1, [r0, r1, lsl #2]");
        assert_eq!(address(0xF8CE, 0x1FFF), 0x200D, "str.w r1, [lr, #4095]");
    }

    #[test]
    fn stack_pointer_and_program_counter_are_no_part_of_it() {
        assert_eq!(decode(0xF8D0, 0xD004), None, "ldr sp, [r0, #4]");
        assert_eq!(decode(0xF8D0, 0xF004), None, "ldr pc, [r0, #4]");
        assert_eq!(decode(0xF8DF, 0x1004), None, "ldr r1, [pc, #4]");
        assert_eq!(decode(0xF8DD, 0x1004), None, "ldr.w r1, [sp, #4]");
        assert_eq!(decode(0x9901, 0), None, "ldr r1, [sp, #4]");
    }

    #[test]
    fn what_is_no_load_or_store_is_none() {
        for (first, second) in
            [(0x4770, 0), (0xF000, 0xB800), (0xFFFF, 0xFFFF), (0x0000, 0), (0xF8F0, 0x1000)]
        {
            assert_eq!(decode(first, second), None, "{first:#06x}");
        }
    }

    /// A status with this IT state and all other bits set.
    fn status(it: u32) -> u32 {
        !0x0600_FC00 | (it & 0xFC) << 8 | (it & 3) << 25
    }

    #[test]
    fn the_it_state_moves_on_by_one_instruction() {
        // ITTE EQ: conditions EQ, EQ, NE.
        assert_eq!(behind(status(0b0000_0110)), status(0b0000_1100));
        assert_eq!(behind(status(0b0000_1100)), status(0b0001_1000));
    }

    #[test]
    fn the_last_instruction_of_an_it_block_ends_it() {
        assert_eq!(behind(status(0b0001_1000)), status(0));
    }

    #[test]
    fn outside_of_it_blocks_the_status_stays() {
        assert_eq!(behind(status(0)), status(0));
        assert_eq!(behind(0x6100_0003), 0x6100_0003);
    }
}
