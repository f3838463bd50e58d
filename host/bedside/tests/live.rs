//! A real server on simulated devices, and pages that are real WebSocket clients.

mod rig;

use std::time::{Duration, Instant};

use plant::bench::BenchConfig;
use rig::{Cable, Page, get, samples};
use serde_json::{Value, json};

use bedside::server::{Options, Server};
use bedside::source::{Source, Unable, Watch};
use shared::link::messages::{Request, Response};
use show::monitor::News;

/// Serves these devices at a free port.
fn serve(watches: Vec<Watch>, steer: bool) -> Server {
    let listen = "127.0.0.1:0".parse().unwrap();
    Server::start(watches, &Options { listen, steer, demo: false, folder: std::env::temp_dir() }).unwrap()
}

fn bench() -> Watch {
    Watch::bench("R20C20", &BenchConfig::paper(20.0, 20.0)).unwrap()
}

/// A server with one simulated device that a page has started.
fn ventilating() -> (Server, Page) {
    let server = serve(vec![bench()], true);
    let mut page = Page::steering(&server);
    page.ventilate(0);
    (server, page)
}

#[test]
fn the_greeting_is_first_and_states_follow_at_least_once_a_second() {
    let server = serve(vec![bench(), bench()], false);
    let mut page = Page::open(&server);
    let hello = page.next_text();
    assert_eq!((&hello["type"], &hello["version"]), (&json!("hello"), &json!(1)));
    assert_eq!((&hello["steer"], hello["devices"].as_array().unwrap().len()), (&json!(false), 2));
    assert_eq!(
        hello["devices"][1],
        json!({"id": 1, "name": "R20C20", "kind": "simulated", "period_us": 1000})
    );
    page.state(1, |state| state["connected"] == true && state["settings"]["pip"] == 20.0);
    for _ in 0..3 {
        let before = Instant::now();
        page.state(1, |_| true);
        assert!(before.elapsed() < Duration::from_secs(1), "a page would show that it has no data");
    }
}

#[test]
fn every_sample_comes_in_order_with_its_estimates() {
    let (_server, mut page) = ventilating();
    let first = samples(&page.next_binary());
    let (mut next, mut count) = (first.tick + first.columns[0].len() as u64, 0);
    while count < 7000 {
        let frame = samples(&page.next_binary());
        assert_eq!((frame.tick, frame.dropped, frame.device), (next, 0, 0), "nothing is lost");
        next += frame.columns[0].len() as u64;
        count += frame.columns[0].len();
        assert!(frame.columns[..4].iter().flatten().all(|value| value.is_finite()));
        assert!(frame.phases.iter().all(|phase| *phase < 3));
        // After the first breath the lung is known.
        assert!(
            count < 4000 || frame.columns[5].iter().chain(&frame.columns[6]).all(|value| value.is_finite())
        );
    }
}

#[test]
fn a_breath_has_its_figures() {
    let (_server, mut page) = ventilating();
    let breath = page.text(|message| message["type"] == "breath" && message["number"] == 1);
    let close = |name: &str, expected: f64, tolerance: f64| {
        let found = breath[name].as_f64().unwrap_or(f64::NAN);
        assert!((found - expected).abs() <= tolerance, "{name} is {found}: {breath}");
    };
    close("plateau", 20.0, 1.5);
    close("peep", 5.0, 0.7);
    close("rate", 20.0, 0.1);
    close("ie", 2.0, 0.01);
    close("compliance", 20.0, 4.0);
    close("resistance", 20.0, 6.0);
    close("tidal_volume", 300.0, 60.0);
    assert_eq!(breath["estimated"], false, "its flow sensor measures");
}

#[test]
fn a_device_with_a_flow_sensor_reports_its_leak() {
    let mut bench = BenchConfig::paper(20.0, 20.0);
    bench.circuit.leak_l_per_s_at_30_cmh2o = 0.1;
    let mut served = Vec::new();
    let server = serve(vec![rig::fast_on(&bench, true, &mut served)], true);
    let mut page = Page::steering(&server);
    page.ventilate(0);
    let breath = page.text(|message| message["type"] == "breath" && message["number"] == 8);
    // 18 mL/s at 1 cmH2O, by a mean root of the pressure of about 3.
    let leak = breath["leak"].as_f64().unwrap();
    assert!((leak - 3.3).abs() < 0.6, "{leak} L/min: {breath}");
    let volume = breath["tidal_volume"].as_f64().unwrap();
    assert!((volume - 285.0).abs() < 40.0, "without the leak's gas, about 90 mL: {volume} mL");
}

