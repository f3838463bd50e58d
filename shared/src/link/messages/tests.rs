use std::string::String;
use std::vec;
use std::vec::Vec as StdVec;

use proptest::prelude::*;

use super::*;
use crate::breath::Phase;
use crate::calibration::tests::SOUND;
use crate::calibration::{CalibrationError, Quantity};
use crate::control::memory::Lesson;
use crate::explore::sines::{SweepError, SweepQuantity};
use crate::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, MESSAGE_BYTES, Poll, encode_frame};
use crate::link::self_test::{Finding, Outcome, REPORT_STEPS, Step, StepResult};
use crate::link::telemetry::{BATCH_SAMPLES, Counters, PackedSample};
use crate::recorder::{Held, PAGE_BYTES, RecordingState};
use crate::reset::ResetCause;
use crate::settings::{FieldIndex, SettingsError};
use crate::timing::CycleStats;
use crate::ventilator::Sample;
use crate::weights::ImageProblem;
use crate::weights::slots::{Slot, SlotState};

mod drawn;
mod page;

#[test]
fn no_response_is_longer_than_a_page_of_the_recorder_needs() {
    assert!(size_of::<Response>() <= 272, "{} bytes, which every answer takes", size_of::<Response>());
}

fn hex<M: Serialize>(message: &M) -> String {
    let mut buffer = [0; MESSAGE_BYTES];
    let bytes = postcard::to_slice(message, &mut buffer).unwrap();
    let digits = bytes.iter().flat_map(|byte| [byte >> 4, byte & 15]);
    digits.filter_map(|digit| char::from_digit(digit.into(), 16)).collect()
}

fn alarms(present: u32, indicated: u32) -> AlarmStatus {
    let [present, indicated] = [present, indicated].map(FaultSet::from_bits);
    AlarmStatus { present, indicated, level: Level::CappedPid }
}

const AUDIO: AudioStatus = AudioStatus { priority: Some(Priority::Medium), pause_left: 120 };

const TIMES: TickTimes = TickTimes {
    core_hz: 1024,
    ticks: 1,
    missed: 0,
    latency: CycleStats { shortest: 2, mean: 1.0, longest: 4 },
    work: CycleStats { shortest: 0, mean: 0.0, longest: 0 },
    period: CycleStats { shortest: 0, mean: 0.0, longest: 0 },
    histogram: [0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 12],
};

const HELD: Held = Held { first: 1, next: 300, origin: u32::MAX };
const STATUS: RecorderStatus = RecorderStatus {
    boot: 2,
    recording: RecordingState::Fault(Fault::HighPressure),
    tick: 128,
    tick_boot: 1,
    fast: HELD,
    slow: Held { first: 0, next: 15, origin: 19 },
    log: Held { first: 0, next: 4, origin: 0 },
};

fn sample(breath: u32, tick: u32, values: [f32; 5], flow: Option<f32>) -> PackedSample {
    let [target, pressure, u_in, explore, learned] = values;
    PackedSample::pack(&Sample {
        breath,
        tick,
        phase: Phase::Fall,
        target,
        pressure,
        u_in,
        u_out: true,
        explore,
        learned,
        flow,
    })
}

fn batch(sequence: u32, first_tick: u64, counters: Counters, samples: &[PackedSample]) -> Event {
    Event::Telemetry(TelemetryBatch {
        sequence,
        first_tick,
        counters,
        samples: Vec::from_slice(samples).unwrap(),
    })
}

/// Encodes and decodes a message as a frame; returns its content.
fn through<M: Serialize>(message: &M) -> StdVec<u8> {
    let (mut buffer, mut decoder) = ([0; FRAME_BYTES], FrameDecoder::<DECODER_BYTES>::new());
    let mut content = None;
    for byte in encode_frame(message, &mut buffer).unwrap() {
        if let Poll::Frame(bytes) = decoder.push(*byte) {
            content = Some(bytes.to_vec());
        }
    }
    content.unwrap()
}

const SWEEP: SineSweep = SineSweep {
    amplitude: 10.0,
    lowest_hz: 2.0,
    ratio: 1.5,
    frequencies: 20,
    phases: 6,
    first_breath: 300,
    from_s: 0.5,
};

