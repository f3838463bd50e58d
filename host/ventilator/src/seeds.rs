//! Families of random seeds, one per purpose, all derived from the user's single seed.
//!
//! A controller must not be judged on noise that it was tuned or trained on. Each family therefore has its own tag in
//! the highest bits: no two families ever share a seed, whatever the user's seeds.

/// Number of bits below the tag. With three tag bits every seed is below 2^53, which any JSON reader keeps exactly.
const TAG_SHIFT: u32 = 50;
/// Number of noise sequences that an evaluation averages over.
pub const EVALUATIONS: u64 = 5;

/// The purpose of a seed; the number is the tag.
#[derive(Clone, Copy)]
enum Purpose {
    Tuning = 1,
    Collection = 2,
    Training = 3,
    HeldOutSimulator = 4,
    Evaluation = 5,
    Robustness = 6,
    Units = 7,
}

/// Noise under which the baselines are tuned.
pub fn tuning(seed: u64) -> u64 {
    derive(Purpose::Tuning, seed, 0)
}

/// Noise and exploration of the data collected in a round.
pub fn collection(seed: u64, round: u64) -> u64 {
    derive(Purpose::Collection, seed, round)
}

/// Initial weights and shuffling of a round of training.
pub fn training(seed: u64, round: u64) -> u64 {
    derive(Purpose::Training, seed, round)
}

/// Data and weights of the simulator that validates a controller but never trains it.
pub fn held_out_simulator(seed: u64) -> u64 {
    derive(Purpose::HeldOutSimulator, seed, 0)
}

/// The [`EVALUATIONS`] noise sequences of reported scores.
pub fn evaluation(seed: u64) -> Vec<u64> {
    (0..EVALUATIONS).map(|index| derive(Purpose::Evaluation, seed, index)).collect()
}

/// Units of a family that a controller is trained on.
pub fn units(seed: u64) -> u64 {
    derive(Purpose::Units, seed, 0)
}

/// Noise of a plant of a family, in a robustness test.
pub fn plant(seed: u64, number: u64) -> u64 {
    derive(Purpose::Robustness, seed, number)
}

fn derive(purpose: Purpose, seed: u64, index: u64) -> u64 {
    let low = scramble(scramble(seed).wrapping_add(index)) >> (u64::BITS - TAG_SHIFT);
    (purpose as u64) << TAG_SHIFT | low
}

/// The output function of `SplitMix64` (Steele, Lea, Flood 2014), which makes neighbouring seeds unrelated.
fn scramble(seed: u64) -> u64 {
    let mut z = seed.wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::HashSet;

    /// One list per family of the seeds derived from a user's seed.
    fn families(seed: u64, round: u64) -> [Vec<u64>; 5] {
        [
            vec![tuning(seed)],
            vec![collection(seed, round)],
            vec![training(seed, round)],
            vec![held_out_simulator(seed)],
            evaluation(seed),
        ]
    }

    proptest! {
        #[test]
        fn families_never_meet(
            seeds in prop::array::uniform2(any::<u64>()), rounds in prop::array::uniform2(any::<u64>()),
        ) {
            let (one, other) = (families(seeds[0], rounds[0]), families(seeds[1], rounds[1]));
            for (index, family) in one.iter().enumerate() {
                for (_, foreign) in other.iter().enumerate().filter(|(theirs, _)| *theirs != index) {
                    prop_assert!(family.iter().all(|seed| !foreign.contains(seed)));
                }
            }
        }

        #[test]
        fn seeds_survive_json_readers_that_know_only_doubles(seed in any::<u64>(), round in any::<u64>()) {
            prop_assert!(families(seed, round).iter().flatten().all(|seed| *seed < 1 << 53));
        }
    }

    #[test]
    fn rounds_and_users_seeds_give_different_seeds() {
        let all: Vec<u64> =
            (0..50).flat_map(|seed| (0..20).map(move |round| collection(seed, round))).collect();
        assert_eq!(all.iter().collect::<HashSet<_>>().len(), all.len());
    }

    #[test]
    fn an_evaluation_averages_over_several_noise_sequences() {
        let distinct: HashSet<u64> = evaluation(7).into_iter().collect();
        assert_eq!(distinct.len() as u64, EVALUATIONS);
        assert_eq!(evaluation(7), evaluation(7));
    }
}
