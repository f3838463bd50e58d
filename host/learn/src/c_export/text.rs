//! Constants as C.

use std::fmt::Display;

/// Longest line of a table, characters.
const WIDTH: usize = 120;

/// A number in single precision; its shortest decimal form, which a compiler rounds to the same bits.
pub fn real(value: f32) -> String {
    debug_assert!(value.is_finite(), "C has no literal for it");
    format!("{value:?}f")
}

/// A macro.
pub fn define(name: &str, value: impl Display) -> String {
    format!("#define {name} {value}\n")
}

/// Elements, separated by commas.
pub fn list(elements: impl IntoIterator<Item = String>) -> String {
    elements.into_iter().collect::<Vec<_>>().join(", ")
}

/// A constant array of floats, on as many lines as it takes.
pub fn reals<'a>(name: &str, values: impl IntoIterator<Item = &'a f32>) -> String {
    let mut lines = vec![String::new()];
    for value in values {
        let element = format!("{}, ", real(*value));
        match lines.last_mut() {
            Some(line) if line.len() + element.len() <= WIDTH => line.push_str(&element),
            _ => lines.push(element),
        }
    }
    let lines: Vec<&str> = lines.iter().map(|line| line.trim_end()).collect();
    format!("static const float {name}[] = {{\n  {}\n}};\n", lines.join("\n  "))
}

/// A constant array of whole numbers.
pub fn wholes<T: Copy + Into<u32>>(name: &str, values: &[T]) -> String {
    let values = list(values.iter().map(|value| format!("{}u", (*value).into())));
    format!("static const uint32_t {name}[] = {{{values}}};\n")
}
