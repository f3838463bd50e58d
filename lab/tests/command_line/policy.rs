//! Third-party policies: the Python example over TCP and over a pipe, and policies that fail.
//!
//! These tests need `python3` and nothing else; without it they print so and end.

use super::python::{Server, example, json, ok, python_is_there, refused, run};
use super::support::{Place, text};

/// The example's line that answers an observation.
const OBSERVES: &str = "        elif kind == OBSERVE:\n";
/// The example's line that computes the command.
const WANTS: &str = "wanted = self.p * error + self.integral";
/// The frames before the second breath: Hello, Reset, Start, 1000 observations, Learn.
const FIRST_BREATH: u32 = 1 + 1 + 1 + 1000 + 1;

/// A folder with the example in it, in which a line is replaced.
fn with_policy(from: &str, to: &str) -> Place {
    let place = Place::new();
    let source = std::fs::read_to_string(example("policy.py")).unwrap();
    assert!(source.contains(from), "{from}");
    std::fs::write(place.path("policy.py"), source.replace(from, to)).unwrap();
    place
}

/// A command line with the policy on a pipe, with few breaths.
fn with_pipe(command: &str) -> String {
    format!("{command} --policy pipe:python3\u{a0}policy.py --pips 20 --breaths 2")
}

/// The JSON without what depends on the machine.
fn without_times(mut summary: serde_json::Value) -> serde_json::Value {
    let policy = summary["policy"].as_object_mut().unwrap();
    for time in ["answer_median_us", "answer_p99_us"] {
        assert!(policy.remove(time).unwrap().as_f64().unwrap() > 0.0);
    }
    summary
}

#[test]
fn the_example_needs_the_standard_library_alone_unless_it_runs_a_network_and_fits_on_a_page() {
    let source = std::fs::read_to_string(example("policy.py")).unwrap();
    assert!(source.lines().count() <= 150, "{} lines", source.lines().count());
    let at_the_top: Vec<&str> = source.lines().filter(|line| line.starts_with("import ")).collect();
    assert_eq!(at_the_top, ["import argparse, math, socket, struct, sys, zlib"]);
}

#[test]
fn a_policy_in_python_scores_alike_over_tcp_and_over_a_pipe() {
    if !python_is_there() {
        return;
    }
    let place = with_policy("", "");
    let server = Server::start(&example("policy.py"), &["--port", "0"]);
    let tcp = format!("evaluate --policy {} --pips 20 --breaths 2", server.address());
    let first = without_times(json(&place, &tcp));
    assert_eq!(without_times(json(&place, &tcp)), first, "the server takes one connection after the other");
    let piped = without_times(json(&place, &with_pipe("evaluate")));
    assert_eq!((&piped["mean"], &piped["policy"]), (&first["mean"], &first["policy"]));
    let policy = &piped["policy"];
    assert_eq!((&policy["commanded"], &policy["failure"]), (&policy["ticks"], &serde_json::Value::Null));
    let score = |of: &str| piped["mean"][of]["score"].as_f64().unwrap();
    assert!(
        score("learned") < score("pid"),
        "the example's integral is stronger than that of the PID underneath"
    );
    let better = json(&place, &with_pipe("evaluate --gains 6.5,265,0.13"));
    assert!(
        better["mean"]["pid"]["score"].as_f64().unwrap() < score("learned"),
        "--gains set the PID underneath"
    );
}

#[test]
fn a_policy_that_fails_leaves_a_result_that_names_the_failure() {
    if !python_is_there() {
        return;
    }
    let from = FIRST_BREATH + 1 + 210;
    let fails = |how: &str| format!("        elif number > {from}:\n            {how}\n{OBSERVES}");
    for (how, told) in [
        ("sys.exit(3)", "closed the line (exit status: 3)"),
        ("__import__('time').sleep(60)", "0 of 32 bytes arrived in 1 s"),
        ("writer.write(bytes(32)); writer.flush()", "not a frame (00 00"),
    ] {
        let place = with_policy(OBSERVES, &fails(how));
        let line = with_pipe("evaluate --policy-timeout 1 --seed 2");
        let output = run(&place, &line);
        let shown = text(&output.stdout);
        assert!(output.status.success(), "{how}: {}", text(&output.stderr));
        assert!(shown.contains("the policy failed in ventilation 1, breath 1, tick 210: "), "{how}: {shown}");
        assert!(shown.contains(told) && shown.contains("the PID commanded from there on"), "{how}: {shown}");
        let summary = json(&place, &line);
        let policy = &summary["policy"];
        assert_eq!((&policy["failure"]["tick"], &policy["runs"]), (&210.into(), &5.into()));
        assert_eq!((&policy["ticks"], summary["waveforms"].as_array().unwrap().len()), (&15_000.into(), 1));
        assert!(policy["pid"].as_u64().unwrap() > 13_000, "{policy}");
    }
}

#[test]
fn a_policy_that_never_commands_is_refused_after_the_scores() {
    if !python_is_there() {
        return;
    }
    let place = with_policy(WANTS, "wanted = math.nan");
    let line = with_pipe("evaluate");
    let output = run(&place, &line);
    assert_eq!(output.status.code(), Some(1));
    assert!(text(&output.stdout).contains("15000 commands (100.0 %) were not usable"));
    let told = text(&output.stderr);
    assert!(told.contains("commanded no tick") && told.contains("a command of NaN percent"), "{told}");
}

