//! The demonstration as its page sees it, and its samples, which must be the same bits in a browser.

use std::collections::BTreeMap;
use std::fmt::Write;
use std::fs;
use std::path::Path;

use plant::bench::family::Family;
use serde_json::Value;
use webdemo::demo::{Demo, RIVAL};
use webdemo::page::Message;

/// Samples of each device that are compared.
const SAMPLES: usize = 1000;
/// Hash of the first samples of each device: device and hash in a line. `host/bedside/web/test/demo.test.ts` compares the same ones.
const GOLDEN: &str = "golden.txt";

/// A page with its clock.
struct Page {
    demo: Demo,
    now_ms: f64,
    texts: Vec<Value>,
    /// Pressure and command of every sample, of each device.
    samples: BTreeMap<u8, Vec<[[u8; 4]; 2]>>,
}

impl Page {
    fn open() -> Self {
        let now_ms = 1.7e12;
        let demo = Demo::start(now_ms).unwrap();
        let mut page = Self { demo, now_ms, texts: Vec::new(), samples: BTreeMap::new() };
        page.read();
        page
    }

    fn read(&mut self) {
        while let Some(message) = self.demo.take() {
            match message {
                Message::Text(text) => self.texts.push(serde_json::from_str(&text).unwrap()),
                Message::Samples(bytes) => {
                    let count = usize::from(u16::from_le_bytes([bytes[2], bytes[3]]));
                    let column = |number: usize| bytes[24 + 4 * count * number..][..4 * count].as_chunks().0;
                    let pairs = column(0).iter().zip(column(2)).map(|(pressure, u_in)| [*pressure, *u_in]);
                    self.samples.entry(bytes[1]).or_default().extend(pairs);
                }
            }
        }
    }

    fn run(&mut self, ms: u32) {
        for _ in 0..ms / 20 {
            self.now_ms += 20.0;
            self.demo.advance(self.now_ms);
            self.read();
        }
    }

    fn send(&mut self, text: &str) {
        self.demo.receive(text, self.now_ms);
        self.read();
    }

    /// The newest message of a type, of a device.
    fn newest(&self, kind: &str, device: u8) -> Option<&Value> {
        self.texts.iter().rfind(|text| text["type"] == kind && text["device"] == device)
    }

    fn answer(&self, id: u32) -> &Value {
        self.texts.iter().find(|text| text["type"] == "answer" && text["id"] == id).expect("an answer")
    }

    /// Runs until a device's state shows something; at most a minute.
    fn until(&mut self, device: u8, shows: impl Fn(&Value) -> bool) {
        for _ in 0..600 {
            self.run(100);
            if self.newest("state", device).is_some_and(&shows) {
                return;
            }
        }
        panic!("never: {:?}", self.newest("state", device));
    }
}

/// FNV-1a.
fn hash(samples: &[[[u8; 4]; 2]]) -> u64 {
    let bytes = samples.as_flattened().as_flattened();
    bytes
        .iter()
        .fold(0xcbf2_9ce4_8422_2325, |hash, byte| (hash ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3))
}

#[test]
fn the_samples_are_those_of_the_golden_file() {
    let mut page = Page::open();
    page.run(1500);
    let mut found = String::new();
    for (device, samples) in &page.samples {
        let _ = writeln!(found, "{device} {:016x}", hash(&samples[..SAMPLES]));
    }
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join(GOLDEN);
    if std::env::var_os("EUPNEA_BLESS").is_some() {
        fs::write(&path, &found).unwrap();
    }
    let golden = fs::read_to_string(&path).unwrap();
    assert_eq!(found, golden, "bless with EUPNEA_BLESS=1, then run cargo xtask web --demo");
}

#[test]
fn the_rival_is_the_best_single_pid_of_the_family() {
    assert_eq!(Family::find("adult").unwrap().pid, Some(RIVAL));
}

