//! Faults on the virtual bench: does the right monitor fire, soon enough, and does the true pressure stay bearable?
//!
//! | file | what |
//! |---|---|
//! | [`injection`] | what can go wrong: sensor, parts, controller, time |
//! | [`trial`] | one ventilator, one lung, one fault |
//! | [`matrix`] | every fault on every lung, each with the monitor that must fire |
//! | [`torture`] | random breaths with random lungs, hostile weights and random faults |

pub mod injection;
pub mod matrix;
pub mod torture;
pub mod trial;
