//! The description of a farm: its units, from a TOML file or virtual ones. Every refusal names the line.

use std::fmt;
use std::path::Path;

use serde::Deserialize;
use toml::Spanned;

use super::UnitName;
use super::band::Band;
use crate::error::{Result, StudyError};
use data::identity::LungParameters;
use data::workspace::WorkspaceError;
use device::port::{Address, BAUD};
use plant::bench::{BenchConfig, UnitConfig};
use shared::calibration::Quantity;

/// A farm.
#[derive(Clone, Debug, PartialEq)]
pub struct Farm {
    /// Its units.
    pub units: Vec<Unit>,
    /// How far a unit may deviate from the rest.
    pub band: Band,
}

/// A unit of a farm.
#[derive(Clone, Debug, PartialEq)]
pub struct Unit {
    /// Its name, which is also that of its folder.
    pub name: UnitName,
    /// Where it is.
    pub place: Place,
    /// The test lung at the unit, if it is known.
    pub lung: Option<LungParameters>,
    /// A remark for people.
    pub note: String,
    /// Change of the sensor's reading per change of the pressure, as measured with a manometer; one if it was not.
    pub sensor_gain: Option<f32>,
    /// Where the file describes it, such as `farm.toml:12`.
    pub line: String,
}

/// Where a unit is.
#[derive(Clone, Debug, PartialEq)]
pub enum Place {
    /// A device at a port.
    Port(Address),
    /// A board on the desk at a port, which simulates a bench.
    Desk(Address, Box<BenchConfig>),
    /// A device in this process, on a bench.
    Bench(Box<BenchConfig>),
}

impl Place {
    /// The port, if the unit is at one.
    pub fn port(&self) -> Option<&Address> {
        match self {
            Self::Port(address) | Self::Desk(address, _) => Some(address),
            Self::Bench(_) => None,
        }
    }
}

impl fmt::Display for Place {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Port(address) => write!(f, "{address}"),
            Self::Desk(address, bench) => write!(f, "{address}, which simulates {}", bench.name),
            Self::Bench(bench) => write!(f, "bench {}", bench.name),
        }
    }
}

impl Unit {
    /// The bench, if the unit is simulated.
    pub fn bench(&self) -> Option<&BenchConfig> {
        match &self.place {
            Place::Desk(_, bench) | Place::Bench(bench) => Some(bench),
            Place::Port(_) => None,
        }
    }
}

/// What the file contains.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    #[serde(default)]
    unit: Vec<Spanned<Entry>>,
    #[serde(default)]
    band: Band,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Entry {
    name: Option<Spanned<String>>,
    port: Option<Spanned<String>>,
    bench: Option<Spanned<String>>,
    lung: Option<Spanned<String>>,
    #[serde(default)]
    note: String,
    sensor_gain: Option<Spanned<f32>>,
}

impl Farm {
    /// Reads a description.
    ///
    /// # Errors
    /// A file that cannot be read, or that is no farm: the refusal names the line.
    pub fn load(path: &Path) -> Result<Self> {
        let text = std::fs::read_to_string(path).map_err(WorkspaceError::file(path))?;
        Self::parse(&text, path)
    }

    /// Reads a description in this text, as if from this file.
    ///
    /// # Errors
    /// See [`Self::load`].
    pub fn parse(text: &str, path: &Path) -> Result<Self> {
        let reader = Reader { text, path };
        let file: File = toml::from_str(text).map_err(|error| {
            let place = error.span().map_or(0, |span| span.start);
            reader.refused(place, error.message().trim())
        })?;
        let mut units: Vec<Unit> = Vec::new();
        for (number, entry) in file.unit.iter().enumerate() {
            let unit = reader.unit(number, entry)?;
            if let Some(earlier) = units.iter().find(|earlier| earlier.name.same_folder(&unit.name)) {
                let message = format!("unit {} is already described at {}", unit.name, earlier.line);
                return Err(reader.refused(entry.span().start, &message));
            }
            let port = unit.place.port().map(canonical);
            let same_port = |earlier: &&Unit| port.is_some() && earlier.place.port().map(canonical) == port;
            if let Some(earlier) = units.iter().find(same_port) {
                let place =
                    entry.get_ref().port.as_ref().map_or(entry.span().start, |port| port.span().start);
                let message =
                    format!("unit {} has the port of unit {} ({})", unit.name, earlier.name, earlier.line);
                return Err(reader.refused(place, &message));
            }
            units.push(unit);
        }
        if units.is_empty() {
            return Err(reader.refused(0, "a farm needs at least one [[unit]] with a port or a bench"));
        }
        Ok(Self { units, band: file.band })
    }