/// Every request and, after the sequence number 300, its bytes.
fn requests() -> StdVec<(Request, &'static str)> {
    vec![
        (Request::Identify, "ac0200"),
        (Request::GetSettings, "ac0201"),
        (
            Request::ApplySettings(Settings::default()),
            "ac02020000a0410000a0400000a0410000803f000000000000003f0000a04000007042cdcccc3e9a99193f00000000000000000000000000000000",
        ),
        (Request::Start, "ac0203"),
        (Request::Stop, "ac0204"),
        (Request::Acknowledge, "ac0205"),
        (
            Request::SetController(ControllerChoice::Pid(PidGains { p: 1.0, i: 2.0, d: 0.5 })),
            "ac0206000000803f000000400000003f",
        ),
        (Request::SetController(ControllerChoice::Learned), "ac020601"),
        (Request::SetExploration(None), "ac020700"),
        (
            Request::SetExploration(Some(Exploration::default())),
            "ac0207019a99193e000000000000c842cdcc4c3d9a99993e0000f0c10000f041cdcccc3d0000003f00",
        ),
        (Request::Telemetry { on: true }, "ac020801"),
        (Request::BeginWeights { length: 5510, id: 0xDEAD_BEEF }, "ac0209862beffdb6f50d"),
        (
            Request::WeightsChunk { offset: 128, bytes: Vec::from_slice(&[0, 1, 255]).unwrap() },
            "ac020a8001030001ff",
        ),
        (Request::CommitWeights, "ac020b"),
        (Request::Reset, "ac020c"),
        (
            Request::QueueSettings(Settings::default()),
            "ac020d0000a0410000a0400000a0410000803f000000000000003f0000a04000007042cdcccc3e9a99193f00000000000000000000000000000000",
        ),
        (Request::GetTiming { clear: true }, "ac020e01"),
        (Request::ResetPlant { seed: 128 }, "ac020f8001"),
        (Request::GetRecorder, "ac0210"),
        (Request::ReadRecorder { part: RecorderPart::Log, from: 300 }, "ac021102ac02"),
        (Request::ClearRecorder, "ac0212"),
        (Request::GetAlarms, "ac0213"),
        (Request::PauseAudio { seconds: 300 }, "ac0214ac02"),
        (Request::GetAudio, "ac0215"),
        (Request::GetSelfTest, "ac0216"),
        (Request::RunSelfTest(Check::Zero), "ac021700"),
        (Request::RunSelfTest(Check::Circuit), "ac021701"),
        (Request::RunSelfTest(Check::Relief), "ac021702"),
        (
            Request::AcquireLease { name: HostName::new("anna@icu"), take_over: true },
            "ac021808616e6e614069637501",
        ),
        (Request::ReleaseLease, "ac0219"),
        (Request::GetLease, "ac021a"),
        (
            Request::StoreCalibration(SOUND),
            "ac021b0000003f6666863f000040410000c8410000803e0000403f0000a03f0000e03f80a4a7da06",
        ),
        (Request::GetCalibration { back: 300 }, "ac021cac02"),
        (Request::CommitBench, "ac021d"),
        (Request::SetSweep(None), "ac021e00"),
        (Request::SetSweep(Some(SWEEP)), "ac021e0100002041000000400000c03f1406ac020000003f"),
    ]
}

#[test]
fn the_bytes_of_every_request_are_pinned() {
    for (request, expected) in requests() {
        let message = ToDevice { sequence: 300, request, host: None };
        assert_eq!(hex(&message), expected, "{message:?}");
        let message = ToDevice { host: Some(300), ..message };
        assert_eq!(hex(&message), std::format!("{expected}01ac02"), "{message:?}");
    }
}

