//! `cargo xtask cost`: counts the instructions of the control tick and its parts in QEMU, measures flash and RAM, and fails
//! if a figure exceeds its ceiling.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail, ensure};
use serde::{Deserialize, Serialize};
use shared::control::network::Network;
use xshell::{Shell, cmd};

use crate::firmware::{self, Size};
use crate::qemu_test;

#[path = "../../firmware/src/cost/fixture.rs"]
mod fixture;

/// File with the ceilings.
const CEILINGS: &str = "firmware/ceilings.toml";
/// File with the images' expected sizes.
const SIZES: &str = "firmware/sizes.txt";
/// Accepted relative change of a size: an image contains the paths of its sources, whose lengths differ between
/// machines.
const SIZE_TOLERANCE: f64 = 0.01;
/// Instructions that the core can execute in a tick of 1 ms, one per cycle.
const TICK_BUDGET: f64 = 168_000.0;
/// Part that is compared with other implementations.
const REFERENCE: &str = "network_40_32_32_1_relu";
/// Part that only a test on the whole image can measure.
const ON_THE_IMAGE: &str = "tick_on_the_image";
/// First word of the line with the networks' output bits.
const BITS: &str = "bits";

/// Arguments of `cargo xtask cost`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Write the figures as JSON
    #[arg(long, value_name = "FILE")]
    json: Option<PathBuf>,
    /// Count the parts only, without tests on the image and without sizes
    #[arg(long, conflicts_with_all = ["json", "bless"])]
    parts_only: bool,
    /// Accept the images' current sizes: write them to firmware/sizes.txt
    #[arg(long)]
    bless: bool,
}

/// Mean and worst cost of a part, instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
struct Cost {
    mean: u32,
    worst: u32,
}

/// Output of the counting image.
#[derive(Debug, Default, PartialEq, Eq)]
struct Counted {
    parts: BTreeMap<String, Cost>,
    bits: [u32; 2],
}

/// Output of `--json`.
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

/// Highest accepted figures.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Ceilings {
    flash_bytes: u64,
    ram_bytes: u64,
    desk_flash_bytes: u64,
    desk_ram_bytes: u64,
    parts: BTreeMap<String, u32>,
}

/// Counts, prints the table, and compares with the ceilings.
pub fn run(shell: &Shell, arguments: &Arguments) -> Result<()> {
    let ceilings: Ceilings = toml::from_str(&shell.read_file(CEILINGS)?).context(CEILINGS)?;
    let mut counted = count(shell)?;
    check_bits(&counted)?;
    let mut exceeded = Vec::new();
    if !arguments.parts_only {
        exceeded = image(shell, arguments, &mut counted.parts, &ceilings)?;
    }
    print!("{}", table(&counted.parts, &ceilings));
    exceeded.extend(exceeded_parts(&counted.parts, &ceilings, arguments.parts_only));
    ensure!(
        exceeded.is_empty(),
        "failed the ceilings in {CEILINGS}: {}; make the code cheaper, or correct the ceiling and give the reason",
        exceeded.join(", ")
    );
    Ok(())
}

/// Measures the images' sizes, and adds the tick times of the golden test on an image to `parts`. Returns the sizes above
/// their ceiling.
fn image(
    shell: &Shell,
    arguments: &Arguments,
    parts: &mut BTreeMap<String, Cost>,
    ceilings: &Ceilings,
) -> Result<Vec<String>> {
    let images = firmware::build_unsigned(shell)?;
    let golden = qemu_test::golden(shell)?;
    let (mean, worst) = (golden.tick_mean, golden.tick_worst);
    parts.insert(ON_THE_IMAGE.into(), Cost { mean, worst });
    let sizes = [
        ("board", size(&images.board, firmware::MAIN_BOARD)?),
        ("hil", size(&images.hil, firmware::MAIN_BOARD)?),
        ("desk", size(&images.desk, firmware::DESK)?),
    ];
    let [(_, board), _, (_, desk)] = sizes;
    for (name, Size { flash, ram }) in sizes {
        println!("{name}: flash {flash}, RAM {ram} bytes");
    }
    println!("golden trace: host {}, QEMU {}", golden.hash_host, golden.hash_qemu);
    if let Some(path) = &arguments.json {
        let worst = |name: &str| parts.get(name).map_or(0, |cost| cost.worst);
        let figures = Figures {
            tick_worst: worst("tick").max(golden.tick_worst),
            network: worst(REFERENCE),
            parts,
            flash_bytes: board.flash,
            ram_bytes: board.ram,
            golden_hash_host: golden.hash_host.clone(),
            golden_hash_qemu: golden.hash_qemu.clone(),
        };
        shell.write_file(path, serde_json::to_string_pretty(&figures)? + "\n")?;
    }
    ensure!(golden.hash_host == golden.hash_qemu, "the golden traces of host and QEMU differ");
    if arguments.bless {
        shell.write_file(SIZES, sizes_text(&sizes))?;
    } else {
        check_sizes(&shell.read_file(SIZES)?, &sizes)?;
    }
    Ok(exceeded_sizes(board, desk, ceilings))
}

