//! Safety: checks readings, pressure and breaths, limits the controller's command, and keeps ventilating where it can.
//! Its assertions are compiled out on the chip, as everywhere in this crate.
//!
//! | module | purpose |
//! |---|---|
//! | [`filter`] | the valve command, which this module alone can make |
//! | [`supervisor`] | everything between a controller's output and the valves |
//! | [`source`] | chooses the pressure sensor that is believed |
//! | [`plateau`] | compares the pressure sensors at the end of inspirations |
//! | [`reading_monitor`] | checks that a sensor works |
//! | [`expected`] | the change of the pressure that the commands must bring |
//! | [`pressure_monitor`] | checks that the pressure is within its limits |
//! | [`breath_monitor`] | checks each phase of the breaths |
//! | [`lung_estimator`] | estimates the lung, and checks that the pressure responds to the delivered gas |
//! | [`standing`] | finds a reading that stands still while gas goes in and out |
//! | [`flow_monitor`] | checks the flow sensor against the valve's gas |
//! | [`leak`] | estimates the leak of the circuit |
//! | [`volumes`] | measures what goes in and comes out |
//! | [`volume_monitor`] | checks tidal volume and minute volume, and detects apnoea |
//! | [`reference_volume`] | checks the volume of a breath against those before |
//! | [`settling`] | how long monitors wait after a change of the settings |
//! | [`host`] | detects a silent host |
//! | [`slew`] | limits how fast the learned part of a command changes |
//! | [`ladder`] | levels of trust: learned controller, PID, capped PID, backup ventilation |
//! | [`backup`] | ventilation without a pressure reading |
//! | [`expiration`] | holds PEEP against a leak, lengthens expirations, lets PIP follow a constant baseline |
//! | [`alarms`] | the table of alarms with priorities and actions |
//! | [`indications`] | the alarms that are present or not yet acknowledged |
//! | [`windows`] | means over the end of an expiration |
//! | [`monitors`] | the set of enabled monitors, and their times in ticks |
//! | [`responses`] | the set of enabled responses |

pub mod alarms;
pub mod backup;
pub mod breath_monitor;
pub mod expected;
pub mod expiration;
pub mod filter;
pub mod flow_monitor;
pub mod host;
pub mod indications;
pub mod ladder;
pub mod leak;
pub mod lung_estimator;
pub mod monitors;
pub mod plateau;
pub mod pressure_monitor;
pub mod reading_monitor;
pub mod reference_volume;
pub mod responses;
pub mod settling;
pub mod slew;
pub mod source;
pub mod standing;
pub mod supervisor;
pub mod volume_monitor;
pub mod volumes;
pub mod windows;
