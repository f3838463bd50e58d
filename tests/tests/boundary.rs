//! The boundary of the core: `shared` and the bench must not use std or float functions that differ between platforms.
//!
//! The compiler rejects most uses, since without std these functions do not exist on `f32`. But a dependency's trait
//! can bring them back, and `core` gets new functions with each release, so this test also reads the source.

use std::fs;
use std::path::{Path, PathBuf};

/// Functions whose last bits depend on the platform's library, or that contract two roundings into one.
const FUNCTIONS: &[&str] = &[
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "cos", "cosh", "exp", "exp2",
    "exp_m1", "hypot", "ln", "ln_1p", "log", "log10", "log2", "mul_add", "powf", "powi", "sin", "sin_cos",
    "sinh", "sqrt", "tan", "tanh",
];
/// Modules and traits that provide such functions under the same or other names.
const PROVIDERS: &[&str] = &["libm::", "micromath::", "f32::math", "f64::math", "intrinsics::"];

#[test]
fn float_functions_of_the_platform_stand_nowhere_in_the_core() {
    let files = core_files();
    assert!(files.len() > 10, "too few source files of the core found: {files:?}");
    let found: Vec<String> = files
        .iter()
        .filter(|path| !path.ends_with("math.rs"))
        .flat_map(|path| {
            let source = fs::read_to_string(path).expect("a source file can be read");
            offences(&source)
                .into_iter()
                .map(move |(line, what)| format!("{}:{line}: {what}", path.display()))
        })
        .collect();
    assert!(
        found.is_empty(),
        "these functions differ between platforms; define them in the math.rs of the crate:\n{}",
        found.join("\n")
    );
}

#[test]
fn the_core_is_unconditionally_without_std() {
    let root = fs::read_to_string(core().join("lib.rs")).expect("the core has a root");
    let lines: Vec<&str> = root.lines().collect();
    assert!(lines.contains(&"#![no_std]"), "no_std must be unconditional");
    assert!(lines.contains(&"#![forbid(unsafe_code)]"));
    for (above, line) in lines.iter().zip(&lines[1..]) {
        let brings_std = line.contains("extern crate std") || line.contains("extern crate alloc");
        assert!(!brings_std || *above == "#[cfg(test)]", "only tests may use std: {line}");
    }
}

#[test]
fn a_planted_offence_is_found_where_it_stands() {
    for planted in [
        "let y = x.tanh();",
        "let y = f32::sqrt(x);",
        "let y = a.mul_add(b, c);",
        "let y = x\n    .powf(1.3);",
        "let y = libm::expf(x);",
        "xs.iter().map(f32::ln).sum()",
    ] {
        let source = format!("fn core() {{\n{planted}\n}}\n");
        assert_eq!(offences(&source).len(), 1, "{planted}");
    }
    assert_eq!(offences("\n\nlet y = x.exp();"), [(3, "exp".to_owned())]);
}

#[test]
fn comments_tests_and_other_names_are_no_offence() {
    for innocent in [
        "// x.tanh() costs a hundred instructions",
        "/// `f32::exp` differs",
        "self.explore(tick); log_entry.exponent();",
        "fn core() {}\n#[cfg(test)]\nmod tests {\n    fn y(x: f32) -> f32 { x.tanh() }\n}\n",
    ] {
        assert_eq!(offences(innocent), [], "{innocent}");
    }
}

/// Numbers of lines (from 1) that name a platform function outside comments and tests.
fn offences(source: &str) -> Vec<(usize, String)> {
    // The tests of a file are at its end.
    let code = source.split("#[cfg(test)]\nmod tests").next().unwrap_or_default();
    let mut found = Vec::new();
    for (index, line) in code.lines().enumerate() {
        let line = line.split("//").next().unwrap_or_default();
        let functions = FUNCTIONS.iter().filter(|name| names_function(line, name));
        let providers = PROVIDERS.iter().filter(|provider| line.contains(**provider));
        found.extend(functions.chain(providers).map(|what| (index + 1, (*what).to_owned())));
    }
    found
}

/// Whether the line contains `name` as a method or at the end of a path.
fn names_function(line: &str, name: &str) -> bool {
    line.match_indices(name).any(|(start, _)| {
        let (before, after) = (&line[..start], &line[start + name.len()..]);
        let called = before.ends_with('.') || before.ends_with("::");
        // A crate's own file of functions.
        let is_ours = before.ends_with("::math::");
        called && !is_ours && !after.starts_with(|next: char| next.is_alphanumeric() || next == '_')
    })
}

fn core() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/src")
}

/// The bench, which a chip can run too.
fn bench() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../shared/bench/src")
}

/// All source files of core and bench except those that contain only tests.
fn core_files() -> Vec<PathBuf> {
    let (mut files, mut folders) = (Vec::new(), vec![core(), bench()]);
    while let Some(folder) = folders.pop() {
        for entry in fs::read_dir(folder).expect("a source folder can be read") {
            let path = entry.expect("an entry of a source folder can be read").path();
            if path.file_stem().is_some_and(|stem| stem == "tests") {
                continue;
            }
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "rs") {
                files.push(path);
            }
        }
    }
    files
}
