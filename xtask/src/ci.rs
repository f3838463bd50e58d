//! `cargo xtask ci`: all checks that a change must pass, as a table of commands in two lanes.
//!
//! The lanes run in parallel, because a single one leaves a core idle while it waits for a linker, a download, or a board in
//! lockstep with its plant. After a failure no further step starts, and the program prints the command that repeats the step.

use std::io::{self, Read, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::sync::{Condvar, Mutex, PoisonError};
use std::time::{Duration, Instant};

use anyhow::{Context, Result, bail};
use clap::builder::PossibleValuesParser;
use xshell::Shell;

use crate::papers::results;

/// One check.
struct Step {
    name: &'static str,
    /// A step of the other lane that must pass first, since it builds files that this step uses.
    after: Option<&'static str>,
    environment: Option<(&'static str, &'static str)>,
    /// Parts of the command line after `cargo`, joined by spaces.
    cargo: &'static [&'static str],
}

/// Checks of the host's code. Cheap checks come first, so that simple mistakes are reported early.
const HOST: &[Step] = &[
    step("format", &["fmt --all --check"]),
    step("clippy", &["clippy --all-targets --test engines --features tests/board", DENY_WARNINGS]),
    // After clippy, since it needs the same dependencies.
    Step {
        environment: Some(("RUSTDOCFLAGS", "-D warnings")),
        ..step("doc", &["doc --no-deps --document-private-items"])
    },
    step("build", &["test --no-run --workspace --exclude firmware"]),
    step("test", &["test --workspace --exclude firmware"]),
    // With the whole workspace, so that nothing is built again.
    step("engines", &["test --workspace --exclude firmware --test engines"]).after("setup"),
    // On the lane that ends first. It needs the firmware's images, and what the set-up before them installs.
    step("web", &["xtask web"]).after("firmware"),
    // At the end, with the results of all other steps.
    step("papers", &["xtask papers"]).after("cost"),
];

/// Checks of the chip's code, then steps that use the trainer, which the other lane builds, and the tests in QEMU.
const CHIP: &[Step] = &[
    step("setup", &["xtask setup"]),
    step("clippy-board", &[CHIP_CLIPPY, "-p firmware --features stm32f405", DENY_WARNINGS]),
    step("clippy-hil", &[CHIP_CLIPPY, "-p firmware --features stm32f405,hil,cost", DENY_WARNINGS]),
    step("clippy-desk", &[CHIP_CLIPPY, "-p firmware --features stm32f405,desk", DENY_WARNINGS]),
    step("clippy-f446", &[CHIP_CLIPPY, "-p firmware --features stm32f446,desk", DENY_WARNINGS]),
    step("clippy-shim", &[CHIP_CLIPPY, "-p shim", DENY_WARNINGS]),
    step("firmware", &["xtask firmware"]),
    // The test step runs these tests in debug; here the chip's optimisation must give the same bits.
    step("golden", &[OPTIMISED_TEST, "golden -- golden"]),
    step("frames", &[OPTIMISED_TEST, "fuzz -- no_damaged_frame"]),
    // After the build, whose crates it uses.
    step("package", &["xtask package"]).after("build"),
    step("python", &["xtask python"]).after("build"),
    step("faults", &["xtask faults"]).after("build"),
    step("monitors", &["xtask mutate-monitors"]).after("build"),
    step("qemu-test", &["xtask qemu-test"]).after("build"),
    // After the tests in QEMU, whose golden test leaves figures that this step would else run it for.
    step("cost", &["xtask cost"]),
];

const LANES: [&[Step]; 2] = [HOST, CHIP];

/// Lints a package for the chip.
const CHIP_CLIPPY: &str =
    "clippy --profile chip --target thumbv7em-none-eabihf --no-default-features --bins --examples";
const DENY_WARNINGS: &str = "-- -D warnings";
/// Runs a test of the core with the chip's optimisation, without the host side's crates.
const OPTIMISED_TEST: &str = "test --profile chip -p tests --no-default-features --test";

const fn step(name: &'static str, cargo: &'static [&'static str]) -> Step {
    Step { name, after: None, environment: None, cargo }
}

impl Step {
    const fn after(self, step: &'static str) -> Self {
        Self { after: Some(step), ..self }
    }

    /// The command as a user would type it.
    fn command_line(&self) -> String {
        let environment =
            self.environment.map(|(name, value)| format!("{name}='{value}' ")).unwrap_or_default();
        format!("{environment}cargo {}", self.cargo.join(" "))
    }

    /// The command to run. `cargo xtask` runs this program directly: cargo would wait for the other lane's build, only to find
    /// nothing to do.
    fn command(&self, root: &Path, xtask: &Path) -> Command {
        let words: Vec<_> = self.cargo.iter().flat_map(|part| part.split(' ')).collect();
        let (program, arguments) = match &words[..] {
            ["xtask", arguments @ ..] => (xtask, arguments),
            arguments => (Path::new("cargo"), arguments),
        };
        let mut command = Command::new(program);
        command.args(arguments).current_dir(root).envs(self.environment);
        command
    }
}

/// Arguments of `cargo xtask ci`.
#[derive(clap::Args)]
pub struct Arguments {
    /// Run only these steps
    #[arg(long, value_name = "STEP", value_parser = PossibleValuesParser::new(names()))]
    only: Vec<String>,
}

fn names() -> impl Iterator<Item = &'static str> {
    LANES.into_iter().flatten().map(|step| step.name)
}