/// Every response except [`Response::Refused`], and its bytes with the sequence number 5.
fn responses() -> StdVec<(Response, &'static str)> {
    let identity = DeviceIdentity {
        protocol: PROTOCOL,
        firmware: [0, 1, 200],
        device: DeviceKind::HardwareInTheLoop,
        period_us: 1000,
        mode: Mode::Fault(Fault::HighPressure),
        controller: ControllerChoice::Learned,
        exploration: None,
        slots: [SlotState::Valid { generation: 1, id: 7 }, SlotState::Torn],
        running: Some(Slot::A),
        reset: ResetCause::Software,
        failure: Some(heapless::String::try_from("no").unwrap()),
        weights_key: Some(KeyId([9, 8, 7, 6, 5, 4, 3, 2])),
    };
    let in_force = Settings::default();
    vec![
        (
            Response::Identity(identity),
            "000500040001c80101e807020201000301070101000301026e6f010908070605040302",
        ),
        (
            Response::Settings { in_force, pending: None },
            "0005010000a0410000a0400000a0410000803f000000000000003f0000a04000007042cdcccc3e9a99193f0000000000000000000000000000000000",
        ),
        (Response::Mode(Mode::Ventilating), "00050201"),
        (Response::Controller(ControllerChoice::Learned), "00050301"),
        (Response::Exploration(None), "00050400"),
        (Response::Telemetry { on: false }, "00050500"),
        (Response::Progress { offset: 128 }, "0005068001"),
        (Response::Weights { id: 1, slot: Slot::B }, "0005070101"),
        (Response::Done, "000508"),
        (Response::Queued { free: 3 }, "00050a03"),
        (
            Response::Timing(TIMES),
            "00050b80080100020000803f0400000000000000000000000000000000000000000000000c",
        ),
        (Response::Recorder(STATUS), "00050c02030280010101ac02ffffffff0f000f13000400"),
        (
            Response::Recorded(Page {
                part: RecorderPart::Slow,
                first: 128,
                bytes: Vec::from_slice(&[7, 8]).unwrap(),
            }),
            "00050d018001020708",
        ),
        (Response::Alarms(alarms(1, 0x8000_0001)), "00050e01818080800802"),
        (Response::Audio(AUDIO), "00050f010178"),
        (
            Response::SelfTest(
                [Outcome::NotRun, Outcome::Runs, Outcome::Passed, Outcome::Failed(Finding::Alarm)]
                    .into_iter()
                    .map(|outcome| StepResult { outcome, value: 1.0 })
                    .collect(),
            ),
            "00051004000000803f010000803f020000803f03110000803f",
        ),
        (Response::Lease(LeaseStatus { holder: Some(HostName::new("a")), yours: true }), "00051101016101"),
        (Response::Lease(LeaseStatus::default()), "0005110000"),
        (
            Response::Calibration { stored: 300, calibration: Some(SOUND) },
            "000512ac02010000003f6666863f000040410000c8410000803e0000403f0000a03f0000e03f80a4a7da06",
        ),
        (Response::Calibration { stored: 0, calibration: None }, "0005120000"),
        (Response::Sweep(Some(SWEEP)), "0005130100002041000000400000c03f1406ac020000003f"),
        (Response::Sweep(None), "00051300"),
    ]
}

#[test]
fn the_bytes_of_every_response_are_pinned() {
    for (response, expected) in responses() {
        let message = ToHost::Response { sequence: 5, response };
        assert_eq!(hex(&message), expected, "{message:?}");
    }
}

