//! The column map: which column contains which quantity, in which unit; as typed in TOML, and as checked.

use std::path::Path;

use serde::Deserialize;
use thiserror::Error;

/// Quantities that a row can have, in the order of the reader's `Fields`.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Quantity {
    /// Time in seconds from any origin.
    Time,
    /// Airway pressure, cmH2O.
    Pressure,
    /// Command of the inspiratory valve, percent.
    UIn,
    /// Command of the expiratory valve, percent from closed to open.
    UOut,
    /// Requested pressure, cmH2O.
    Target,
    /// Flow into the patient circuit, L/s.
    FlowIn,
    /// Flow out of the patient circuit, L/s.
    FlowOut,
    /// Airway resistance, cmH2O/(L/s).
    Resistance,
    /// Compliance, mL/cmH2O.
    Compliance,
    /// Command of a second inspiratory valve (oxygen), percent.
    UPsol,
}

/// Number of quantities.
pub const QUANTITIES: usize = 10;

/// The unit of a command from 0 to 1.
const SHARE: &str = "share";

/// Pressure units: name and factor to cmH2O.
const PRESSURES: &[(&str, f64)] = &[
    ("cmH2O", 1.0),
    ("hPa", 1.019_716),
    ("mbar", 1.019_716),
    ("kPa", 10.197_16),
    ("Pa", 0.010_197_16),
    ("mmHg", 1.359_51),
];

impl Quantity {
    /// All quantities.
    pub const ALL: [Self; QUANTITIES] = [
        Self::Time,
        Self::Pressure,
        Self::UIn,
        Self::UOut,
        Self::Target,
        Self::FlowIn,
        Self::FlowOut,
        Self::Resistance,
        Self::Compliance,
        Self::UPsol,
    ];

    /// Name of its table in the column map.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Time => "time",
            Self::Pressure => "pressure",
            Self::UIn => "u_in",
            Self::UOut => "u_out",
            Self::Target => "target",
            Self::FlowIn => "flow_in",
            Self::FlowOut => "flow_out",
            Self::Resistance => "resistance",
            Self::Compliance => "compliance",
            Self::UPsol => "u_psol",
        }
    }

    /// Accepted units with their factors; the first is the default and our own.
    pub const fn units(self) -> &'static [(&'static str, f64)] {
        match self {
            Self::Time => &[("s", 1.0), ("ms", 1e-3), ("us", 1e-6)],
            Self::Pressure | Self::Target => PRESSURES,
            Self::UIn | Self::UOut | Self::UPsol => &[("percent", 1.0), (SHARE, 100.0)],
            Self::FlowIn | Self::FlowOut => {
                &[("L/s", 1.0), ("L/min", 1.0 / 60.0), ("mL/s", 1e-3), ("mL/min", 1e-3 / 60.0)]
            }
            Self::Resistance => &[("cmH2O/(L/s)", 1.0), ("hPa/(L/s)", 1.019_716), ("kPa/(L/s)", 10.197_16)],
            Self::Compliance => {
                &[("mL/cmH2O", 1.0), ("L/cmH2O", 1000.0), ("mL/hPa", 0.980_665), ("mL/kPa", 0.098_066_5)]
            }
        }
    }
}

/// Why a column map cannot be used.
#[derive(Debug, Error)]
#[expect(missing_docs, reason = "the message names every field")]
pub enum MapError {
    /// The file cannot be opened.
    #[error("cannot read the column map {path}: {source}; check the path")]
    Read { path: String, source: std::io::Error },
    /// Not TOML, or an unknown name.
    #[error("the column map is not valid: {0}")]
    Syntax(#[from] toml::de::Error),
    /// A quantity has neither column nor value, or both.
    #[error("[{0}] of the column map needs either a `column` or a `value`")]
    Source(&'static str),
    /// Unknown unit.
    #[error("[{quantity}] of the column map: unknown unit `{unit}`: write one of {known}")]
    Unit { quantity: &'static str, unit: String, known: String },
    /// A separator of more than one byte.
    #[error("the column map's separator `{0}` is none that a table can have: write one ASCII character")]
    Separator(char),
    /// A number out of range.
    #[error("{0} of the column map must be a number above 0")]
    Number(&'static str),
    /// A quantity that must be a column has a value.
    #[error("[{0}] of the column map must be a column, not a value: it changes from row to row")]
    NotConstant(&'static str),
    /// The start of a breath is not defined.
    #[error(
        "the column map does not define where a breath starts: give a [breath] column, a [target] that rises, or a \
         [u_out] that closes"
    )]
    NoStart,
    /// The end of an inspiration is not defined.
    #[error(
        "the column map does not define where an inspiration ends: give a [u_out] that opens, a [target] that falls, \
         or inspiration_s"
    )]
    NoEnd,
}

/// A quantity as typed.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    column: Option<String>,
    value: Option<f64>,
    unit: Option<String>,
    scale: Option<f64>,
    #[serde(default)]
    offset: f64,
}

