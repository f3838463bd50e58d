//! What commands share: arguments for lungs, gains and presets, Ctrl-C.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};

use anyhow::bail;
use shared::control::pid::PidGains;

use plant::bench::BenchConfig;

static STOP: AtomicBool = AtomicBool::new(false);

/// From now on the first Ctrl-C asks the running command to end with what it has; the second ends the process.
pub fn watch_for_ctrl_c() {
    let handler = || {
        if STOP.swap(true, Ordering::SeqCst) {
            std::process::exit(130);
        }
        eprintln!("\nstopping with what there is; press Ctrl-C again to end at once");
    };
    if ctrlc::set_handler(handler).is_err() {
        tracing::warn!("Ctrl-C will end the process at once: its signal cannot be caught here");
    }
}

/// The flag that Ctrl-C sets.
pub fn stop() -> &'static AtomicBool {
    &STOP
}

/// Whether Ctrl-C was pressed.
pub fn stopped() -> bool {
    STOP.load(Ordering::Relaxed)
}

/// Settings of others under one name; what is typed beside it has precedence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum Preset {
    /// The paper's authors: 30 ms, PEEP 5 cmH2O, their exploration, PID and simulator
    #[value(name = "paper-30ms")]
    Paper30Ms,
}

/// Which bench.
#[derive(Debug, clap::Args)]
pub struct BenchArgs {
    /// Lung on the virtual bench: R and C as in R20C20, or a row of the test table as in iso-07
    #[arg(long, default_value = "R20C20", conflicts_with = "bench")]
    pub lung: String,
    /// Bench from a TOML file that may set every parameter (`trainer inspect --bench R20C20` prints one)
    #[arg(long, value_name = "FILE")]
    pub bench: Option<PathBuf>,
}

impl BenchArgs {
    /// The benches meant: a preset may name several.
    pub fn benches(&self) -> anyhow::Result<Vec<BenchConfig>> {
        Ok(match &self.bench {
            Some(file) => vec![BenchConfig::load(file)?],
            None => BenchConfig::preset(&self.lung)?,
        })
    }

    /// The one bench meant.
    pub fn one(&self) -> anyhow::Result<BenchConfig> {
        let mut benches = self.benches()?;
        match benches.len() {
            1 => Ok(benches.remove(0)),
            n => bail!("{} stands for {n} lungs, this command takes one: name it as in R20C20", self.lung),
        }
    }
}

/// The benches of these files or, if there are none, the lungs of these names.
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

/// Gains as typed: `P,I` or `P,I,D`.
pub fn gains(text: &str) -> Result<PidGains, String> {
    let numbers: Vec<f32> = text
        .split(',')
        .map(|part| {
            part.trim().parse().map_err(|_| format!("'{part}' is not a number; write P,I,D as in 2,30,0.01"))
        })
        .collect::<Result<_, _>>()?;
    match numbers[..] {
        [p, i] => Ok(PidGains { p, i, d: 0.0 }),
        [p, i, d] => Ok(PidGains { p, i, d }),
        _ => Err("write two or three gains, P,I,D as in 2,30,0.01".into()),
    }
}