    /// A farm of this many devices in this process, which differ as units of one type do, with the paper's nine lungs in turn.
    pub fn virtual_units(count: u32, seed: u64) -> Self {
        let lungs = BenchConfig::paper_lungs();
        let unit = |number: u32| {
            let mut bench = lungs[(number - 1) as usize % lungs.len()].clone();
            // Another seed gives other units.
            let number_of_type = (seed as u32).wrapping_mul(1000).wrapping_add(number);
            bench.unit = UnitConfig { number: number_of_type, ..bench.unit };
            Unit {
                name: UnitName::numbered(number),
                lung: Some(lung_of(&bench)),
                place: Place::Bench(Box::new(bench)),
                note: String::new(),
                sensor_gain: None,
                line: format!("virtual unit {number}"),
            }
        };
        Self { units: (1..=count).map(unit).collect(), band: Band::default() }
    }

    /// The benches, if all units are simulated.
    pub fn benches(&self) -> Option<Vec<&BenchConfig>> {
        self.units.iter().map(Unit::bench).collect()
    }
}

/// The lung of a bench.
fn lung_of(bench: &BenchConfig) -> LungParameters {
    let lung = &bench.lung.first;
    LungParameters {
        resistance: lung.resistance_cmh2o_per_l_s as f32,
        compliance: lung.compliance_ml_per_cmh2o as f32,
    }
}

/// An address that two names of one port have in common.
fn canonical(address: &Address) -> Address {
    match address {
        Address::Serial { name, .. } => {
            let path = std::fs::canonicalize(name).ok();
            let name = path.map_or_else(|| name.clone(), |path| path.display().to_string());
            // The speed does not make another port of it.
            Address::Serial { name, baud: BAUD }
        }
        Address::Tcp(address) => Address::Tcp(address.replace("localhost:", "127.0.0.1:")),
    }
}

/// Reads entries, and names the lines of those that it refuses.
struct Reader<'a> {
    text: &'a str,
    path: &'a Path,
}

