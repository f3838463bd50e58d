//! Finds a sentence that states numbers in a document, wherever the document breaks its lines, and compares
//! the numbers.

use std::ops::Range;

/// Parts of a document that state no behaviour of the code: results of measurements.
const MEASURED: [&str; 2] = ["<!-- measured: begin -->", "<!-- measured: end -->"];
/// Numbers as words, except those of names and idioms (one, third party).
const WORDS: [&str; 14] = [
    "two", "three", "four", "five", "six", "seven", "eight", "nine", "ten", "twelve", "half", "fifth",
    "tenth", "twice",
];
/// Names that contain numbers.
const NAMES: [&str; 2] = ["IEC 60601-1-8", "CRC-32"];

/// A sentence, or a part of one, and the numbers that the code gives it.
#[derive(Clone, Debug)]
pub struct Claim {
    /// The words, with `{}` for each number; they begin with a word.
    pub sentence: &'static str,
    /// The numbers.
    pub figures: Vec<String>,
}

impl Claim {
    /// How a text differs from the claim; none if it makes it.
    pub fn problem(&self, text: &str) -> Option<String> {
        let stated = self.stated(text);
        if stated.is_empty() {
            let figures = self.figures.join(", ");
            return Some(format!(
                "lacks the sentence \"{}\" (numbers {figures}): state it, or take it out of claims.rs",
                self.sentence
            ));
        }
        let differs = |places: &&Vec<Range<usize>>| {
            let stated = places.iter().map(|place| &text[place.clone()]);
            !stated.eq(self.figures.iter().map(String::as_str))
        };
        stated.iter().find(differs).map(|places| {
            let stated: Vec<_> = places.iter().map(|place| &text[place.clone()]).collect();
            let (sentence, stated, figures) = (self.sentence, stated.join(", "), self.figures.join(", "));
            format!("\"{sentence}\" has the numbers {stated}, the code has {figures}")
        })
    }

    /// The text with the numbers of the code.
    pub fn corrected(&self, mut text: String) -> String {
        for places in self.stated(&text).into_iter().rev() {
            for (place, figure) in places.into_iter().zip(&self.figures).rev() {
                text.replace_range(place, figure);
            }
        }
        text
    }

    /// The claims that differ from this one in a single number.
    pub fn with_each_figure_changed(&self) -> impl Iterator<Item = Self> {
        (0..self.figures.len()).map(|changed| {
            let mut claim = self.clone();
            "7431".clone_into(&mut claim.figures[changed]);
            claim
        })
    }

    /// The places of the numbers, for each time that a text contains the sentence.
    fn stated(&self, text: &str) -> Vec<Vec<Range<usize>>> {
        let first = self.sentence.split([' ', '{']).next().unwrap_or_default();
        text.match_indices(first).filter_map(|(at, _)| numbers_at(text, at, self.sentence)).collect()
    }
}

/// The places of the numbers of a sentence that begins here; a space stands for any white space.
fn numbers_at(text: &str, at: usize, sentence: &str) -> Option<Vec<Range<usize>>> {
    let mut rest = &text[at..];
    let mut places = Vec::new();
    for (count, words) in sentence.split("{}").enumerate() {
        if count > 0 {
            let (start, length) = (text.len() - rest.len(), number_length(rest));
            if length == 0 {
                return None;
            }
            places.push(start..start + length);
            rest = &rest[length..];
        }
        for letter in words.chars() {
            rest = if letter == ' ' {
                rest.strip_prefix(char::is_whitespace)?.trim_start()
            } else {
                rest.strip_prefix(letter)?
            };
        }
    }
    Some(places)
}

/// Length of the number with which a text begins; 0 if there is none.
fn number_length(text: &str) -> usize {
    let digits = text.strip_prefix('-').unwrap_or(text);
    if !digits.starts_with(|first: char| first.is_ascii_digit()) {
        return 0;
    }
    let end = digits.find(|letter: char| !(letter.is_ascii_digit() || ".,".contains(letter)));
    let number = digits[..end.unwrap_or(digits.len())].trim_end_matches(['.', ',']);
    number.len() + text.len() - digits.len()
}

