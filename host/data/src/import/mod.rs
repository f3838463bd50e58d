//! Third-party recordings: [`respiraworks`] reads one known format, [`foreign`] any table by a map of its columns.

pub mod foreign;
pub mod respiraworks;
mod rises;
