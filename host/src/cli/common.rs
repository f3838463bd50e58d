//! Shared by the commands: arguments for lungs, gains and presets, and Ctrl-C.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::bail;
use shared::control::pid::PidGains;
use shared::link::messages::DeviceIdentity;

use plant::bench::BenchConfig;
use show::monitor::words;

static STOP: AtomicBool = AtomicBool::new(false);

/// Makes the first Ctrl-C stop the running command, which keeps its results; the second ends the process.
pub fn watch_for_ctrl_c() {
    let handler = || {
        if STOP.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
        eprintln!("\nstopping and keeping the results so far; press Ctrl-C again to end immediately");
    };
    if ctrlc::set_handler(handler).is_err() {
        tracing::warn!("Ctrl-C will end the process without saving: its signal cannot be handled here");
    }
}

/// The flag set by Ctrl-C.
pub fn stop() -> &'static AtomicBool {
    &STOP
}

/// Whether Ctrl-C was pressed.
pub fn stopped() -> bool {
    STOP.load(Ordering::Relaxed)
}

/// Warns of a device whose firmware accepts unsigned weights.
pub fn warn_of_development_build(identity: &DeviceIdentity) {
    if words::is_development(identity) {
        eprintln!(
            "warning: this device runs a development build, which accepts unsigned weights: build its firmware with a key (`trainer keys --help`)"
        );
    }
}

/// A named set of third-party settings; options on the command line take precedence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Preset {
    /// The paper's authors: 30 ms, PEEP 5 cmH2O, their exploration, PID and simulator
    #[value(name = "paper-30ms")]
    Paper30Ms,
}

/// The choice of a bench.
#[derive(Debug, clap::Args)]
pub struct BenchArgs {
    /// Lung on the virtual bench: R and C as in R20C20, or a row of the test table as in iso-07; on the machine for newborns as in
    /// neonate-R100C2 or neonate-iso-14
    #[arg(long, default_value = "R20C20", conflicts_with = "bench")]
    pub lung: String,
    /// Bench description in TOML, which can set every parameter (`trainer inspect --bench R20C20` prints one)
    #[arg(long, value_name = "FILE")]
    pub bench: Option<PathBuf>,
}

impl BenchArgs {
    /// The chosen benches; one name can select several.
    pub fn benches(&self) -> anyhow::Result<Vec<BenchConfig>> {
        Ok(match &self.bench {
            Some(file) => vec![BenchConfig::load(file)?],
            None => BenchConfig::preset(&self.lung)?,
        })
    }

    /// The chosen bench, which must be a single one.
    pub fn one(&self) -> anyhow::Result<BenchConfig> {
        let mut benches = self.benches()?;
        match benches.len() {
            1 => Ok(benches.remove(0)),
            n => bail!("{} selects {n} lungs, but this command needs one: name it as in R20C20", self.lung),
        }
    }
}

/// The benches in these files or, if there are none, those of the named lungs.
pub fn benches(lungs: &[String], files: &[PathBuf]) -> anyhow::Result<Vec<BenchConfig>> {
    let mut benches = Vec::new();
    for file in files {
        benches.push(BenchConfig::load(file)?);
    }
    if benches.is_empty() {
        for name in lungs {
            benches.extend(BenchConfig::preset(name)?);
        }
    }
    Ok(benches)
}

/// Parses gains: `P,I` or `P,I,D`.
pub fn gains(text: &str) -> Result<PidGains, String> {
    let numbers: Vec<f32> = text
        .split(',')
        .map(|part| {
            part.trim().parse().map_err(|_| format!("'{part}' is not a number: write P,I,D as in 2,30,0.01"))
        })
        .collect::<Result<_, _>>()?;
    match numbers[..] {
        [p, i] => Ok(PidGains { p, i, d: 0.0 }),
        [p, i, d] => Ok(PidGains { p, i, d }),
        _ => Err("write two or three gains P,I,D, such as 2,30,0.01".into()),
    }
}