/// A column of names or numbers that are only compared.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Label {
    column: String,
}

/// The columns that identify test runs.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Group {
    /// The ventilator's name, or the name of the whole.
    column: String,
    /// The name of the run among those of the ventilator.
    run: Option<String>,
}

/// A column map as typed.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ColumnMap {
    plant: Option<String>,
    note: Option<String>,
    period_ms: Option<f64>,
    inspiration_s: Option<f64>,
    separator: Option<char>,
    breath: Option<Label>,
    group: Option<Group>,
    time: Entry,
    pressure: Entry,
    u_in: Entry,
    u_out: Option<Entry>,
    target: Option<Entry>,
    flow_in: Option<Entry>,
    flow_out: Option<Entry>,
    resistance: Option<Entry>,
    compliance: Option<Entry>,
    u_psol: Option<Entry>,
}

/// The source of a quantity.
#[derive(Debug, Clone, PartialEq)]
pub enum ColumnSource {
    /// A column, times a factor, plus an offset, in our unit.
    Column {
        /// Header of the column.
        name: String,
        /// Factor to our unit.
        factor: f64,
        /// Offset added after scaling, in our unit.
        offset: f64,
        /// Whether it is a command from 0 to 1; values outside are errors.
        share: bool,
    },
    /// A constant for all rows, in our unit.
    Value(f64),
}

/// The event that starts a breath.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum StartBy {
    /// A new value in the breath column.
    Number,
    /// A rise of the set-point after a rest.
    Target,
    /// The expiratory valve closes.
    Valve,
}

/// The event that ends an inspiration.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum EndBy {
    /// A fixed time, seconds.
    Time(f64),
    /// The expiratory valve opens.
    Valve,
    /// The set-point falls.
    Target,
}

/// A checked column map.
#[derive(Debug, Clone, PartialEq)]
pub struct TableLayout {
    /// Name of the recorded plant.
    pub plant: String,
    /// A remark for the recording.
    pub note: Option<String>,
    /// Sample period in seconds, if the map gives it.
    pub period_s: Option<f64>,
    /// Column separator.
    pub separator: u8,
    /// Header of the breath column.
    pub breath: Option<String>,
    /// Header of the group column.
    pub group: Option<String>,
    /// Header of the column of runs within a group.
    pub run: Option<String>,
    /// Quantities, in the order of [`Quantity::ALL`].
    pub origins: [Option<ColumnSource>; QUANTITIES],
    /// The event that starts a breath.
    pub start: StartBy,
    /// The event that ends an inspiration.
    pub end: EndBy,
}

impl ColumnMap {
    /// Reads a column map.
    ///
    /// # Errors
    /// The file cannot be read or is not a column map.
    pub fn load(path: &Path) -> Result<Self, MapError> {
        let text = std::fs::read_to_string(path)
            .map_err(|source| MapError::Read { path: path.display().to_string(), source })?;
        Self::from_toml(&text)
    }

    /// Reads a column map from text.
    ///
    /// # Errors
    /// The text is not a column map.
    pub fn from_toml(text: &str) -> Result<Self, MapError> {
        Ok(toml::from_str(text)?)
    }

    /// The layout of the Kaggle competition "Ventilator Pressure Prediction" (Google Brain, 2021).
    ///
    /// # Errors
    /// See [`Self::from_toml`]; a test rules this out.
    pub fn kaggle() -> Result<Self, MapError> {
        Self::from_toml(include_str!("kaggle.toml"))
    }

