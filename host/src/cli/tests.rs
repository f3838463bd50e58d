//! Tests of the list of commands, and of commands that another program calls.

use std::ffi::OsString;
use std::path::Path;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use campaign::record::{Ending, MADE_BY, Record};
use clap::CommandFactory;
use serde_json::Value;

use super::*;
use crate::command::call::{CallError, call, help, options};
use crate::command::{Makes, Observer};
use progress::Event;

#[test]
fn the_arguments_of_all_commands_are_consistent() {
    Cli::command().debug_assert();
}

#[test]
fn a_command_says_what_it_makes() {
    let folder = |path| Makes::Folder(Path::new(path));
    for (line, makes) in [
        ("demo", folder("out/demo")),
        ("demo --out a --json b.json", folder("a")),
        ("farm --virtual 2", folder("out/farm")),
        ("train --out a", folder("a")),
        ("train-family --out a", folder("a")),
        ("commission --out a", folder("a")),
        ("tune-pid", Makes::Experiment),
        ("tune-pid --shard 1/2 --out a", Makes::Shard),
        ("evaluate", Makes::Experiment),
        ("fit a", Makes::Experiment),
        ("collect --out a.parquet --json b.json", Makes::Nothing),
        ("inspect a.bin --json b.json", Makes::Nothing),
    ] {
        let cli = Cli::try_parse_from(format!("trainer {line}").split(' ')).unwrap();
        assert_eq!(cli.chosen().output().makes, makes, "{line}");
    }
}

fn called_with(line: &str, stop: &AtomicBool, observer: &Observer<'_>) -> Result<Value, CallError> {
    let arguments: Vec<OsString> = line.split(' ').map(OsString::from).collect();
    Ok(serde_json::from_str(&call::<Cli>(&arguments, observer, stop)?).expect("the result is JSON"))
}

fn called(line: &str) -> Result<Value, CallError> {
    called_with(line, &AtomicBool::new(false), &|_| ())
}

#[test]
fn a_command_returns_its_json() {
    let result = called("evaluate --gains 2,30 --pips 20 --breaths 1").unwrap();
    assert_eq!((&result["seed"], &result["lung"]), (&Value::from(1), &Value::from("R20C20")));
    assert!(result["mean"]["pid"]["score"].as_f64().is_some_and(|score| score > 0.5), "{result:#}");
}

#[test]
fn wrong_arguments_and_failures_are_told_apart() {
    for line in ["evaluate --gain 1", "nonsense", "evaluate --gains much"] {
        let error = called(line).unwrap_err();
        assert!(matches!(&error, CallError::Usage(text) if !text.contains("Usage")), "{error}");
    }
    let error = called("evaluate --controller /nowhere.bin").unwrap_err();
    assert!(matches!(error, CallError::Failed(_)), "{error}");
}

#[test]
fn commands_run_side_by_side_and_one_stops_without_the_other() {
    let folder = tempfile::tempdir().unwrap();
    let (stop, go_on) = (AtomicBool::new(false), AtomicBool::new(false));
    let other = "evaluate --gains 3,30 --pips 20 --breaths 1";
    let alone = called(other).unwrap();
    let line = format!("collect --breaths 3000 --out {}", folder.path().join("a.parquet").display());
    let begun = AtomicBool::new(false);
    let (line, stop, begun) = (&line, &stop, &begun);
    thread::scope(|scope| {
        let begins = move |event: &Event<'_>| begun.store(event.done > 2, Ordering::SeqCst);
        let stopped = scope.spawn(move || called_with(line, stop, &begins));
        while !begun.load(Ordering::SeqCst) && !stopped.is_finished() {
            thread::yield_now();
        }
        let beside = called_with(other, &go_on, &|_| ()).unwrap();
        stop.store(true, Ordering::SeqCst);
        let again = called_with(other, &go_on, &|_| ()).unwrap();
        let stopped = stopped.join().unwrap().unwrap();
        assert_eq!((&beside, &again), (&alone, &alone));
        assert_eq!(stopped["complete"], false, "{stopped}");
        let breaths = stopped["breaths"].as_u64().unwrap();
        assert!(breaths > 2 && breaths < 3000, "{stopped}");
    });
    let complete = called_with(&(line.replace("3000", "3") + " --force"), &go_on, &|_| ()).unwrap();
    assert_eq!((&complete["breaths"], &complete["complete"]), (&3.into(), &true.into()));
}

