//! Evaluation: scores of any controller, baselines and bounds, and behaviour under faults.
#![forbid(unsafe_code)]

pub mod accuracy;
pub mod balloon;
pub mod baselines;
pub mod bound;
pub mod breathing;
pub mod endure;
pub mod evaluate;
pub mod faults;
pub mod identify;
pub mod margins;
pub mod policy;
pub mod rivals;
pub mod rl;
pub mod robust;
pub mod simulator;
pub mod test_table;
pub mod verdict;
