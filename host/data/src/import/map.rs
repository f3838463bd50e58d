//! The column map: which column contains which quantity, in which unit; as typed in TOML, and as checked.

use std::fmt;
use std::path::Path;

use serde::Deserialize;
use thiserror::Error;

/// Quantities that a row can have, in the order of its fields.
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

/// Units of flows, and of a volume as the flow that makes it: name and factor to L/s and L.
const FLOWS: &[(&str, f64)] = &[("L/s", 1.0), ("L/min", 1.0 / 60.0), ("mL/s", 1e-3), ("mL/min", 1e-3 / 60.0)];
pub(super) const VOLUMES: &[(&str, f64)] = &[("L", 1.0), ("mL", 1e-3)];

/// The unit of a command from 0 to 1.
const SHARE: &str = "share";

/// Pressure units: name and factor to cmH2O.
const PRESSURES: &[(&str, f64)] = &[
    ("cmH2O", 1.0),
    ("mmH2O", 0.1),
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
            Self::FlowIn | Self::FlowOut => FLOWS,
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
    /// A mark of more than one byte.
    #[error("the column map's `{0}` is no mark that a table can have: write one ASCII character")]
    Separator(char),
    /// A number out of range.
    #[error("{0} of the column map must be a number above 0")]
    Number(&'static str),
    /// A quantity that must be a column has a value.
    #[error("[{0}] of the column map must be a column, not a value: it changes from row to row")]
    NotConstant(&'static str),
    /// A single flow beside one for each direction, or a volume beside either.
    #[error(
        "the column map has several flows: give [flow_in] and [flow_out], or one [flow] with its sign, or a [volume]"
    )]
    Flows,
    /// Neither times nor a period.
    #[error("the column map has no times: give a [time] column, or period_ms for rows at even steps")]
    NoTime,
    /// Columns are counted from one.
    #[error("the column map has column 0: columns are counted from 1")]
    NoColumn,
}

/// A column of a table.
#[derive(Debug, Clone, PartialEq, Eq, Deserialize)]
#[serde(untagged)]
pub enum Column {
    /// The one with this name.
    Name(String),
    /// The one at this place, counted from 1; of a table without names.
    Number(usize),
}

impl Column {
    /// The name, if it is known by one.
    pub fn name(&self) -> Option<&str> {
        match self {
            Self::Name(name) => Some(name),
            Self::Number(_) => None,
        }
    }
}

impl fmt::Display for Column {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Name(name) => f.write_str(name),
            Self::Number(number) => write!(f, "{number}"),
        }
    }
}

/// A quantity as typed.
#[derive(Debug, Clone, PartialEq, Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    column: Option<Column>,
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
    column: Column,
}

/// The columns that identify test runs.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
struct Group {
    /// The ventilator's name, or the name of the whole.
    column: Column,
    /// The name of the run among those of the ventilator.
    run: Option<Column>,
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
    decimal: Option<char>,
    comment: Option<char>,
    #[serde(default)]
    skip_lines: u64,
    breath: Option<Label>,
    group: Option<Group>,
    time: Option<Entry>,
    pressure: Entry,
    flow: Option<Entry>,
    volume: Option<Entry>,
    u_in: Option<Entry>,
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
        /// The column.
        column: Column,
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
    /// The flow, or the pressure if there is none.
    Found,
}

/// A column that becomes the flows in both directions.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Signed {
    /// A flow, positive into the lung.
    Flow,
    /// The volume in the lung.
    Volume,
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
    /// The file tells the phases.
    Phase,
    /// The flow turns or, if there is none, the pressure falls.
    Found,
}

/// The decimal mark of a table's numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Decimal {
    /// The mark: a point or a comma.
    pub mark: u8,
    /// Whether the map says so: the other mark can then only be one between thousands.
    pub sure: bool,
}

