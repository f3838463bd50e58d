//! Third-party devices: the Python example at a pseudo-terminal, and what became of it after each of many mistakes.
//!
//! These tests need `python3` and nothing else; without it they print so and end.

use std::io::{BufRead, BufReader, Read, Write};
use std::net::TcpStream;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

use data::recording::Recording;
use device::DeviceError;
use shared::calibration::Calibration;
use shared::control::pid::PidGains;
use shared::link::messages::{ControllerChoice, Request};
use shared::link::self_test::Check;
use shared::recorder::RecorderPart;
use shared::settings::Settings;

use super::python::{example, python_is_there};
use super::support::{Place, text};

/// Short breaths.
const SHORT: &str = "--settings rate=60,inspiratory_time=0.4,fall_time=0.2";
/// Time within which every command must have given up, whatever the device does: 20 s without samples, and 1 s for the rest.
const LONG: Duration = Duration::from_mins(1);

/// The example with changes, each of which its source must contain once. Ends when dropped.
struct Board {
    process: Child,
    port: String,
}

impl Board {
    fn start(place: &Place, changes: &[(&str, &str)]) -> Self {
        let mut source = std::fs::read_to_string(example("device.py")).unwrap();
        for (from, to) in changes {
            assert_eq!(source.matches(from).count(), 1, "{from}");
            source = source.replace(from, to);
        }
        let script = place.path("device.py");
        std::fs::write(&script, source).unwrap();
        let mut process = Command::new("python3").arg(script).stderr(Stdio::piped()).spawn().unwrap();
        let mut said = BufReader::new(process.stderr.take().unwrap());
        let mut line = String::new();
        said.read_line(&mut line).unwrap();
        let port = line.trim().rsplit(' ').next().unwrap().to_owned();
        // Read on: a full pipe would stop it.
        std::thread::spawn(move || said.read_to_end(&mut Vec::new()));
        Self { process, port }
    }

    /// A connection to it.
    fn connected(&self) -> device::Device {
        device::Device::connect(&self.port.parse().unwrap()).unwrap()
    }
}

impl Drop for Board {
    fn drop(&mut self) {
        let _ = self.process.kill();
        self.process.wait().unwrap();
    }
}

/// Runs a command that must end in time; returns its exit code and what it wrote to standard error.
fn said(place: &Place, line: &str) -> (Option<i32>, String) {
    let started = Instant::now();
    let output = place.run(line);
    assert!(started.elapsed() < LONG, "{line} took {:?}", started.elapsed());
    let stderr = text(&output.stderr);
    assert!(!stderr.contains("panicked"), "{line}: {stderr}");
    (output.status.code(), stderr)
}

/// Lets a command run for a while, then presses Ctrl-C.
fn watched(place: &Place, line: &str, seconds: u64) -> (String, String) {
    let mut command = place.command(line);
    let child = command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    std::thread::sleep(Duration::from_secs(seconds));
    let Output { stdout, stderr, .. } = interrupted(child);
    (text(&stdout), text(&stderr))
}

/// Presses Ctrl-C, which must end a command.
fn interrupted(child: Child) -> Output {
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130), "{}", text(&output.stderr));
    output
}

#[test]
fn the_example_needs_the_standard_library_alone_and_is_short() {
    let source = std::fs::read_to_string(example("device.py")).unwrap();
    assert!(source.lines().count() <= 155, "{} lines", source.lines().count());
    let imports: Vec<&str> = source.lines().filter(|line| line.contains("import ")).collect();
    let optional = "        import serial";
    assert_eq!(
        imports,
        ["import os, struct, sys, time, tty, zlib", "from contextlib import suppress", optional]
    );
}

