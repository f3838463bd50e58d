//! The margins of a simulated device, measured from a page.

mod rig;

#[path = "rig/in_step.rs"]
mod in_step;

use bedside::server::{Options, Server};
use bedside::source::Watch;
use in_step::{Clock, in_step};
use plant::bench::BenchConfig;
use rig::Page;
use serde_json::{Value, json};
use shared::control::pid::PidGains;

fn serve(watch: Watch, steer: bool) -> Server {
    let listen = "127.0.0.1:0".parse().unwrap();
    Server::start(vec![watch], &Options { listen, steer, demo: true, folder: std::env::temp_dir() }).unwrap()
}

/// A bench whose device has an airway sensor alone.
fn bench() -> BenchConfig {
    let mut bench = BenchConfig::paper(20.0, 20.0);
    bench.flow_sensor.present = false;
    bench
}

/// A server with a device that breathes and has stopped its clock, and the page that steers it.
fn ventilating() -> (Server, Page, Clock) {
    let (watch, clock) = in_step(&bench(), GAINS);
    let server = serve(watch, true);
    let mut page = Page::steering(&server);
    page.ventilate(0);
    page.text(|message| message["type"] == "breath");
    clock.allow(0);
    (server, page, clock)
}

/// Gains whose margins on the bench are stated.
const GAINS: PidGains = PidGains { p: 4.0, i: 120.0, d: 0.1 };
/// Margins of the held bench at a PIP of 20 cmH2O: `cargo lab margins --bench R20C20 --gains 4,120,0.1`.
const EXACT: [(&str, f64); 3] = [("Ms", 1.78), ("gain margin", 2.51), ("delay margin", 36.4)];
/// Ticks of a breath.
const BREATH: u64 = 3000;

/// A request to measure.
fn request(frequencies: u8, breaths: u8) -> Value {
    let sines = json!({"amplitude": 10, "frequencies": frequencies, "breaths": breaths});
    json!({"type": "measure", "device": 0, "test_lung": true, "sines": sines})
}

#[test]
fn the_margins_of_a_device_are_those_of_its_bench_and_its_settings_come_back() {
    let (server, mut page, clock) = ventilating();
    let answer = page.ask(request(20, 6));
    assert_eq!(answer["ok"], true, "{answer}");
    clock.allow(30 * BREATH);
    let state = page.state(0, |state| state["measuring"]["breath"].as_u64() > Some(20));
    assert_eq!((&state["settings"]["rise_time"], &state["measuring"]["breaths"]), (&json!(1.0), &json!(126)));
    let refused = page.ask(json!({"type": "apply", "device": 0, "settings": {"pip": 30}}));
    assert!(
        refused["text"].as_str().unwrap().contains("a measurement of the margins is running"),
        "{refused}"
    );
    clock.run();
    let found = page.text(|message| message["type"] == "margins");
    assert_eq!(found["refused"], Value::Null, "{found}");
    for (row, (name, exact)) in found["margins"].as_array().unwrap().iter().zip(EXACT) {
        assert_eq!(row["name"], name);
        assert!((row["value"].as_f64().unwrap() / exact - 1.0).abs() < 0.05, "{row}, not {exact}");
    }
    let titles: Vec<&Value> =
        found["charts"].as_array().unwrap().iter().map(|chart| &chart["title"]).collect();
    assert_eq!(titles.len(), 5, "{titles:?}");
    page.state(0, |state| state["settings"]["rise_time"] == 0.0 && state["measuring"] == Value::Null);
    let later = Page::open(&server).text(|message| message["type"] == "margins");
    assert_eq!(later["margins"], found["margins"], "a page that opens later gets them, too");
}