#[test]
fn the_bytes_of_every_refusal_are_pinned() {
    let bounds = SettingsError::OutOfBounds { field: FieldIndex(2), value: 200.0, min: 4.0, max: 80.0 };
    let refusals = [
        (Refusal::Settings(bounds), "0900000200004843000080400000a042"),
        (Refusal::Settings(SettingsError::PipBelowPeep { pip: 5.0, peep: 8.0 }), "0900010000a04000000041"),
        (
            Refusal::Settings(SettingsError::LimitTooLow { limit: 40.0, pip: 38.0, margin: 5.0 }),
            "09000200002042000018420000a040",
        ),
        (
            Refusal::Settings(SettingsError::BreathTooShort { inspiration: 1.5, breath: 1.0 }),
            "0900030000c03f0000803f",
        ),
        (Refusal::Settings(SettingsError::Period { period_us: 1 }), "09000401"),
        (
            Refusal::Settings(SettingsError::TriggerInNoise {
                field: FieldIndex(8),
                value: 0.5,
                lowest: 1.0,
            }),
            "090005080000003f0000803f",
        ),
        (
            Refusal::Settings(SettingsError::LimitsCrossed {
                field: FieldIndex(10),
                upper: FieldIndex(11),
                low: 2.0,
                high: 1.0,
            }),
            "0900060a0b000000400000803f",
        ),
        (Refusal::Gains, "0901"),
        (Refusal::Exploration, "0902"),
        (Refusal::Ventilating, "0903"),
        (Refusal::FaultLatched, "0904"),
        (Refusal::NoFault, "0905"),
        (Refusal::NoWeights, "0906"),
        (Refusal::NoUpload, "0907"),
        (Refusal::WrongLength, "0908"),
        (Refusal::WrongOffset { expected: 256 }, "09098002"),
        (Refusal::BadImage(ImageProblem::Length), "090a00"),
        (Refusal::BadImage(ImageProblem::Golden), "090a08"),
        (Refusal::OtherImage, "090b"),
        (Refusal::Storage, "090c"),
        (Refusal::UnknownRequest, "090d"),
        (Refusal::QueueFull, "090e"),
        (Refusal::NoPlant, "090f"),
        (Refusal::NoSensor, "0910"),
        (Refusal::PauseTooLong, "0911"),
        (Refusal::NothingSounds, "0912"),
        (Refusal::SelfTestFailed { step: Step::Relief, finding: Finding::Program }, "09130700"),
        (Refusal::SelfTestRuns, "0914"),
        (Refusal::Lease { holder: HostName::new("a") }, "09150161"),
        (Refusal::NoLease, "0916"),
        (Refusal::NotConfirmed, "0917"),
        (Refusal::Unsigned, "0918"),
        (Refusal::WrongSignature, "0919"),
        (Refusal::OldWeights { version: 1, stored: 128 }, "091a018001"),
        (Refusal::OtherPlant, "091b"),
        (
            Refusal::Calibration(CalibrationError::OutOfBounds { quantity: Quantity::ValveFlow, value: 1.0 }),
            "091c00040000803f",
        ),
        (Refusal::Calibration(CalibrationError::FlowFalls { from: 2.0, to: 1.0 }), "091c01000000400000803f"),
        (Refusal::CalibrationStorage, "091d"),
        (Refusal::NoCalibrations, "091e"),
        (Refusal::NoBench, "091f"),
        (Refusal::BadBench, "0920"),
        (Refusal::Sweep(SweepError { quantity: SweepQuantity::From, value: 1.0 }), "0921060000803f"),
        (Refusal::AlarmPresent, "0922"),
    ];
    for (refusal, expected) in refusals {
        let response = Response::Refused(refusal);
        assert_eq!(hex(&response), expected, "{refusal:?}");
    }
}

/// Every event and its bytes.
fn events() -> StdVec<(Event, &'static str)> {
    let counters =
        Counters { dropped: 1, corrupt_frames: 2, missed_ticks: 3, worst_tick_us: 400, mean_tick_us: 55.5 };
    let samples = [
        sample(1, 700, [20.0, 19.5, 30.0, 0.0, 0.0], None),
        sample(1, 701, [20.0, 19.5, 30.0, -0.0, 1.5], Some(-0.25)),
    ];
    let summary = |leak, lesson, adopted| {
        Event::Breath(BreathSummary {
            breath: 9,
            mean_absolute_error: 1.25,
            peak_pressure: 21.0,
            end_pressure: 5.0,
            leak,
            lesson,
            adopted,
        })
    };
    vec![
        (
            batch(2, 1000, counters, &samples),
            "010002e807010203900300005e420201bc0501010000a04100009c410000f04100000001bd0501010000a04100009c410000f0410100000080010000c03f01000080be",
        ),
        (summary(None, Lesson::Adopt, 4), "0101090000a03f0000a8410000a040000004"),
        (summary(Some(0.5), Lesson::Discard, 3), "0101090000a03f0000a8410000a040010000003f0103"),
        (summary(Some(0.0), Lesson::Forget, 0), "0101090000a03f0000a8410000a04001000000000200"),
        (Event::Alarm { fault: Fault::ReadingNotANumber, tick: 1 }, "01020001"),
        (Event::Alarm { fault: Fault::ReadingOutOfRange, tick: 1 }, "01020101"),
        (Event::Alarm { fault: Fault::HighPressure, tick: 1 }, "01020201"),
        (Event::Unacknowledged { fault: Fault::HighPressure, tick: 1 }, "01030201"),
    ]
}