#[test]
fn a_device_in_python_is_identified_recorded_judged_and_scored() {
    if !python_is_there() {
        return;
    }
    let place = Place::new();
    let board = Board::start(&place, &[]);
    let port = &board.port;
    let identity = place.json(&format!("identify --port {port}"));
    assert_eq!(identity["identity"]["device"], "ThirdParty");
    let state = place.json(&format!("monitor --port {port} --once"));
    assert_eq!((&state["settings"]["pip"], &state["alarms"]["level"]), (&20.0.into(), &"Pid".into()));
    for unknown in ["audio", "lease", "ticks"] {
        assert!(state[unknown].is_null(), "{state}");
    }

    let (code, warned) =
        said(&place, &format!("collect --port {port} --breaths 3 --pips 15,20 {SHORT} --out a.parquet"));
    assert_eq!(code, Some(0), "{warned}");
    assert!(warned.contains("SetExploration") && warned.lines().count() == 1, "{warned}");
    let recording = Recording::load(place.path("a.parquet")).unwrap();
    assert_eq!((recording.len(), recording.inspirations().len()), (3000, 3));
    assert!(recording.provenance.notes.iter().any(|note| note.contains("SetExploration")));
    let plateau = |row: usize| recording.pressure[row];
    assert!((plateau(399) - 15.0).abs() < 1.5 && (plateau(2399) - 20.0).abs() < 1.5);
    assert!(recording.explore.iter().all(|part| *part == 0.0));
    let judged = place.ok("judge a.parquet");
    assert!(judged.contains("3 of 3 breaths judged by the measured pressure, 1 ms"), "{judged}");

    let scores = place.json(&format!("evaluate --port {port} --pips 20 --breaths 1 {SHORT}"));
    let score = scores["mean"]["pid"]["score"].as_f64().unwrap();
    assert!(score > 0.3 && score < 4.0, "{score}");
    let (_, refused) =
        said(&place, &format!("evaluate --port {port} --pips 20 --breaths 1 --controller adult {SHORT}"));
    assert!(refused.contains("does not know the request BeginWeights"), "{refused}");
    for line in ["blackbox", "selftest"] {
        let (code, refused) = said(&place, &format!("{line} --port {port}"));
        assert!(code == Some(1) && refused.contains("does not know the request Get"), "{line}: {refused}");
    }
}

#[test]
fn a_device_in_python_is_shown_on_a_page_and_as_lines() {
    if !python_is_there() {
        return;
    }
    let place = Place::new();
    let board = Board::start(&place, &[]);
    let mut device = board.connected();
    device
        .apply(Settings { rate: 60.0, inspiratory_time: 0.4, fall_time: 0.2, ..Settings::default() })
        .unwrap();
    device.start().unwrap();
    drop(device);

    let mut command = place.command(&format!("serve --listen 127.0.0.1:0 --port {}", board.port));
    let mut server =
        command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    let mut address = String::new();
    BufReader::new(server.stdout.as_mut().unwrap()).read_line(&mut address).unwrap();
    let stream = stream_of(address.trim().trim_start_matches("http://").trim_end_matches('/'));
    let breaths = stream.matches("\"type\":\"breath\"").count();
    assert!(breaths >= 2, "{breaths}");
    assert!(stream.contains("not shown: the device does not know the request GetLease"));
    assert!(stream.contains("\"ventilating\":true") && stream.contains("\"kind\":\"board\""));
    interrupted(server);

    let (lines, _) = watched(&place, &format!("monitor --port {}", board.port), 4);
    assert!(lines.contains("device: third-party device, firmware 0.1.0, tick 1000 us"), "{lines}");
    assert!(lines.contains("mode: ventilating"), "{lines}");
    assert_eq!(lines.matches("the request GetLease").count(), 1, "each once: {lines}");
}

