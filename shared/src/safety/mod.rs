//! Safety: who may command the valves, and when they are closed for good.
//!
//! [`filter::ValveCommand`] can be made by this module alone; the [`supervisor`] decides each tick whether the
//! reading can be believed and whether the pressure is bearable, and latches the safe state when not.

pub mod filter;
pub mod supervisor;