/// Runs all steps or the selected ones, each lane in the table's order.
pub fn run(shell: &Shell, arguments: &Arguments) -> Result<()> {
    let xtask = std::env::current_exe().context("cannot find the path of this program")?;
    let root = shell.current_dir();
    let only = &arguments.only;
    let chosen = |name: &str| only.is_empty() || only.iter().any(|only| only == name);
    let results = Some((results::folder(shell), results::revision(shell)));
    let progress = Progress { results, ..Progress::default() };
    let begun = Instant::now();
    let alone = HOST.iter().all(|step| !chosen(step.name));
    let show_chip: fn(Command) -> io::Result<bool> = if alone { run_in_sight } else { run_aside };
    let [host, chip] = LANES.map(|lane| lane.iter().filter(|step| chosen(step.name)));
    std::thread::scope(|scope| {
        scope.spawn(|| progress.follow(host, &chosen, |step| run_in_sight(step.command(&root, &xtask))));
        scope.spawn(|| progress.follow(chip, &chosen, |step| show_chip(step.command(&root, &xtask))));
    });
    let State { passed, failed } = progress.state.into_inner().unwrap_or_else(PoisonError::into_inner);
    print!("{}", summary(&passed, begun.elapsed().as_secs_f64()));
    if let Some(step) = failed {
        bail!("step `{}` failed; repeat it with: {}", step.name, step.command_line());
    }
    println!("all {} steps passed", passed.len());
    Ok(())
}

/// Runs a command and shows its output as it arrives; returns whether it succeeded.
fn run_in_sight(mut command: Command) -> io::Result<bool> {
    Ok(command.status()?.success())
}

/// Runs a command and shows its output at the end, so that the other lane's output does not interleave.
fn run_aside(mut command: Command) -> io::Result<bool> {
    let (mut output, input) = io::pipe()?;
    let mut child = command.stdin(Stdio::null()).stdout(input.try_clone()?).stderr(input).spawn()?;
    // The command holds an open copy of the pipe's writing end.
    drop(command);
    let mut text = Vec::new();
    output.read_to_end(&mut text)?;
    io::stdout().write_all(&text)?;
    Ok(child.wait()?.success())
}

/// Progress of both lanes.
#[derive(Default)]
struct Progress {
    /// Folder of the steps' results for the papers, and the revision; none in tests.
    results: Option<(PathBuf, String)>,
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    passed: Vec<(&'static str, Cost)>,
    /// The first step that failed.
    failed: Option<&'static Step>,
}

impl Progress {
    /// Runs steps in order until one fails in either lane.
    fn follow(
        &self,
        steps: impl Iterator<Item = &'static Step>,
        chosen: &impl Fn(&str) -> bool,
        run: impl Fn(&Step) -> io::Result<bool>,
    ) {
        for step in steps {
            if !self.may_start(step, chosen) {
                return;
            }
            println!("\n=== {}: {}", step.name, step.command_line());
            let begun = Instant::now();
            let result = run(step);
            if let Err(error) = &result {
                println!("{}: {error}", step.name);
            }
            self.finish(step, begun.elapsed(), children_s(), matches!(result, Ok(true)));
        }
    }

    /// Waits for the step of the other lane that this one needs; false if a step has failed.
    fn may_start(&self, step: &Step, chosen: &impl Fn(&str) -> bool) -> bool {
        let waits = |state: &mut State| {
            let needed = step.after.filter(|needed| chosen(needed));
            state.failed.is_none()
                && needed.is_some_and(|needed| state.passed.iter().all(|(name, _)| *name != needed))
        };
        let state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        self.changed.wait_while(state, waits).unwrap_or_else(PoisonError::into_inner).failed.is_none()
    }

    /// Notes the end of a step; `children` is the processor time of all steps that have ended, s.
    fn finish(&self, step: &'static Step, wall: Duration, children: f64, passed: bool) {
        let mut state = self.state.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some((folder, revision)) = &self.results
            && let Err(error) = results::note_step(folder, step.name, revision, passed)
        {
            println!("{}: its result is not kept for the papers: {error:#}", step.name);
        }
        if passed {
            let processor = children - state.passed.iter().map(|(_, cost)| cost.processor_s).sum::<f64>();
            state.passed.push((step.name, Cost { wall_s: wall.as_secs_f64(), processor_s: processor }));
        } else {
            state.failed.get_or_insert(step);
        }
        self.changed.notify_all();
    }
}

/// What a step has cost, s.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Cost {
    wall_s: f64,
    /// Over all cores.
    processor_s: f64,
}

