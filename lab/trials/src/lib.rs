//! Trials of a ventilator: injected [`faults`], days with random patients ([`endure`]), families of plants ([`robust`]), the declared
//! [`accuracy`] of the pressure, and the rows of the standard's [`test_table`].
#![forbid(unsafe_code)]

pub mod accuracy;
pub mod draw;
pub mod endure;
pub mod faults;
pub mod robust;
pub mod test_table;