/// Content of the file of sizes.
fn sizes_text(sizes: &[(&str, Size)]) -> String {
    let line = |(name, Size { flash, ram }): &(&str, Size)| format!("{name} flash {flash} ram {ram}\n");
    sizes.iter().map(line).collect()
}

/// Fails if the size of an image changed by more than the tolerance.
fn check_sizes(text: &str, sizes: &[(&str, Size)]) -> Result<()> {
    let now = sizes_text(sizes);
    let (before, after) = (text.split_whitespace(), now.split_whitespace());
    let same = before.clone().count() == after.clone().count()
        && before.zip(after).all(|(before, after)| match (before.parse::<f64>(), after.parse::<f64>()) {
            (Ok(before), Ok(after)) => (after - before).abs() <= SIZE_TOLERANCE * before,
            _ => before == after,
        });
    ensure!(
        same,
        "sizes changed from\n{text}to\n{now}if that is intended, run cargo xtask cost --bless and commit {SIZES}"
    );
    Ok(())
}

/// Builds the counting image and runs it.
fn count(shell: &Shell) -> Result<Counted> {
    let image = firmware::build_cost(shell)?;
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
        let [name, first, second] = words[..] else {
            bail!("unexpected output of the counting image: {output}")
        };
        let number = |word: &str| word.parse().with_context(|| format!("not a number in `{line}`"));
        let (first, second) = (number(first)?, number(second)?);
        if name == BITS {
            counted.bits = [first, second];
        } else {
            counted.parts.insert(name.to_owned(), Cost { mean: first, worst: second });
        }
    }
    Ok(counted)
}

/// Fails unless the chip computed the same bits as this computer.
fn check_bits(counted: &Counted) -> Result<()> {
    let here = fixture::reference_bits(
        |network, inputs| network.forward_with(inputs, fixture::relu),
        fixture::Reference::forward,
    );
    ensure!(counted.bits == here, "the networks' output bits differ: chip {:?}, host {here:?}", counted.bits);
    Ok(())
}

/// Flash and RAM of an image with a map of regions.
fn size(image: &Path, map: &str) -> Result<Size> {
    firmware::size(image, Path::new(map))
}

fn table(parts: &BTreeMap<String, Cost>, ceilings: &Ceilings) -> String {
    let head = format!(
        "{:<28} {:>8} {:>8} {:>8}  share of a tick\n",
        "part, instructions", "mean", "worst", "ceiling"
    );
    let line = |(name, cost): (&String, &Cost)| {
        let ceiling = ceilings.parts.get(name).map_or_else(|| "-".into(), ToString::to_string);
        let share = 100.0 * f64::from(cost.worst) / TICK_BUDGET;
        // The start of the program is not part of a tick.
        let share = if name.starts_with("boot") { String::new() } else { format!("{share:>15.1} %") };
        format!("{name:<28} {:>8} {:>8} {ceiling:>8}{share}\n", cost.mean, cost.worst)
    };
    head + &parts.iter().map(line).collect::<String>()
}

/// Parts that exceed their ceiling, have none, or were not counted although they have one.
fn exceeded_parts(parts: &BTreeMap<String, Cost>, ceilings: &Ceilings, parts_only: bool) -> Vec<String> {
    let too_high = parts.iter().filter_map(|(name, cost)| match ceilings.parts.get(name) {
        Some(ceiling) if cost.worst <= *ceiling => None,
        Some(ceiling) => Some(format!("{name} {} > {ceiling}", cost.worst)),
        None => Some(format!("{name} has no ceiling")),
    });
    let expected = ceilings.parts.keys().filter(|name| !(parts_only && *name == ON_THE_IMAGE));
    let missing =
        expected.filter(|name| !parts.contains_key(*name)).map(|name| format!("{name} was not counted"));
    too_high.chain(missing).collect()
}

fn exceeded_sizes(board: Size, desk: Size, ceilings: &Ceilings) -> Vec<String> {
    let all = [
        ("flash", board.flash, ceilings.flash_bytes),
        ("RAM", board.ram, ceilings.ram_bytes),
        ("flash for the desk", desk.flash, ceilings.desk_flash_bytes),
        ("RAM for the desk", desk.ram, ceilings.desk_ram_bytes),
    ];
    let exceeded = all.into_iter().filter(|(_, bytes, ceiling)| bytes > ceiling);
    exceeded.map(|(name, bytes, ceiling)| format!("{name} {bytes} > {ceiling}")).collect()
}

