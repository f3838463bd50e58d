//! Numbers and times as tables write them.

use super::super::map::Decimal;

/// Seconds of a day.
const DAY: f64 = 86_400.0;

/// What may stand between thousands, beside the mark that is not the decimal one.
const BETWEEN_THOUSANDS: [char; 6] = [' ', '\u{a0}', '\u{2009}', '\u{202f}', '\'', '\u{2019}'];
/// The minus sign that some languages write.
const MINUS: char = '\u{2212}';

/// A number with this decimal mark; none if the text is no finite number.
#[inline]
pub(in crate::import) fn number(text: &str, decimal: Decimal) -> Option<f64> {
    let has = |mark| text.as_bytes().contains(&mark);
    let number = match decimal.mark {
        b'.' => text.parse::<f64>().ok(),
        mark if !has(b'.') => text.replace(char::from(mark), ".").parse().ok(),
        mark if has(mark) || decimal.sure => None,
        _ => text.parse().ok(),
    };
    number.or_else(|| written_out(text, decimal)).filter(|number| number.is_finite())
}

/// A number with marks between its thousands or a typographic minus sign; none if a mark could as well be a decimal one.
#[cold]
fn written_out(text: &str, decimal: Decimal) -> Option<f64> {
    let unsigned = text.strip_prefix(['-', '+', MINUS]).unwrap_or(text);
    let sign = if text.starts_with(['-', MINUS]) { -1.0 } else { 1.0 };
    let (whole, fraction) = unsigned.split_once(char::from(decimal.mark)).unwrap_or((unsigned, ""));
    let other = if decimal.mark == b'.' { ',' } else { '.' };
    let mark = whole.chars().find(|letter| !letter.is_ascii_digit());
    let groups: Vec<&str> = whole.split(|letter| Some(letter) == mark).collect();
    let sure = mark != Some(other) || decimal.sure || groups.len() > 2 || whole.len() < unsigned.len();
    let known = mark.is_none_or(|mark| mark == other || BETWEEN_THOUSANDS.contains(&mark));
    let full = |group: &&str| group.len() == 3;
    let digits = |text: &str| text.bytes().all(|byte| byte.is_ascii_digit());
    let grouped = (1..=3).contains(&groups[0].len()) && groups[1..].iter().all(full) || groups.len() == 1;
    if !(sure && known && grouped && digits(fraction) && groups.iter().all(|group| digits(group))) {
        return None;
    }
    let number: f64 = format!("{}.{fraction}", groups.concat()).parse().ok()?;
    Some(sign * number)
}

/// Whether a number has one mark that could be its decimal one.
fn has_one_mark(text: &str) -> bool {
    let parts: Vec<&str> = text.trim_start_matches(['-', '+']).split([',', '.']).collect();
    parts.len() == 2 && parts.iter().all(|part| part.bytes().all(|byte| byte.is_ascii_digit()))
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
    let seconds = whole.get(2).map_or(Some(0.0), |part| number(part, Decimal::EITHER))?;
    let (hours, minutes) = (hours?, minutes?);
    if hours >= 24.0 || minutes >= 60.0 || !(0.0..61.0).contains(&seconds) {
        return None;
    }
    let hours = half.map_or(hours, |half| hours % 12.0 + half);
    Some(3600.0 * hours + 60.0 * minutes + seconds + fraction)
}

/// Why text is no number, and what to do.
pub(super) fn no_number(text: &str) -> &'static str {
    if has_one_mark(text) && text.len() > 1 {
        "is not a number: write the decimal mark into the column map, `decimal = \",\"` or `decimal = \".\"`"
    } else {
        "is not a number: correct the cell, or remove the line"
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const POINT: Decimal = Decimal { mark: b'.', sure: false };
    const SURE_POINT: Decimal = Decimal { mark: b'.', sure: true };
    const SURE_COMMA: Decimal = Decimal { mark: b',', sure: true };

    #[test]
    fn numbers_have_the_decimal_mark_of_the_map() {
        for (text, decimal, expected) in [
            ("1.5", POINT, Some(1.5)),
            ("1,5", POINT, None),
            ("nan", POINT, None),
            ("-1,5", Decimal::EITHER, Some(-1.5)),
            ("-1.5", Decimal::EITHER, Some(-1.5)),
            ("1.5", SURE_COMMA, None),
            ("1,5e-3", SURE_COMMA, Some(1.5e-3)),
        ] {
            assert_eq!(number(text, decimal), expected, "{text}");
        }
        for text in ["0,00", "-1,234"] {
            assert!(no_number(text).contains("decimal = "));
        }
        for text in ["", "-", "1,2,3", "a,b"] {
            assert!(!no_number(text).contains("decimal = "), "{text}");
        }
    }

    #[test]
    fn marks_between_thousands_are_read_unless_they_could_be_decimal_ones() {
        for (text, decimal, expected) in [
            ("1,234.5", POINT, Some(1234.5)),
            ("1,234", POINT, None),
            ("1,234", SURE_POINT, Some(1234.0)),
            ("1,234,567", POINT, Some(1_234_567.0)),
            ("1.234,5", Decimal::EITHER, Some(1234.5)),
            ("-22.500", SURE_COMMA, Some(-22_500.0)),
            ("22 500,0", Decimal::EITHER, Some(22_500.0)),
            ("1\u{202f}234", POINT, Some(1234.0)),
            ("12'345.5", POINT, Some(12_345.5)),
            ("\u{2212}12.5", POINT, Some(-12.5)),
            ("\u{2212}12,5", Decimal::EITHER, Some(-12.5)),
            ("12,34.5", POINT, None),
            ("1234,567.5", POINT, None),
            ("1 2", POINT, None),
            ("", POINT, None),
            ("-", POINT, None),
            (".", POINT, None),
            ("1:234", POINT, None),
        ] {
            assert_eq!(number(text, decimal), expected, "{text}");
        }
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