#[test]
fn commands_side_by_side_keep_their_own_records() {
    let folder = tempfile::tempdir().unwrap();
    let evaluate = |seed: u64| {
        let json = folder.path().join(format!("{seed}.json"));
        called(&format!("evaluate --pips 20 --breaths 1 --seed {seed} --json {}", json.display())).unwrap();
        Record::load(&json.with_extension(MADE_BY)).unwrap().unwrap()
    };
    let records = thread::scope(|scope| {
        [1, 2].map(|seed| scope.spawn(move || evaluate(seed))).map(|run| run.join().unwrap())
    });
    let seeds = records.each_ref().map(|record| record.options["seed"].as_str());
    assert_eq!(seeds, ["1", "2"]);
    assert!(records.iter().all(|record| record.ending == Ending::Complete));
    assert_ne!(records[0].results, records[1].results);
}

#[test]
fn a_verdict_with_a_status_of_its_own_is_an_outcome_and_another_one_an_error() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("a.parquet");
    let file = file.display();
    called(&format!("collect --breaths 6 --out {file}")).unwrap();
    let verdict = called(&format!("judge {file} --overshoot 0")).unwrap();
    assert_eq!(verdict["pass"], false);
    let limits = "--gains 10,400 --aborts 0 --settings pressure_limit=36 --pips 35 --pip-range 34:35";
    let refused = called(&format!("collect --breaths 6 {limits} --out {file} --force"));
    assert!(matches!(&refused, Err(CallError::Failed(_))), "{refused:?}");
}

#[test]
fn settings_are_named_values() {
    let scored = |settings: &str| called(&format!("evaluate --pips 20 --breaths 1{settings}"));
    let (usual, other) = (scored("").unwrap(), scored(" --settings peep=8,rate=15").unwrap());
    assert_eq!(usual["lung"], other["lung"]);
    assert_ne!(usual["mean"]["pid"]["score"], other["mean"]["pid"]["score"]);
    let unknown = scored(" --settings peeep=8").unwrap_err();
    assert!(matches!(&unknown, CallError::Usage(text) if text.contains("choose from peep")), "{unknown}");
}

#[test]
fn help_and_options_are_those_of_the_command_line() {
    assert!(help::<Cli>("evaluate").unwrap().contains("--breaths-of-learning"));
    assert!(help::<Cli>("nonsense").is_none() && options::<Cli>("nonsense").is_none());
    let repeated = |command: &str, option: &str| options::<Cli>(command).unwrap().get(option).copied();
    assert_eq!(repeated("evaluate", "breaths-of-learning"), Some(false));
    assert_eq!(repeated("fit", "hold-out-lung"), Some(true));
    assert_eq!((repeated("evaluate", "pips"), repeated("evaluate", "gains")), (Some(false), Some(false)));
    assert_eq!(repeated("evaluate", "gain"), None);
}

#[test]
fn every_command_reads_its_arguments_as_they_are_declared() {
    for line in [
        "demo",
        "collect --out a",
        "tune-pid",
        "fit a",
        "train --out a",
        "train-family --out a",
        "commission --out a",
        "farm --virtual 2",
        "evaluate",
        "judge a",
        "import a --out b",
        "export a --out b.bin",
        "inspect a",
        "identify a",
        "selftest --port a",
        "flash a --port b",
        "keys --out a",
        "monitor --port a",
        "serve --demo",
        "blackbox --port a",
        "completions bash",
    ] {
        let read = Cli::try_parse_from(format!("trainer {line}").split(' '));
        assert!(read.is_ok(), "{line}: {}", read.unwrap_err());
    }
}
