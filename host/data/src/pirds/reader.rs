//! Reads events from a JSON array, from JSON lines or from the log of `pirds_logger`, in bounded memory.
//!
//! The log has a line for each event: the second of its arrival, and its fields with colons between them.

use std::io::{self, BufRead};

use serde_json::{Map, Value};
use thiserror::Error;

use super::{Event, Measurement, PhaseMark, Sensor};

/// Longest event, bytes; a message has at most 255.
const MOST_BYTES: usize = 1 << 14;
/// Most characters of a name by which an event is counted.
const NAME_CHARS: usize = 24;

/// Why a file cannot be read on. The text says what to do.
#[derive(Debug, Error)]
pub enum EventFault {
    /// The operating system could not read the file.
    #[error(transparent)]
    Read(#[from] io::Error),
    /// A line that is not an event.
    #[error("{reason}")]
    Line {
        /// The line, counted from 1.
        line: u64,
        /// What is wrong, and what to do.
        reason: String,
    },
}

/// A file that is being read.
#[derive(Debug)]
pub struct EventReader<R> {
    from: R,
    /// The line, counted from 1.
    line: u64,
    /// Whether an array was opened and not closed.
    within_array: bool,
    text: Vec<u8>,
}

impl<R: BufRead> EventReader<R> {
    /// A reader at the start of a file.
    pub fn new(from: R) -> Self {
        Self { from, line: 1, within_array: false, text: Vec::new() }
    }

    /// The next event; none at the end of the file.
    ///
    /// # Errors
    /// A file that cannot be read, or content that is not an event, with its line.
    pub fn next_event(&mut self) -> Result<Option<Event>, EventFault> {
        let Some(first) = self.find()? else { return Ok(None) };
        let line = self.line;
        self.text.clear();
        self.text.push(first);
        let event = if first == b'{' {
            self.collect()?;
            event(&self.text)
        } else {
            self.collect_line()?;
            logged(&String::from_utf8_lossy(&self.text))
        };
        event.map(Some).map_err(|reason| EventFault::Line { line, reason })
    }

    /// Goes to the start of the next event and takes its first byte; none at the end of the file.
    fn find(&mut self) -> Result<Option<u8>, EventFault> {
        while let Some(byte) = self.byte()? {
            match byte {
                b'{' => return Ok(Some(byte)),
                byte if byte.is_ascii_digit() && !self.within_array => return Ok(Some(byte)),
                b'[' if !self.within_array => self.within_array = true,
                b']' if self.within_array => self.within_array = false,
                b',' => {}
                // PIRDS-logger writes an empty text for a meta event that it does not know.
                b'"' if self.within_array => self.empty_text()?,
                byte if byte.is_ascii_whitespace() => {}
                other => {
                    return Err(self.fault(format!(
                        "`{}` is not the start of an event such as {{\"event\": \"M\", ...}}: remove it",
                        char::from(other).escape_default()
                    )));
                }
            }
        }
        if self.within_array {
            return Err(
                self.fault("the file ends before the `]` of its array: copy it again, or add it".into())
            );
        }
        Ok(None)
    }

    /// Takes the rest of a line.
    fn collect_line(&mut self) -> Result<(), EventFault> {
        let line = self.line;
        while let Some(byte) = self.byte()?.filter(|byte| *byte != b'\n') {
            self.add(byte, line)?;
        }
        Ok(())
    }

    /// Takes the rest of an object.
    fn collect(&mut self) -> Result<(), EventFault> {
        let (line, mut depth, mut quoted, mut escaped) = (self.line, 1, false, false);
        while depth > 0 {
            let Some(byte) = self.byte()? else {
                let reason = "the file ends within this event: copy it again, or remove the event".to_owned();
                return Err(EventFault::Line { line, reason });
            };
            self.add(byte, line)?;
            match byte {
                _ if escaped => escaped = false,
                b'\\' if quoted => escaped = true,
                b'"' => quoted = !quoted,
                b'{' if !quoted => depth += 1,
                b'}' if !quoted => depth -= 1,
                _ => {}
            }
        }
        Ok(())
    }

    /// Adds a byte to an event that began in this line.
    fn add(&mut self, byte: u8, line: u64) -> Result<(), EventFault> {
        if self.text.len() == MOST_BYTES {
            let reason =
                format!("the event has more than {MOST_BYTES} bytes: close its `}}` or end its line");
            return Err(EventFault::Line { line, reason });
        }
        self.text.push(byte);
        Ok(())
    }