/// Proves at compile time that the product's network is an instance of the counted code.
const _: fn(&Network, &[f32; shared::control::network::INPUTS]) -> f32 = Network::forward;

#[cfg(test)]
mod tests {
    use super::*;

    fn ceilings(tick: u32) -> Ceilings {
        Ceilings {
            flash_bytes: 100,
            ram_bytes: 50,
            desk_flash_bytes: 200,
            desk_ram_bytes: 60,
            parts: BTreeMap::from([("tick".into(), tick)]),
        }
    }

    #[test]
    fn the_images_lines_are_read() {
        let counted = parse("tick 100 200\nbits 4000000000 7\n").unwrap();
        assert_eq!(counted.parts["tick"], Cost { mean: 100, worst: 200 });
        assert_eq!(counted.bits, [4_000_000_000, 7]);
        assert!(parse("panicked at somewhere").is_err());
    }

    fn parts(parts: &[(&str, u32, u32)]) -> BTreeMap<String, Cost> {
        parts
            .iter()
            .map(|(name, mean, worst)| ((*name).into(), Cost { mean: *mean, worst: *worst }))
            .collect()
    }

    #[test]
    fn whatever_exceeds_its_ceiling_is_named() {
        let parts = parts(&[("tick", 1, 10)]);
        assert!(exceeded_parts(&parts, &ceilings(10), false).is_empty());
        assert_eq!(exceeded_parts(&parts, &ceilings(9), false), ["tick 10 > 9"]);
        let [board, desk] = [Size { flash: 100, ram: 50 }, Size { flash: 200, ram: 60 }];
        assert!(exceeded_sizes(board, desk, &ceilings(9)).is_empty());
        let exceeded = exceeded_sizes(Size { flash: 101, ram: 51 }, desk, &ceilings(9));
        assert_eq!(exceeded, ["flash 101 > 100", "RAM 51 > 50"]);
        let exceeded = exceeded_sizes(board, Size { flash: 201, ram: 61 }, &ceilings(9));
        assert_eq!(exceeded, ["flash for the desk 201 > 200", "RAM for the desk 61 > 60"]);
    }

    #[test]
    fn a_part_without_ceiling_and_a_ceiling_without_part_are_named() {
        let parts = parts(&[("new", 1, 1)]);
        assert_eq!(
            exceeded_parts(&parts, &ceilings(9), false),
            ["new has no ceiling", "tick was not counted"]
        );
    }

    #[test]
    fn a_missing_figure_of_the_image_is_reported_only_if_requested() {
        let ceilings = Ceilings { parts: BTreeMap::from([(ON_THE_IMAGE.into(), 9)]), ..ceilings(9) };
        assert!(exceeded_parts(&BTreeMap::new(), &ceilings, true).is_empty());
        assert_eq!(
            exceeded_parts(&BTreeMap::new(), &ceilings, false),
            [format!("{ON_THE_IMAGE} was not counted")]
        );
    }

    #[test]
    fn the_table_sets_each_part_against_its_ceiling_and_the_tick() {
        let parts = parts(&[("tick", 1500, 16_800), ("unlisted", 7, 8), ("boot_decode", 900, 900_000)]);
        insta::assert_snapshot!(table(&parts, &ceilings(20_000)));
    }

    #[test]
    fn sizes_may_change_by_a_hundredth() {
        let text = "board flash 10000 ram 500\n";
        let check = |flash, ram| check_sizes(text, &[("board", Size { flash, ram })]);
        assert!(check(10_000, 500).is_ok() && check(10_100, 495).is_ok());
        let error = check(10_101, 500).unwrap_err().to_string();
        assert!(error.contains("to\nboard flash 10101 ram 500\n") && error.contains("--bless"), "{error}");
        assert!(check(10_000, 506).is_err() && check(10_000, 494).is_err());
        assert!(check_sizes("", &[("board", Size { flash: 1, ram: 1 })]).is_err());
    }

    #[test]
    fn the_committed_ceilings_are_within_the_goals() {
        let text = std::fs::read_to_string(Path::new("..").join(CEILINGS)).unwrap();
        let ceilings: Ceilings = toml::from_str(&text).unwrap();
        assert!(ceilings.parts[REFERENCE] <= 7_011 && ceilings.parts["tick"] <= 25_000);
        assert!(ceilings.flash_bytes <= 256 * 1024 && ceilings.ram_bytes <= 48 * 1024);
        // The RAM with the stack in use has the same limit in the tests in QEMU.
        assert!(ceilings.desk_flash_bytes <= 384 * 1024 && ceilings.desk_ram_bytes <= 96 * 1024);
    }

    #[test]
    fn this_computer_computes_the_pinned_bits() {
        check_bits(&Counted { parts: BTreeMap::new(), bits: [2_197_030_421, 65_935_474] }).unwrap();
    }
}
