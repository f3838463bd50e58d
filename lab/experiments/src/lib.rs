//! Many runs: a [`sweep`] over the options of a command, shards of a command on an engine ([`submit`]), and the records that [`runs`]
//! leave.
#![forbid(unsafe_code)]

pub mod runs;
#[cfg(unix)]
pub mod submit;
pub mod sweep;
