//! Named lungs: those of the paper and those of the pressure-control test table, on the default machine or on one for newborns.

use std::path::Path;

use shared::breath::{ISO_ROWS, IsoRow};

use super::config::{
    BenchConfig, BenchError, CircuitConfig, CompartmentConfig, ExpiratoryConfig, FlowSensorConfig,
    LungConfig, OutletSensorConfig, SensorConfig, ValveConfig,
};

/// Resistances of the paper's lungs, cmH2O/(L/s).
const PAPER_RESISTANCES: [f64; 3] = [5.0, 20.0, 50.0];
/// Compliances of the paper's lungs, mL/cmH2O.
const PAPER_COMPLIANCES: [f64; 3] = [10.0, 20.0, 50.0];
/// Name of the machine for newborns, and of a newborn on it; with a hyphen, the beginning of the names of other lungs on it.
const NEONATE: &str = "neonate";
/// A newborn: resistance of airways and endotracheal tube, cmH2O/(L/s), and compliance, mL/cmH2O.
const NEWBORN: (f64, f64) = (100.0, 2.0);
/// Turbulence of a newborn's endotracheal tube, s/L.
const TUBE_TURBULENCE_S_PER_L: f64 = 2.0;
/// Highest compliance of a newborn in the test table, mL/cmH2O; the rows above are of 10 and more.
const MOST_NEONATAL_COMPLIANCE: f32 = 3.0;

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

    /// The 21 lungs of the test table, each on the machine that fits it: rows 9 to 21, with compliances up to 3 mL/cmH2O, on the one
    /// for newborns.
    pub fn iso_matched() -> Vec<Self> {
        let matched =
            |(row, lung): (&IsoRow, Self)| if is_neonatal(row) { lung.for_newborns() } else { lung };
        ISO_ROWS.iter().zip(Self::iso_lungs()).map(matched).collect()
    }

    /// The same lung on a machine for newborns: a valve for a third of the flow, which is faster; a small circuit, and sensors of
    /// finer resolution. The lung's resistance includes an endotracheal tube, whose flow is turbulent.
    #[must_use]
    pub fn for_newborns(mut self) -> Self {
        self.name = format!("{NEONATE}-{}", self.name);
        self.valve = ValveConfig {
            dead_time_ms: 8.0,
            lag_ms: 15.0,
            backlash_percent: 3.0,
            dead_zone_percent: 3.0,
            curve_exponent: 1.5,
            max_flow_l_per_s: 0.5,
            ..self.valve
        };
        self.expiratory = ExpiratoryConfig {
            lag_ms: 10.0,
            orifice_l_per_s_per_sqrt_cmh2o: 0.15,
            laminar_resistance_cmh2o_per_l_s: 2.0,
            ..self.expiratory
        };
        self.circuit =
            CircuitConfig { compliance_ml_per_cmh2o: 0.5, leak_l_per_s_at_30_cmh2o: 0.002, ..self.circuit };
        self.sensor = SensorConfig { lag_ms: 2.0, noise_sd_cmh2o: 0.05, quantum_cmh2o: 0.03 };
        let SensorConfig { lag_ms, noise_sd_cmh2o, quantum_cmh2o } = self.sensor;
        self.outlet_sensor = OutletSensorConfig {
            lag_ms,
            noise_sd_cmh2o,
            quantum_cmh2o,
            tube_resistance_cmh2o_per_l_s: 10.0,
            ..self.outlet_sensor
        };
        self.flow_sensor = FlowSensorConfig { lag_ms: 1.5, noise_sd_l_per_s: 0.0005, ..self.flow_sensor };
        self.lung.first.turbulence_s_per_l = TUBE_TURBULENCE_S_PER_L;
        self
    }

    /// The lung named `name`: `R<resistance>C<compliance>` with any allowed numbers, or `iso-01` to `iso-21`; `neonate-` before it
    /// selects the machine for newborns, and `neonate` alone a newborn on it.
    ///
    /// # Errors
    /// [`BenchError::UnknownName`], or [`BenchError::OutOfRange`] for numbers that are not allowed.
    pub fn from_name(name: &str) -> Result<Self, BenchError> {
        if name == NEONATE {
            let (resistance, compliance) = NEWBORN;
            return Ok(Self { name: name.to_owned(), ..Self::paper(resistance, compliance).for_newborns() });
        }
        if let Some(rest) = on_neonatal_machine(name) {
            return match Self::from_name(rest) {
                Err(BenchError::UnknownName(_)) => Err(BenchError::UnknownName(name.to_owned())),
                found => Ok(found?.for_newborns()),
            };
        }
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

    /// The lungs named `name`: `paper` (9), `iso` (21), `iso-matched` (21, each on the machine that fits it), `neonate-iso` (rows 9 to
    /// 21 on the machine for newborns), or a single lung by its name.
    ///
    /// # Errors
    /// See [`BenchConfig::from_name`].
    pub fn preset(name: &str) -> Result<Vec<Self>, BenchError> {
        match name {
            "paper" => Ok(Self::paper_lungs()),
            "iso" => Ok(Self::iso_lungs()),
            "iso-matched" => Ok(Self::iso_matched()),
            "neonate-iso" => {
                let rows = ISO_ROWS.iter().zip(Self::iso_matched());
                Ok(rows.filter(|(row, _)| is_neonatal(row)).map(|(_, lung)| lung).collect())
            }
            single => Self::from_name(single).map(|lung| vec![lung]),
        }
    }

    /// The benches that a text selects: those of a lung's name, as [`BenchConfig::preset`] knows it, or the one that a file describes.
    ///
    /// # Errors
    /// See [`BenchConfig::preset`] and [`BenchConfig::load`].
    pub fn find(text: &str) -> Result<Vec<Self>, BenchError> {
        match Self::file(text) {
            Some(path) => Ok(vec![Self::load(path)?]),
            None => Self::preset(text),
        }
    }

    /// The file that a text means; none if it can only be the name of a lung.
    pub fn file(text: &str) -> Option<&Path> {
        let path = Path::new(text);
        (path.extension().is_some_and(|ending| ending == "toml") || path.is_file()).then_some(path)
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

/// The name of the lung, if this is the name of a lung on the machine for newborns.
fn on_neonatal_machine(name: &str) -> Option<&str> {
    let lung = name.strip_prefix(NEONATE)?.strip_prefix('-')?;
    // The machine is chosen once.
    (!lung.starts_with(NEONATE)).then_some(lung)
}

/// Whether a row of the test table is a newborn, for whom there is a machine of its own.
pub fn is_neonatal(row: &IsoRow) -> bool {
    row.compliance <= MOST_NEONATAL_COMPLIANCE
}