#[test]
fn a_policy_that_opens_the_valve_for_good_is_contained_and_scored() {
    if !python_is_there() {
        return;
    }
    let place = with_policy(WANTS, "return 100.0");
    let summary = json(&place, &with_pipe("evaluate"));
    let (policy, score) = (&summary["policy"], &summary["mean"]["learned"]);
    assert!(
        policy["pid"].as_u64().unwrap() >= 5000,
        "one breath in three, under each of five seeds: {policy}"
    );
    assert!(score["cut"].as_f64().unwrap() > 0.0 && score["score"].as_f64().unwrap() > 2.0, "{score}");
    let shown = text(&run(&place, &with_pipe("evaluate --report report.html")).stdout);
    assert!(
        shown.contains("policy: the pressure limit ended") && place.path("report.html").exists(),
        "{shown}"
    );
}

#[test]
fn a_policy_runs_on_many_plants_one_after_the_other() {
    if !python_is_there() {
        return;
    }
    let place = with_policy("", "");
    let line = "robust --plants 4 --subset 0 --breaths 2 --policy pipe:python3\u{a0}policy.py";
    let shown = text(&run(&place, line).stdout);
    assert!(shown.contains("the policy commanded 100.0 % of"), "{shown}");
    assert_eq!(json(&place, line), json(&place, line));
}

#[test]
fn kept_results_of_a_policy_are_continued_only_under_its_name_and_with_the_same_pid() {
    if !python_is_there() {
        return;
    }
    let place = with_policy("", "");
    place.write_short_family();
    let policy = "--family short.toml --plants 2 --subset 0 --breaths 1 --policy pipe:python3\u{a0}policy.py";
    let line = |kept: &str| format!("robust {policy} {kept}");
    for kept in ["--keep kept.json", "--shard 0/2 --out out", "--merge --out out"] {
        let told = refused(&place, &line(kept));
        assert!(told.contains("add --policy-id NAME"), "{kept}: {told}");
    }
    let first = json(&place, &line("--keep kept.json --policy-id one"));
    assert_eq!(json(&place, &line("--keep kept.json --policy-id one")), first);
    for shard in ["0/2", "1/2"] {
        ok(&place, &line(&format!("--shard {shard} --out out --policy-id one")));
    }
    assert_eq!(json(&place, &line("--merge --out out --policy-id one")), first);
    for kept in ["--keep kept.json", "--shard 0/2 --out out", "--merge --out out"] {
        for (other, here) in
            [("two", "policy two over 3,30,0"), ("one --gains 2,80,0", "policy one over 2,80,0")]
        {
            let told = refused(&place, &line(&format!("{kept} --policy-id {other}")));
            assert!(told.contains("policy one over 3,30,0") && told.contains(here), "{kept}: {told}");
        }
    }
}

#[test]
fn the_plants_after_a_policys_failure_are_not_kept() {
    if !python_is_there() {
        return;
    }
    // Hello, Reset, Start and the 200 observations of the first plant: the policy ends within the second one.
    let fails = format!("        elif number > 300:\n            sys.exit(3)\n{OBSERVES}");
    let place = with_policy(OBSERVES, &fails);
    place.write_short_family();
    let line = "robust --family short.toml --plants 3 --subset 0 --breaths 1 --keep kept.json --policy-id one \
                --policy pipe:python3\u{a0}policy.py";
    let told = refused(&place, line);
    assert!(
        told.contains("plant 1 does not count: the policy failed") && told.contains("repeat the command"),
        "{told}"
    );
    std::fs::copy(example("policy.py"), place.path("policy.py")).unwrap();
    let shown = text(&run(&place, line).stdout);
    assert!(shown.contains("of 400 ticks"), "the first plant was kept: {shown}");
    let continued = json(&place, line);
    std::fs::remove_file(place.path("kept.json")).unwrap();
    assert_eq!(json(&place, line)["mean"], continued["mean"]);
}

#[test]
fn another_period_than_the_policys_is_refused() {
    if !python_is_there() {
        return;
    }
    let place = with_policy("period_us = 0  # any", "period_us = 5000");
    let told = refused(&place, &with_pipe("evaluate --period-us 1000"));
    assert!(told.contains("is 5000 us, not 1000"), "{told}");
    assert_eq!(json(&place, &with_pipe("evaluate"))["period_us"], 5000);
    std::fs::copy(example("plant.py"), place.path("plant.py")).unwrap();
    let told = refused(&place, &with_pipe("evaluate --plant pipe:python3\u{a0}plant.py"));
    assert!(told.contains("is 5000 us, but the plant's is 30000 us"), "{told}");
}

#[test]
fn a_policy_in_python_controls_a_plant_in_python() {
    if !python_is_there() {
        return;
    }
    let place = with_policy("\"3,60\"", "\"2,30\"");
    std::fs::copy(example("plant.py"), place.path("plant.py")).unwrap();
    let summary = json(&place, &with_pipe("evaluate --plant pipe:python3\u{a0}plant.py"));
    assert_eq!(
        (&summary["period_us"], &summary["policy"]["failure"]),
        (&30_000.into(), &serde_json::Value::Null)
    );
    assert!(summary["mean"]["learned"]["score"].as_f64().unwrap() < 6.0, "{summary}");
}

#[test]
fn a_policy_runs_on_the_host_only() {
    if !python_is_there() {
        return;
    }
    let told = refused(&with_policy("", ""), &with_pipe("evaluate --port tcp:localhost:5555"));
    assert!(told.contains("runs on the host only"), "{told}");
}

#[test]
fn a_policy_takes_the_place_of_a_controller() {
    let place = Place::new();
    for line in [
        "evaluate --policy tcp:localhost:7100 --controller adult",
        "evaluate --policy tcp:localhost:7100 --breathing",
        "evaluate --policy-timeout 5",
        "evaluate --policy localhost:7100",
        "evaluate --policy tcp:localhost:7100 --policy-timeout 0",
        "robust --policy tcp:localhost:7100 --controller weights.bin",
        "robust --policy-id one",
    ] {
        assert_eq!(place.run(line).status.code(), Some(2), "{line}");
    }
}
