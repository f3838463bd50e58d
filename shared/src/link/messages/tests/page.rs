//! `docs/DEVICE_LINK.md`: the numbers of its lists and the frames of its examples.

use std::format;

use super::*;
use crate::control::memory::Lesson;
use crate::control::pid::{KNOWN_GOOD, PidGains};
use crate::settings::{FieldIndex, Settings, SettingsError};

const PAGE: &str = include_str!("../../../../../docs/DEVICE_LINK.md");

/// The rows of the list below a heading, as number and name.
fn list(heading: &str) -> StdVec<(u8, &'static str)> {
    let (_, below) = PAGE.split_once(heading).unwrap();
    let lines = below.trim_start_matches('\n').lines().map_while(|line| line.strip_prefix("    "));
    // A line that continues the row above is indented further.
    let rows = lines.filter(|line| !line.starts_with(' '));
    rows.map(|row| {
        let mut words = row.split_whitespace();
        // A star marks what a small device knows.
        (words.next().unwrap().parse().unwrap(), words.next().unwrap().trim_end_matches('*'))
    })
    .collect()
}

/// Numbers and names of variants, each once.
fn variants<M: Serialize + core::fmt::Debug>(messages: impl IntoIterator<Item = M>) -> StdVec<(u8, String)> {
    let mut found: StdVec<(u8, String)> = messages
        .into_iter()
        .map(|message| {
            let number = u8::from_str_radix(&hex(&message)[..2], 16).unwrap();
            let name = format!("{message:?}");
            (number, name.split(|c: char| !c.is_alphanumeric()).next().unwrap().into())
        })
        .collect();
    found.sort();
    found.dedup();
    found
}

fn compare(heading: &str, variants: &[(u8, String)]) {
    let variants: StdVec<_> = variants.iter().map(|(number, name)| (*number, name.as_str())).collect();
    assert_eq!(list(heading), variants, "{heading}");
}

#[test]
fn the_page_numbers_every_message() {
    compare(
        "Requests, and the name of the response:",
        &variants(requests().into_iter().map(|(request, _)| request)),
    );
    let refused = [Response::Refused(Refusal::NoLease)];
    let responses = responses().into_iter().map(|(response, _)| response).chain(refused);
    compare("Responses:", &variants(responses));
    let error = SettingsError::OutOfBounds { field: FieldIndex(0), value: 80.0, min: 5.0, max: 60.0 };
    compare(
        "Refusals that a small device needs:",
        &variants([
            Refusal::Settings(error),
            Refusal::FaultLatched,
            Refusal::NoFault,
            Refusal::UnknownRequest,
            Refusal::QueueFull,
            Refusal::NotConfirmed,
        ]),
    );
    compare("Events:", &variants(events().into_iter().map(|(event, _)| event)));
    assert!(PAGE.contains(&format!("It describes version {PROTOCOL}.")));
    assert!(PAGE.contains(&format!("1 to {MESSAGE_BYTES} bytes")));
}

/// What the page says of the requests that need no lease.
#[test]
fn the_page_says_which_requests_need_no_lease() {
    let others = ["Identify", "ReadRecorder", "AcquireLease", "ReleaseLease", "Telemetry"];
    for (request, _) in requests() {
        let name = format!("{request:?}");
        let clears = request == Request::GetTiming { clear: true };
        let free = name.starts_with("Get") && !clears || others.iter().any(|other| name.starts_with(other));
        assert_eq!(request.changes(), !free, "{name}");
    }
}

/// The contents of the frames in the examples.
fn examples() -> StdVec<StdVec<u8>> {
    let (_, examples) = PAGE.split_once("## Examples").unwrap();
    let digits: String = examples
        .lines()
        .filter_map(|line| line.strip_prefix("    "))
        .flat_map(|line| line.split_whitespace())
        .collect();
    let mut decoder = FrameDecoder::<DECODER_BYTES>::new();
    let mut contents = vec![];
    for place in (0..digits.len()).step_by(2) {
        let byte = u8::from_str_radix(&digits[place..place + 2], 16).unwrap();
        if let Poll::Frame(content) = decoder.push(byte) {
            contents.push(content.to_vec());
        }
    }
    assert_eq!(decoder.counters().corrupt(), 0);
    contents
}

fn answer(sequence: u16, response: Response) -> ToHost {
    ToHost::Response { sequence, response }
}

/// A simulated board after power-on.
fn board() -> DeviceIdentity {
    DeviceIdentity {
        protocol: PROTOCOL,
        firmware: [0, 1, 0],
        device: DeviceKind::Simulated,
        period_us: 1000,
        mode: Mode::Standby,
        controller: ControllerChoice::Pid(KNOWN_GOOD),
        exploration: None,
        slots: [SlotState::Empty; 2],
        running: None,
        reset: ResetCause::PowerOn,
        failure: None,
        weights_key: None,
    }
}

#[test]
fn the_frames_of_the_page_are_what_is_written_above_them() {
    let frames = examples();
    assert_eq!(frames.len(), 17);
    let host = Some(0x1234_5678);
    let lease = Request::AcquireLease { name: HostName::new("anna"), take_over: false };
    let pid = ControllerChoice::Pid(PidGains { p: 3.0, i: 30.0, d: 0.0 });
    let asked = [
        (0, ToDevice { sequence: 1, request: Request::Identify, host: None }),
        (2, ToDevice { sequence: 2, request: lease, host }),
        (4, ToDevice { sequence: 3, request: Request::Start, host }),
        (7, ToDevice { sequence: 6, request: Request::SetController(pid), host }),
        (9, ToDevice { sequence: 4, request: Request::QueueSettings(Settings::default()), host }),
        (13, ToDevice { sequence: 7, request: Request::GetLease, host }),
    ];
    for (at, expected) in asked {
        assert_eq!(read_request(&frames[at]), Ok(expected));
    }
    let one = PackedSample::pack(&Sample {
        breath: 3,
        tick: 700,
        phase: Phase::Inspiration,
        target: 20.0,
        pressure: 19.5,
        u_in: 30.0,
        u_out: false,
        explore: 0.0,
        learned: 1.5,
        flow: None,
    });
    let counters = Counters { worst_tick_us: 42, mean_tick_us: 17.5, ..Counters::default() };
    let summary = BreathSummary {
        breath: 3,
        mean_absolute_error: 1.25,
        peak_pressure: 21.5,
        end_pressure: 5.1,
        leak: None,
        lesson: Lesson::Adopt,
        adopted: 0,
    };
    let error = SettingsError::OutOfBounds { field: FieldIndex(0), value: 80.0, min: 5.0, max: 60.0 };
    let told = [
        (1, answer(1, Response::Identity(board()))),
        (3, answer(2, Response::Lease(LeaseStatus { holder: Some(HostName::new("anna")), yours: true }))),
        (5, answer(3, Response::Refused(Refusal::NotConfirmed))),
        (6, ToHost::Event(batch(7, 1000, counters, &[one]))),
        (8, answer(6, Response::Controller(pid))),
        (10, answer(4, Response::Queued { free: 7 })),
        (11, answer(8, Response::Refused(Refusal::Settings(error)))),
        (12, answer(9, Response::Mode(Mode::Ventilating))),
        (14, answer(7, Response::Refused(Refusal::UnknownRequest))),
        (15, ToHost::Event(Event::Breath(summary))),
        (16, ToHost::Event(Event::Alarm { fault: Fault::HighPressure, tick: 5000 })),
    ];
    for (at, expected) in told {
        assert_eq!(read_reply(&frames[at]), Ok(expected));
    }
    assert_eq!(greeted_protocol(&frames[1]), Some(PROTOCOL));
}
