//! Words as a shell takes them.

use std::ffi::OsStr;

/// A word as a shell takes it: in quotes if it has letters that mean something there.
pub fn quoted(word: impl AsRef<OsStr>) -> String {
    let word = word.as_ref().to_string_lossy();
    let plain = |letter: char| letter.is_alphanumeric() || "-_=+,.:/\\@%".contains(letter);
    if !word.is_empty() && word.chars().all(plain) {
        word.into_owned()
    } else {
        format!("'{}'", word.replace('\'', "'\\''"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn words_are_quoted_where_a_shell_needs_it() {
        let words = ["out/a-1,2", "two words", "it's", "", "serial:a?baud=9"].map(quoted);
        assert_eq!(words, ["out/a-1,2", "'two words'", r"'it'\''s'", "''", "'serial:a?baud=9'"]);
    }
}