#[test]
fn without_a_flow_sensor_flow_and_volume_are_estimated_and_no_leak_is_known() {
    let mut served = Vec::new();
    let server = serve(vec![rig::fast(&mut served)], true);
    let mut page = Page::steering(&server);
    page.ventilate(0);
    let breath = page.text(|message| message["type"] == "breath" && message["number"] == 4);
    assert_eq!((&breath["leak"], &breath["estimated"]), (&Value::Null, &json!(true)));
    assert!(breath["tidal_volume"].is_number() && breath["compliance"].is_number(), "{breath}");
}

#[test]
fn a_page_that_opens_later_gets_the_trends_of_the_earlier_breaths() {
    let mut served = Vec::new();
    let server = serve(vec![rig::fast(&mut served)], true);
    let mut page = Page::steering(&server);
    page.ventilate(0);
    page.text(|message| message["type"] == "breath" && message["number"].as_u64() >= Some(2));
    let history = Page::open(&server).text(|message| message["type"] == "history");
    assert_eq!(history["device"], 0);
    let columns = ["low", "mean", "high"].map(|column| &history["figures"]["pip"][column][0]);
    let [low, mean, high] = columns.map(|value| value.as_f64().unwrap());
    assert!(low <= mean && mean <= high && (15.0..30.0).contains(&mean), "{history}");
    assert!(history["breaths"][0].as_u64() >= Some(1), "{history}");
}

#[test]
fn a_page_reads_the_flight_recorder_of_a_device() {
    let (_server, mut page) = ventilating();
    page.text(|message| message["type"] == "breath");
    page.send(&json!({"type": "recorder", "device": 0, "id": 99}));
    let log = page.text(|message| message["type"] == "recorder");
    assert!(log["events"].to_string().contains("ventilation started"), "{log}");
    for part in ["fast", "slow"] {
        let columns = ["time", "pressure", "target", "u_in", "u_out"].map(|name| log[part][name].as_array());
        let [Some(time), Some(pressure), rest @ ..] = columns else { panic!("{part}: {log}") };
        assert!(!time.is_empty() && time.last().unwrap().as_f64() == Some(0.0), "{part}");
        assert!(pressure.iter().any(|pressure| pressure.as_f64() > Some(1.0)), "{part}");
        assert!(rest.iter().all(|column| column.is_some_and(|column| column.len() == time.len())), "{part}");
    }
    let answer = page.text(|message| message["type"] == "answer");
    assert_eq!((&answer["id"], &answer["ok"]), (&json!(99), &json!(true)), "{answer}");
}

#[test]
fn settings_are_shown_as_asked_and_as_applied() {
    let (_server, mut page) = ventilating();
    let answer = page.ask(json!({"type": "apply", "device": 0, "settings": {"pip": 26, "rate": 15}}));
    assert_eq!((&answer["ok"], &answer["settings"]["pip"]), (&json!(true), &json!(26.0)));
    page.state(0, |state| state["settings"]["pip"] == 26.0 && state["settings"]["rate"] == 15.0);
    let refused = page.ask(json!({"type": "apply", "device": 0, "settings": {"pip": 95}}));
    assert_eq!(refused["ok"], false);
    assert!(refused["text"].as_str().unwrap().contains("allowed are 5 to 60"), "{refused}");
    let state = page.state(0, |_| true);
    assert_eq!(state["settings"]["pip"], 26.0, "a refused setting changes nothing");
    let paused = page.ask(json!({"type": "pause_audio", "device": 0, "seconds": 121}));
    assert_eq!(paused["ok"], false);
    let stopped = page.ask(json!({"type": "stop", "device": 0}));
    assert_eq!((&stopped["ok"], &stopped["text"]), (&json!(true), &json!("standby")));
}

#[test]
fn quick_changes_do_not_undo_each_other() {
    let (_server, mut page) = ventilating();
    page.send(&json!({"type": "apply", "device": 0, "id": 101, "settings": {"pip": 26}}));
    page.send(&json!({"type": "apply", "device": 0, "id": 102, "settings": {"rate": 15}}));
    let answer = page.text(|message| message["type"] == "answer" && message["id"] == 102);
    assert_eq!((&answer["settings"]["pip"], &answer["settings"]["rate"]), (&json!(26.0), &json!(15.0)));
}

