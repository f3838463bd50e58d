//! Prescriptions: the settings that plants are ventilated with, listed or drawn.
//!
//! A description lists PIPs that take turns, or gives ranges for the settings that vary:
//!
//! ```
//! # use plant::prescriptions::Prescriptions;
//! let ward = Prescriptions::from_toml(
//!     "name = \"ward\"
//!      square_share = 0.25
//!      [settings]
//!      rate = 15
//!      [drawn]
//!      peep = { uniform = [5, 12] }
//!      driving_pressure = { uniform = [8, 20] }
//!      rise_time = { uniform = [0.1, 0.3] }",
//! )?;
//! let settings = ward.draw(1, 0);
//! assert!((5.0..=12.0).contains(&settings.peep) && settings.pip >= settings.peep + 8.0);
//! assert_eq!(settings, ward.draw(1, 0));
//! # Ok::<(), plant::prescriptions::PrescriptionsError>(())
//! ```
//!
//! Beside the settings by their names, `driving_pressure` (PIP above PEEP), `i_to_e` (inspiratory over expiratory time) and
//! `limit_margin` (pressure limit above PIP) can be drawn. What two draws together would exceed is moved to its bound: PIP and the
//! pressure limit to the highest allowed, the rate to the nearest one that leaves time for the inspiration, the fall to the rest of the
//! breath.

use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};
use shared::breath::PAPER_PIPS;
use shared::settings::{FIELDS, Field, LEAST_RISE, LIMIT_MARGIN, Settings, SettingsError};

use crate::range::{Range, share, stream};

/// PIP above PEEP, cmH2O.
const DRIVING_PRESSURE: &str = "driving_pressure";
/// Inspiratory over expiratory time.
const I_TO_E: &str = "i_to_e";
/// Pressure limit above PIP, cmH2O.
const LIMIT_ABOVE: &str = "limit_margin";
/// Settings that can be drawn.
const DRAWN: [&str; 8] = [
    "pip",
    "peep",
    "rate",
    "inspiratory_time",
    "rise_time",
    "fall_time",
    "expiratory_bias",
    "pressure_limit",
];
/// Distance by which random PIPs go beyond listed ones, cmH2O.
const BEYOND_CMH2O: f32 = 2.0;
/// Names of the shipped prescriptions.
pub const NAMES: [&str; 2] = ["paper", "bedside"];

/// Why prescriptions were refused.
#[derive(Debug, thiserror::Error)]
pub enum PrescriptionsError {
    /// There are no shipped prescriptions of that name, and no such file.
    #[error("there are no prescriptions {0}: name a TOML file, or one of {names}", names = NAMES.join(", "))]
    Unknown(String),
    /// The file cannot be read.
    #[error("cannot read the prescriptions {}: {source}; check the path", path.display())]
    File {
        /// The path tried.
        path: PathBuf,
        /// The system's error.
        source: std::io::Error,
    },
    /// The file is not TOML, or has other tables.
    #[error("the prescriptions are not valid: {0}")]
    Syntax(#[from] toml::de::Error),
    /// A list of PIPs is empty.
    #[error("the prescriptions have no waveform: name at least one PIP, as in pips = [15, 25]")]
    NoWaveform,
    /// A share is not one.
    #[error("square_share is {0}; a share is 0 to 1")]
    Share(f64),
    /// There is no such setting to draw.
    #[error(
        "drawn.{0} cannot be drawn; draw one of {names}, {DRIVING_PRESSURE}, {I_TO_E}, {LIMIT_ABOVE}",
        names = DRAWN.join(", ")
    )]
    Unnamed(String),
    /// The numbers of a range are in the wrong order, not finite, or negative where they must not be.
    #[error(
        "drawn.{0}: the range is empty; the lower number comes first, log_uniform needs numbers above 0, and an sd is not negative"
    )]
    EmptyRange(String),
    /// A range goes beyond what is allowed.
    #[error("drawn.{name} goes from {low} to {high}; allowed are {min} to {max}")]
    OutOfBounds {
        /// The setting.
        name: String,
        /// Lowest number of the range.
        low: f64,
        /// Highest number of the range.
        high: f64,
        /// Lowest number allowed.
        min: f64,
        /// Highest number allowed.
        max: f64,
    },
    /// The settings of a breath are not allowed.
    #[error("a prescription cannot be run: {0}")]
    Settings(#[from] SettingsError),
}