#[test]
fn a_page_is_greeted_and_gets_samples_and_states_of_all_devices() {
    let mut page = Page::open();
    assert_eq!((&page.texts[0]["type"], &page.texts[0]["demo"]), (&"hello".into(), &true.into()));
    let devices = page.texts[0]["devices"].as_array().unwrap().len();
    page.run(7000);
    assert_eq!((devices, page.samples.len()), (18, 18));
    for device in 0..18 {
        let state = page.newest("state", device).unwrap();
        let level = if device % 2 == 0 { "pid" } else { "learned" };
        assert_eq!((&state["connected"], &state["ventilating"]), (&true.into(), &true.into()));
        assert_eq!((state["level"].as_str(), &state["line"]["lost_batches"]), (Some(level), &0.into()));
        assert!(page.newest("breath", device).is_some(), "{device}");
        assert!(page.samples[&device].len() > 6900, "{device}: {}", page.samples[&device].len());
    }
}

#[test]
fn a_page_gets_samples_only_of_the_devices_that_it_watches() {
    let mut page = Page::open();
    page.send(r#"{"type":"watch","devices":[3]}"#);
    page.run(1000);
    assert_eq!(page.samples.keys().copied().collect::<Vec<_>>(), [3]);
}

#[test]
fn a_fault_raises_an_alarm_and_ends_when_it_is_mended() {
    let mut page = Page::open();
    // The monitors must know the lung first: a tube that is off from the start looks like a lung, and the real one then like an occlusion.
    page.run(6000);
    page.send(r#"{"type":"fault","id":1,"device":1,"fault":"disconnect"}"#);
    assert_eq!(page.answer(1)["ok"], false, "the page has not taken the device");
    page.send(r#"{"type":"take","device":1}"#);
    page.send(r#"{"type":"fault","id":2,"device":1,"fault":"disconnect"}"#);
    assert_eq!(page.answer(2)["ok"], true);
    page.until(1, |state| state["alarms"][0]["priority"] == "high" && state["alarms"][0]["present"] == true);
    page.send(r#"{"type":"fault","id":3,"device":1,"fault":"none"}"#);
    page.until(1, |state| state["alarms"][0]["present"] != true);
    page.send(r#"{"type":"acknowledge","id":4,"device":1}"#);
    page.until(1, |state| state["alarms"].as_array().is_some_and(Vec::is_empty));
}

#[test]
fn settings_are_applied_and_a_device_stops_and_starts_again() {
    let mut page = Page::open();
    page.send(r#"{"type":"take","device":0}"#);
    page.send(r#"{"type":"apply","id":1,"device":0,"settings":{"pip":25}}"#);
    assert_eq!(
        (&page.answer(1)["ok"], page.answer(1)["settings"]["pip"].as_f64()),
        (&true.into(), Some(25.0))
    );
    page.until(0, |state| state["settings"]["pip"].as_f64() == Some(25.0));
    page.send(r#"{"type":"stop","id":2,"device":0}"#);
    page.until(0, |state| state["ventilating"] == false);
    page.send(r#"{"type":"apply","id":3,"device":0,"settings":{}}"#);
    page.send(r#"{"type":"start","id":4,"device":0}"#);
    assert_eq!((&page.answer(3)["ok"], &page.answer(4)["ok"]), (&true.into(), &true.into()));
    page.until(0, |state| state["ventilating"] == true);
}

#[test]
fn a_page_that_slept_goes_on_from_where_it_was() {
    let mut page = Page::open();
    page.run(1000);
    let before = page.samples[&0].len();
    page.now_ms += 3.6e6;
    page.run(1000);
    let more = page.samples[&0].len() - before;
    assert!((900..1200).contains(&more), "{more} samples in a second after an hour");
}

#[test]
fn what_cannot_be_read_or_done_is_refused() {
    let mut page = Page::open();
    page.send("{");
    assert!(page.texts.iter().any(|text| text["type"] == "answer" && text["ok"] == false));
    page.send(r#"{"type":"record","id":7,"device":0,"on":true}"#);
    assert!(page.answer(7)["text"].as_str().unwrap().contains("trainer serve --demo"));
    page.send(r#"{"type":"take","device":99}"#);
    page.send(r#"{"type":"mark","id":8,"device":0,"text":"here"}"#);
    assert_eq!(
        (&page.answer(8)["ok"], &page.newest("event", 0).unwrap()["text"]),
        (&true.into(), &"here".into())
    );
}
