//! Named lungs: those of the paper and those of the pressure-control test table.

use shared::breath::{ISO_ROWS, IsoRow};

use super::config::{BenchConfig, BenchError, CompartmentConfig, LungConfig};

/// Resistances of the paper's lungs, cmH2O/(L/s).
const PAPER_RESISTANCES: [f64; 3] = [5.0, 20.0, 50.0];
/// Compliances of the paper's lungs, mL/cmH2O.
const PAPER_COMPLIANCES: [f64; 3] = [10.0, 20.0, 50.0];

impl BenchConfig {
    /// A lung of `resistance` cmH2O/(L/s) and `compliance` mL/cmH2O on the default bench, named like `R20C20`.
    pub fn paper(resistance: f64, compliance: f64) -> Self {
        Self::with_lung(format!("R{resistance}C{compliance}"), resistance, compliance)
    }

    /// The nine combinations of R 5, 20, 50 and C 10, 20, 50.
    pub fn paper_lungs() -> Vec<Self> {
        let lungs = PAPER_RESISTANCES.iter().flat_map(|r| PAPER_COMPLIANCES.iter().map(move |c| (*r, *c)));
        lungs.map(|(r, c)| Self::paper(r, c)).collect()
    }

    /// The 21 lungs of the pressure-control test table, `iso-01` to `iso-21`.
    pub fn iso_lungs() -> Vec<Self> {
        let lung = |row: &IsoRow| {
            let name = format!("iso-{:02}", row.number);
            Self::with_lung(name, f64::from(row.resistance), f64::from(row.compliance))
        };
        ISO_ROWS.iter().map(lung).collect()
    }

    /// The lung named `name`: `R<resistance>C<compliance>` with any allowed numbers, or `iso-01` to `iso-21`.
    ///
    /// # Errors
    /// [`BenchError::UnknownName`], or [`BenchError::OutOfRange`] for numbers that are not allowed.
    pub fn from_name(name: &str) -> Result<Self, BenchError> {
        if let Some(lung) = Self::iso_lungs().into_iter().find(|lung| lung.name == name) {
            return Ok(lung);
        }
        let numbers = name.strip_prefix('R').and_then(|rest| rest.split_once('C'));
        let Some((Ok(r), Ok(c))) = numbers.map(|(r, c)| (r.parse::<f64>(), c.parse::<f64>())) else {
            return Err(BenchError::UnknownName(name.to_owned()));
        };
        let lung = Self::paper(r, c);
        lung.validate()?;
        Ok(lung)
    }

    /// The lungs named `name`: `paper` (9), `iso` (21), or a single lung by its name.
    ///
    /// # Errors
    /// See [`BenchConfig::from_name`].
    pub fn preset(name: &str) -> Result<Vec<Self>, BenchError> {
        match name {
            "paper" => Ok(Self::paper_lungs()),
            "iso" => Ok(Self::iso_lungs()),
            single => Self::from_name(single).map(|lung| vec![lung]),
        }
    }

    fn with_lung(name: String, resistance: f64, compliance: f64) -> Self {
        let first = CompartmentConfig {
            resistance_cmh2o_per_l_s: resistance,
            compliance_ml_per_cmh2o: compliance,
            ..CompartmentConfig::default()
        };
        Self { name, lung: LungConfig { first, second: None }, ..Self::default() }
    }
}