#[test]
fn a_lost_line_releases_the_wheel_and_empties_the_settings() {
    let (cable, watch) = Cable::with_watch();
    let server = serve(vec![watch], true);
    let mut page = Page::steering(&server);
    page.send(&json!({"type": "take", "device": 0}));
    page.text(|message| message["type"] == "steerer" && message["yours"] == true);
    page.state(0, |state| state["settings"].is_object());
    let cable = cable.cut();
    page.text(|message| message["type"] == "steerer" && message["who"] == Value::Null);
    page.state(0, |state| state["missing"] == "line" && state["settings"] == Value::Null);
    let _cable = cable.plug_in();
    page.state(0, |state| state["connected"] == true && state["settings"].is_object());
}

#[test]
fn a_device_that_is_not_there_at_the_start_stops_no_other_and_is_shown_when_it_comes() {
    let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
    let address = device::port::Address::Tcp(listener.local_addr().unwrap().to_string());
    drop(listener);
    let (watch, identity) = Watch::port(&address);
    assert!(identity.is_err());
    let server = serve(vec![bench(), watch], false);
    let mut page = Page::open(&server);
    assert_eq!(page.next_text()["devices"][1]["kind"], "board", "not known yet");
    page.state(0, |state| state["connected"] == true);
    page.state(1, |state| state["missing"] == "line");
    let _cable = Cable::at(&address);
    assert_eq!(page.closed(), Some(1013), "the page starts again, since the device is another one");
    let mut page = Page::open(&server);
    assert_eq!(page.next_text()["devices"][1]["kind"], "simulated");
    page.state(1, |state| state["connected"] == true);
}

/// A device whose session fails after its first words.
struct Failing(u32);

impl Source for Failing {
    fn next(&mut self, _patience: Duration) -> Option<News> {
        self.0 += 1;
        assert!(self.0 < 100, "the session fails");
        std::thread::sleep(Duration::from_millis(2));
        let (request, result) = (Request::Identify, Ok(Response::Done));
        Some(News::Answer { request, result })
    }

    fn ask(&mut self, _request: Request) -> Result<(), Unable> {
        Ok(())
    }

    fn leave(self: Box<Self>) {}
}

#[test]
fn a_device_whose_part_of_the_server_fails_is_shown_as_lost_and_the_others_go_on() {
    let failing = Watch { name: "failing".to_owned(), source: Box::new(Failing(0)), ..bench() };
    let server = serve(vec![failing, bench()], true);
    let mut page = Page::steering(&server);
    let failed =
        |state: &Value| state["lost"].as_str().is_some_and(|lost| lost.contains("start the server again"));
    assert_eq!(page.state(0, failed)["connected"], false);
    assert_eq!(Page::open(&server).state(0, failed)["connected"], false, "also for a page that opens later");
    page.ventilate(1);
    let refused = page.ask(json!({"type": "mark", "device": 0, "text": "x"}));
    assert_eq!(refused["ok"], false, "{refused}");
    assert!(metrics(&server).contains("eupnea_connected{device=\"failing\"} 0"), "{}", metrics(&server));
    assert!(get(&server, "/api/state", &[]).2.contains("start the server again"));
    page.state(1, |state| state["connected"] == true && state["ventilating"] == true);
}

#[test]
fn a_capture_that_is_armed_is_shown_and_one_that_cannot_trigger_is_refused() {
    let (_server, mut page) = ventilating();
    let armed = page.ask(json!({"type": "capture", "device": 0, "triggers": {"pressure": 40}}));
    assert_eq!(armed["ok"], true);
    page.state(0, |state| state["triggers"]["pressure"] == 40.0);
    let refused = page.ask(json!({"type": "capture", "device": 0, "triggers": {"overshoot": 0}}));
    assert_eq!(refused["ok"], false);
    assert!(refused["text"].as_str().unwrap().contains("overshoot"), "{refused}");
    page.state(0, |state| state["triggers"]["pressure"] == 40.0);
    assert_eq!(page.ask(json!({"type": "capture", "device": 0, "triggers": {}}))["ok"], true);
    page.state(0, |state| state["triggers"] == Value::Null);
}

