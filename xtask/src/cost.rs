//! `cargo xtask cost`: instructions of the control tick and its parts, counted in QEMU; flash and RAM; and the ceilings of
//! all of them, which a change may not exceed unnoticed.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use shared::control::network::Network;
use xshell::{Shell, cmd};

use crate::firmware::{self, Images};
use crate::{CHIP_TARGET, qemu_test};

#[path = "../../firmware/src/cost/fixture.rs"]
mod fixture;

/// Where the ceilings stand.
const CEILINGS: &str = "firmware/ceilings.toml";
/// Instructions that the core can run in a tick of 1 ms, one per cycle.
const TICK_BUDGET: f64 = 168_000.0;
/// The figure that is compared with other implementations.
const REFERENCE: &str = "network_40_32_32_1_relu";
/// What the line with the networks' output bits begins with.
const BITS: &str = "bits";

/// Arguments of `cargo xtask cost`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Write the figures as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
}

/// Mean and worst cost of a part, instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
struct Cost {
    mean: u32,
    worst: u32,
}

/// What the counting image printed.
#[derive(Debug, Default, PartialEq, Eq)]
struct Counted {
    parts: BTreeMap<String, Cost>,
    bits: [u32; 2],
}

/// What `--json` gives.
#[derive(Debug, Serialize)]
struct Figures<'a> {
    tick_worst: u32,
    network: u32,
    parts: &'a BTreeMap<String, Cost>,
    flash_bytes: u64,
    ram_bytes: u64,
    golden_hash_host: String,
    golden_hash_qemu: String,
}

/// Highest figures that pass.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Ceilings {
    flash_bytes: u64,
    ram_bytes: u64,
    parts: BTreeMap<String, u32>,
}

/// Counts, prints, compares.
pub fn run(shell: &Shell, arguments: &Arguments) -> Result<()> {
    let images = firmware::build(shell)?;
    let golden = qemu_test::golden(shell)?;
    let mut counted = count(shell)?;
    check_bits(&counted)?;
    // The tick of the real image, by its own clock, beside the one that was counted by itself.
    counted
        .parts
        .insert("tick_on_the_image".into(), Cost { mean: golden.tick_mean, worst: golden.tick_worst });
    let ceilings = toml::from_str(&shell.read_file(CEILINGS)?).context(CEILINGS)?;
    let (flash_bytes, ram_bytes) = sizes(&images)?;
    print!("{}", table(&counted.parts, &ceilings));
    println!(
        "flash {flash_bytes} of at most {}, RAM {ram_bytes} of at most {} bytes",
        ceilings.flash_bytes, ceilings.ram_bytes
    );
    println!("golden trace: host {}, QEMU {}", golden.hash_host, golden.hash_qemu);
    let worst = |name: &str| counted.parts.get(name).map_or(0, |cost| cost.worst);
    if let Some(path) = &arguments.json {
        let figures = Figures {
            tick_worst: worst("tick").max(golden.tick_worst),
            network: worst(REFERENCE),
            parts: &counted.parts,
            flash_bytes,
            ram_bytes,
            golden_hash_host: golden.hash_host.clone(),
            golden_hash_qemu: golden.hash_qemu.clone(),
        };
        shell.write_file(path, serde_json::to_string_pretty(&figures)? + "\n")?;
    }
    ensure!(golden.hash_host == golden.hash_qemu, "the golden traces of host and QEMU differ");
    let exceeded = exceeded(&counted.parts, flash_bytes, ram_bytes, &ceilings);
    ensure!(
        exceeded.is_empty(),
        "above the ceiling: {}; make it cheaper, or raise the ceiling in {CEILINGS} and say why",
        exceeded.join(", ")
    );
    Ok(())
}

/// Builds the counting image and runs it.
fn count(shell: &Shell) -> Result<Counted> {
    let target = CHIP_TARGET;
    cmd!(shell, "cargo build --release -p firmware --bin cost --features cost --target {target}")
        .quiet()
        .run()?;
    let image = firmware::cargo_folder(shell).join(CHIP_TARGET).join("release/cost");
    let output = cmd!(
        shell,
        "qemu-system-arm -M netduinoplus2 -display none -monitor none -serial none
         -semihosting-config enable=on,target=native -icount shift=3,sleep=off -kernel {image}"
    );
    parse(&output.quiet().read().context("QEMU cannot run the counting image; run: cargo xtask setup")?)
}

fn parse(output: &str) -> Result<Counted> {
    let mut counted = Counted::default();
    for line in output.lines() {
        let words: Vec<&str> = line.split_whitespace().collect();
        let [name, first, second] = words[..] else { bail!("the counting image said: {output}") };
        let number = |word: &str| word.parse().with_context(|| format!("`{line}`"));
        let (first, second) = (number(first)?, number(second)?);
        if name == BITS {
            counted.bits = [first, second];
        } else {
            counted.parts.insert(name.to_owned(), Cost { mean: first, worst: second });
        }
    }
    Ok(counted)
}

