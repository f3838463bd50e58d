//! Families of plants: ranges for the parameters of a bench, from which a seed draws any number of plants.
//!
//! A family is a bench description with a table `[family]`, in which a range stands in the place of each number that varies:
//!
//! ```
//! # use plant::bench::family::Family;
//! let family = Family::from_toml(
//!     "name = \"children\"
//!      [circuit]
//!      compliance_ml_per_cmh2o = 1.0
//!      [family.lung.first]
//!      resistance_cmh2o_per_l_s = { log_uniform = [10, 80] }
//!      compliance_ml_per_cmh2o = { uniform = [5, 25] }
//!      [family.sensor]
//!      noise_sd_cmh2o = { normal = [0.1, 0.02] }",
//! )?;
//! let plant = family.draw(1, 0);
//! assert!((5.0..=25.0).contains(&plant.lung.first.compliance_ml_per_cmh2o));
//! assert_eq!(plant, family.draw(1, 0));
//! # Ok::<(), plant::bench::family::FamilyError>(())
//! ```
//!
//! `bench = "neonate"`, or the name of another lung, gives the values that the file leaves out; without it they are the defaults.
//! `[pid]` and `[soft_pid]` are gains `p`, `i` and `d`: of the best single PID of the family, and of one that is stable on every plant.
//! `[bedside_pid]` are those of the best single PID under the prescriptions of the bedside.
//!
//! `pips` and `[settings]` are the waveforms on which the family's plants are judged; without them they are the paper's. A table
//! `[bedside]` describes what is set for the family's patients ([`Prescriptions`]).
//!
//! Each parameter is drawn by a generator of its own, from the seed, the plant's number and the parameter's name: a change of one
//! range leaves all other draws as they were.

use std::path::{Path, PathBuf};

use shared::breath::PAPER_PIPS;
use shared::control::pid::PidGains;
use shared::settings::{Settings, SettingsError};
use toml::{Table, Value};

use super::{BenchConfig, BenchError};
use crate::prescriptions::{NAMES, Prescriptions, PrescriptionsError};
use crate::range::{self, Range};

/// The shipped families, by name.
const SHIPPED: [(&str, &str); 3] = [
    ("adult", include_str!("adult.toml")),
    ("neonate", include_str!("neonate.toml")),
    ("blower", include_str!("blower.toml")),
];