#[test]
fn the_bytes_of_every_event_are_pinned() {
    for (event, expected) in events() {
        assert_eq!(hex(&ToHost::Event(event.clone())), expected, "{event:?}");
    }
}

#[test]
fn the_longest_messages_fit_into_a_frame() {
    let largest = Counters {
        dropped: u32::MAX,
        corrupt_frames: u32::MAX,
        missed_ticks: u32::MAX,
        worst_tick_us: u32::MAX,
        mean_tick_us: 1.0,
    };
    let samples = [sample(u32::MAX, u32::MAX, [1.0; 5], Some(1.0)); BATCH_SAMPLES];
    let event = ToHost::Event(batch(u32::MAX, u64::MAX, largest, &samples));
    assert_eq!(read_reply(&through(&event)), Ok(event));
    let chunk =
        Request::WeightsChunk { offset: u32::MAX, bytes: Vec::from_slice(&[0xFF; CHUNK_BYTES]).unwrap() };
    let page =
        Page { part: RecorderPart::Fast, first: u32::MAX, bytes: Vec::from_slice(&[1; PAGE_BYTES]).unwrap() };
    let answer = ToHost::Response { sequence: u16::MAX, response: Response::Recorded(page) };
    assert_eq!(read_reply(&through(&answer)), Ok(answer));
    let message = ToDevice { sequence: u16::MAX, request: chunk, host: Some(u32::MAX) };
    assert_eq!(read_request(&through(&message)), Ok(message));
}

#[test]
fn an_unknown_request_can_be_refused_under_its_number() {
    assert_eq!(read_request(&[0xAC, 0x02, 99]), Err(Unreadable { sequence: Some(300) }));
    assert_eq!(read_request(&[]), Err(Unreadable { sequence: None }));
    assert_eq!(read_request(&[5, 3, 0]).unwrap_err().sequence, Some(5), "a byte too many");
    let response = Response::Refused(Refusal::UnknownRequest);
    let refusal = Unreadable { sequence: Some(300) }.refusal();
    assert_eq!(refusal, Some(ToHost::Response { sequence: 300, response }));
    assert_eq!(Unreadable { sequence: None }.refusal(), None);
}

#[test]
fn the_id_of_the_weights_that_run_is_that_of_their_slot() {
    let running = |running, slots| {
        let identity = DeviceIdentity {
            protocol: PROTOCOL,
            firmware: [1, 2, 3],
            device: DeviceKind::Ventilator,
            period_us: 1000,
            mode: Mode::Standby,
            controller: ControllerChoice::Learned,
            exploration: None,
            slots,
            running,
            reset: ResetCause::PowerOn,
            failure: None,
            weights_key: None,
        };
        identity.running_id()
    };
    let slots = [SlotState::Valid { generation: 1, id: 70 }, SlotState::Valid { generation: 2, id: 80 }];
    assert_eq!((running(Some(Slot::A), slots), running(Some(Slot::B), slots)), (Some(70), Some(80)));
    assert_eq!(running(None, slots), None);
    assert_eq!(running(Some(Slot::A), [SlotState::Torn; 2]), None);
}

#[test]
fn a_greeting_of_another_version_is_recognised() {
    assert_eq!(greeted_protocol(&[0, 5, 0, 77, 1, 2, 3, 4, 5]), Some(77));
    assert_eq!(greeted_protocol(&[0, 5, 8]), None);
    assert_eq!(greeted_protocol(&[1, 5, 0, 77]), None);
}
