//! The choice of benches.

use std::path::PathBuf;

use anyhow::bail;

use plant::bench::BenchConfig;

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
    ///
    /// # Errors
    /// A name or a file that describes no bench.
    pub fn benches(&self) -> anyhow::Result<Vec<BenchConfig>> {
        Ok(match &self.bench {
            Some(file) => vec![BenchConfig::load(file)?],
            None => BenchConfig::preset(&self.lung)?,
        })
    }

    /// The chosen bench, which must be a single one.
    ///
    /// # Errors
    /// A name or a file that describes no bench, or a name that selects several.
    pub fn one(&self) -> anyhow::Result<BenchConfig> {
        let mut benches = self.benches()?;
        match benches.len() {
            1 => Ok(benches.remove(0)),
            n => bail!("{} selects {n} lungs, but this command needs one: name it as in R20C20", self.lung),
        }
    }
}

/// The benches in these files or, if there are none, those of the named lungs.
///
/// # Errors
/// A name or a file that describes no bench.
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
