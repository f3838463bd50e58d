//! Breaths in a file of measurements: a message event at the start of each phase, which also gives the
//! target.
//!
//! The text has no colon, comma, quote or brace, because the C library of the standard splits events at them.

use std::fmt;
use std::str::FromStr;

use crate::recording::PHASE_NAMES;

/// First word of the messages.
const TAG: &str = "eupnea";

/// The start of a phase: from now on the target goes in a straight line to a pressure, and stays there.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PhaseMark {
    /// Number of the breath.
    pub breath: u32,
    /// The phase, as in a recording.
    pub phase: u8,
    /// Target at the start, cmH2O.
    pub from: f32,
    /// Target at which it stays, cmH2O.
    pub to: f32,
    /// Time in which it gets there, ms.
    pub in_ms: u32,
}

impl PhaseMark {
    /// Target this many ms after the start of the phase, cmH2O.
    pub fn target(&self, ms: u32) -> f32 {
        if ms >= self.in_ms {
            return self.to;
        }
        self.from + (self.to - self.from) * (ms as f32 / self.in_ms as f32)
    }
}

impl fmt::Display for PhaseMark {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { breath, phase, from, to, in_ms } = self;
        let name = PHASE_NAMES.get(usize::from(*phase)).unwrap_or(&"unknown");
        write!(f, "{TAG} breath {breath} {name} from {from} to {to} cmH2O in {in_ms} ms")
    }
}

/// The text is not of a mark.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct NoMark;

impl FromStr for PhaseMark {
    type Err = NoMark;

    fn from_str(text: &str) -> Result<Self, NoMark> {
        let words: Vec<_> = text.split(' ').collect();
        let [TAG, "breath", breath, name, "from", from, "to", to, "cmH2O", "in", in_ms, "ms"] = words[..]
        else {
            return Err(NoMark);
        };
        let pressure = |word: &str| word.parse().ok().filter(|value: &f32| value.is_finite()).ok_or(NoMark);
        let phase = PHASE_NAMES.iter().position(|known| *known == name).ok_or(NoMark)?;
        Ok(Self {
            breath: breath.parse().map_err(|_| NoMark)?,
            phase: phase as u8,
            from: pressure(from)?,
            to: pressure(to)?,
            in_ms: in_ms.parse().map_err(|_| NoMark)?,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::recording::{EXPIRATION, FALL, INSPIRATION};
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn a_mark_is_read_as_it_was_written(
            breath: u32, phase in INSPIRATION..=EXPIRATION,
            from in -50_f32..150.0, to in -50_f32..150.0, in_ms: u32,
        ) {
            let mark = PhaseMark { breath, phase, from, to, in_ms };
            let text = mark.to_string();
            prop_assert_eq!(text.parse(), Ok(mark));
            prop_assert!(text.len() < 256 && !text.contains([':', ',', '{', '}', '"']), "{}", text);
        }

        #[test]
        fn no_text_makes_a_mark_panic(text: String) {
            let _ = text.parse::<PhaseMark>();
        }
    }

    #[test]
    fn marks_name_the_phases_as_other_programs_know_them() {
        for (phase, name) in [(INSPIRATION, "inspiration"), (FALL, "fall"), (EXPIRATION, "expiration")] {
            let mark = PhaseMark { breath: 7, phase, from: 5.0, to: 25.0, in_ms: 0 };
            assert_eq!(mark.to_string(), format!("eupnea breath 7 {name} from 5 to 25 cmH2O in 0 ms"));
        }
    }

    #[test]
    fn a_text_that_is_no_mark_is_none() {
        let mark = "eupnea breath 0 fall from 25 to 5 cmH2O in 500 ms";
        assert!(mark.parse::<PhaseMark>().is_ok());
        for (part, other) in [("25", "NaN"), ("5 ", "inf "), ("fall", "pause"), ("eupnea", ""), ("500", "-1")]
        {
            assert_eq!(mark.replacen(part, other, 1).parse::<PhaseMark>(), Err(NoMark), "{other}");
        }
    }

    #[test]
    fn a_target_goes_in_a_straight_line_and_stays() {
        let mark = PhaseMark { breath: 0, phase: FALL, from: 25.0, to: 5.0, in_ms: 500 };
        let targets = |mark: PhaseMark| [0, 250, 500, 501].map(|ms| mark.target(ms).to_bits());
        assert_eq!(targets(mark), [25_f32, 15.0, 5.0, 5.0].map(f32::to_bits));
        assert_eq!(targets(PhaseMark { in_ms: 0, ..mark }), [5_f32; 4].map(f32::to_bits));
    }
}