    /// The end of an empty text, whose first quote has been read.
    fn empty_text(&mut self) -> Result<(), EventFault> {
        match self.byte()? {
            Some(b'"') => Ok(()),
            _ => Err(self.fault("a text is no event: remove it".to_owned())),
        }
    }

    fn byte(&mut self) -> Result<Option<u8>, io::Error> {
        let byte = loop {
            match self.from.fill_buf() {
                Ok(buffer) => break buffer.first().copied(),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) => return Err(error),
            }
        };
        if let Some(byte) = byte {
            self.from.consume(1);
            self.line += u64::from(byte == b'\n');
        }
        Ok(byte)
    }

    fn fault(&self, reason: String) -> EventFault {
        EventFault::Line { line: self.line, reason }
    }
}

/// Whether a line is one of a logger's file.
pub fn is_logged(line: &str) -> bool {
    logged(line).is_ok()
}

/// The event in a line of a logger's file; otherwise what is wrong.
fn logged(line: &str) -> Result<Event, String> {
    let (_, fields) = line.trim().split_once(':').unwrap_or_default();
    let fields: Vec<&str> = fields.splitn(6, ':').collect();
    let read = match fields[..] {
        ["M", kind, location, number, ms, value] => logged_reading([kind, location, number, ms, value]),
        ["E", kind, ms, ref text @ ..] if kind.len() == 1 => {
            ms.parse().ok().map(|ms| meta(kind, ms, text.join(":").trim_matches('"')))
        }
        [event, kind, ..] if event != "M" && event.len() == 1 && kind.len() == 1 => Some(other(event, kind)),
        _ => None,
    };
    read.ok_or_else(|| {
        "this line of a log is no event, such as 1591668735:M:D:A:0:263923:50: remove it".to_owned()
    })
}

fn logged_reading([kind, location, number, ms, value]: [&str; 5]) -> Option<Event> {
    let letter = |text: &str| text.parse::<char>().ok();
    let sensor = Sensor { kind: letter(kind)?, location: letter(location)?, number: number.parse().ok()? };
    let time = ms.parse::<i64>().ok()?;
    let ms = u32::try_from(time.unsigned_abs()).ok()?;
    Some(Event::Measurement(Measurement { sensor, ms, value: value.parse().ok()?, beyond_range: time < 0 }))
}

/// The event of a JSON object; otherwise what is wrong.
fn event(text: &[u8]) -> Result<Event, String> {
    let fields: Map<String, Value> =
        serde_json::from_slice(text).map_err(|error| format!("{error}: correct the event's JSON"))?;
    match word(&fields, "event")? {
        "M" => measurement(&fields).map(Event::Measurement),
        "E" if word(&fields, "type")? == "M" => {
            let text = fields.get("buff").and_then(Value::as_str).unwrap_or_default();
            Ok(meta("M", time(&fields)?.0, text))
        }
        event => Ok(other(event, fields.get("type").and_then(Value::as_str).unwrap_or("?"))),
    }
}

/// A meta event with its text, which may be the mark of a phase.
fn meta(kind: &str, ms: u32, text: &str) -> Event {
    match text.parse::<PhaseMark>() {
        Ok(mark) if kind == "M" => Event::Phase(ms, mark),
        _ if kind == "M" => Event::Other("messages".to_owned()),
        _ => other("E", kind),
    }
}

/// An event that is no reading, by its name.
fn other(event: &str, kind: &str) -> Event {
    let name = match event {
        "A" => format!("assertion {kind}"),
        "E" => format!("meta event {kind}"),
        event => format!("unknown event {event}"),
    };
    Event::Other(name.chars().take(NAME_CHARS).collect())
}

fn measurement(fields: &Map<String, Value>) -> Result<Measurement, String> {
    let (ms, beyond_range) = time(fields)?;
    let sensor = Sensor {
        kind: letter(fields, "type")?,
        location: letter(fields, "loc")?,
        number: integer(fields, "num", 0, i64::from(u8::MAX))? as u8,
    };
    let value = integer(fields, "val", i64::from(i32::MIN), i64::from(i32::MAX))? as i32;
    Ok(Measurement { sensor, ms, value, beyond_range })
}

/// The time, and whether it is negative: so the standard's tools mark a reading beyond the sensor's range.
fn time(fields: &Map<String, Value>) -> Result<(u32, bool), String> {
    let ms = integer(fields, "ms", -i64::from(u32::MAX), i64::from(u32::MAX))?;
    Ok((ms.unsigned_abs() as u32, ms < 0))
}

