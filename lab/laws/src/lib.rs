//! Control laws that a learned controller is compared with: [`rivals`] from the literature, third-party programs ([`policy`]) and
//! reinforcement learning ([`rl`]).
#![forbid(unsafe_code)]

pub mod policy;
pub mod rivals;
pub mod rl;