/// What a page receives in four seconds, as text with whatever a binary message becomes.
fn stream_of(host: &str) -> String {
    let mut stream = TcpStream::connect(host).unwrap();
    write!(
        stream,
        "GET /api/stream HTTP/1.1\r\nhost: {host}\r\nupgrade: websocket\r\nconnection: upgrade\r\n\
         sec-websocket-version: 13\r\nsec-websocket-key: dGhlIHNhbXBsZSBub25jZQ==\r\n\r\n"
    )
    .unwrap();
    stream.set_read_timeout(Some(Duration::from_millis(200))).unwrap();
    let (mut all, started) = (Vec::new(), Instant::now());
    while started.elapsed() < Duration::from_secs(4) {
        let mut chunk = [0; 4096];
        let count = stream.read(&mut chunk).unwrap_or(0);
        all.extend_from_slice(&chunk[..count]);
    }
    String::from_utf8_lossy(&all).into_owned()
}

/// A mistake of a device: its name, what is changed in the example, and what the refusal says.
type Mistake = (&'static str, &'static [(&'static str, &'static str)], &'static str);

/// Mistakes in the frames and in the greeting.
const GREETINGS: [Mistake; 9] = [
    (
        "bytes of chance",
        &[("pending += out if", "pending += os.urandom(40) if")],
        "sends, but does not answer: ",
    ),
    (
        "half frames",
        &[("pending += out if", "pending += out[: len(out) // 2] if")],
        "sends, but does not answer: ",
    ),
    (
        "another checksum",
        &[("zlib.crc32(content)), b\"\\0\"", "zlib.crc32(content) ^ 1), b\"\\0\"")],
        "damaged frames",
    ),
    (
        "another sequence",
        &[("varint(sequence)", "varint(sequence + 1)")],
        "answers under other sequence numbers",
    ),
    (
        "another protocol",
        &[(
            "VERSION, THIRD_PARTY, PERIOD_US, BATCH, QUEUE = 4",
            "VERSION, THIRD_PARTY, PERIOD_US, BATCH, QUEUE = 5",
        )],
        "uses protocol 5",
    ),
    ("no period", &[("varint(PERIOD_US)", "varint(0)")], "control period as 0 us, allowed are 250 to 50000"),
    ("a period of 1 us", &[("varint(PERIOD_US)", "varint(1)")], "control period as 1 us"),
    ("a period of 10 s", &[("varint(PERIOD_US)", "varint(10_000_000)")], "control period as 10000000 us"),
    (
        "another kind of answer",
        &[("ventilator.answer(kind, rest)", "ventilator.answer(4, rest)")],
        "answers Identify with Mode",
    ),
];

/// Mistakes in the samples.
const SAMPLES: [Mistake; 9] = [
    (
        "no number",
        &[("floats(target, self.pressure, u_in)", "floats(target, 0 * 1e999, u_in)")],
        "a pressure of NaN cmH2O in breath 0",
    ),
    (
        "a valve command of 250 %",
        &[("floats(target, self.pressure, u_in)", "floats(target, self.pressure, 250)")],
        "a valve command of 250 %",
    ),
    (
        "ticks that go backwards",
        &[("varint(self.tick) + bytes", "varint(self.tick % 1300 % 700) + bytes")],
        "ticks that go backwards, to tick 0 of breath 0",
    ),
    (
        "a breath without an end",
        &[("if self.tick >= total:", "if False:"), ("due += PERIOD_US * 1e-6", "due += PERIOD_US * 2e-7")],
        "a breath without an end: 31000 ticks",
    ),
    (
        "a slow clock",
        &[("due += PERIOD_US * 1e-6", "due += PERIOD_US * 4e-6")],
        "2000 samples of 1000 us, which is 2.0 s, in",
    ),
    (
        "an inspiration without an end",
        &[("(self.tick >= inspired) + (self.tick >= fallen)", "0")],
        "an inspiration of more than its 400 ticks",
    ),
    (
        "a count from 1",
        &[(
            "self.breath, self.tick, self.samples = VENTILATING, 0, 0, []",
            "self.breath, self.tick, self.samples = VENTILATING, 1, 0, []",
        )],
        "both count from 0",
    ),
    (
        "a flood",
        &[(
            "pending += out if",
            "pending += out + frame(b\"\\1\\0\" + varint(9) + bytes(9) + b\"\\1\\x09\\x09\" + bytes(17)) * 20 if",
        )],
        "samples were lost",
    ),
    (
        "an early death",
        &[("[write(pending)", "[write(pending) if ventilator.ticks < 2500 else sys.exit()")],
        "was lost: reconnect the device",
    ),
];

/// Runs commands on a device with each of these mistakes at a time; each must be refused for the right reason.
fn refuses_each(mistakes: &[Mistake], line: impl Fn(&str) -> String + Sync) {
    if !python_is_there() {
        return;
    }
    std::thread::scope(|scope| {
        for (name, changes, expected) in mistakes {
            let line = &line;
            scope.spawn(move || {
                let place = Place::new();
                let board = Board::start(&place, changes);
                let (code, refused) = said(&place, &line(&board.port));
                assert_eq!(code, Some(1), "{name}: {refused}");
                assert!(refused.contains(expected), "{name}: {refused}");
                // What was recorded before the mistake is sound, and says how it ended.
                if place.path("a.parquet").exists() {
                    let recording = Recording::load(place.path("a.parquet")).unwrap();
                    let notes = &recording.provenance.notes;
                    assert!(
                        notes.iter().any(|note| note.contains("the recording ended in breath")),
                        "{name}: {notes:?}"
                    );
                }
            });
        }
    });
}

#[test]
fn a_device_that_is_not_understood_is_not_recorded() {
    refuses_each(&GREETINGS, |port| format!("collect --port {port} --out a.parquet"));
}

#[test]
fn a_device_that_is_not_understood_is_neither_scored_nor_watched() {
    refuses_each(&GREETINGS[..5], |port| format!("evaluate --port {port}"));
    refuses_each(&GREETINGS[3..], |port| format!("monitor --port {port}"));
}

#[test]
fn a_device_whose_samples_are_impossible_leaves_no_recording_that_looks_sound() {
    refuses_each(&SAMPLES, |port| format!("collect --port {port} --breaths 9 {SHORT} --out a.parquet"));
}

#[test]
fn a_device_whose_samples_are_impossible_is_not_scored() {
    refuses_each(&SAMPLES[..2], |port| format!("evaluate --port {port} --pips 20 --breaths 1 {SHORT}"));
}

#[test]
fn a_page_and_lines_go_on_beside_a_device_that_is_not_understood() {
    if !python_is_there() {
        return;
    }
    let place = Place::new();
    let board = Board::start(&place, GREETINGS[5].1);
    let (_, said) = watched(&place, &format!("serve --listen 127.0.0.1:0 --port {}", board.port), 2);
    assert!(said.contains("warning: the device gives its control period as 0 us"), "{said}");
    assert!(said.contains("tried again while the page is served"), "{said}");

    let board = Board::start(&place, SAMPLES[1].1);
    let mut device = board.connected();
    device.apply(Settings::default()).unwrap();
    device.start().unwrap();
    drop(device);
    let (lines, _) = watched(&place, &format!("monitor --port {}", board.port), 2);
    assert_eq!(lines.matches("samples: the device sends a valve command of 250 %").count(), 1, "{lines}");
}

#[test]
fn another_period_than_the_devices_is_refused_with_the_option_to_add() {
    if !python_is_there() {
        return;
    }
    let place = Place::new();
    let board = Board::start(&place, &[("varint(PERIOD_US)", "varint(10_000)")]);
    let (_, refused) = said(&place, &format!("collect --port {} --out a.parquet", board.port));
    assert!(refused.contains("add --period-us 10000"), "{refused}");
    // It is a lie: every sample is that of a millisecond.
    let line = format!("collect --port {} --period-us 10000 {SHORT} --out a.parquet", board.port);
    let (_, refused) = said(&place, &line);
    assert!(refused.contains("an inspiration of more than its 40 ticks"), "{refused}");
}

#[test]
fn a_device_with_a_controller_of_its_own_must_name_the_one_that_runs() {
    if !python_is_there() {
        return;
    }
    let place = Place::new();
    let board = Board::start(&place, &[("elif kind == 6 and rest[0] == 0:", "elif kind == 99:")]);
    let line = |gains: &str| format!("collect --port {} --breaths 1 --pips 15 {SHORT} {gains}", board.port);
    let (code, refused) = said(&place, &line("--gains 2,20,0 --out a.parquet"));
    assert!(code == Some(1) && refused.contains("runs the PID 3,30,0, not the PID 2,20,0"), "{refused}");
    let (code, warned) = said(&place, &line("--gains 3,30,0 --out b.parquet"));
    assert_eq!(code, Some(0), "{warned}");
}

/// 20 s without a sample, which is the longest that any command waits.
#[test]
fn a_device_that_falls_silent_is_left_after_twenty_seconds() {
    if !python_is_there() {
        return;
    }
    let place = Place::new();
    let board = Board::start(
        &place,
        &[("out += events if ventilator.telemetry", "out += events if ventilator.ticks < 2500")],
    );
    let started = Instant::now();
    let (code, refused) =
        said(&place, &format!("collect --port {} --breaths 9 {SHORT} --out a.parquet", board.port));
    assert_eq!(code, Some(1), "{refused}");
    assert!(refused.contains("stopped sending samples in breath 2"), "{refused}");
    assert!(refused.contains("2 complete breaths are saved in a.parquet"), "{refused}");
    assert!((20..40).contains(&started.elapsed().as_secs()), "{:?}", started.elapsed());
    assert_eq!(Recording::load(place.path("a.parquet")).unwrap().inspirations().len(), 3);
}

/// The stars of the page, and what the example really knows.
#[test]
fn the_example_knows_the_requests_that_the_page_marks() {
    if !python_is_there() {
        return;
    }
    let place = Place::new();
    let board = Board::start(&place, &[]);
    let mut device = board.connected();
    let page = include_str!("../../../docs/DEVICE_LINK.md");
    for request in [
        Request::Identify,
        Request::GetSettings,
        Request::ApplySettings(Settings::default()),
        Request::Start,
        Request::Stop,
        Request::Acknowledge,
        Request::SetController(ControllerChoice::Pid(PidGains { p: 1.0, i: 2.0, d: 0.0 })),
        Request::SetExploration(None),
        Request::Telemetry { on: true },
        Request::BeginWeights { length: 1, id: 2 },
        Request::WeightsChunk { offset: 0, bytes: std::iter::empty().collect() },
        Request::CommitWeights,
        Request::Reset,
        Request::QueueSettings(Settings::default()),
        Request::GetTiming { clear: false },
        Request::ResetPlant { seed: 1 },
        Request::GetRecorder,
        Request::ReadRecorder { part: RecorderPart::Log, from: 0 },
        Request::ClearRecorder,
        Request::GetAlarms,
        Request::PauseAudio { seconds: 1 },
        Request::GetAudio,
        Request::GetSelfTest,
        Request::RunSelfTest(Check::Zero),
        Request::AcquireLease { name: device::host_name(), take_over: false },
        Request::ReleaseLease,
        Request::GetLease,
        Request::StoreCalibration(Calibration {
            sensor_zero: 0.0,
            sensor_gain: 1.0,
            dead_time_ms: 12.0,
            lag_ms: 25.0,
            valve_flow: [0.25, 0.75, 1.25, 1.75],
            measured_at: 0,
        }),
        Request::GetCalibration { back: 0 },
    ] {
        let name: String = format!("{request:?}").chars().take_while(char::is_ascii_alphanumeric).collect();
        let marked = page.contains(&format!(" {name}* "));
        assert!(marked || page.contains(&format!(" {name} ")), "{name}");
        let known = !matches!(device.request(&request), Err(DeviceError::Unknown(_)));
        assert_eq!(known, marked, "{name}");
    }
}