impl Decimal {
    /// A comma or, where a number has none, a point.
    pub const EITHER: Self = Self { mark: b',', sure: false };
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
    /// Decimal mark.
    pub decimal: Decimal,
    /// First character of lines that are left out.
    pub comment: Option<u8>,
    /// Lines at the start of the file that are left out.
    pub skip_lines: u64,
    /// The breath column.
    pub breath: Option<Column>,
    /// The group column.
    pub group: Option<Column>,
    /// The column of runs within a group.
    pub run: Option<Column>,
    /// What the columns of the flows contain instead, if that is one column for both.
    pub signed: Option<Signed>,
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
            Quantity::Time => self.time.as_ref(),
            Quantity::Pressure => Some(&self.pressure),
            Quantity::UIn => self.u_in.as_ref(),
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
        if self.time.is_none() && period_s.is_none() {
            return Err(MapError::NoTime);
        }
        let inspiration_s = positive(self.inspiration_s, "inspiration_s")?;
        let mut origins: [Option<ColumnSource>; QUANTITIES] = Default::default();
        for (origin, quantity) in origins.iter_mut().zip(Quantity::ALL) {
            let entry = self.entry(quantity);
            *origin =
                entry.map(|entry| entry.origin(quantity, quantity.name(), quantity.units())).transpose()?;
        }
        let signed = self.signed(&mut origins)?;
        let separator = mark(self.separator)?.unwrap_or(b',');
        let decimal = match mark(self.decimal)? {
            Some(mark) => Decimal { mark, sure: true },
            None if separator == b',' => Decimal { mark: b'.', sure: false },
            None => Decimal::EITHER,
        };
        let (valve, target) = (self.u_out.is_some(), self.target.is_some());
        let start = match self.breath {
            Some(_) => StartBy::Number,
            None if target => StartBy::Target,
            None if valve => StartBy::Valve,
            None => StartBy::Found,
        };
        let end = match inspiration_s {
            Some(seconds) => EndBy::Time(seconds),
            None if valve => EndBy::Valve,
            None if target => EndBy::Target,
            None => EndBy::Found,
        };
        let (group, breath) = (self.group.as_ref(), self.breath.as_ref());
        let layout = TableLayout {
            plant: self.plant.clone().unwrap_or_else(|| "unknown".into()),
            note: self.note.clone(),
            period_s,
            separator,
            decimal,
            comment: Some(mark(self.comment)?.unwrap_or(b'#')),
            skip_lines: self.skip_lines,
            breath: breath.map(|label| label.column.clone()),
            group: group.map(|group| group.column.clone()),
            run: group.and_then(|group| group.run.clone()),
            signed,
            origins,
            start,
            end,
        };
        if layout.columns().any(|column| *column == Column::Number(0)) {
            return Err(MapError::NoColumn);
        }
        Ok(layout)
    }

    /// Puts a signed flow, or a volume, where the flows are.
    fn signed(&self, origins: &mut [Option<ColumnSource>; QUANTITIES]) -> Result<Option<Signed>, MapError> {
        let of = |entry: &Option<Entry>, name, units| {
            entry.as_ref().map(|entry| entry.origin(Quantity::FlowIn, name, units)).transpose()
        };
        let (flow, volume) = (of(&self.flow, "flow", FLOWS)?, of(&self.volume, "volume", VOLUMES)?);
        let (inward, outward) = (Quantity::FlowIn as usize, Quantity::FlowOut as usize);
        let each = origins[inward].is_some() || origins[outward].is_some();
        // Of flow and volume the flow is the better one: both are common in one table.
        let (signed, origin) = match (flow, volume) {
            (None, None) => return Ok(None),
            (Some(_), _) if each => return Err(MapError::Flows),
            (None, Some(_)) if each => return Ok(None),
            (Some(flow), _) => (Signed::Flow, flow),
            (None, Some(volume)) => (Signed::Volume, volume),
        };
        (origins[inward], origins[outward]) = (Some(origin.clone()), Some(origin));
        Ok(Some(signed))
    }
}

impl TableLayout {
    /// The layout of a format that is no table: which quantities its rows have, in our units. Flow or pressure show the breaths.
    pub fn of_format(plant: &str, note: &str, has: impl Fn(Quantity) -> bool) -> Self {
        let column = |quantity: Quantity| ColumnSource::Column {
            column: Column::Name(quantity.name().to_owned()),
            factor: 1.0,
            offset: 0.0,
            share: false,
        };
        Self {
            plant: plant.to_owned(),
            note: Some(note.to_owned()),
            period_s: None,
            separator: b',',
            decimal: Decimal { mark: b'.', sure: true },
            comment: None,
            skip_lines: 0,
            breath: None,
            group: None,
            run: None,
            signed: None,
            origins: Quantity::ALL.map(|quantity| has(quantity).then(|| column(quantity))),
            start: StartBy::Found,
            end: EndBy::Found,
        }
    }

    /// All columns that a table needs.
    pub fn columns(&self) -> impl Iterator<Item = &Column> {
        let quantities = self.origins.iter().flatten().filter_map(|origin| match origin {
            ColumnSource::Column { column, .. } => Some(column),
            ColumnSource::Value(_) => None,
        });
        quantities.chain(&self.breath).chain(&self.group).chain(&self.run)
    }

    /// Whether the rows have this quantity.
    pub fn has(&self, quantity: Quantity) -> bool {
        self.origins[quantity as usize].is_some()
    }

    /// Whether the order of the rows is that of the file: breaths are numbered, and their times may all begin at zero.
    pub fn is_ordered(&self) -> bool {
        self.breath.is_some()
    }

    /// Whether the flows come from a volume.
    pub fn has_volumes(&self) -> bool {
        self.signed == Some(Signed::Volume)
    }

    /// Factor of the times to seconds.
    pub fn time_factor(&self) -> f64 {
        match &self.origins[Quantity::Time as usize] {
            Some(ColumnSource::Column { factor, .. }) => *factor,
            _ => 1.0,
        }
    }
}

/// A mark of one byte.
fn mark(typed: Option<char>) -> Result<Option<u8>, MapError> {
    match typed {
        Some(character) if !character.is_ascii() => Err(MapError::Separator(character)),
        character => Ok(character.map(|character| character as u8)),
    }
}

impl Entry {
    fn origin(
        &self,
        quantity: Quantity,
        name: &'static str,
        units: &[(&str, f64)],
    ) -> Result<ColumnSource, MapError> {
        let unit = self.unit.as_deref().unwrap_or(units[0].0);
        let Some((_, factor)) = units.iter().find(|(known, _)| *known == unit) else {
            let known = units.iter().map(|(known, _)| *known).collect::<Vec<_>>().join(", ");
            return Err(MapError::Unit { quantity: name, unit: unit.to_owned(), known });
        };
        let scale = self.scale.unwrap_or(1.0);
        match (&self.column, self.value) {
            (Some(column), None) => Ok(ColumnSource::Column {
                column: column.clone(),
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
