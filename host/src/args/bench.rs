//! The choice of benches: lungs by name, or descriptions in files.

use std::path::Path;

use anyhow::bail;
use clap::builder::ArgPredicate;

use plant::bench::BenchConfig;

/// The bench of a command line that names none.
const USUAL_BENCH: &str = "R20C20";

/// The choice of a bench.
#[derive(Debug, clap::Args)]
pub struct BenchArgs {
    /// Virtual bench: a lung by R and C as in R20C20, or a row of the test table as in iso-07, and on the machine for newborns as in
    /// neonate-R100C2 or neonate-iso-14; or a TOML file, which can set every parameter (`trainer inspect --bench R20C20` prints one)
    // None beside a port: a board on the desk keeps the bench that it has unless the command line names another.
    #[arg(long, value_name = "LUNG|FILE", default_value_if("port", ArgPredicate::IsPresent, None), default_value = USUAL_BENCH)]
    pub bench: Option<String>,
}

/// The choice of several benches.
#[derive(Debug, clap::Args)]
pub struct BenchesArgs {
    /// Virtual bench: a lung as in R20C20, `paper` for its nine lungs, `iso` for the 21 rows of the test table, or a TOML file;
    /// repeat it for more
    #[arg(long, value_name = "LUNG|FILE", default_value = USUAL_BENCH)]
    pub bench: Vec<String>,
}

impl BenchArgs {
    /// The chosen benches; one name can select several.
    ///
    /// # Errors
    /// A name or a file that describes no bench.
    pub fn benches(&self) -> anyhow::Result<Vec<BenchConfig>> {
        Ok(BenchConfig::find(self.name())?)
    }

    /// The chosen bench, which must be a single one.
    ///
    /// # Errors
    /// A name or a file that describes no bench, or a name that selects several.
    pub fn one(&self) -> anyhow::Result<BenchConfig> {
        one(self.name())
    }

    /// The file that describes the bench; none if it is a named lung.
    pub fn file(&self) -> Option<&Path> {
        BenchConfig::file(self.name())
    }

    /// What a board on the desk is to simulate; none if the command line names no bench.
    ///
    /// # Errors
    /// As [`BenchArgs::one`].
    pub fn described(&self) -> anyhow::Result<Option<BenchConfig>> {
        self.bench.as_deref().map(one).transpose()
    }

    fn name(&self) -> &str {
        self.bench.as_deref().unwrap_or(USUAL_BENCH)
    }
}

impl BenchesArgs {
    /// The chosen benches.
    ///
    /// # Errors
    /// A name or a file that describes no bench.
    pub fn benches(&self) -> anyhow::Result<Vec<BenchConfig>> {
        benches(&self.bench)
    }
}

/// The bench of this name or file, which must be a single one.
///
/// # Errors
/// A name or a file that describes no bench, or a name that selects several.
pub fn one(bench: &str) -> anyhow::Result<BenchConfig> {
    let mut benches = BenchConfig::find(bench)?;
    match benches.len() {
        1 => Ok(benches.remove(0)),
        n => bail!("{bench} selects {n} lungs, but this command needs one: name it as in R20C20"),
    }
}

/// The benches of these names and files.
///
/// # Errors
/// A name or a file that describes no bench.
pub fn benches(names: &[String]) -> anyhow::Result<Vec<BenchConfig>> {
    let mut benches = Vec::new();
    for name in names {
        benches.extend(BenchConfig::find(name)?);
    }
    Ok(benches)
}
