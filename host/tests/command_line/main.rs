//! The `trainer` command line from the user's side: the real program, its output, files and exit codes.

mod bad_input;
#[cfg(unix)]
mod bedside;
#[cfg(unix)]
mod blackbox;
mod commission;
mod endure;
mod export;
mod farm;
mod formats;
mod help;
mod interrupted;
mod judge;
mod keys;
mod margins;
mod pipeline;
mod plant;
mod policy;
mod python;
mod recordings;
mod rivals;
mod robust;
mod runs;
#[cfg(unix)]
mod serve;
mod shards;
#[expect(dead_code, reason = "the tests on engines use the rest")]
mod support;
mod test_table;