impl Reader<'_> {
    /// A place in the file, such as `farm.toml:12`.
    fn line(&self, place: usize) -> String {
        let number = 1 + self.text.bytes().take(place).filter(|byte| *byte == b'\n').count();
        format!("{}:{number}", self.path.display())
    }

    fn refused(&self, place: usize, message: &str) -> StudyError {
        StudyError::Description { line: self.line(place), message: message.to_owned() }
    }

    fn unit(&self, number: usize, entry: &Spanned<Entry>) -> Result<Unit> {
        let start = entry.span().start;
        let entry = entry.get_ref();
        let name = match &entry.name {
            Some(name) => {
                let refused = |message: String| self.refused(name.span().start, &message);
                name.get_ref().parse::<UnitName>().map_err(refused)?
            }
            None => UnitName::numbered(number as u32 + 1),
        };
        let place = match (&entry.port, &entry.bench) {
            (Some(port), None) => Place::Port(self.parsed(port)?),
            (Some(port), Some(bench)) => Place::Desk(self.parsed(port)?, Box::new(self.bench(bench)?)),
            (None, Some(bench)) => Place::Bench(Box::new(self.bench(bench)?)),
            (None, None) => {
                let message = format!("unit {name} needs a port or a bench");
                return Err(self.refused(start, &message));
            }
        };
        let named = entry.lung.as_ref().map(|lung| self.bench(lung)).transpose()?;
        let lung = match (&named, &place) {
            (Some(lung), _) => Some(lung_of(lung)),
            (None, Place::Desk(_, bench) | Place::Bench(bench)) => Some(lung_of(bench)),
            (None, Place::Port(_)) => None,
        };
        let (low, high) = Quantity::SensorGain.bounds();
        // In this form a NaN is refused too.
        let refused = |gain: &&Spanned<f32>| !(low..=high).contains(gain.get_ref());
        if let Some(gain) = entry.sensor_gain.as_ref().filter(refused) {
            let message =
                format!("sensor_gain {} is outside {low} to {high}: repair the sensor", gain.get_ref());
            return Err(self.refused(gain.span().start, &message));
        }
        let sensor_gain = entry.sensor_gain.as_ref().map(|gain| *gain.get_ref());
        Ok(Unit { name, place, lung, note: entry.note.clone(), sensor_gain, line: self.line(start) })
    }

    fn parsed(&self, port: &Spanned<String>) -> Result<Address> {
        let address = port.get_ref().parse::<Address>();
        address.map_err(|error| self.refused(port.span().start, &error.to_string()))
    }

    /// A bench by its name or, with the ending `.toml`, in a file beside the farm's.
    fn bench(&self, name: &Spanned<String>) -> Result<BenchConfig> {
        let text = name.get_ref();
        let found = if Path::new(text).extension().is_some_and(|ending| ending == "toml") {
            BenchConfig::load(self.path.parent().unwrap_or(Path::new("")).join(text))
        } else {
            BenchConfig::from_name(text)
        };
        found.map_err(|error| self.refused(name.span().start, &error.to_string()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Farm> {
        Farm::parse(text, Path::new("farm.toml"))
    }

    fn refusal(text: &str) -> String {
        parse(text).unwrap_err().to_string()
    }

    #[test]
    fn a_unit_has_a_place_a_lung_and_a_note() {
        let farm = parse(
            "[[unit]]\nport = \"/dev/ttyACM0\"\nlung = \"R20C50\"\nnote = \"new valve\"\nsensor_gain = 1.02\n\
             [[unit]]\nname = \"spare\"\nbench = \"R5C10\"\n\
             [[unit]]\nport = \"COM4\"\nbench = \"R50C20\"\n[band]\ndead_time_ms = 2\n",
        )
        .unwrap();
        let [first, second, desk] = &farm.units[..] else { panic!("{farm:?}") };
        assert_eq!((first.name.as_str(), first.sensor_gain), ("1", Some(1.02)));
        assert_eq!(first.lung, Some(LungParameters { resistance: 20.0, compliance: 50.0 }));
        assert_eq!((second.name.as_str(), second.line.as_str()), ("spare", "farm.toml:6"));
        assert_eq!(second.lung, Some(LungParameters { resistance: 5.0, compliance: 10.0 }));
        assert_eq!(desk.place.to_string(), "COM4, which simulates R50C20");
        assert_eq!(desk.lung, Some(LungParameters { resistance: 50.0, compliance: 20.0 }));
        assert_eq!(farm.band, Band { dead_time_ms: 2.0, ..Band::default() });
        assert!(farm.benches().is_none());
    }

    #[test]
    fn a_description_that_is_wrong_is_refused_with_the_line() {
        for (text, wanted) in [
            ("", "farm.toml:1: a farm needs at least one"),
            (
                "[[unit]]\nport = \"COM3\"\n[[unit]]\nport = \"COM3\"\n",
                "farm.toml:4: unit 2 has the port of unit 1",
            ),
            (
                "[[unit]]\nport = \"COM3\"\n[[unit]]\nport = \"COM3\"\nbench = \"R5C10\"\n",
                "farm.toml:4: unit 2 has the port of unit 1",
            ),
            (
                "[[unit]]\nport = \"COM3\"\n[[unit]]\nport = \"serial:COM3?baud=9600\"\n",
                "farm.toml:4: unit 2 has the port of unit 1",
            ),
            (
                "[[unit]]\nport = \"tcp:localhost:5\"\n[[unit]]\nport = \"tcp:127.0.0.1:5\"\n",
                "farm.toml:4: unit 2 has the port of unit 1",
            ),
            ("[[unit]]\nport = \"COM3\"\nlung = \"R20\"\n", "farm.toml:3: unknown lung \"R20\""),
            ("[[unit]]\nport = \"COM3\"\nlungs = \"R20C20\"\n", "farm.toml:3: unknown field `lungs`"),
            ("[[unit]]\nnote = \"\"\n", "farm.toml:1: unit 1 needs a port or a bench"),
            ("[[unit]]\nname = \"a/b\"\nport = \"COM3\"\n", "farm.toml:2: the name a/b"),
            ("[[unit]]\nport = \"tcp:x\"\n", "farm.toml:2: 'tcp:x' is not a device's address"),
            ("[[unit]]\nport = \"COM3\"\nsensor_gain = 2.0\n", "farm.toml:3: sensor_gain 2 is outside"),
            (
                "[[unit]]\nname = \"a\"\nport = \"COM3\"\n[[unit]]\nname = \"a\"\nport = \"COM4\"\n",
                "farm.toml:4: unit a is already described at farm.toml:1",
            ),
        ] {
            let refused = refusal(text);
            assert!(refused.starts_with(wanted), "{refused}, not {wanted}");
        }
    }

    #[test]
    fn virtual_units_differ_and_another_seed_gives_other_units() {
        let farm = Farm::virtual_units(10, 1);
        let benches = farm.benches().unwrap();
        assert!(benches.iter().enumerate().all(|(n, bench)| !benches[..n].contains(bench)));
        assert_ne!(farm, Farm::virtual_units(10, 2));
        assert_eq!(farm, Farm::virtual_units(10, 1));
    }
}
