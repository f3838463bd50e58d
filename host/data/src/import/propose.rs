//! Proposes a column map for a table: guesses from names, units and values, each with its reason.

mod columns;
pub(super) mod words;

use std::fmt::Write as _;
use std::io::Read;
use std::path::Path;

use self::columns::Columns;
use self::words::{Meaning, bracketed, direction, meaning, unit};
use super::map::Quantity;
use super::table::text::{Text, name};
use crate::recording::DatasetError;

/// Bytes of a table from which a map is proposed.
const START: u64 = 1 << 18;

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
    let columns =
        Columns::of(&lines).map_err(|reason| DatasetError::NoTable { path: path.to_owned(), reason })?;
    Ok(map(&columns, &guesses(&columns)))
}

/// A guess for each column of which there is one; of several columns for one quantity, the first.
fn guesses(columns: &Columns) -> Vec<Guess> {
    let mut named: Vec<Guess> = (0..columns.count()).filter_map(|column| by_name(columns, column)).collect();
    part_flows(columns, &mut named);
    let mut guesses = Vec::<Guess>::new();
    for guess in named {
        if guesses.iter().all(|other| other.meaning != guess.meaning) {
            guesses.push(guess);
        }
    }
    let mut lacking = |meaning: Meaning, find: fn(&[f64]) -> bool, reason: &str| {
        let has = |meaning| guesses.iter().any(|guess| guess.meaning == meaning);
        if has(meaning) || meaning == Meaning::Flow && has(Meaning::Of(Quantity::FlowIn)) {
            return;
        }
        let free = |column: &usize| guesses.iter().all(|guess| guess.column != *column);
        let found = (0..columns.count()).filter(free).find(|column| find(&columns.values(*column)));
        let reason = reason.to_owned();
        guesses.extend(found.map(|column| Guess { column, meaning, unit: None, reason }));
    };
    lacking(Meaning::Of(Quantity::Time), increases, "its values increase from row to row");
    lacking(Meaning::Flow, changes_sign, "its values change sign");
    lacking(Meaning::Of(Quantity::Pressure), is_pressure, "its values could be airway pressures");
    for guess in &mut guesses {
        judge(columns, guess);
    }
    guesses
}

/// Makes flows in and out of two flows of which the names tell that.
fn part_flows(columns: &Columns, guesses: &mut [Guess]) {
    let of = |guess: &Guess| {
        let name = columns.names.get(guess.column).filter(|_| guess.meaning == Meaning::Flow);
        name.and_then(|name| direction(name))
    };
    let directions: Vec<_> = guesses.iter().map(of).collect();
    if [Quantity::FlowIn, Quantity::FlowOut].iter().all(|flow| directions.contains(&Some(*flow))) {
        for (guess, flow) in guesses.iter_mut().zip(directions) {
            guess.meaning = flow.map_or(guess.meaning, Meaning::Of);
        }
    }
}

/// A guess from the name of a column that has values.
fn by_name(columns: &Columns, column: usize) -> Option<Guess> {
    let shown = columns.names.get(column)?;
    let (word, meaning) = meaning(shown)?;
    if meaning != Meaning::Breath && columns.values(column).is_empty() {
        return None;
    }
    let below = columns.units.get(column).and_then(|text| unit(text, meaning));
    let brackets = bracketed(shown);
    let in_name = || {
        let rest = shown.to_lowercase().replacen(word, "", 1);
        brackets.and_then(|text| unit(text, meaning)).or_else(|| unit(&rest, meaning))
    };
    let (unit, source) = match below {
        Some(below) => (Some(below), "the line below it"),
        None => (in_name(), "its name"),
    };
    let unit = unit.map(|(unit, _)| unit);
    let told = match (unit, brackets, meaning.units()) {
        (Some(unit), ..) => format!("; {source} says {unit}"),
        (None, Some(other), [(own, _), ..]) => {
            format!("; `{other}` is no unit known here: if it is one, give `scale`, its factor to {own}")
        }
        _ => String::new(),
    };
    Some(Guess { column, meaning, unit, reason: format!("its name has `{word}`{told}") })
}