fn word<'a>(fields: &'a Map<String, Value>, name: &str) -> Result<&'a str, String> {
    let value = fields.get(name).and_then(Value::as_str);
    value.ok_or_else(|| format!("the event has no text `{name}`: add it or remove the event"))
}

fn letter(fields: &Map<String, Value>, name: &str) -> Result<char, String> {
    let mut letters = word(fields, name)?.chars();
    match (letters.next(), letters.next()) {
        (Some(letter), None) => Ok(letter),
        _ => Err(format!("`{name}` must be one letter: correct or remove the event")),
    }
}

/// A whole number; some writers put it in quotes.
fn integer(fields: &Map<String, Value>, name: &str, low: i64, high: i64) -> Result<i64, String> {
    let number = match fields.get(name) {
        Some(Value::Number(number)) => number.as_i64(),
        Some(Value::String(text)) => text.trim().parse().ok(),
        _ => None,
    };
    number.filter(|number| (low..=high).contains(number)).ok_or_else(|| {
        format!("`{name}` must be a whole number from {low} to {high}: correct or remove the event")
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Vec<Event>, EventFault> {
        let mut reader = EventReader::new(text.as_bytes());
        std::iter::from_fn(|| reader.next_event().transpose()).collect()
    }

    const READING: &str = r#"{"event":"M","type":"D","loc":"A","num":0,"ms":19,"val":-12}"#;

    fn reading() -> Event {
        let sensor = Sensor { kind: 'D', location: 'A', number: 0 };
        Event::Measurement(Measurement { sensor, ms: 19, value: -12, beyond_range: false })
    }

    #[test]
    fn an_array_and_lines_hold_the_same_events_however_they_are_broken() {
        let [two, spread] = [vec![READING; 2], vec![READING; 2]];
        let spread = spread.join("\r\n,").replace(',', " ,\n\t");
        for text in
            [two.join("\n"), format!("[{}]", two.join(",")), two.concat(), format!(" [\n{spread}\n] ")]
        {
            assert_eq!(read(&text).unwrap(), [reading(), reading()], "{text}");
        }
        assert!(read("").unwrap().is_empty() && read("[]").unwrap().is_empty());
    }

    #[test]
    fn a_line_of_a_logger_is_an_event() {
        let log = "1593299588:M:D:A:0:19:-12\r\n1593299588:E:C:19:\"Sat Jun 27 23:13:08 2020\"\n1593299588:M:D:A:0:19:-12";
        let events = read(log).unwrap();
        assert_eq!(events, [reading(), Event::Other("meta event C".to_owned()), reading()]);
        assert!(is_logged("1593299588:M:D:A:0:19:-12") && !is_logged("10:00:05,1") && !is_logged("5,1"));
        let Err(EventFault::Line { line, reason }) = read("1:M:D:A:0:19:5\n1:M:D:A:0:1") else {
            panic!("it was read")
        };
        assert!(line == 2 && reason.contains("remove it"), "{line} {reason}");
    }

    #[test]
    fn an_event_that_the_logger_left_empty_is_skipped() {
        assert_eq!(read(&format!("[{READING},\n\"\",\n{READING}]")).unwrap(), [reading(), reading()]);
        assert!(read(&format!("[{READING},\n\"x\"]")).is_err());
    }

    #[test]
    fn braces_and_quotes_within_a_text_do_not_end_an_event() {
        let message = r#"{"event":"E","type":"M","ms":5,"b_size":9,"buff":"} \" {\\"}"#;
        let events = read(&format!("{message}\n{READING}")).unwrap();
        assert_eq!(events, [Event::Other("messages".to_owned()), reading()]);
    }

    #[test]
    fn a_negative_time_marks_a_reading_beyond_the_range() {
        let event = read(&READING.replace("19", "-19")).unwrap().remove(0);
        let Event::Measurement(measurement) = event else { panic!("{event:?}") };
        assert_eq!((measurement.ms, measurement.beyond_range), (19, true));
    }

    #[test]
    fn an_event_that_never_ends_is_refused_before_it_fills_the_memory() {
        let endless = format!("{READING}\n{{\"event\":\"{}", "M".repeat(10 * MOST_BYTES));
        let Err(EventFault::Line { line, reason }) = read(&endless) else { panic!("it was read") };
        assert!(line == 2 && reason.contains("more than"), "{line} {reason}");
    }
}