/// The chip must have computed what this computer computes.
fn check_bits(counted: &Counted) -> Result<()> {
    let here = fixture::reference_bits(
        |network, inputs| network.forward_with(inputs, fixture::relu),
        |network, inputs| network.forward(inputs),
    );
    ensure!(
        counted.bits == here,
        "the chip's networks give other bits than the host's: {:?}, {here:?}",
        counted.bits
    );
    Ok(())
}

/// Flash and RAM of the board's image.
fn sizes(images: &Images) -> Result<(u64, u64)> {
    let size = firmware::size(&images.board, Path::new("memory.x"))?;
    Ok((size.flash, size.ram))
}

fn table(parts: &BTreeMap<String, Cost>, ceilings: &Ceilings) -> String {
    let head = format!(
        "{:<28} {:>8} {:>8} {:>8}  share of a tick\n",
        "part, instructions", "mean", "worst", "ceiling"
    );
    let line = |(name, cost): (&String, &Cost)| {
        let ceiling = ceilings.parts.get(name).map_or_else(|| "-".into(), ToString::to_string);
        let share = 100.0 * f64::from(cost.worst) / TICK_BUDGET;
        // The start of the program is no part of a tick.
        let share = if name.starts_with("boot") { String::new() } else { format!("{share:>14.1} %") };
        format!("{name:<28} {:>8} {:>8} {ceiling:>8} {share}\n", cost.mean, cost.worst)
    };
    head + &parts.iter().map(line).collect::<String>()
}

/// What lies above its ceiling, or has none, or is missing.
fn exceeded(parts: &BTreeMap<String, Cost>, flash: u64, ram: u64, ceilings: &Ceilings) -> Vec<String> {
    let mut exceeded: Vec<String> = Vec::new();
    for (name, cost) in parts {
        match ceilings.parts.get(name) {
            Some(ceiling) if cost.worst <= *ceiling => {}
            Some(ceiling) => exceeded.push(format!("{name} {} > {ceiling}", cost.worst)),
            None => exceeded.push(format!("{name} has no ceiling")),
        }
    }
    exceeded.extend(
        ceilings
            .parts
            .keys()
            .filter(|name| !parts.contains_key(*name))
            .map(|name| format!("{name} was not counted")),
    );
    for (name, bytes, ceiling) in [("flash", flash, ceilings.flash_bytes), ("RAM", ram, ceilings.ram_bytes)] {
        if bytes > ceiling {
            exceeded.push(format!("{name} {bytes} > {ceiling}"));
        }
    }
    exceeded
}

/// Compile-time proof that the product's network is an instance of what is counted.
const _: fn(&Network, &[f32; shared::control::features::FEATURES]) -> f32 = Network::forward;

#[cfg(test)]
mod tests {
    use super::*;

    fn ceilings(tick: u32) -> Ceilings {
        Ceilings { flash_bytes: 100, ram_bytes: 50, parts: BTreeMap::from([("tick".into(), tick)]) }
    }

    #[test]
    fn the_images_lines_are_read() {
        let counted = parse("tick 100 200\nbits 4000000000 7\n").unwrap();
        assert_eq!(counted.parts["tick"], Cost { mean: 100, worst: 200 });
        assert_eq!(counted.bits, [4_000_000_000, 7]);
        assert!(parse("panicked at somewhere").is_err());
    }

    #[test]
    fn whatever_exceeds_its_ceiling_is_named() {
        let parts = BTreeMap::from([("tick".to_owned(), Cost { mean: 1, worst: 10 })]);
        assert!(exceeded(&parts, 100, 50, &ceilings(10)).is_empty());
        assert_eq!(
            exceeded(&parts, 101, 51, &ceilings(9)),
            ["tick 10 > 9", "flash 101 > 100", "RAM 51 > 50"]
        );
    }

    #[test]
    fn a_part_without_ceiling_and_a_ceiling_without_part_are_named() {
        let parts = BTreeMap::from([("new".to_owned(), Cost { mean: 1, worst: 1 })]);
        assert_eq!(exceeded(&parts, 0, 0, &ceilings(9)), ["new has no ceiling", "tick was not counted"]);
    }

    #[test]
    fn the_trees_ceilings_are_no_higher_than_the_goals() {
        let text = std::fs::read_to_string(Path::new("..").join(CEILINGS)).unwrap();
        let ceilings: Ceilings = toml::from_str(&text).unwrap();
        assert!(ceilings.parts[REFERENCE] <= 7_011 && ceilings.parts["tick"] <= 25_000);
        assert!(ceilings.flash_bytes <= 128 * 1024 && ceilings.ram_bytes <= 48 * 1024);
    }

    #[test]
    fn this_computer_computes_the_pinned_bits() {
        check_bits(&Counted { parts: BTreeMap::new(), bits: [2_197_030_421, 65_935_474] }).unwrap();
    }
}