    /// The layout of the measured tables of the `RespiraWorks` ventilator.
    ///
    /// # Errors
    /// See [`Self::from_toml`]; a test rules this out.
    pub fn respiraworks() -> Result<Self, MapError> {
        Self::from_toml(include_str!("respiraworks.toml"))
    }

    fn entry(&self, quantity: Quantity) -> Option<&Entry> {
        match quantity {
            Quantity::Time => Some(&self.time),
            Quantity::Pressure => Some(&self.pressure),
            Quantity::UIn => Some(&self.u_in),
            Quantity::UOut => self.u_out.as_ref(),
            Quantity::Target => self.target.as_ref(),
            Quantity::FlowIn => self.flow_in.as_ref(),
            Quantity::FlowOut => self.flow_out.as_ref(),
            Quantity::Resistance => self.resistance.as_ref(),
            Quantity::Compliance => self.compliance.as_ref(),
            Quantity::UPsol => self.u_psol.as_ref(),
        }
    }

    /// Checks the map.
    ///
    /// # Errors
    /// The first problem found.
    pub fn layout(&self) -> Result<TableLayout, MapError> {
        let positive = |value: Option<f64>, what| match value {
            Some(value) if !(value > 0.0 && value.is_finite()) => Err(MapError::Number(what)),
            value => Ok(value),
        };
        let period_s = positive(self.period_ms, "period_ms")?.map(|ms| ms * 1e-3);
        let inspiration_s = positive(self.inspiration_s, "inspiration_s")?;
        let mut origins: [Option<ColumnSource>; QUANTITIES] = Default::default();
        for (origin, quantity) in origins.iter_mut().zip(Quantity::ALL) {
            *origin = self.entry(quantity).map(|entry| entry.origin(quantity)).transpose()?;
        }
        let separator = match self.separator {
            Some(character) if !character.is_ascii() => return Err(MapError::Separator(character)),
            character => character.map_or(b',', |character| character as u8),
        };
        let (valve, target) = (self.u_out.is_some(), self.target.is_some());
        let start = match self.breath {
            Some(_) => StartBy::Number,
            None if target => StartBy::Target,
            None if valve => StartBy::Valve,
            None => return Err(MapError::NoStart),
        };
        let end = match inspiration_s {
            Some(seconds) => EndBy::Time(seconds),
            None if valve => EndBy::Valve,
            None if target => EndBy::Target,
            None => return Err(MapError::NoEnd),
        };
        Ok(TableLayout {
            plant: self.plant.clone().unwrap_or_else(|| "unknown".into()),
            note: self.note.clone(),
            period_s,
            separator,
            breath: self.breath.as_ref().map(|label| label.column.clone()),
            group: self.group.as_ref().map(|group| group.column.clone()),
            run: self.group.as_ref().and_then(|group| group.run.clone()),
            origins,
            start,
            end,
        })
    }
}

impl Entry {
    fn origin(&self, quantity: Quantity) -> Result<ColumnSource, MapError> {
        let name = quantity.name();
        let units = quantity.units();
        let unit = self.unit.as_deref().unwrap_or(units[0].0);
        let Some((_, factor)) = units.iter().find(|(known, _)| *known == unit) else {
            let known = units.iter().map(|(known, _)| *known).collect::<Vec<_>>().join(", ");
            return Err(MapError::Unit { quantity: name, unit: unit.to_owned(), known });
        };
        let scale = self.scale.unwrap_or(1.0);
        match (&self.column, self.value) {
            (Some(column), None) => Ok(ColumnSource::Column {
                name: column.clone(),
                factor: factor * scale,
                offset: factor * self.offset,
                share: unit == SHARE,
            }),
            (None, Some(value)) if matches!(quantity, Quantity::Resistance | Quantity::Compliance) => {
                Ok(ColumnSource::Value(factor * (value * scale + self.offset)))
            }
            (None, Some(_)) => Err(MapError::NotConstant(name)),
            _ => Err(MapError::Source(name)),
        }
    }
}
