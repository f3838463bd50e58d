//! Ventilator, test run and lung of a row: their types, with the only parser and formatter of each.

use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};
use thiserror::Error;

/// Separates the two parts of a test run, and R from C of a lung.
const SEPARATOR: char = ':';

/// A test run of a ventilator, written `CT_AIR:5`. Files store it as text.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "String", into = "String")]
pub struct TestRun {
    /// Name of the ventilator.
    pub ventilator: String,
    /// Name of the run among those of its ventilator; `None` if the ventilator has only one run.
    pub run: Option<String>,
}

impl TestRun {
    /// A named run of a ventilator.
    pub fn new(ventilator: &str, run: &str) -> Self {
        Self { ventilator: ventilator.to_owned(), run: Some(run.to_owned()) }
    }
}

impl From<&str> for TestRun {
    fn from(text: &str) -> Self {
        match text.split_once(SEPARATOR) {
            Some((ventilator, run)) => Self::new(ventilator, run),
            None => Self { ventilator: text.to_owned(), run: None },
        }
    }
}

impl From<String> for TestRun {
    fn from(text: String) -> Self {
        text.as_str().into()
    }
}

impl From<TestRun> for String {
    fn from(run: TestRun) -> Self {
        run.to_string()
    }
}

impl fmt::Display for TestRun {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.run {
            Some(run) => write!(f, "{}{SEPARATOR}{run}", self.ventilator),
            None => f.write_str(&self.ventilator),
        }
    }
}

/// Nominal R and C of a lung, written `50:20`. Two lungs are equal if both numbers are.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
pub struct LungParameters {
    /// Airway resistance, cmH2O/(L/s).
    pub resistance: f32,
    /// Compliance, mL/cmH2O.
    pub compliance: f32,
}

/// The text is not a lung.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Error)]
#[error("write R:C in cmH2O/(L/s) and mL/cmH2O, such as 50:20")]
pub struct NoLung;

impl FromStr for LungParameters {
    type Err = NoLung;

    fn from_str(text: &str) -> Result<Self, NoLung> {
        let number = |text: &str| {
            text.trim().parse::<f32>().ok().filter(|number| *number > 0.0 && number.is_finite()).ok_or(NoLung)
        };
        let (resistance, compliance) = text.split_once(SEPARATOR).ok_or(NoLung)?;
        Ok(Self { resistance: number(resistance)?, compliance: number(compliance)? })
    }
}

impl fmt::Display for LungParameters {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{SEPARATOR}{}", self.resistance, self.compliance)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_test_run_is_read_and_printed_alike() {
        for text in ["CT_AIR:5", "left", "", ":", "A:", ":5", "A:B:3"] {
            assert_eq!(TestRun::from(text).to_string(), text);
            let json = serde_json::to_string(&TestRun::from(text)).unwrap();
            assert_eq!(json, format!("\"{text}\""));
            assert_eq!(serde_json::from_str::<TestRun>(&json).unwrap(), TestRun::from(text));
        }
    }

    #[test]
    fn runs_of_one_ventilator_share_what_stands_before_the_colon() {
        let [one, other, alone] = ["CT_AIR:3", "CT_AIR:5", "CT_AIR5"].map(TestRun::from);
        assert!(one.ventilator == other.ventilator && one != other);
        assert!(alone.ventilator != one.ventilator && alone.run.is_none());
    }

    #[test]
    fn a_lung_is_typed_and_printed_as_r_and_c() {
        assert_eq!("50:20".parse(), Ok(LungParameters { resistance: 50.0, compliance: 20.0 }));
        assert_eq!(LungParameters { resistance: 7.5, compliance: 20.0 }.to_string(), "7.5:20");
        for wrong in ["50", "50:", "a:b", "0:20", "50:-1", "inf:20", "NaN:3"] {
            assert_eq!(wrong.parse::<LungParameters>(), Err(NoLung), "{wrong}");
        }
    }
}
