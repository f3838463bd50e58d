//! Proposes a column map for a table: guesses from names, units and values, each with its reason.

use std::fmt::Write as _;
use std::io::Read;
use std::path::Path;

use super::map::Quantity;
use super::table::cells::{Clock, number};
use super::table::text::{Text, name};
use crate::recording::DatasetError;

/// Bytes of a table from which a map is proposed.
const START: u64 = 1 << 18;
/// Separators that are tried.
const SEPARATORS: [char; 4] = [';', '\t', ',', '|'];
/// Lines among which the names are sought.
const HEADS: usize = 200;
/// Rows that are judged.
const ROWS: usize = 2000;

/// What a column may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Meaning {
    Of(Quantity),
    Flow,
    Volume,
    Breath,
}

/// Words of names, in the languages of ventilators, the longest and surest first.
const WORDS: [(&str, Meaning); 34] = [
    ("breath_id", Meaning::Breath),
    ("breath_no", Meaning::Breath),
    ("breath number", Meaning::Breath),
    ("set-point", Meaning::Of(Quantity::Target)),
    ("setpoint", Meaning::Of(Quantity::Target)),
    ("set_p", Meaning::Of(Quantity::Target)),
    ("target", Meaning::Of(Quantity::Target)),
    ("soll", Meaning::Of(Quantity::Target)),
    ("consigne", Meaning::Of(Quantity::Target)),
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
    ("flow", Meaning::Flow),
    ("fluss", Meaning::Flow),
    ("flujo", Meaning::Flow),
    ("d\u{e9}bit", Meaning::Flow),
    ("debit", Meaning::Flow),
    ("time", Meaning::Of(Quantity::Time)),
    ("zeit", Meaning::Of(Quantity::Time)),
    ("tiempo", Meaning::Of(Quantity::Time)),
    ("temps", Meaning::Of(Quantity::Time)),
    ("uhr", Meaning::Of(Quantity::Time)),
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
/// Spellings of units in names and in lines below them.
const UNITS: [(&str, &str); 18] = [
    ("cmh2o", "cmH2O"),
    ("mbar", "mbar"),
    ("hpa", "hPa"),
    ("kpa", "kPa"),
    ("mmhg", "mmHg"),
    ("ml/min", "mL/min"),
    ("mlpm", "mL/min"),
    ("ml/s", "mL/s"),
    ("mlps", "mL/s"),
    ("l/min", "L/min"),
    ("lpm", "L/min"),
    ("l/s", "L/s"),
    ("lps", "L/s"),
    ("ml", "mL"),
    ("us", "us"),
    ("ms", "ms"),
    ("%", "percent"),
    ("percent", "percent"),
];

/// The columns of a table.
struct Columns {
    separator: char,
    decimal: u8,
    /// Names; empty if the first line has numbers.
    names: Vec<String>,
    /// Words of the line below the names, if that is no row.
    units: Vec<String>,
    /// The cells of the first rows.
    rows: Vec<Vec<String>>,
}

/// A guess about a column.
struct Guess {
    column: usize,
    meaning: Meaning,
    unit: Option<&'static str>,
    reason: String,
}

/// A column map for a table, as TOML with the reason of each guess. It is to be read before it is used.
///
/// # Errors
/// A file that cannot be read, or that has no columns.
pub fn propose(path: &Path) -> Result<String, DatasetError> {
    let mut start = Vec::new();
    let read = |source| DatasetError::Read { path: path.to_owned(), source };
    Text::open(path)?.reader.take(START).read_to_end(&mut start).map_err(read)?;
    let lines: Vec<String> = start.split(|byte| *byte == b'\n').map(name).collect();
    let columns = Columns::of(&lines).ok_or_else(|| DatasetError::NoTable {
        path: path.to_owned(),
        reason: "has no columns: no separator parts its lines alike",
    })?;
    Ok(columns.map(&columns.guesses()))
}

impl Columns {
    /// The columns with the separator that parts most lines alike.
    fn of(lines: &[String]) -> Option<Self> {
        let best = SEPARATORS.into_iter().max_by_key(|separator| Self::parted(lines, *separator).1)?;
        let (cells, rows) = Self::parted(lines, best);
        if cells < 2 || rows == 0 {
            return None;
        }
        let split = |line: &String| {
            line.split(best).map(|cell| cell.trim().trim_matches('"').to_owned()).collect::<Vec<_>>()
        };
        let table: Vec<Vec<String>> = lines
            .iter()
            .filter(|line| line.matches(best).count() + 1 == cells)
            .map(split)
            .take(ROWS)
            .collect();
        let decimal = if best == ',' { b'.' } else { b',' };
        let is_row = |cells: &Vec<String>| {
            cells.iter().filter(|cell| is_value(cell, decimal)).count() * 2 > cells.len()
        };
        let first = table.iter().take(HEADS).position(is_row)?;
        let names = if first > 0 { table[0].clone() } else { Vec::new() };
        let units = if first > 1 { table[1].clone() } else { Vec::new() };
        Some(Self { separator: best, decimal, names, units, rows: table[first..].to_vec() })
    }

    /// How many cells most lines have with a separator, and how many lines.
    fn parted(lines: &[String], separator: char) -> (usize, usize) {
        let mut counts = std::collections::BTreeMap::<usize, usize>::new();
        for line in lines.iter().filter(|line| !line.is_empty()) {
            *counts.entry(line.matches(separator).count() + 1).or_default() += 1;
        }
        counts.into_iter().filter(|(cells, _)| *cells > 1).max_by_key(|(_, rows)| *rows).unwrap_or((1, 0))
    }

    /// The numbers of a column; times of day in seconds.
    fn values(&self, column: usize) -> Vec<f64> {
        let mut clock = Clock::default();
        let cells = self.rows.iter().filter_map(|row| row.get(column));
        cells.filter_map(|cell| number(cell, self.decimal).or_else(|| clock.seconds(cell))).collect()
    }

    /// A guess for each column of which there is one; of several columns for one quantity, the first.
    fn guesses(&self) -> Vec<Guess> {
        let count = self.rows.first().map_or(0, Vec::len);
        let mut guesses = Vec::<Guess>::new();
        for column in 0..count {
            let guess = self.by_name(column);
            if let Some(guess) =
                guess.filter(|guess| guesses.iter().all(|other| other.meaning != guess.meaning))
            {
                guesses.push(guess);
            }
        }
        let mut lacking = |meaning: Meaning, find: fn(&[f64]) -> bool, reason: &str| {
            let free = |column: &usize| guesses.iter().all(|guess| guess.column != *column);
            if guesses.iter().any(|guess| guess.meaning == meaning) {
                return;
            }
            let found = (0..count).filter(free).find(|column| find(&self.values(*column)));
            guesses.extend(found.map(|column| Guess {
                column,
                meaning,
                unit: None,
                reason: reason.to_owned(),
            }));
        };
        lacking(Meaning::Of(Quantity::Time), increases, "its values increase from row to row");
        lacking(Meaning::Flow, changes_sign, "its values change sign");
        lacking(Meaning::Of(Quantity::Pressure), is_pressure, "its values could be airway pressures");
        for guess in &mut guesses {
            self.judge(guess);
        }
        guesses
    }

    fn by_name(&self, column: usize) -> Option<Guess> {
        let shown = self.names.get(column)?;
        let lower = shown.to_lowercase();
        let bare = lower.split(['(', '[', '/']).next().unwrap_or_default().trim();
        let word = WORDS.iter().find(|(word, _)| lower.contains(word));
        let (word, meaning) = word.or_else(|| LETTERS.iter().find(|(letter, _)| bare == *letter))?;
        let unit = |text: &str| {
            let text = text.to_lowercase().replace("cm h2o", "cmh2o");
            UNITS
                .iter()
                .find(|(spelling, unit)| text.contains(spelling) && fits(*meaning, unit))
                .map(|(_, unit)| *unit)
        };
        let below = self.units.get(column).and_then(|text| unit(text));
        let (unit, source) = match below {
            Some(below) => (Some(below), "the line below it"),
            None => (unit(&lower.replacen(word, "", 1)), "its name"),
        };
        let told = unit.map_or_else(String::new, |unit| format!("; {source} says {unit}"));
        Some(Guess { column, meaning: *meaning, unit, reason: format!("its name has `{word}`{told}") })
    }

    /// Adds to a guess the unit that the values suggest.
    fn judge(&self, guess: &mut Guess) {
        let values = self.values(guess.column);
        let most = values.iter().fold(0.0_f64, |most, value| most.max(value.abs()));
        let (unit, why) = match guess.meaning {
            Meaning::Of(Quantity::Time) => {
                let mut steps: Vec<f64> = values.windows(2).map(|pair| pair[1] - pair[0]).collect();
                steps.sort_by(f64::total_cmp);
                match steps.get(steps.len() / 2) {
                    Some(step) if *step >= 500.0 => ("us", "its usual step is 500 or more"),
                    Some(step) if *step >= 1.0 => ("ms", "its usual step is 1 or more"),
                    _ => return,
                }
            }
            Meaning::Flow if most > 4.0 => ("L/min", "its values exceed 4"),
            Meaning::Volume if most > 10.0 => ("mL", "its values exceed 10"),
            Meaning::Of(Quantity::Pressure | Quantity::Target) if most < 8.0 => {
                ("kPa", "its values stay below 8")
            }
            Meaning::Of(Quantity::UIn | Quantity::UOut) if most <= 1.0 => {
                ("share", "its values stay from 0 to 1")
            }
            _ => return,
        };
        if guess.unit.is_none() {
            guess.unit = Some(unit);
            let _ = write!(guess.reason, "; {why}");
        }
    }

    /// The map in TOML.
    fn map(&self, guesses: &[Guess]) -> String {
        let mut text =
            "# A proposed column map: check each guess, above all the units, before you use it.\n".to_owned();
        let names: Vec<_> = self.names.iter().map(|name| format!("`{name}`")).collect();
        let _ = if names.is_empty() {
            writeln!(text, "# The table has no names: its columns are counted from 1.")
        } else {
            writeln!(text, "# The table's columns: {}", names.join(", "))
        };
        if self.separator != ',' {
            let _ = writeln!(text, "separator = {}", toml::Value::from(self.separator.to_string()));
        }
        let has = |meaning| guesses.iter().any(|guess| guess.meaning == meaning);
        if !has(Meaning::Of(Quantity::Time)) {
            text += "# No column has times: give the time between two rows.\n# period_ms = 20\n";
        }
        for guess in guesses {
            // Of flow and volume the flow is the better one.
            if guess.meaning == Meaning::Volume && has(Meaning::Flow) {
                continue;
            }
            let table = match guess.meaning {
                Meaning::Of(quantity) => quantity.name(),
                Meaning::Flow => "flow",
                Meaning::Volume => "volume",
                Meaning::Breath => "breath",
            };
            let column = match self.names.get(guess.column) {
                Some(name) => toml::Value::from(name.as_str()),
                None => toml::Value::from(guess.column as i64 + 1),
            };
            let _ = writeln!(text, "\n# {}\n[{table}]\ncolumn = {column}", guess.reason);
            if let Some(unit) = guess.unit {
                let _ = writeln!(text, "unit = \"{unit}\"");
            }
        }
        if !has(Meaning::Of(Quantity::Pressure)) {
            text +=
                "\n# No column looks like the airway pressure: name it.\n# [pressure]\n# column = \"...\"\n";
        }
        text
    }
}

/// Whether a cell has a number or a time.
fn is_value(cell: &str, decimal: u8) -> bool {
    number(cell, decimal).is_some() || Clock::default().seconds(cell).is_some()
}

/// Whether a quantity can have a unit.
fn fits(meaning: Meaning, unit: &str) -> bool {
    let units: &[(&str, f64)] = match meaning {
        Meaning::Of(quantity) => quantity.units(),
        Meaning::Flow => Quantity::FlowIn.units(),
        Meaning::Volume => return unit == "mL",
        Meaning::Breath => return false,
    };
    units.iter().any(|(known, _)| *known == unit)
}

fn increases(values: &[f64]) -> bool {
    values.len() > 2
        && values.windows(2).filter(|pair| pair[1] > pair[0]).count() * 10 > 9 * (values.len() - 1)
}

fn changes_sign(values: &[f64]) -> bool {
    let share = |sign: f64| values.iter().filter(|value| **value * sign > 0.0).count() * 10 > values.len();
    share(1.0) && share(-1.0)
}

fn is_pressure(values: &[f64]) -> bool {
    let range = |least: f64, most: f64| values.iter().all(|value| (least..=most).contains(value));
    let distinct = values.windows(2).filter(|pair| pair[0].to_bits() != pair[1].to_bits()).count();
    distinct * 4 > values.len() && range(-20.0, 120.0)
}

#[cfg(test)]
mod tests {
    use super::super::map::ColumnMap;
    use super::*;

    /// The map proposed for a text, which must be valid.
    fn proposed(text: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        std::fs::write(&path, text).unwrap();
        let map = propose(&path).unwrap();
        ColumnMap::from_toml(&map)
            .and_then(|map| map.layout())
            .unwrap_or_else(|error| panic!("{error}\n{map}"));
        map
    }

    /// Rows of time (times `unit`), pressure, and flow in L/min.
    fn rows(separator: &str, unit: f64) -> String {
        let row = |n: usize| {
            let (pressure, flow) = if n % 50 < 20 { (20.1, 30.0) } else { (5.2, -20.5) };
            let noise = (n * 7 % 5) as f64 * 0.1;
            format!("{}{separator}{:.1}{separator}{flow}\n", n as f64 * 0.02 * unit, pressure + noise)
        };
        (0..200).map(row).collect::<Vec<_>>().concat()
    }

    #[test]
    fn names_units_and_values_are_told_with_reasons() {
        let map = proposed(&format!("Zeit [ms];Druck (mbar);Fluss\n{}", rows(";", 1000.0).replace('.', ",")));
        for line in [
            "separator = \";\"",
            "[time]\ncolumn = \"Zeit [ms]\"\nunit = \"ms\"",
            "[pressure]\ncolumn = \"Druck (mbar)\"\nunit = \"mbar\"",
            "[flow]\ncolumn = \"Fluss\"\nunit = \"L/min\"",
            "its values exceed 4",
        ] {
            assert!(map.contains(line), "{line}\n{map}");
        }
        let map = proposed(&format!("# unit 7\nt,Paw,Flow\ns,cmH2O,L/min\n{}", rows(",", 1.0)));
        assert!(map.contains("[pressure]\ncolumn = \"Paw\"\nunit = \"cmH2O\""), "{map}");
        assert!(map.contains("the line below it says L/min"), "{map}");
    }

    #[test]
    fn a_table_without_names_is_judged_by_its_values() {
        let map = proposed(&rows("\t", 1.0));
        for line in
            ["separator = \"\\t\"", "[time]\ncolumn = 1", "[pressure]\ncolumn = 2", "[flow]\ncolumn = 3"]
        {
            assert!(map.contains(line), "{line}\n{map}");
        }
    }

    #[test]
    fn what_is_no_table_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("notes.txt");
        std::fs::write(&path, "a few words\nin two lines\n").unwrap();
        assert!(propose(&path).unwrap_err().to_string().contains("no columns"));
    }
}
