//! Safety: who may command the valves, and when they are closed for good.
//!
//! | file | what |
//! |---|---|
//! | [`filter`] | the valve command, which this module alone can make |
//! | [`supervisor`] | everything between a controller's wish and the valves |
//! | [`reading`] | monitors: can the reading be believed? |
//! | [`pressure`] | monitors: is the pressure bearable? |
//! | [`breathing`] | monitors: does breath after breath go as it must? |
//! | [`opinion`] | monitor: does the pressure answer to what the valve delivers? |
//! | [`host`] | monitor: is a host still there? |
//! | [`ladder`] | learned controller, PID, capped PID |
//! | [`alarms`] | all that can be found, how urgent it is and what is done |
//! | [`monitors`] | which monitors are at work, and their times |

pub mod alarms;
pub mod breathing;
pub mod filter;
pub mod host;
pub mod ladder;
pub mod monitors;
pub mod opinion;
pub mod pressure;
pub mod reading;
pub mod supervisor;
