//! Containers: they grow with the description on a computer, and have a fixed capacity on a chip, which has no heap.

/// Most faults of a description on a chip: each may take thousands of instructions in each step.
pub const MOST_FAULTS: usize = 2;
/// Most changes of the leak in a description on a chip.
pub const MOST_LEAK_CHANGES: usize = 16;
/// Longest delay of a reading on a chip, ms.
pub const MOST_DELAY_MS: usize = 250;
/// Longest name of a description on a chip, bytes.
pub const MOST_NAME_BYTES: usize = 32;

#[cfg(feature = "std")]
mod kind {
    /// A list; on a chip of at most `N` elements.
    pub type List<T, const N: usize> = Vec<T>;
    /// A text; on a chip of at most `N` bytes.
    pub type Text<const N: usize> = String;
}

#[cfg(not(feature = "std"))]
mod kind {
    /// A list of at most `N` elements.
    pub type List<T, const N: usize> = heapless::Vec<T, N>;
    /// A text of at most `N` bytes.
    pub type Text<const N: usize> = heapless::String<N>;
}

pub use kind::{List, Text};
