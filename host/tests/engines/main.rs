//! The shards of a command on real engines: Slurm and GNU parallel, as Debian packages them (`.ci/setup/engines` installs them).

mod disk;
mod parallel;
mod run;
mod slurm;
