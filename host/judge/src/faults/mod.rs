//! Faults on the virtual bench: does the right monitor fire, soon enough, and does the true pressure stay bearable?
//!
//! | file | what |
//! |---|---|
//! | [`injection`] | what can go wrong: sensor, parts, controller, time |
//! | `flash` | weights in a flash memory that loses its supply |
//! | `rig` | the device of a trial, its weights and its host |
//! | [`trial`] | one device, one lung, one fault |
//! | [`matrix`] | every fault on every lung, each with the monitor that must fire |
//! | [`torture`] | random breaths with random lungs, hostile weights and random faults |

mod flash;
pub mod injection;
pub mod matrix;
mod rig;
pub mod torture;
pub mod trial;
