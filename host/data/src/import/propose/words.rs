//! What names and units of columns mean, in the languages of ventilators.

use super::super::map::{Quantity, VOLUMES};

/// What a column may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(in crate::import) enum Meaning {
    Of(Quantity),
    Flow,
    Volume,
    Breath,
}

impl Meaning {
    /// Name of its table in the column map.
    pub fn name(self) -> &'static str {
        match self {
            Self::Of(quantity) => quantity.name(),
            Self::Flow => "flow",
            Self::Volume => "volume",
            Self::Breath => "breath",
        }
    }

    /// The units that it can have, our own first, with their factors to that; none for a number of breaths.
    pub fn units(self) -> &'static [(&'static str, f64)] {
        match self {
            Self::Of(quantity) => quantity.units(),
            Self::Flow => Quantity::FlowIn.units(),
            Self::Volume => VOLUMES,
            Self::Breath => &[],
        }
    }
}

/// Words of names, the longest and surest first.
const WORDS: [(&str, Meaning); 38] = [
    ("breath_id", Meaning::Breath),
    ("breath_no", Meaning::Breath),
    ("breath number", Meaning::Breath),
    ("set-point", Meaning::Of(Quantity::Target)),
    ("setpoint", Meaning::Of(Quantity::Target)),
    ("set_p", Meaning::Of(Quantity::Target)),
    ("pset", Meaning::Of(Quantity::Target)),
    ("target", Meaning::Of(Quantity::Target)),
    ("soll", Meaning::Of(Quantity::Target)),
    ("consigne", Meaning::Of(Quantity::Target)),
    ("flow", Meaning::Flow),
    ("fluss", Meaning::Flow),
    ("flu\u{df}", Meaning::Flow),
    ("flujo", Meaning::Flow),
    ("d\u{e9}bit", Meaning::Flow),
    ("debit", Meaning::Flow),
    ("u_out", Meaning::Of(Quantity::UOut)),
    ("exh", Meaning::Of(Quantity::UOut)),
    ("exp_valve", Meaning::Of(Quantity::UOut)),
    ("u_in", Meaning::Of(Quantity::UIn)),
    ("inh", Meaning::Of(Quantity::UIn)),
    ("valve", Meaning::Of(Quantity::UIn)),
    ("resistance", Meaning::Of(Quantity::Resistance)),
    ("compliance", Meaning::Of(Quantity::Compliance)),
    ("vol", Meaning::Volume),
    ("pressure", Meaning::Of(Quantity::Pressure)),
    ("pression", Meaning::Of(Quantity::Pressure)),
    ("presi\u{f3}n", Meaning::Of(Quantity::Pressure)),
    ("presion", Meaning::Of(Quantity::Pressure)),
    ("druck", Meaning::Of(Quantity::Pressure)),
    ("paw", Meaning::Of(Quantity::Pressure)),
    ("pva", Meaning::Of(Quantity::Pressure)),
    ("time", Meaning::Of(Quantity::Time)),
    ("zeit", Meaning::Of(Quantity::Time)),
    ("tiempo", Meaning::Of(Quantity::Time)),
    ("temps", Meaning::Of(Quantity::Time)),
    ("uhr", Meaning::Of(Quantity::Time)),
    ("epoch", Meaning::Of(Quantity::Time)),
];
/// Names of one or two letters.
const LETTERS: [(&str, Meaning); 8] = [
    ("t", Meaning::Of(Quantity::Time)),
    ("p", Meaning::Of(Quantity::Pressure)),
    ("q", Meaning::Flow),
    ("f", Meaning::Flow),
    ("v'", Meaning::Flow),
    ("v", Meaning::Volume),
    ("set", Meaning::Of(Quantity::Target)),
    ("ms", Meaning::Of(Quantity::Time)),
];
/// Words of the flow of one direction.
const DIRECTIONS: [(&str, Quantity); 6] = [
    ("exp", Quantity::FlowOut),
    ("exh", Quantity::FlowOut),
    ("out", Quantity::FlowOut),
    ("insp", Quantity::FlowIn),
    ("inh", Quantity::FlowIn),
    ("in", Quantity::FlowIn),
];
/// Spellings of units in names and in lines below them.
const UNITS: [(&str, &str); 19] = [
    ("cmh2o", "cmH2O"),
    ("mmh2o", "mmH2O"),
    ("mbar", "mbar"),
    ("hpa", "hPa"),
    ("kpa", "kPa"),
    ("mmhg", "mmHg"),
    ("ml/m", "mL/min"),
    ("mlpm", "mL/min"),
    ("ml/s", "mL/s"),
    ("mlps", "mL/s"),
    ("l/m", "L/min"),
    ("lpm", "L/min"),
    ("l/s", "L/s"),
    ("lps", "L/s"),
    ("ml", "mL"),
    ("us", "us"),
    ("ms", "ms"),
    ("%", "percent"),
    ("percent", "percent"),
];
/// Units that are told by a whole text only.
const WHOLE_UNITS: [(&str, &str); 5] = [("pa", "Pa"), ("l", "L"), ("s", "s"), ("sec", "s"), ("seconds", "s")];

/// What a name means, and the word that shows it.
pub(super) fn meaning(name: &str) -> Option<(&'static str, Meaning)> {
    let lower = name.to_lowercase();
    let bare = lower.split(['(', '[', '/']).next().unwrap_or_default().trim();
    let is_valve = lower.contains("valve");
    let mut words = WORDS.iter().filter(|(_, meaning)| !(is_valve && *meaning == Meaning::Flow));
    let word = words.find(|(word, _)| lower.contains(word));
    word.or_else(|| LETTERS.iter().find(|(letter, _)| bare == *letter)).copied()
}

/// The direction of a flow of this name, if it is that of one.
pub(super) fn direction(name: &str) -> Option<Quantity> {
    let lower = name.to_lowercase();
    let words: Vec<&str> = lower.split(|c: char| !c.is_alphabetic()).collect();
    let has = |part: &&(&str, Quantity)| words.iter().any(|word| word.starts_with(part.0));
    DIRECTIONS.iter().find(has).map(|(_, direction)| *direction)
}

/// The unit in a text, of those that a quantity can have, and its factor to our own.
pub(in crate::import) fn unit(text: &str, meaning: Meaning) -> Option<(&'static str, f64)> {
    let text = text.to_lowercase().replace("m h2o", "mh2o").replace("_per_", "/").replace('\u{2082}', "2");
    let within = UNITS.iter().filter(|(spelling, _)| text.contains(spelling));
    let whole = WHOLE_UNITS.iter().filter(|(spelling, _)| text.trim() == *spelling);
    let known = |spelled: &str| meaning.units().iter().find(|(unit, _)| *unit == spelled).copied();
    within.chain(whole).find_map(|(_, unit)| known(unit))
}

/// The text in brackets, which should be a unit.
pub(in crate::import) fn bracketed(name: &str) -> Option<&str> {
    let (_, rest) = name.split_once(['(', '['])?;
    rest.split([')', ']']).next().filter(|unit| !unit.is_empty())
}