/// A distribution of settings.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Prescriptions {
    /// Name in reports.
    pub name: String,
    /// PIPs that take turns, cmH2O; empty if the PIP is drawn.
    pub pips: Vec<f32>,
    /// Share of the breaths with a square rise, of those whose rise is drawn.
    pub square_share: f64,
    /// Settings that are neither listed nor drawn.
    pub settings: Settings,
    /// Ranges of those that are drawn.
    pub drawn: Vec<(String, Range)>,
}

/// A description as it is written.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Written {
    name: Option<String>,
    pips: Option<Vec<f32>>,
    #[serde(default)]
    square_share: f64,
    #[serde(default)]
    settings: Settings,
    #[serde(default)]
    drawn: std::collections::BTreeMap<String, Range>,
}

impl Default for Prescriptions {
    /// The paper's: six PIPs in turn, PEEP 5 cmH2O, a square rise, one second.
    fn default() -> Self {
        Self::listed(NAMES[0], &PAPER_PIPS, Settings::default())
    }
}

impl Prescriptions {
    /// These PIPs in turn, cmH2O, with all other settings fixed.
    pub fn listed(name: &str, pips: &[f32], settings: Settings) -> Self {
        Self { name: name.to_owned(), pips: pips.to_vec(), square_share: 0.0, settings, drawn: Vec::new() }
    }

    /// The shipped prescriptions of this name or, if there are none, those in this file.
    ///
    /// # Errors
    /// See [`PrescriptionsError`].
    pub fn find(name: &str) -> Result<Self, PrescriptionsError> {
        let path = Path::new(name);
        match name {
            "paper" => Ok(Self::default()),
            "bedside" => Self::from_toml(include_str!("bedside.toml")),
            _ if path.extension().is_none() && !path.exists() => {
                Err(PrescriptionsError::Unknown(name.to_owned()))
            }
            _ => {
                let text = std::fs::read_to_string(path)
                    .map_err(|source| PrescriptionsError::File { path: path.to_owned(), source })?;
                Self::from_toml(&text)
            }
        }
    }

    /// Reads and validates a description.
    ///
    /// # Errors
    /// See [`PrescriptionsError`].
    pub fn from_toml(text: &str) -> Result<Self, PrescriptionsError> {
        Self::written(toml::from_str(text)?)
    }

    /// Reads and validates the table of a description.
    ///
    /// # Errors
    /// See [`PrescriptionsError`].
    pub fn from_table(table: toml::Table) -> Result<Self, PrescriptionsError> {
        Self::written(table.try_into()?)
    }

    fn written(written: Written) -> Result<Self, PrescriptionsError> {
        let Written { name, pips, square_share, settings, drawn } = written;
        let draws_pip = drawn.contains_key("pip") || drawn.contains_key(DRIVING_PRESSURE);
        let pips = match pips {
            Some(pips) if pips.is_empty() => return Err(PrescriptionsError::NoWaveform),
            Some(pips) => pips,
            None if draws_pip => Vec::new(),
            None => PAPER_PIPS.to_vec(),
        };
        let name = name.unwrap_or_else(|| "prescriptions".to_owned());
        let prescriptions = Self { name, pips, square_share, settings, drawn: drawn.into_iter().collect() };
        prescriptions.check()?;
        Ok(prescriptions)
    }

    /// Checks that every breath can be run.
    fn check(&self) -> Result<(), PrescriptionsError> {
        if !(0.0..=1.0).contains(&self.square_share) {
            return Err(PrescriptionsError::Share(self.square_share));
        }
        for (name, range) in &self.drawn {
            let (low, high) = range.ends().ok_or_else(|| PrescriptionsError::EmptyRange(name.clone()))?;
            let (min, max) = bounds(name).ok_or_else(|| PrescriptionsError::Unnamed(name.clone()))?;
            if !(low >= min && high <= max) {
                return Err(PrescriptionsError::OutOfBounds { name: name.clone(), low, high, min, max });
            }
        }
        (0..self.pips.len().max(1)).try_for_each(|number| self.draw(0, number as u32).validate())?;
        Ok(())
    }

    /// Whether nothing is drawn: only the PIP varies.
    pub fn are_listed(&self) -> bool {
        self.drawn.is_empty()
    }

