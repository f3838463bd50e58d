//! A real device at the page's computer, as its page sees it: a simulated chip stands behind the port.

use plant::bench::{BenchConfig, BenchPlant};
use serde_json::{Value, json};
use shared::link::frame::{FRAME_BYTES, encode_frame};
use shared::link::host_name::HostName;
use shared::link::messages::{Request, ToDevice};
use shared::recorder::RecorderMemory;
use virtual_chip::Chip;
use webdemo::board::Board;
use webdemo::page::Message;

/// Token of another host on the line.
const OTHER: u32 = 7;

/// A chip, and a page that has opened its port.
struct Rig {
    chip: Chip<'static>,
    board: Board,
    now_ms: u64,
    texts: Vec<Value>,
    samples: usize,
    /// Whether the line carries bytes.
    joined: bool,
}

impl Rig {
    fn new() -> Self {
        let memory: &'static RecorderMemory = Box::leak(Box::new(RecorderMemory::new()));
        let mut chip = Chip::new(BenchPlant::new(&BenchConfig::default()).unwrap(), memory);
        chip.read_all_sensors();
        let board = Board::new(42, 0);
        Self { chip, board, now_ms: 1_700_000_000_000, texts: vec![], samples: 0, joined: true }
    }

    fn run(&mut self, ms: u64) {
        for _ in 0..ms / 20 {
            self.now_ms += 20;
            (0..20).for_each(|_| self.chip.tick());
            let heard = std::mem::take(self.chip.out());
            let heard = if self.joined { heard } else { vec![] };
            self.board.hear(&heard, self.now_ms);
            self.carry();
        }
    }

    /// Carries the page's bytes to the chip and reads what the page gets.
    fn carry(&mut self) {
        self.board.advance(self.now_ms);
        for byte in self.board.wire() {
            if self.joined {
                self.chip.hear(byte);
            }
        }
        while let Some(message) = self.board.take() {
            match message {
                Message::Text(text) => self.texts.push(serde_json::from_str(&text).unwrap()),
                Message::Samples(bytes) => {
                    self.samples += usize::from(u16::from_le_bytes([bytes[2], bytes[3]]));
                }
            }
        }
    }

    fn send(&mut self, message: &Value) {
        self.board.receive(&message.to_string(), self.now_ms);
    }

    /// The answer to a request of the page.
    fn ask(&mut self, id: u32, mut message: Value) -> Value {
        (message["id"], message["device"]) = (id.into(), 0.into());
        self.send(&message);
        for _ in 0..1000 {
            self.run(20);
            if let Some(answer) = self.texts.iter().find(|text| text["type"] == "answer" && text["id"] == id)
            {
                return answer.clone();
            }
        }
        panic!("no answer to {message}");
    }

    fn newest(&self, kind: &str) -> &Value {
        self.texts.iter().rfind(|text| text["type"] == kind).unwrap_or(&Value::Null)
    }

    /// Runs until the state shows something; at most a minute.
    fn until(&mut self, shows: impl Fn(&Value) -> bool) {
        for _ in 0..3000 {
            self.run(20);
            if shows(self.newest("state")) {
                return;
            }
        }
        panic!("never: {}", self.newest("state"));
    }

    /// Sends a request as another host.
    fn other(&mut self, request: Request) {
        let mut buffer = [0; FRAME_BYTES];
        let message = ToDevice { sequence: 1, request, host: Some(OTHER) };
        for byte in encode_frame(&message, &mut buffer).unwrap() {
            self.chip.hear(*byte);
        }
    }

    fn start(&mut self) {
        self.until(|state| state["connected"] == true && !state["settings"].is_null());
        self.send(&json!({"type": "take", "device": 0}));
        let applied = self.ask(1, json!({"type": "apply", "settings": {"pip": 22}}));
        assert_eq!((&applied["ok"], applied["settings"]["pip"].as_f64()), (&true.into(), Some(22.0)));
        let started = self.ask(2, json!({"type": "start"}));
        assert_eq!(started["ok"], true, "{started}");
    }
}

#[test]
fn a_board_is_only_read_until_the_page_takes_control_and_then_ventilates() {
    let mut rig = Rig::new();
    rig.until(|state| state["connected"] == true && !state["settings"].is_null());
    let hello = rig.newest("hello");
    assert_eq!((&hello["demo"], &hello["steer"]), (&false.into(), &true.into()));
    assert_eq!(hello["devices"][0]["kind"], "simulated", "as the device has said");
    assert_eq!(rig.newest("state")["lease"], Value::Null, "reading takes no lease");
    let refused = rig.ask(9, json!({"type": "start"}));
    assert_eq!(
        (&refused["ok"], &refused["text"]),
        (&false.into(), &"take control of the device first".into())
    );
    rig.start();
    rig.until(|state| state["ventilating"] == true && state["lease"] == "this server");
    rig.run(5000);
    assert!(rig.samples > 4000 && rig.newest("breath").is_object(), "{}", rig.samples);
    assert_eq!(rig.newest("state")["line"], json!({"corrupt": 0, "lost_batches": 0, "dropped": 0}));
    let stopped = rig.ask(3, json!({"type": "stop"}));
    assert_eq!(stopped["ok"], true);
    rig.send(&json!({"type": "release", "device": 0}));
    rig.until(|state| state["ventilating"] == false && state["lease"].is_null());
}

