//! Faults on the virtual bench: does the right monitor fire, soon enough, and does the true pressure stay bearable?

mod flash;
pub mod injection;
pub mod matrix;
mod rig;
pub mod torture;
pub mod trial;