/// Processor time of all child processes that have ended, s: what a step costs a machine, however busy it is. 0 where the system does
/// not count it.
fn children_s() -> f64 {
    /// Ticks per second of the times in this file, on every Linux.
    const TICKS: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    // The name of the program, in brackets, may contain blanks. `cutime` and `cstime` are the fields 16 and 17 of the line.
    let after_name = stat.rsplit(") ").next().unwrap_or_default();
    let ticks = after_name.split(' ').skip(13).take(2).filter_map(|ticks| ticks.parse::<f64>().ok());
    ticks.sum::<f64>() / TICKS
}

/// One line per passed step, and the sums.
fn summary(costs: &[(&str, Cost)], wall_s: f64) -> String {
    let processor_s = costs.iter().map(|(_, cost)| cost.processor_s).sum();
    let line = |(name, cost): &(&str, Cost)| {
        format!("{name:<12} {:>7.1} s {:>7.1} s of processors\n", cost.wall_s, cost.processor_s)
    };
    let lines: String = costs.iter().chain([&("total", Cost { wall_s, processor_s })]).map(line).collect();
    format!("\n=== summary, lanes in parallel\n{lines}")
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::cell::RefCell;

    #[test]
    fn a_step_can_be_repeated_from_its_command_line() {
        let doc = LANES.into_iter().flatten().find(|step| step.name == "doc").unwrap();
        assert_eq!(
            doc.command_line(),
            "RUSTDOCFLAGS='-D warnings' cargo doc --no-deps --document-private-items"
        );
    }

    #[test]
    fn the_summary_names_each_step_with_its_cost_and_the_sums() {
        let cost = |wall_s, processor_s| Cost { wall_s, processor_s };
        let text = summary(&[("format", cost(1.5, 1.0)), ("test", cost(62.0, 100.0))], 62.0);
        let lines = [
            "format           1.5 s     1.0 s of processors\n",
            "test            62.0 s   100.0 s of processors\n",
            "total           62.0 s   101.0 s of processors\n",
        ];
        assert_eq!(text, format!("\n=== summary, lanes in parallel\n{}", lines.concat()));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn the_processor_time_of_a_child_is_counted() {
        let before = children_s();
        let busy =
            Command::new("sh").args(["-c", "i=0; while [ $i -lt 200000 ]; do i=$((i+1)); done"]).status();
        assert!(busy.unwrap().success() && children_s() > before);
    }

    #[test]
    fn no_two_steps_share_a_name() {
        let mut different: Vec<_> = names().collect();
        different.sort_unstable();
        different.dedup();
        assert_eq!(different.len(), names().count());
    }

    #[test]
    fn a_step_waits_for_one_that_the_other_lane_runs() {
        for [lane, other] in [[HOST, CHIP], [CHIP, HOST]] {
            for needed in lane.iter().filter_map(|step| step.after) {
                assert!(other.iter().any(|step| step.name == needed), "{needed}");
            }
        }
    }

    /// Two lanes; the second has to wait for the first.
    const FIRST: &[Step] = &[step("a", &[]), step("b", &[])];
    const SECOND: &[Step] = &[step("c", &[]).after("b"), step("d", &[])];

    #[test]
    fn nothing_starts_before_what_it_needs() {
        let (progress, order) = (Progress::default(), Mutex::new(Vec::new()));
        std::thread::scope(|scope| {
            for lane in [SECOND, FIRST] {
                scope.spawn(|| {
                    progress.follow(lane.iter(), &|_| true, |step| {
                        order.lock().unwrap().push(step.name);
                        Ok(true)
                    });
                });
            }
        });
        assert_eq!(order.into_inner().unwrap(), ["a", "b", "c", "d"]);
    }

    #[test]
    fn after_a_failure_nothing_starts() {
        let (progress, order) = (Progress::default(), RefCell::new(Vec::new()));
        let run = |step: &Step| {
            order.borrow_mut().push(step.name);
            Ok(step.name != "a")
        };
        progress.follow(FIRST.iter(), &|_| true, run);
        progress.follow(SECOND.iter(), &|_| true, run);
        assert_eq!(order.into_inner(), ["a"]);
        assert_eq!(progress.state.into_inner().unwrap().failed.map(|step| step.name), Some("a"));
    }

    #[test]
    fn steps_that_are_not_selected_are_not_waited_for() {
        let progress = Progress::default();
        progress.follow(SECOND.iter(), &|name| name != "b", |_| Ok(true));
        assert_eq!(progress.state.into_inner().unwrap().passed.len(), 2);
    }
}