    /// Longest inspiratory time, s.
    pub fn longest_inspiration(&self) -> f32 {
        let drawn = self.drawn.iter().find(|(name, _)| name == "inspiratory_time");
        let end = drawn.and_then(|(_, range)| range.ends());
        end.map_or(self.settings.inspiratory_time, |(_, longest)| longest as f32)
    }

    /// Range of the listed PIPs, and a little beyond them where that can be run, cmH2O.
    pub fn pip_range(&self) -> (f32, f32) {
        let ends = self.pips.iter().fold((f32::INFINITY, 0.0_f32), |(l, h), pip| (l.min(*pip), h.max(*pip)));
        let allowed = |pip: f32| Settings { pip, ..self.settings }.validate().is_ok().then_some(pip);
        (allowed(ends.0 - BEYOND_CMH2O).unwrap_or(ends.0), allowed(ends.1 + BEYOND_CMH2O).unwrap_or(ends.1))
    }

    /// Lowest and highest PIP that a breath can have beside these settings, cmH2O.
    pub fn any_pip(&self) -> (f32, f32) {
        let pip = field("pip");
        (pip.min.max(self.settings.peep + LEAST_RISE), pip.max)
    }

    /// Settings of the breaths with this number, from 0, of those that a seed gives.
    pub fn draw(&self, seed: u64, number: u32) -> Settings {
        let drawn = |name: &str| {
            let (_, range) = self.drawn.iter().find(|(drawn, _)| drawn == name)?;
            Some(range.draw(&mut stream(seed, name, number)) as f32)
        };
        let mut settings = self.settings;
        if let Some(count) = u32::try_from(self.pips.len()).ok().filter(|count| *count > 0) {
            settings.pip = self.pips[(number % count) as usize];
        }
        let mut values = settings.values();
        for (value, field) in values.iter_mut().zip(FIELDS) {
            *value = drawn(field.name).unwrap_or(*value);
        }
        settings = Settings::from_values(values);
        let square = share(&mut stream(seed, "square_share", number)) < self.square_share;
        if square && drawn("rise_time").is_some() {
            settings.rise_time = 0.0;
        }
        if let Some(driving) = drawn(DRIVING_PRESSURE) {
            settings.pip = settings.peep + driving;
        }
        if let Some(i_to_e) = drawn(I_TO_E) {
            settings.rate = 60.0 / (settings.inspiratory_time * (1.0 + 1.0 / i_to_e));
        }
        if let Some(margin) = drawn(LIMIT_ABOVE) {
            settings.pressure_limit = settings.pip + margin;
        }
        if self.are_listed() { settings } else { possible(settings) }
    }
}

/// Lowest and highest value that can be drawn under a name; none if nothing is drawn under it.
fn bounds(name: &str) -> Option<(f64, f64)> {
    Some(match name {
        DRIVING_PRESSURE => (f64::from(LEAST_RISE), f64::from(field("pip").max)),
        I_TO_E => (0.05, 20.0),
        LIMIT_ABOVE => (f64::from(LIMIT_MARGIN), f64::from(field("pressure_limit").max)),
        name => {
            let field = DRAWN.contains(&name).then(|| field(name))?;
            (f64::from(field.min), f64::from(field.max))
        }
    })
}

/// The setting of this name.
///
/// # Panics
/// There is none.
pub fn field(name: &str) -> &'static Field {
    FIELDS.iter().find(|field| field.name == name).expect("a setting's name")
}

