//! A case: everything that determines a run, as TOML.

use std::path::{Path, PathBuf};

use learn::controller::shipped;
use serde::{Deserialize, Serialize};
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::settings::{Settings, SettingsError};
use thiserror::Error;

use plant::bench::{BenchConfig, BenchError, FaultConfig};

/// Longest case, s.
const LONGEST_S: f64 = 3600.0;

/// Why a case was refused.
#[derive(Debug, Error)]
pub enum CaseError {
    /// The file cannot be read.
    #[error("cannot read the case {}: {source}; check the path", path.display())]
    File {
        /// The path tried.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is not a case.
    #[error("the case is not valid: {0}")]
    Syntax(#[from] toml::de::Error),
    /// Its bench is not allowed.
    #[error(transparent)]
    Bench(#[from] BenchError),
    /// Its settings are not allowed.
    #[error("the settings of the case cannot be run: {0}")]
    Settings(#[from] SettingsError),
    /// Its times are not allowed.
    #[error("{0}")]
    Times(String),
    /// There is no such controller.
    #[error(
        "there is no controller \"{0}\": name a shipped one, as in controller = \"adult\", or gains, as in controller = [3, 30, 0]"
    )]
    Controller(String),
}

/// A run and its faults.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Case {
    /// Seed of the noise and of the patient's irregularity.
    #[serde(default)]
    pub seed: u64,
    /// Duration, s.
    pub seconds: f64,
    /// The controller.
    pub controller: Law,
    /// Control ticks that are missed.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub stalls: Option<Stalls>,
    /// Settings at the start.
    pub settings: Settings,
    /// A host that keeps changing the settings.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub host: Option<Rhythm>,
    /// Machine and patient, with the faults of sensors, parts, lung and patient.
    #[serde(default)]
    pub bench: BenchConfig,
}

/// A controller: a shipped one by its name, or the gains of a PID.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged)]
pub enum Law {
    /// A shipped learned controller.
    Learned(String),
    /// Gains P, I, D: percent per cmH2O, cmH2O s and cmH2O/s.
    Pid([f32; 3]),
}

/// Control ticks that are missed, again and again.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Stalls {
    /// First of them, s.
    pub from_s: f64,
    /// Ticks that are missed in a row.
    pub ticks: u32,
    /// Time from one row to the next, ms.
    pub every_ms: u32,
}

/// A host that alternates between the settings of the start and others.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Rhythm {
    /// First change, s.
    pub from_s: f64,
    /// Time from one change to the next, s.
    pub every_s: f64,
    /// The other settings.
    pub settings: Settings,
}

impl Law {
    /// Builds it.
    ///
    /// # Errors
    /// No shipped controller of that name, or gains that are refused.
    pub fn controller(&self) -> Result<Controller, CaseError> {
        match self {
            Self::Learned(name) => shipped::residual(name).map(Controller::Residual),
            Self::Pid([p, i, d]) => {
                Pid::new(PidGains { p: *p, i: *i, d: *d }, DEFAULT_PERIOD_US).ok().map(Controller::Pid)
            }
        }
        .ok_or_else(|| CaseError::Controller(format!("{self:?}")))
    }
}

impl Case {
    /// Reads and validates a case; what is absent from its bench has its default.
    ///
    /// # Errors
    /// See [`CaseError`].
    pub fn from_toml(text: &str) -> Result<Self, CaseError> {
        let case: Self = toml::from_str(text)?;
        case.validate()?;
        Ok(case)
    }

    /// Reads and validates the file at a path.
    ///
    /// # Errors
    /// See [`CaseError`].
    pub fn load(path: &Path) -> Result<Self, CaseError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| CaseError::File { path: path.to_owned(), source })?;
        Self::from_toml(&text)
    }

    /// The case as TOML, without the values of bench and settings that are the default.
    pub fn to_toml(&self) -> String {
        let mut table = toml_of(self);
        for (name, usual) in
            [("bench", toml_of(&BenchConfig::default())), ("settings", toml_of(&Settings::default()))]
        {
            if let Some(toml::Value::Table(values)) = table.get_mut(name) {
                *values = differing(values, &usual);
            }
        }
        toml::to_string(&table).expect("a table always has a TOML form")
    }

    /// Checks settings, times and bench.
    ///
    /// # Errors
    /// See [`CaseError`].
    pub fn validate(&self) -> Result<(), CaseError> {
        self.bench.validate()?;
        self.settings.validate()?;
        self.controller.controller()?;
        if !(1.0..=LONGEST_S).contains(&self.seconds) {
            return Err(CaseError::Times(format!(
                "seconds is {}; allowed are 1 to {LONGEST_S}",
                self.seconds
            )));
        }
        if let Some(Stalls { from_s, ticks, every_ms }) = self.stalls
            && !(from_s >= 0.0 && ticks > 0 && ticks < every_ms)
        {
            return Err(CaseError::Times(
                "stalls: from_s is not negative, and ticks are at least 1 and less than every_ms".to_owned(),
            ));
        }
        if let Some(Rhythm { from_s, every_s, settings }) = self.host {
            settings.validate()?;
            if !(from_s >= 0.0 && every_s >= 0.1) {
                return Err(CaseError::Times(
                    "host: from_s is not negative, and every_s is at least 0.1".to_owned(),
                ));
            }
        }
        Ok(())
    }

    /// The same case with other faults of the bench.
    #[must_use]
    pub fn with_faults(&self, faults: Vec<FaultConfig>) -> Self {
        let mut case = self.clone();
        case.bench.faults = faults;
        case
    }

    /// When the first fault begins, s; the end without one.
    pub fn onset_s(&self) -> f64 {
        let faults = self.bench.faults.iter().map(|fault| fault.from_s);
        let others =
            self.stalls.map(|stalls| stalls.from_s).into_iter().chain(self.host.map(|host| host.from_s));
        faults.chain(others).fold(self.seconds, f64::min)
    }

    /// The settings that the host has sent last at a time, s.
    pub fn settings_at(&self, time_s: f64) -> Settings {
        match self.host {
            Some(host) if time_s >= host.from_s => {
                let changes = ((time_s - host.from_s) / host.every_s) as u64;
                if changes.is_multiple_of(2) { host.settings } else { self.settings }
            }
            _ => self.settings,
        }
    }

    /// Duration of the longest breath, s.
    pub fn breath_s(&self) -> f64 {
        let slowest = self.host.map_or(self.settings.rate, |host| host.settings.rate.min(self.settings.rate));
        60.0 / f64::from(slowest)
    }
}

fn toml_of(value: &impl Serialize) -> toml::Table {
    toml::Table::try_from(value).expect("numbers, strings and tables always have a TOML form")
}

/// What differs from the usual values, table by table.
fn differing(table: &toml::Table, usual: &toml::Table) -> toml::Table {
    let differs = |(name, value): (&String, &toml::Value)| match (value, usual.get(name)) {
        (toml::Value::Table(table), Some(toml::Value::Table(usual))) => {
            let inner = differing(table, usual);
            (!inner.is_empty()).then(|| (name.clone(), toml::Value::Table(inner)))
        }
        (value, Some(usual)) if value == usual => None,
        (value, _) => Some((name.clone(), value.clone())),
    };
    table.iter().filter_map(differs).collect()
}