/// Adds to a guess the unit that the values suggest.
fn judge(columns: &Columns, guess: &mut Guess) {
    let values = columns.values(guess.column);
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
        Meaning::Flow | Meaning::Of(Quantity::FlowIn | Quantity::FlowOut) if most > 4.0 => {
            ("L/min", "its values exceed 4")
        }
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
fn map(columns: &Columns, guesses: &[Guess]) -> String {
    let mut text = head(columns);
    let has = |meaning| guesses.iter().any(|guess| guess.meaning == meaning);
    if !has(Meaning::Of(Quantity::Time)) {
        let _ = match columns.rate {
            Some(rate) => {
                writeln!(text, "# A line above tells {rate} rows a second.\nperiod_ms = {}", 1000.0 / rate)
            }
            None => {
                writeln!(text, "# No column has times: give the time between two rows.\n# period_ms = 20")
            }
        };
    }
    for guess in guesses {
        // Of flow and volume the flow is the better one.
        if guess.meaning == Meaning::Volume && (has(Meaning::Flow) || has(Meaning::Of(Quantity::FlowIn))) {
            continue;
        }
        let column = match columns.name(guess.column) {
            Some(name) => toml::Value::from(name),
            None => toml::Value::from(guess.column as i64 + 1),
        };
        let table = guess.meaning.name();
        let _ = writeln!(text, "\n# {}\n[{table}]\ncolumn = {column}", guess.reason);
        if let Some(unit) = guess.unit {
            let _ = writeln!(text, "unit = \"{unit}\"");
        }
    }
    if !has(Meaning::Of(Quantity::Pressure)) {
        text += "\n# No column looks like the airway pressure: name it.\n# [pressure]\n# column = \"...\"\n";
    }
    text
}

/// The lines about the table as a whole.
fn head(columns: &Columns) -> String {
    let mut text =
        "# A proposed column map: check each guess, above all the units, before you use it.\n".to_owned();
    let names: Vec<_> = columns.names.iter().map(|name| format!("`{name}`")).collect();
    let _ = if names.is_empty() {
        writeln!(text, "# The table has no names: its columns are counted from 1.")
    } else {
        writeln!(text, "# The table's columns: {}", names.join(", "))
    };
    if columns.separator != ',' {
        let _ = writeln!(text, "separator = {}", toml::Value::from(columns.separator.to_string()));
    }
    if columns.decimal.sure {
        text += "decimal = \",\"\n";
    }
    text
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
            "separator = \";\"\ndecimal = \",\"",
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
    fn names_are_found_whatever_stands_around_them() {
        let with = |names: &str, columns: &str| proposed(&format!("{names}\n{}", rows(columns, 1.0)));
        // A commented line of as many cells, names in quotes, and rows that end with a separator.
        let map = with("# lung A, of silicone, 2026\nt,Paw,Flow", ",");
        assert!(map.contains("[pressure]\ncolumn = \"Paw\""), "{map}");
        let map = with("\"Time (s)\",\"Pressure, airway (mbar)\",\"Flow\"", ",");
        assert!(map.contains("column = \"Pressure, airway (mbar)\"\nunit = \"mbar\""), "{map}");
        let map = proposed(&format!("t,Paw,Flow\n{}", rows(",", 1.0).replace('\n', ",\n")));
        assert!(map.contains("[flow]\ncolumn = \"Flow\""), "{map}");
        let map = with("t Paw Flow", " ");
        assert!(map.contains("separator = \" \"") && map.contains("column = \"Paw\""), "{map}");
        // Of two columns with one name, the place tells which one is meant.
        let map = with("t,p,p", ",");
        assert!(map.contains("[pressure]\ncolumn = 2"), "{map}");
    }

    #[test]
    fn columns_without_values_are_no_guess_and_a_rate_is_a_period() {
        let pressures = "5.5,,,\n9.5,,,\n14.5,,,\n".repeat(100);
        let map = proposed(&format!("#samplerate,125\npressure,flow,pip,peep\n{pressures}"));
        assert!(map.contains("period_ms = 8\n") && map.contains("column = \"pressure\""), "{map}");
        assert!(!map.contains("[flow]"), "{map}");
    }

    #[test]
    fn flows_of_each_direction_and_unknown_units_are_told() {
        let row = |n: usize| format!("{},{}.5,{}.5,{},0\n", n as f64 * 0.02, n % 20, n % 10, n % 40);
        let rows: String = (0..200).map(row).collect();
        let map = proposed(&format!("t,Pset,p (psi),Flow insp [l/min],Flow exp [l/min]\n{rows}"));
        for line in [
            "[target]\ncolumn = \"Pset\"",
            "`psi` is no unit known here",
            "[flow_in]\ncolumn = \"Flow insp [l/min]\"\nunit = \"L/min\"",
            "[flow_out]\ncolumn = \"Flow exp [l/min]\"",
        ] {
            assert!(map.contains(line), "{line}\n{map}");
        }
        let map = proposed(&format!("t,set,Pressure (mmH2O),Insp. flow (mL/m),x\n{rows}"));
        for line in ["unit = \"mmH2O\"", "[flow]\ncolumn = \"Insp. flow (mL/m)\"\nunit = \"mL/min\""] {
            assert!(map.contains(line), "{line}\n{map}");
        }
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
        std::fs::write(&path, "words\nlines\n").unwrap();
        assert!(propose(&path).unwrap_err().to_string().contains("no columns"));
        std::fs::write(&path, "1 s,5 cmH2O\n2 s,6 cmH2O\n").unwrap();
        assert!(propose(&path).unwrap_err().to_string().contains("no rows of numbers"));
    }
}
