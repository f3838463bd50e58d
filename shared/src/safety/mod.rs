//! Safety: who may command the valves, and when they are closed for good.
//!
//! | file | what |
//! |---|---|
//! | [`filter`] | the valve command, which this module alone can make |
//! | [`supervisor`] | everything between a controller's output and the valves |
//! | [`reading_monitor`] | can the reading be believed? |
//! | [`pressure_monitor`] | is the pressure within its limits? |
//! | [`breath_monitor`] | does breath after breath go as it must? |
//! | [`lung_estimator`] | what is the lung like, and does the pressure answer to what the valve delivers? |
//! | [`host`] | is a host still there? |
//! | [`ladder`] | learned controller, PID, capped PID |
//! | [`alarms`] | all that can be found, how urgent it is and what is done |
//! | [`monitors`] | which monitors are at work, and their times |

pub mod alarms;
pub mod breath_monitor;
pub mod filter;
pub mod host;
pub mod ladder;
pub mod lung_estimator;
pub mod monitors;
pub mod pressure_monitor;
pub mod reading_monitor;
pub mod supervisor;
