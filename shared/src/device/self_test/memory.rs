//! A test of RAM: the march test C- of words, block by block, after which every word has its old content.
//!
//! It detects bits that are stuck or do not change, and words that change or shadow others of their block. It does not detect
//! address lines that are shorted beyond a block.

/// Words of a block.
pub const BLOCK: usize = 256;

/// Memory that is tested.
pub trait Words {
    /// Number of words.
    fn length(&self) -> usize;
    /// The word at an index below the length.
    fn load(&self, index: usize) -> u32;
    /// Stores a word at an index below the length.
    fn store(&mut self, index: usize, word: u32);
}

/// Whether the memory keeps its content. It is restored even if not, as far as the memory lets it.
#[inline(never)]
pub fn is_sound(memory: &mut impl Words) -> bool {
    let mut kept = [0; BLOCK];
    let mut sound = true;
    for start in (0..memory.length()).step_by(BLOCK) {
        let length = BLOCK.min(memory.length() - start);
        let kept = &mut kept[..length];
        kept.iter_mut().enumerate().for_each(|(index, word)| *word = memory.load(start + index));
        for background in [0, 0x5555_5555] {
            sound &= march(memory, start, length, background);
        }
        kept.iter().enumerate().for_each(|(index, word)| memory.store(start + index, *word));
        sound &= kept.iter().enumerate().all(|(index, word)| memory.load(start + index) == *word);
    }
    sound
}

/// A march with a background and its complement: write; up: read, write complement; up: read complement, write; the same
/// down; read.
fn march(memory: &mut impl Words, start: usize, length: usize, background: u32) -> bool {
    let mut sound = true;
    let mut turn = |memory: &mut _, index: usize, expected: u32| {
        let place = start + index;
        sound &= Words::load(memory, place) == expected;
        Words::store(memory, place, !expected);
    };
    (0..length).for_each(|index| memory.store(start + index, background));
    (0..length).for_each(|index| turn(memory, index, background));
    (0..length).for_each(|index| turn(memory, index, !background));
    (0..length).rev().for_each(|index| turn(memory, index, background));
    (0..length).rev().for_each(|index| turn(memory, index, !background));
    sound && (0..length).all(|index| memory.load(start + index) == background)
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    /// What is wrong with a memory.
    #[derive(Clone, Copy, Debug)]
    enum Defect {
        None,
        /// Bits of a word that are always 0, or always 1.
        StuckAtZero(usize, u32),
        StuckAtOne(usize, u32),
        /// Bits of a word that do not change to 1, or to 0, once they are the other.
        NoRise(usize, u32),
        NoFall(usize, u32),
        /// A change of the first word changes the second one.
        Couples(usize, usize, u32),
        /// Two addresses of one word.
        Shadows(usize, usize),
    }

    struct Ram {
        words: Vec<u32>,
        defect: Defect,
    }

    impl Words for Ram {
        fn length(&self) -> usize {
            self.words.len()
        }

        fn load(&self, index: usize) -> u32 {
            match self.defect {
                Defect::StuckAtZero(place, bits) if place == index => self.words[index] & !bits,
                Defect::StuckAtOne(place, bits) if place == index => self.words[index] | bits,
                Defect::Shadows(place, shadow) if place == index => self.words[shadow],
                _ => self.words[index],
            }
        }

        fn store(&mut self, index: usize, word: u32) {
            let before = self.words[index];
            self.words[index] = match self.defect {
                Defect::NoRise(place, bits) if place == index => word & !(bits & !before),
                Defect::NoFall(place, bits) if place == index => word | bits & before,
                _ => word,
            };
            match self.defect {
                Defect::Couples(from, to, bits) if from == index && before != word => self.words[to] ^= bits,
                Defect::Shadows(place, shadow) if place == index => self.words[shadow] = word,
                _ => {}
            }
        }
    }

    /// Two blocks and a part of one.
    const LENGTH: usize = 2 * BLOCK + 10;

    fn ram(defect: Defect) -> Ram {
        Ram { words: (0..LENGTH as u32).map(|index| index.wrapping_mul(0x9E37_79B9)).collect(), defect }
    }

    #[test]
    fn sound_memory_passes_and_keeps_its_content() {
        let mut memory = ram(Defect::None);
        assert!(is_sound(&mut memory));
        assert_eq!(memory.words, ram(Defect::None).words);
        assert!(is_sound(&mut Ram { words: Vec::new(), defect: Defect::None }));
    }

    #[test]
    fn every_kind_of_defect_is_found_in_every_block() {
        for place in [0, 1, BLOCK - 1, BLOCK, BLOCK + 77, LENGTH - 2] {
            let (bits, other) =
                (1 << (place % 32), if place % BLOCK == BLOCK - 1 { place - 1 } else { place + 1 });
            for defect in [
                Defect::StuckAtZero(place, bits),
                Defect::StuckAtOne(place, bits),
                Defect::NoRise(place, bits),
                Defect::NoFall(place, bits),
                Defect::Couples(place, other, bits),
                Defect::Couples(other, place, bits),
                Defect::Shadows(place, other),
                Defect::Shadows(other, place),
            ] {
                assert!(!is_sound(&mut ram(defect)), "{defect:?}");
            }
        }
    }
}