/// Why a family was refused.
#[derive(Debug, thiserror::Error)]
pub enum FamilyError {
    /// There is no shipped family of that name, and no such file.
    #[error("there is no family {0}: name a TOML file, or one of {names}", names = Family::names().join(", "))]
    Unknown(String),
    /// The file cannot be read.
    #[error("cannot read the family {}: {source}; check the path", path.display())]
    File {
        /// The path tried.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is not TOML, or its bench is not one.
    #[error("the family is not valid: {0}")]
    Syntax(#[from] toml::de::Error),
    /// Nothing varies.
    #[error(
        "the family varies nothing: add a table such as [family.valve] with lag_ms = {{ uniform = [15, 45] }}"
    )]
    Empty,
    /// A table of ranges contains something else.
    #[error(
        "family.{0} is no range: write {{ uniform = [low, high] }}, {{ log_uniform = [low, high] }} or {{ normal = [mean, sd] }}"
    )]
    NotARange(String),
    /// The bench has no such number.
    #[error("family.{0} is no number of a bench: see the bench description for the names")]
    NoSuchNumber(String),
    /// The numbers of a range are in the wrong order, not finite, or negative where they must not be.
    #[error(
        "family.{0}: the range is empty; the lower number comes first, log_uniform needs numbers above 0, and an sd is not negative"
    )]
    EmptyRange(String),
    /// There is no waveform.
    #[error("the family has no waveform: name at least one PIP, as in pips = [15, 25]")]
    NoWaveform,
    /// The settings of a waveform are not allowed.
    #[error("a waveform of the family cannot be run: {0}")]
    Settings(#[from] SettingsError),
    /// The prescriptions of the bedside are not valid.
    #[error("bedside: {0}")]
    Bedside(#[from] PrescriptionsError),
    /// The fixed values of the bench, or a value within a range, are not allowed.
    #[error(transparent)]
    Bench(#[from] BenchError),
}

/// A family of plants.
#[derive(Clone, Debug, PartialEq)]
pub struct Family {
    /// Name in reports and of the plants.
    pub name: String,
    /// Best single PID of the family, if known.
    pub pid: Option<PidGains>,
    /// A PID that is stable on every plant of the family, if known: the one under a residual for the family.
    pub soft_pid: Option<PidGains>,
    /// Best single PID of the family under the prescriptions of its bedside, if known.
    pub bedside_pid: Option<PidGains>,
    /// PIPs of the waveforms, cmH2O.
    pub pips: Vec<f32>,
    /// All other settings of the waveforms.
    pub settings: Settings,
    /// What is set at the bedside of this family's patients.
    pub bedside: Prescriptions,
    /// Description of a complete bench, with the values that do not vary.
    bench: Table,
    /// Path and range of every parameter that varies, such as `valve.lag_ms`.
    ranges: Vec<(String, Range)>,
}

impl Family {
    /// Names of the shipped families.
    pub fn names() -> Vec<&'static str> {
        SHIPPED.iter().map(|(name, _)| *name).collect()
    }

    /// The shipped family of this name or, if there is none, the one in this file.
    ///
    /// # Errors
    /// See [`FamilyError`].
    pub fn find(name: &str) -> Result<Self, FamilyError> {
        if let Some((_, text)) = SHIPPED.iter().find(|(shipped, _)| *shipped == name) {
            return Self::from_toml(text);
        }
        let path = Path::new(name);
        if path.extension().is_none() && !path.exists() {
            return Err(FamilyError::Unknown(name.to_owned()));
        }
        let text = std::fs::read_to_string(path)
            .map_err(|source| FamilyError::File { path: path.to_owned(), source })?;
        Self::from_toml(&text)
    }

    /// Reads and validates a family. Every value within its ranges is allowed on a bench.
    ///
    /// # Errors
    /// See [`FamilyError`].
    pub fn from_toml(text: &str) -> Result<Self, FamilyError> {
        let mut table: Table = toml::from_str(text)?;
        let Some(Value::Table(varies)) = table.remove("family") else { return Err(FamilyError::Empty) };
        let pid = table.remove("pid").map(Value::try_into).transpose()?;
        let soft_pid = table.remove("soft_pid").map(Value::try_into).transpose()?;
        let bedside_pid = table.remove("bedside_pid").map(Value::try_into).transpose()?;
        let pips = table.remove("pips").map(Value::try_into).transpose()?;
        let settings = table.remove("settings").map(Value::try_into).transpose()?.unwrap_or_default();
        let bedside = match table.remove("bedside") {
            Some(Value::Table(drawn)) => Prescriptions::from_table(drawn)?,
            _ => Prescriptions::find("bedside")?,
        };
        let fixed = fixed(table)?;
        let bench = toml_of(&fixed);
        let mut ranges = Vec::new();
        collect(&varies, "", &mut ranges)?;
        if ranges.is_empty() {
            return Err(FamilyError::Empty);
        }
        let pips = pips.unwrap_or_else(|| PAPER_PIPS.to_vec());
        let family =
            Self { name: fixed.name, pid, soft_pid, bedside_pid, pips, settings, bedside, bench, ranges };
        family.check()?;
        Ok(family)
    }

    /// Checks that the waveforms and the ends of each range are allowed.
    fn check(&self) -> Result<(), FamilyError> {
        if self.pips.is_empty() {
            return Err(FamilyError::NoWaveform);
        }
        for number in 0..self.pips.len() {
            self.waveform(number as u32).validate()?;
        }
        for (path, range) in &self.ranges {
            let (low, high) = range.ends().ok_or_else(|| FamilyError::EmptyRange(path.clone()))?;
            for value in [low, high] {
                let mut bench = self.bench.clone();
                set(&mut bench, path, value).ok_or_else(|| FamilyError::NoSuchNumber(path.clone()))?;
                let bench: BenchConfig = bench.try_into()?;
                bench.validate()?;
            }
        }
        Ok(())
    }

    /// The bench of the family in which nothing varies: its nominal machine, with its usual lung.
    pub fn nominal(&self) -> BenchConfig {
        self.bench.clone().try_into().expect("the bench was checked")
    }

    /// Prescriptions for the plants: `paper` are the family's waveforms, `bedside` those of its patients, and any other name is that of
    /// a file.
    ///
    /// # Errors
    /// See [`PrescriptionsError`].
    pub fn prescriptions(&self, name: &str) -> Result<Prescriptions, PrescriptionsError> {
        match name {
            "paper" => Ok(self.listed()),
            "bedside" => Ok(self.bedside.clone()),
            file => Prescriptions::find(file),
        }
    }

    /// The family's own waveforms, as prescriptions.
    pub fn listed(&self) -> Prescriptions {
        Prescriptions::listed(NAMES[0], &self.pips, self.settings)
    }

    /// Settings of the waveform for the plant with this number: the waveforms take turns.
    pub fn waveform(&self, number: u32) -> Settings {
        Settings { pip: self.pips[number as usize % self.pips.len()], ..self.settings }
    }

    /// The plant with this number, from 0, of those that a seed gives.
    pub fn draw(&self, seed: u64, number: u32) -> BenchConfig {
        let mut bench = self.bench.clone();
        for (path, range) in &self.ranges {
            let value = range.draw(&mut range::stream(seed, path, number));
            set(&mut bench, path, value).expect("the paths were checked");
        }
        bench.insert("name".to_owned(), Value::String(format!("{}-{number}", self.name)));
        bench.try_into().expect("every value within the ranges is allowed")
    }
}

/// The bench of a family: the named one, with the values of the file in place of its own.
fn fixed(mut table: Table) -> Result<BenchConfig, FamilyError> {
    let named: Option<String> = table.remove("bench").map(Value::try_into).transpose()?;
    let named = named.map(|name| BenchConfig::from_name(&name)).transpose()?.unwrap_or_default();
    let mut complete = toml_of(&named);
    replace(&mut complete, table);
    let bench: BenchConfig = complete.try_into()?;
    bench.validate()?;
    Ok(bench)
}

fn toml_of(bench: &BenchConfig) -> Table {
    Table::try_from(bench).expect("a bench always has a TOML form")
}

/// Replaces the values of a table by those of another, table by table.
fn replace(table: &mut Table, values: Table) {
    for (name, value) in values {
        match (table.get_mut(&name), value) {
            (Some(Value::Table(inner)), Value::Table(values)) => replace(inner, values),
            (_, value) => {
                table.insert(name, value);
            }
        }
    }
}

/// Collects the ranges in a table and in those that it contains.
fn collect(table: &Table, path: &str, ranges: &mut Vec<(String, Range)>) -> Result<(), FamilyError> {
    for (name, value) in table {
        let path = if path.is_empty() { name.clone() } else { format!("{path}.{name}") };
        let Value::Table(inner) = value else { return Err(FamilyError::NotARange(path)) };
        if let Ok(range) = value.clone().try_into() {
            ranges.push((path, range));
        } else if inner.values().any(Value::is_array) || inner.is_empty() {
            return Err(FamilyError::NotARange(path));
        } else {
            collect(inner, &path, ranges)?;
        }
    }
    Ok(())
}

/// Replaces the number at a path; none if there is no number.
fn set(bench: &mut Table, path: &str, value: f64) -> Option<()> {
    let (tables, name) = path.rsplit_once('.').unwrap_or(("", path));
    let mut table = bench;
    for part in tables.split('.').filter(|part| !part.is_empty()) {
        table = table.get_mut(part)?.as_table_mut()?;
    }
    let number = table.get_mut(name)?;
    *number = match number {
        Value::Integer(_) => Value::Integer(value.round() as i64),
        Value::Float(_) => Value::Float(value),
        _ => return None,
    };
    Some(())
}

#[cfg(test)]
mod tests;