#[test]
fn one_page_steers_and_the_others_see_who() {
    let (server, mut page) = ventilating();
    let mut other = Page::steering(&server);
    let steerer = other.text(|message| message["type"] == "steerer");
    assert_eq!(steerer["yours"], false);
    let refused = other.ask(json!({"type": "stop", "device": 0}));
    assert_eq!(refused["ok"], false);
    assert_eq!(refused["text"], format!("{} steers this device", steerer["who"].as_str().unwrap()));
    page.send(&json!({"type": "release", "device": 0}));
    other.text(|message| message["type"] == "steerer" && message["who"] == Value::Null);
    assert_eq!(other.ask(json!({"type": "stop", "device": 0}))["text"], "take control of the device first");
    other.send(&json!({"type": "take", "device": 0}));
    other.text(|message| message["type"] == "steerer" && message["yours"] == true);
    page.send(&json!({"type": "take", "device": 0}));
    page.text(|message| {
        message["type"] == "steerer" && message["who"].is_string() && message["yours"] == false
    });
    page.send(&json!({"type": "take", "device": 0, "take_over": true}));
    other.text(|message| message["type"] == "steerer" && message["yours"] == false);
    page.send(&json!({"type": "release", "device": 0}));
    other.text(|message| message["type"] == "steerer" && message["who"] == Value::Null);
    other.send(&json!({"type": "take", "device": 0}));
    other.text(|message| message["type"] == "steerer" && message["yours"] == true);
    drop(other);
    page.text(|message| message["type"] == "steerer" && message["who"] == Value::Null);
}

#[test]
fn a_page_without_the_token_only_reads() {
    let server = serve(vec![bench()], true);
    let mut page = Page::open(&server);
    for request in [
        json!({"type": "start", "device": 0}),
        json!({"type": "apply", "device": 0, "settings": {"pip": 26}}),
        json!({"type": "mark", "device": 0, "text": "here"}),
    ] {
        let answer = page.ask(request);
        assert_eq!(answer["ok"], false);
        assert!(answer["text"].as_str().unwrap().starts_with("read only"), "{answer}");
    }
    page.send(&json!({"type": "token", "token": "0".repeat(32)}));
    assert_eq!(page.closed(), Some(1008));
    assert!(metrics(&server).contains("eupnea_refused_total{reason=\"token\"} 1\n"));
}

#[test]
fn a_marker_reaches_every_page() {
    let (server, mut page) = ventilating();
    let mut other = Page::open(&server);
    // A marker has the tick of the newest sample.
    page.next_binary();
    assert_eq!(page.ask(json!({"type": "mark", "device": 0, "text": "suction"}))["ok"], true);
    let event = other.text(|message| message["type"] == "event" && message["kind"] == "marker");
    assert_eq!(event["text"], "suction");
    assert!(event["tick"].is_u64(), "{event}");
    let later = Page::open(&server).text(|message| message["type"] == "event" && message["kind"] == "marker");
    assert_eq!(later, event, "also one that opens later");
}

#[test]
fn a_slow_page_loses_samples_and_slows_nobody() {
    // A hundred times as fast as a chip, so that the buffers of the operating system fill soon.
    let mut served = Vec::new();
    let server = serve(vec![rig::fast(&mut served)], true);
    let mut page = Page::steering(&server);
    let mut slow = Page::sluggish(&server);
    page.ventilate(0);
    // A page that neither takes nor sends anything would be closed.
    let mut alive = Instant::now();
    let deadline = Instant::now() + rig::LONG;
    let (mut next, mut quick_dropped) = (None, 0);
    while !metrics(&server).lines().any(|line| {
        line.strip_prefix("eupnea_viewer_dropped_samples_total{").is_some_and(|rest| !rest.ends_with(" 0"))
    }) {
        assert!(Instant::now() < deadline, "no sample was dropped");
        for _ in 0..50 {
            let frame = samples(&page.next_binary());
            quick_dropped = frame.dropped;
            assert!(next.is_none_or(|next| next == frame.tick) || frame.dropped > 0);
            next = Some(frame.tick + frame.columns[0].len() as u64);
        }
        slow.next();
        if alive.elapsed() > Duration::from_secs(1) {
            alive = Instant::now();
            slow.send(&json!({"type": "watch", "devices": [0]}));
        }
    }
    assert_eq!(quick_dropped, 0, "the other page gets everything");
    let deadline = Instant::now() + rig::LONG;
    while samples(&slow.next_binary()).dropped == 0 {
        assert!(Instant::now() < deadline, "the slow page is not told of its losses");
    }
}