/// The nearest settings that a breath can have.
fn possible(mut settings: Settings) -> Settings {
    let (pip, limit, rate) = (field("pip"), field("pressure_limit"), field("rate"));
    settings.pip = settings.pip.max(settings.peep + LEAST_RISE).min(pip.max);
    settings.pressure_limit =
        settings.pressure_limit.max(settings.pip + LIMIT_MARGIN).max(limit.min).min(limit.max);
    // A breath of the last bits more than its phases, whose sum is rounded.
    let shortest = settings.inspiratory_time * (1.0 + 1e-5);
    settings.rate = settings.rate.clamp(rate.min, rate.max.min(60.0 / shortest));
    settings.fall_time = settings.fall_time.min(60.0 / settings.rate - shortest).max(0.0);
    settings
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn refusal(text: &str) -> String {
        Prescriptions::from_toml(text).unwrap_err().to_string()
    }

    #[test]
    fn the_papers_are_six_pips_in_turn() {
        let paper = Prescriptions::find("paper").unwrap();
        let pips: Vec<f32> = (0..7).map(|number| paper.draw(9, number).pip).collect();
        assert_eq!(pips, [10.0, 15.0, 20.0, 25.0, 30.0, 35.0, 10.0]);
        assert_eq!(paper.draw(9, 2), Settings::default());
    }

    #[test]
    fn random_pips_go_beyond_the_listed_ones_but_not_beyond_the_bounds_of_settings() {
        let range = |pips: &[f32]| Prescriptions::listed("", pips, Settings::default()).pip_range();
        assert_eq!(range(&PAPER_PIPS), (8.0, 37.0));
        assert_eq!(range(&[6.0, 59.0]), (6.0, 59.0));
        assert_eq!(Prescriptions::default().any_pip(), (7.0, 60.0));
    }

    #[test]
    fn those_of_the_bedside_have_their_ranges_and_shares() {
        let bedside = Prescriptions::find("bedside").unwrap();
        let drawn: Vec<Settings> = (0..3000).map(|number| bedside.draw(4, number)).collect();
        let share = |which: &dyn Fn(&Settings) -> bool| {
            drawn.iter().filter(|settings| which(settings)).count() as f32 / 3000.0
        };
        assert!((share(&|s| s.rise_time == 0.0) - 0.333).abs() < 0.03);
        assert!((share(&|s| s.peep < 5.0) - 0.25).abs() < 0.03);
        assert!((share(&|s| s.inspiratory_time < 3.0_f32.sqrt() * 0.4_f32.sqrt()) - 0.5).abs() < 0.03);
        for settings in &drawn {
            assert!((5.0..=30.01).contains(&(settings.pip - settings.peep)), "{settings:?}");
            assert!(settings.rise_time == 0.0 || (0.05..=0.4).contains(&settings.rise_time));
            assert!((0.0..=15.0).contains(&settings.expiratory_bias));
        }
    }

    #[test]
    fn a_draw_depends_on_seed_and_number_alone() {
        let bedside = Prescriptions::find("bedside").unwrap();
        assert_eq!(bedside.draw(1, 7), Prescriptions::find("bedside").unwrap().draw(1, 7));
        assert_ne!(bedside.draw(1, 7), bedside.draw(2, 7));
        assert_ne!(bedside.draw(1, 7), bedside.draw(1, 8));
    }

    #[test]
    fn refusals_say_what_to_do() {
        let unknown = Prescriptions::find("aliens").unwrap_err().to_string();
        assert_eq!(unknown, "there are no prescriptions aliens: name a TOML file, or one of paper, bedside");
        assert!(
            refusal("[drawn]\ncolour = { uniform = [1, 2] }").starts_with("drawn.colour cannot be drawn")
        );
        assert_eq!(
            refusal("[drawn]\npeep = { uniform = [0, 30] }"),
            "drawn.peep goes from 0 to 30; allowed are 0 to 20"
        );
        assert!(
            refusal("[drawn]\npeep = { uniform = [9, 3] }").starts_with("drawn.peep: the range is empty")
        );
        assert!(refusal("pips = []").starts_with("the prescriptions have no waveform"));
        assert!(refusal("square_share = 2").starts_with("square_share is 2"));
        assert!(refusal("[settings]\npeep = 19").starts_with("a prescription cannot be run: PIP (10 cmH2O)"));
        assert!(refusal("[sett]\npeep = 19").starts_with("the prescriptions are not valid"));
    }

    proptest! {
        #[test]
        fn whatever_is_drawn_can_be_run(seed: u64, number: u32, low in 0.2f64..1.0, more in 0.0f64..4.0) {
            let text = format!(
                "square_share = 0.5\n[drawn]\npeep = {{ uniform = [0, 20] }}\ndriving_pressure = {{ uniform = [2, 60] }}\n\
                 rise_time = {{ uniform = [0, 1] }}\ninspiratory_time = {{ uniform = [{low}, {}] }}\n\
                 i_to_e = {{ log_uniform = [0.05, 20] }}\nfall_time = {{ uniform = [0, 2] }}\n\
                 expiratory_bias = {{ uniform = [0, 20] }}\nlimit_margin = {{ uniform = [5, 70] }}",
                low + more
            );
            let settings = Prescriptions::from_toml(&text).unwrap().draw(seed, number);
            prop_assert_eq!(settings.validate(), Ok(()));
        }
    }
}
