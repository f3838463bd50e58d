//! Numbers and times as tables write them.

/// Seconds of a day.
const DAY: f64 = 86_400.0;

/// A number with this decimal mark; none if the text is no finite number.
#[inline]
pub(in crate::import) fn number(text: &str, decimal: u8) -> Option<f64> {
    let number = if decimal == b'.' || !text.as_bytes().contains(&decimal) {
        text.parse::<f64>()
    } else {
        text.replace(char::from(decimal), ".").parse()
    };
    number.ok().filter(|number| number.is_finite())
}

/// Whether a text is a number with a decimal comma.
pub(super) fn has_decimal_comma(text: &str) -> bool {
    text.matches(',').count() == 1 && number(text, b',').is_some()
}

/// Times of day, with or without a date before them, as seconds since the first midnight.
#[derive(Debug, Clone, Copy, Default)]
pub(in crate::import) struct Clock {
    days: f64,
    last: Option<f64>,
}

impl Clock {
    /// The time that a text tells: hours, minutes and seconds with their fraction, after a point, a comma or a colon. A date is not read:
    /// a time that is half a day earlier than the one before belongs to the next day.
    pub(in crate::import) fn seconds(&mut self, text: &str) -> Option<f64> {
        let of_day = time_of_day(text)?;
        if self.last.replace(of_day).is_some_and(|last| last - of_day > 0.5 * DAY) {
            self.days += 1.0;
        }
        Some(self.days * DAY + of_day)
    }
}

/// The time of day in a text, s.
fn time_of_day(text: &str) -> Option<f64> {
    // A date stands before the time, a zone behind it.
    let word = text.split([' ', 'T', 't', '_']).find(|word| word.contains(':'))?;
    let word = word.split(['Z', 'z', '+', '-']).next()?;
    let half = text.to_ascii_lowercase();
    let half = if half.ends_with("am") { Some(0.0) } else { half.ends_with("pm").then_some(12.0) };
    let word = word.trim_end_matches(|letter: char| letter.is_ascii_alphabetic());
    let parts: Vec<&str> = word.split(':').collect();
    let (whole, fraction) = match parts[..] {
        [_, _] | [_, _, _] => (&parts[..], 0.0),
        [_, _, _, thousandths] => (&parts[..3], thousandths.parse::<u32>().ok().map(f64::from)? * 1e-3),
        _ => return None,
    };
    let [hours, minutes] = [whole[0], whole[1]].map(|part| part.parse::<u32>().ok().map(f64::from));
    let seconds = whole.get(2).map_or(Some(0.0), |part| number(part, b','))?;
    let (hours, minutes) = (hours?, minutes?);
    if hours >= 24.0 || minutes >= 60.0 || !(0.0..61.0).contains(&seconds) {
        return None;
    }
    let hours = half.map_or(hours, |half| hours % 12.0 + half);
    Some(3600.0 * hours + 60.0 * minutes + seconds + fraction)
}

/// Why text is no number, and what to do.
pub(super) fn no_number(text: &str) -> &'static str {
    if has_decimal_comma(text) {
        "is not a number: if its comma is a decimal one, write `decimal = \",\"` in the column map"
    } else {
        "is not a number: correct the cell, or remove the line"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_have_the_decimal_mark_of_the_map() {
        assert_eq!(number("1.5", b'.'), Some(1.5));
        assert_eq!(number("-1,5", b','), Some(-1.5));
        assert_eq!(number("1,5", b'.'), None);
        assert_eq!(number("nan", b'.'), None);
        assert!(no_number("0,00").contains("decimal = "));
    }

    #[test]
    fn times_of_day_are_read_in_the_usual_forms() {
        let seconds = |text| Clock::default().seconds(text);
        for text in [
            "13:45:30.25",
            "13:45:30,25",
            "13:45:30:250",
            "2026-03-01T13:45:30.25Z",
            "2026-03-01 13:45:30.25+01:00",
            "01.03.2026 13:45:30,25",
            "3/1/2026 1:45:30.25 PM",
        ] {
            assert_eq!(seconds(text), Some(49_530.25), "{text}");
        }
        assert_eq!(seconds("12:00:01 am"), Some(1.0));
        assert_eq!(seconds("0:10"), Some(600.0));
        for text in ["25:00:00", "12:61:00", "12", "noon", "1:2:3:4:5"] {
            assert_eq!(seconds(text), None, "{text}");
        }
    }

    #[test]
    fn a_clock_goes_on_after_midnight() {
        let mut clock = Clock::default();
        assert_eq!(clock.seconds("23:59:59.9"), Some(86_399.9));
        assert_eq!(clock.seconds("00:00:00.1"), Some(86_400.1));
        assert_eq!(clock.seconds("23:59:59"), Some(2.0 * 86_400.0 - 1.0));
    }
}
