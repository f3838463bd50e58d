//! Safety: checks readings, pressure and breaths, limits the controller's command, and latches the safe state.
//!
//! | module | purpose |
//! |---|---|
//! | [`filter`] | the valve command, which this module alone can make |
//! | [`supervisor`] | everything between a controller's output and the valves |
//! | [`reading_monitor`] | checks that the sensor works |
//! | [`pressure_monitor`] | checks that the pressure is within its limits |
//! | [`breath_monitor`] | checks each phase of the breaths |
//! | [`lung_estimator`] | estimates the lung, and checks that the pressure responds to the delivered gas |
//! | [`host`] | detects a silent host |
//! | [`ladder`] | levels of trust: learned controller, PID, capped PID |
//! | [`alarms`] | the table of alarms with priorities and actions |
//! | [`monitors`] | the set of enabled monitors, and their times in ticks |

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