#[test]
fn a_device_dies_and_returns() {
    let (cable, watch) = Cable::with_watch();
    let server = serve(vec![watch], false);
    let mut page = Page::open(&server);
    page.state(0, |state| state["connected"] == true);
    let cable = cable.cut();
    let lost = page.text(|message| message["type"] == "event" && message["kind"] == "lost");
    assert_eq!(lost["device"], 0);
    let state = page.state(0, |state| state["connected"] == false);
    assert!(state["lost"].is_string());
    let _cable = cable.plug_in();
    page.state(0, |state| state["connected"] == true && state["lost"] == Value::Null);
}

#[test]
fn the_state_is_also_a_file_and_every_response_has_the_policy() {
    let server = serve(vec![bench()], false);
    let mut page = Page::open(&server);
    page.state(0, |state| state["connected"] == true);
    let (status, _, body) = get(&server, "/api/state", &[]);
    let state: Value = serde_json::from_str(&body).unwrap();
    assert_eq!((status, &state["states"][0]["device"]), (200, &json!(0)));
    assert_eq!(state["hello"]["devices"][0]["name"], "R20C20");
    for path in ["/", "/app.js", "/app.css", "/metrics", "/nothing"] {
        let (status, headers, _) = get(&server, path, &[]);
        assert_eq!(status, if path == "/nothing" { 404 } else { 200 }, "{path}");
        // The whole policy: a directive that is missing allows what it names.
        let policy = "content-security-policy: default-src 'none'; script-src 'self'; style-src 'self'; \
            img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";
        for header in [policy, "x-content-type-options: nosniff", "cross-origin-resource-policy: same-origin"]
        {
            assert!(headers.lines().any(|line| line.trim_end() == header), "{path}: {headers}");
        }
    }
}

#[test]
fn metrics_count_samples_and_latencies() {
    let (server, mut page) = ventilating();
    for _ in 0..20 {
        let frame = samples(&page.next_binary());
        page.send(&json!({"type": "drawn", "device": 0, "tick": frame.tick}));
        std::thread::sleep(Duration::from_millis(30));
    }
    let deadline = Instant::now() + rig::LONG;
    let counted = |name: &str| {
        let text = metrics(&server);
        let line = text.lines().find_map(|line| line.strip_prefix(name).map(str::to_owned));
        line.map_or(0.0, |value| value.trim().parse::<f64>().unwrap())
    };
    while counted("eupnea_draw_latency_seconds_count") < 20.0
        || counted("eupnea_samples_total{device=\"R20C20\"}") < 500.0
    {
        assert!(Instant::now() < deadline, "{}", metrics(&server));
        page.next_binary();
    }
    assert!(counted("eupnea_viewers") >= 1.0);
}

fn metrics(server: &Server) -> String {
    get(server, "/metrics", &[]).2
}

#[test]
fn the_demonstration_breathes_and_its_faults_raise_alarms() {
    let watches = bedside::demo::start().unwrap();
    let listen = "127.0.0.1:0".parse().unwrap();
    let server =
        Server::start(watches, &Options { listen, steer: true, demo: true, folder: std::env::temp_dir() })
            .unwrap();
    let mut page = Page::steering(&server);
    let hello = page.next_text();
    assert_eq!((&hello["demo"], hello["devices"].as_array().unwrap().len()), (&json!(true), 18));
    assert_eq!(hello["devices"][9]["name"], "R20C20 adult");
    for device in 0..18 {
        let level = if device % 2 == 0 { "pid" } else { "learned" };
        page.state(device, |state| state["ventilating"] == true && state["level"] == level);
    }
    let deadline = Instant::now() + rig::LONG;
    let share = |page: &mut Page, device: u8| loop {
        assert!(Instant::now() < deadline, "no inspiration of device {device} arrives");
        page.send(&json!({"type": "watch", "devices": [device]}));
        let frame = samples(&page.next_binary());
        let known = frame.columns[4].iter().all(|share| share.is_finite()) && frame.phases.contains(&0);
        if frame.device == device && known {
            break frame.columns[4].iter().fold(0.0_f32, |most, share| most.max(share.abs()));
        }
        std::thread::sleep(Duration::from_millis(40));
    };
    assert!(share(&mut page, 8).abs() < f32::EPSILON, "a PID has no learned part");
    assert!(share(&mut page, 9) > 0.5, "a learned controller has one");
    let adapted = page.state(9, |state| state["adaptation"]["breaths"].as_u64() >= Some(1));
    assert_eq!(adapted["adaptation"]["last"], "adopted", "{adapted}");
    assert_eq!(page.state(8, |_| true)["adaptation"], Value::Null, "a PID does not adapt");
    page.send(&json!({"type": "take", "device": 9}));
    assert_eq!(page.ask(json!({"type": "fault", "device": 9, "fault": "disconnect"}))["ok"], true);
    let alarmed = page.state(9, |state| state["alarms"].as_array().is_some_and(|alarms| !alarms.is_empty()));
    assert_eq!(alarmed["alarms"][0]["present"], true, "{alarmed}");
    assert_eq!(page.ask(json!({"type": "fault", "device": 9, "fault": "none"}))["ok"], true);
}

