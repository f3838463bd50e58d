//! Command lines as text that a shell reads back.

use std::borrow::Cow;
use std::ffi::OsStr;

/// A word as a shell reads it back.
pub fn quoted(word: impl AsRef<OsStr>) -> String {
    let word = word.as_ref().to_string_lossy();
    // shlex quotes a list such as 7.2,253,0.13 too, which is harder to read and means the same.
    let list =
        !word.is_empty() && word.split(',').all(|part| shlex::try_quote(part).is_ok_and(|p| p == part));
    if list {
        return word.into_owned();
    }
    // A word with a zero byte cannot be an argument of any command.
    shlex::try_quote(&word).map_or_else(|_| String::new(), Cow::into_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_where_a_shell_needs_it() {
        for plain in ["out/a-1,2", "--bench", "R20C20", "7.2,253,0.13"] {
            assert_eq!(quoted(plain), plain);
        }
        for word in ["two words", "it's", "", "serial:a?baud=9", "a$b", "a;b"] {
            let read = shlex::split(&quoted(word));
            assert!(quoted(word) != word && read == Some(vec![word.to_owned()]), "{word}: {}", quoted(word));
        }
    }
}
