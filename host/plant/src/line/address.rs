//! The address of a program at the other end of a line.

use std::fmt;
use std::str::FromStr;

use thiserror::Error;

/// A program that listens, or a command that starts one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Address {
    /// `host:port`.
    Tcp(String),
    /// A command, split into words, that communicates over its standard input and output.
    Pipe(Vec<String>),
}

/// The address is not valid.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
#[error("'{0}' is no address: write tcp:HOST:PORT, or 'pipe:COMMAND', such as 'pipe:python3 plant.py'")]
pub struct AddressError(String);

/// The `host:port` of an address that begins with `tcp:`; none for any other address.
///
/// # Errors
/// `tcp:` without a host or a port.
pub fn tcp_address(text: &str) -> Option<Result<String, AddressError>> {
    let address = text.strip_prefix("tcp:")?;
    let complete = |(host, port): (&str, &str)| !host.is_empty() && port.parse::<u16>().is_ok();
    let complete = address.rsplit_once(':').is_some_and(complete);
    Some(if complete { Ok(address.to_owned()) } else { Err(AddressError(text.to_owned())) })
}

impl FromStr for Address {
    type Err = AddressError;

    fn from_str(text: &str) -> Result<Self, AddressError> {
        if let Some(address) = tcp_address(text) {
            return address.map(Self::Tcp);
        }
        let words = text.strip_prefix("pipe:").and_then(words).filter(|words| !words.is_empty());
        words.map(Self::Pipe).ok_or_else(|| AddressError(text.to_owned()))
    }
}

impl fmt::Display for Address {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Tcp(address) => write!(f, "tcp:{address}"),
            Self::Pipe(words) => {
                let quoted = |word: &String| match word {
                    word if word.contains('\'') => format!("\"{word}\""),
                    word if word.is_empty() || word.contains([' ', '"']) => format!("'{word}'"),
                    word => word.clone(),
                };
                write!(f, "pipe:{}", words.iter().map(quoted).collect::<Vec<_>>().join(" "))
            }
        }
    }
}

/// Splits a command into words at blanks outside quotes of either kind. `None` if a quote is not closed.
fn words(text: &str) -> Option<Vec<String>> {
    let mut words = Vec::new();
    let mut word: Option<String> = None;
    let mut quote = None;
    for letter in text.chars() {
        match (quote, letter) {
            (Some(open), _) if open == letter => quote = None,
            (None, '\'' | '"') => {
                quote = Some(letter);
                word.get_or_insert_default();
            }
            (None, ' ' | '\t') => words.extend(word.take()),
            _ => word.get_or_insert_default().push(letter),
        }
    }
    words.extend(word);
    quote.is_none().then_some(words)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_read_as_they_are_printed() {
        for text in [
            "tcp:localhost:7000",
            "pipe:python3 plant.py",
            "pipe:'my plant' --say \"it's\" ''",
            "tcp:[::1]:7",
        ] {
            assert_eq!(text.parse::<Address>().unwrap().to_string(), text);
        }
    }

    #[test]
    fn quotes_keep_blanks_together() {
        let words: Address = "pipe:python3  'a b.py' x\"y z\"".parse().unwrap();
        assert_eq!(words, Address::Pipe(["python3", "a b.py", "xy z"].map(str::to_owned).to_vec()));
    }

    #[test]
    fn what_is_no_address_is_refused_with_the_right_form() {
        for wrong in ["", "plant", "tcp:", "tcp:host", "tcp:host:port", "tcp::7", "pipe:", "pipe:a 'b"] {
            let refused = wrong.parse::<Address>().unwrap_err().to_string();
            assert!(refused.contains("tcp:HOST:PORT") && refused.contains("pipe:"), "{wrong}: {refused}");
        }
    }
}