/// The number that a source file states with these words; for a constant that a test cannot use.
pub fn quoted(file: &str, words: &str) -> f64 {
    let text = super::read(file);
    let first = words.split('{').next().unwrap_or_default();
    let found = text.match_indices(first).find_map(|(at, _)| numbers_at(&text, at, words));
    let place = found.unwrap_or_else(|| panic!("{file} lacks `{words}`"))[0].clone();
    text[place].replace('_', "").parse().unwrap_or_else(|error| panic!("{file}, `{words}`: {error}"))
}

/// The places of all numbers that state a behaviour: neither results of measurements, nor parts of names,
/// paths and commands.
pub fn checked_numbers(text: &str) -> Vec<Range<usize>> {
    let text = without_names(&without_measurements(text));
    let mut places = Vec::new();
    let mut at = 0;
    while let Some(next) = text[at..].find(|letter: char| letter.is_ascii_digit()) {
        let start = at + next;
        let length = number_length(&text[start..]);
        let in_word = text[..start].ends_with(|before: char| before.is_alphanumeric() || before == '_');
        if !in_word {
            places.push(start..start + length);
        }
        at = start + length;
    }
    let words = WORDS.iter().flat_map(|word| text.match_indices(word));
    places.extend(words.map(|(at, word)| at..at + word.len()).filter(|place| is_word(&text, place)));
    places
}

/// Whether a place is a word of its own.
fn is_word(text: &str, place: &Range<usize>) -> bool {
    let goes_on = |letter: char| letter.is_alphanumeric() || letter == '-';
    !text[..place.start].ends_with(goes_on) && !text[place.end..].starts_with(goes_on)
}

/// The text with spaces in place of what was measured.
fn without_measurements(text: &str) -> String {
    let mut result = String::new();
    let mut rest = text;
    while let Some((before, after)) = rest.split_once(MEASURED[0]) {
        let (measured, next) = after.split_once(MEASURED[1]).expect("the end of what was measured is marked");
        result.extend([before, &blank(MEASURED[0]), &blank(measured), &blank(MEASURED[1])]);
        rest = next;
    }
    result + rest
}

/// The text with spaces in place of names and of words in backquotes, except in blocks of code.
fn without_names(text: &str) -> String {
    let text = NAMES.iter().fold(text.replace("```", "   "), |text, name| text.replace(name, &blank(name)));
    let parts = text.split('`').enumerate();
    let parts = parts.map(|(count, part)| if count % 2 == 0 { part.to_owned() } else { blank(part) });
    parts.collect::<Vec<_>>().join("`")
}

fn blank(text: &str) -> String {
    text.bytes().map(|byte| if byte == b'\n' { '\n' } else { ' ' }).collect()
}

#[test]
fn a_sentence_is_found_across_lines_and_only_with_numbers() {
    let claim = Claim { sentence: "capped at {} %, from {} cmH2O", figures: vec!["40".into(), "-5".into()] };
    assert_eq!(claim.problem("is capped\n  at 40 %, from -5 cmH2O."), None);
    let problem = claim.problem("capped at 45 %, from -5 cmH2O").unwrap();
    assert!(problem.contains("45, -5") && problem.contains("40, -5"), "{problem}");
    assert!(claim.problem("capped at most %, from -5 cmH2O").unwrap().contains("lacks the sentence"));
    let again = "capped at 40 %, from -5 cmH2O; capped at 41 %, from -5 cmH2O";
    assert!(claim.problem(again).is_some(), "each place counts");
    assert_eq!(claim.problem(&claim.corrected(again.to_owned())), None);
}

#[test]
fn numbers_in_names_and_results_of_measurements_are_not_checked() {
    let text = "5 s, half as often, R20 and `x 3`, -2.5, CRC-32 \
                <!-- measured: begin -->9 <!-- measured: end -->1,000.\n```text\n0 to 7\n```";
    let numbers: Vec<_> = checked_numbers(text).into_iter().map(|place| &text[place]).collect();
    assert_eq!(numbers, ["5", "2.5", "1,000", "0", "7", "half"]);
}