#[test]
fn nothing_is_measured_without_a_test_lung_a_breath_or_the_right_to_steer() {
    let (watch, _) = in_step(&bench(), GAINS);
    let server = serve(watch, true);
    let mut viewer = Page::open(&server);
    let why = |answer: Value| {
        assert_eq!(answer["ok"], false, "{answer}");
        answer["text"].as_str().unwrap().to_owned()
    };
    assert!(why(viewer.ask(request(8, 5))).starts_with("read only"));
    let mut page = Page::steering(&server);
    assert!(why(page.ask(request(8, 5))).contains("take control"));
    page.send(&json!({"type": "take", "device": 0}));
    page.state(0, |state| state["settings"].is_object());
    assert!(why(page.ask(request(8, 5))).contains("does not ventilate"));
    page.ventilate(0);
    page.text(|message| message["type"] == "breath");
    let mut unconfirmed = request(8, 5);
    unconfirmed["test_lung"] = json!(false);
    assert!(why(page.ask(unconfirmed)).contains("test lung"));
    assert!(why(page.ask(request(8, 4))).contains("allowed are 5 to 24"));
    let mut strong = request(8, 5);
    strong["sines"]["amplitude"] = json!(30);
    assert!(why(page.ask(strong)).contains("allowed are 0.1 to 20"));
    let mut other = Page::steering(&server);
    assert!(why(other.ask(request(8, 5))).contains("steers this device"));
    assert_eq!(page.state(0, |_| true)["settings"]["rise_time"], 0.0, "nothing was changed");
}

#[test]
fn under_an_alarm_the_device_refuses_and_keeps_its_settings() {
    let (_server, mut page, clock) = ventilating();
    page.ask(json!({"type": "fault", "device": 0, "fault": "disconnect"}));
    clock.run();
    page.state(0, |state| state["alarms"].as_array().is_some_and(|alarms| !alarms.is_empty()));
    let refused = page.ask(request(8, 5));
    assert_eq!(refused["ok"], false, "{refused}");
    assert!(refused["text"].as_str().unwrap().contains("alarm"), "{refused}");
    assert_eq!(page.state(0, |_| true)["settings"]["rise_time"], 0.0, "nothing was changed");
}

#[test]
fn an_alarm_ends_a_measurement_and_is_named() {
    let (_server, mut page, clock) = ventilating();
    let begun = page.ask(request(8, 5));
    assert_eq!(begun["ok"], true, "{begun}");
    // Within the breaths of the first frequency.
    clock.allow(12 * BREATH);
    page.state(0, |state| state["measuring"]["breath"].as_u64() > Some(6));
    page.ask(json!({"type": "fault", "device": 0, "fault": "disconnect"}));
    clock.run();
    let ended = page.text(|message| message["type"] == "margins");
    assert!(ended["refused"].as_str().unwrap().starts_with("an alarm ended the measurement: "), "{ended}");
    page.state(0, |state| state["settings"]["rise_time"] == 0.0 && state["measuring"] == Value::Null);
}

#[test]
fn a_measurement_is_stopped_by_its_page_which_shows_what_was_measured() {
    let (_server, mut page, clock) = ventilating();
    assert_eq!(page.ask(request(40, 24))["ok"], true);
    clock.allow(40 * BREATH);
    page.state(0, |state| state["measuring"]["breath"].as_u64() > Some(6 + 24));
    assert_eq!(page.ask(json!({"type": "stop_measuring", "device": 0}))["ok"], true);
    clock.run();
    let stopped = page.text(|message| message["type"] == "margins");
    assert!(stopped["remarks"].to_string().contains("stopped: only the frequencies"), "{stopped}");
    page.state(0, |state| state["settings"]["rise_time"] == 0.0 && state["measuring"] == Value::Null);
}

#[test]
fn a_page_that_closes_or_is_taken_over_ends_its_measurement() {
    let (server, mut page, clock) = ventilating();
    assert_eq!(page.ask(request(40, 24))["ok"], true);
    page.state(0, |state| state["measuring"].is_object());
    let mut other = Page::steering(&server);
    other.send(&json!({"type": "take", "device": 0, "take_over": true}));
    // Too few for the whole measurement.
    clock.allow(8 * BREATH);
    other.state(0, |state| state["measuring"] == Value::Null && state["settings"]["rise_time"] == 0.0);
    other.state(0, |state| state["ventilating"] == true);
    let begun = other.ask(request(40, 24));
    assert_eq!(begun["ok"], true, "{begun}");
    other.state(0, |state| state["measuring"].is_object());
    // Its first state is that of now.
    let mut viewer = Page::open(&server);
    viewer.state(0, |state| state["measuring"].is_object());
    clock.allow(20 * BREATH);
    drop(other);
    viewer.state(0, |state| state["measuring"] == Value::Null && state["settings"]["rise_time"] == 0.0);
}