#[test]
fn the_flight_recorder_of_a_device_is_shown_from_its_file() {
    let mut served = Vec::new();
    drop(rig::fast(&mut served));
    let mut device = device::Device::connect(served[0].address()).unwrap();
    device.telemetry(true).unwrap();
    device.apply(shared::settings::Settings::default()).unwrap();
    device.start().unwrap();
    // Whole breaths, so that both parts of the recorder have entries.
    let event = || device.events().recv_timeout(rig::LONG).unwrap();
    while !matches!(event(), shared::link::messages::Event::Breath(breath) if breath.breath > 0) {}
    // At its pace a running recorder would overwrite what is being read.
    device.stop().unwrap();
    let blackbox = device.blackbox(&progress::Progress::silent()).unwrap();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("fault.json");
    std::fs::write(&path, serde_json::to_string(&blackbox).unwrap()).unwrap();
    let server = serve(bedside::replay::blackbox(&path).unwrap(), false);
    let mut page = Page::open(&server);
    let hello = page.next_text();
    let kinds: Vec<&Value> =
        hello["devices"].as_array().unwrap().iter().map(|device| &device["kind"]).collect();
    assert_eq!(kinds, ["recording", "recording"]);
    assert_eq!(hello["devices"][1]["period_us"], 20_000);
    let log = page.text(|message| message["type"] == "recorder");
    assert!(log["events"].to_string().contains("ventilation started"), "{log}");
    page.state(0, |state| state["connected"] == true && state["ventilating"] == true);
    assert!(samples(&page.next_binary()).columns[0].iter().all(|pressure| pressure.is_finite()));
}

#[test]
fn a_page_records_and_the_file_holds_every_sample() {
    let folder = tempfile::tempdir().unwrap();
    let options = Options {
        listen: "127.0.0.1:0".parse().unwrap(),
        steer: true,
        demo: false,
        folder: folder.path().to_owned(),
    };
    let server = Server::start(vec![bench()], &options).unwrap();
    let mut page = Page::steering(&server);
    page.ventilate(0);
    let started = page.ask(json!({"type": "record", "device": 0, "on": true}));
    assert_eq!(started["ok"], true, "{started}");
    let mut other = Page::steering(&server);
    let refused = other.ask(json!({"type": "record", "device": 0, "on": false}));
    assert_eq!(refused["ok"], false, "another page has started it");
    page.state(0, |state| state["recording"]["samples"].as_u64().is_some_and(|samples| samples > 500));
    assert_eq!(page.ask(json!({"type": "mark", "device": 0, "text": "here"}))["ok"], true);
    let stopped = page.ask(json!({"type": "record", "device": 0, "on": false}));
    let samples: usize = stopped["text"].as_str().unwrap().split(' ').next().unwrap().parse().unwrap();
    page.state(0, |state| state["recording"] == Value::Null);
    let mut files: Vec<_> =
        std::fs::read_dir(folder.path()).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    assert_eq!(files.len(), 2, "{files:?}");
    assert_eq!(files[0].extension().unwrap(), "mcap");
    let mcap = std::fs::read(&files[0]).unwrap();
    assert!(String::from_utf8_lossy(&mcap).contains("/markers"), "the marker is in this file, too");
    let recording = data::recording::Recording::load(&files[1]).unwrap();
    assert_eq!(recording.len(), samples);
    assert!(recording.provenance.notes[0].ends_with(": here"));
    let again = serve(vec![bedside::replay::recording("again", &recording).unwrap()], false);
    let mut page = Page::open(&again);
    assert_eq!(rig::samples(&page.next_binary()).tick, 0);
    let verdict = Page::open(&again).text(|message| message["type"] == "verdict");
    assert!(verdict["breaths"].is_u64() && verdict["limits"].is_array(), "{verdict}");
}