#[test]
fn another_hosts_lease_is_respected_until_a_person_takes_it_over() {
    let mut rig = Rig::new();
    rig.until(|state| state["connected"] == true && !state["settings"].is_null());
    rig.other(Request::AcquireLease { name: HostName::new("anna"), take_over: false });
    rig.until(|state| state["lease"] == "anna");
    rig.send(&json!({"type": "take", "device": 0}));
    let refused = rig.ask(1, json!({"type": "apply", "settings": {"pip": 22}}));
    assert!(refused["ok"] == false && refused["text"].as_str().unwrap().contains("anna"), "{refused}");
    rig.send(&json!({"type": "take", "device": 0, "take_over": true}));
    let applied = rig.ask(2, json!({"type": "apply", "settings": {"pip": 22}}));
    assert_eq!(applied["ok"], true, "{applied}");
    rig.until(|state| state["lease"] == "this server");
}

#[test]
fn a_silent_board_is_lost_and_returns_without_being_steered() {
    let mut rig = Rig::new();
    rig.start();
    rig.joined = false;
    rig.until(|state| state["missing"] == "line");
    assert!(rig.newest("state")["lost"].as_str().unwrap().contains("the board does not answer"));
    assert_eq!(rig.newest("steerer")["yours"], false);
    let refused = rig.ask(5, json!({"type": "stop"}));
    assert_eq!(refused["ok"], false);
    rig.joined = true;
    rig.until(|state| state["connected"] == true && state["ventilating"] == true);
    assert_eq!(rig.newest("state")["settings"]["pip"].as_f64(), Some(22.0), "nothing was pushed");
    assert_eq!(rig.newest("state")["steered_by"], Value::Null);
}

#[test]
fn a_page_that_plugs_its_board_in_again_still_has_its_lease() {
    let mut rig = Rig::new();
    rig.start();
    rig.until(|state| state["lease"] == "this server");
    rig.board.unplugged(rig.now_ms);
    rig.board = Board::new(42, 500);
    rig.send(&json!({"type": "take", "device": 0}));
    let stopped = rig.ask(7, json!({"type": "stop"}));
    assert_eq!(stopped["ok"], true, "{stopped}");
    rig.until(|state| state["ventilating"] == false);
}

#[test]
fn an_unplugged_board_is_told_at_once_and_its_requests_are_refused() {
    let mut rig = Rig::new();
    rig.start();
    rig.send(&json!({"type": "pause_audio", "id": 6, "device": 0, "seconds": 60}));
    rig.board.unplugged(rig.now_ms);
    rig.run(1000);
    let answer = rig.texts.iter().find(|text| text["id"] == 6).unwrap();
    assert!(answer["text"].as_str().unwrap().contains("unplugged"), "{answer}");
    assert!(rig.newest("state")["lost"].as_str().unwrap().contains("press Connect a board"));
    rig.run(10_000);
    assert_eq!(rig.board.wire(), [0; 0], "nothing more is sent");
}

#[test]
fn a_stop_overtakes_a_start() {
    let mut rig = Rig::new();
    rig.until(|state| state["connected"] == true && !state["settings"].is_null());
    rig.send(&json!({"type": "take", "device": 0}));
    rig.send(&json!({"type": "apply", "id": 1, "device": 0, "settings": {}}));
    rig.send(&json!({"type": "start", "id": 2, "device": 0}));
    rig.send(&json!({"type": "stop", "id": 3, "device": 0}));
    let _ = rig.ask(4, json!({"type": "acknowledge"}));
    let start = rig.texts.iter().find(|text| text["id"] == 2).unwrap();
    assert_eq!(start["text"], "not started: a stop was requested after it");
    rig.run(3000);
    assert_eq!(rig.newest("state")["ventilating"], false);
}

#[test]
fn leaving_gives_the_lease_back_and_leaves_the_ventilation() {
    let mut rig = Rig::new();
    rig.start();
    rig.until(|state| state["lease"] == "this server");
    for byte in rig.board.leave() {
        rig.chip.hear(byte);
    }
    rig.board = Board::new(43, 900);
    rig.until(|state| state["connected"] == true && state["ventilating"] == true && state["lease"].is_null());
}

#[test]
fn a_board_of_another_protocol_and_noise_are_told() {
    let mut rig = Rig::new();
    rig.joined = false;
    rig.board.hear(&[1, 2, 3, 0, 9, 9, 0], rig.now_ms);
    let greeting: (u8, u16, u8, u16, [u8; 3]) = (0, 1, 0, 99, [1, 2, 3]);
    let mut buffer = [0; FRAME_BYTES];
    let frame = encode_frame(&greeting, &mut buffer).unwrap().to_vec();
    rig.board.hear(&frame, rig.now_ms);
    rig.run(1000);
    let lost = rig.newest("state")["lost"].as_str().unwrap().to_owned();
    assert!(lost.contains("the board uses protocol 99") && lost.contains("update the older side"), "{lost}");
}
