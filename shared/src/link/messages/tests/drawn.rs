//! Messages drawn from all that can be sent.

use super::*;

fn settings() -> impl Strategy<Value = Settings> {
    prop::array::uniform(-1.0e6f32..1.0e6).prop_map(Settings::from_values)
}

fn exploration() -> impl Strategy<Value = Option<Exploration>> {
    let drawn = (0.0f32..1.0, any::<u64>()).prop_map(|(boundary_probability, seed)| Exploration {
        boundary_probability,
        seed,
        ..Exploration::default()
    });
    prop::option::of(drawn)
}

fn sweep() -> impl Strategy<Value = Option<SineSweep>> {
    let drawn = (0.0f32..20.0, any::<u8>(), any::<u32>());
    prop::option::of(drawn.prop_map(|(amplitude, phases, first_breath)| SineSweep {
        amplitude,
        phases,
        first_breath,
        ..SWEEP
    }))
}

fn controller() -> impl Strategy<Value = ControllerChoice> {
    let pid = |(p, i, d)| ControllerChoice::Pid(PidGains { p, i, d });
    let gains = (0.0f32..100.0, 0.0f32..1000.0, 0.0f32..10.0);
    prop_oneof![Just(ControllerChoice::Learned), gains.prop_map(pid)]
}

fn mode() -> impl Strategy<Value = Mode> {
    prop_oneof![Just(Mode::Standby), Just(Mode::Ventilating), Just(Mode::Fault(Fault::HighPressure))]
}

fn request() -> impl Strategy<Value = Request> {
    let chunk = prop::collection::vec(any::<u8>(), 0..=CHUNK_BYTES);
    prop_oneof![
        Just(Request::Identify),
        Just(Request::GetSettings),
        settings().prop_map(Request::ApplySettings),
        Just(Request::Start),
        Just(Request::Stop),
        Just(Request::Acknowledge),
        controller().prop_map(Request::SetController),
        exploration().prop_map(Request::SetExploration),
        any::<bool>().prop_map(|on| Request::Telemetry { on }),
        (any::<u32>(), any::<u32>()).prop_map(|(length, id)| Request::BeginWeights { length, id }),
        (any::<u32>(), chunk).prop_map(|(offset, bytes)| Request::WeightsChunk {
            offset,
            bytes: Vec::from_slice(&bytes).unwrap(),
        }),
        Just(Request::CommitWeights),
        Just(Request::Reset),
        settings().prop_map(Request::QueueSettings),
        any::<bool>().prop_map(|clear| Request::GetTiming { clear }),
        any::<u64>().prop_map(|seed| Request::ResetPlant { seed }),
        Just(Request::GetRecorder),
        any::<u32>().prop_map(|from| Request::ReadRecorder { part: RecorderPart::Slow, from }),
        Just(Request::ClearRecorder),
        Just(Request::GetAlarms),
        any::<u16>().prop_map(|seconds| Request::PauseAudio { seconds }),
        Just(Request::GetAudio),
        Just(Request::GetSelfTest),
        Just(Request::RunSelfTest(Check::Relief)),
        (".{0,40}", any::<bool>())
            .prop_map(|(name, take_over)| Request::AcquireLease { name: HostName::new(&name), take_over }),
        Just(Request::ReleaseLease),
        Just(Request::GetLease),
        calibration().prop_map(Request::StoreCalibration),
        any::<u16>().prop_map(|back| Request::GetCalibration { back }),
        Just(Request::CommitBench),
        sweep().prop_map(Request::SetSweep),
    ]
}

fn calibration() -> impl Strategy<Value = Calibration> {
    let values = prop::array::uniform8(-1.0e3f32..1.0e3);
    (values, any::<u32>()).prop_map(
        |([sensor_zero, sensor_gain, dead_time_ms, lag_ms, a, b, c, d], measured_at)| Calibration {
            sensor_zero,
            sensor_gain,
            dead_time_ms,
            lag_ms,
            valve_flow: [a, b, c, d],
            measured_at,
        },
    )
}

fn refusal() -> impl Strategy<Value = Refusal> {
    let out_of_bounds = |(field, value)| {
        let field = FieldIndex(field);
        SettingsError::OutOfBounds { field, value, min: 4.0, max: 80.0 }
    };
    prop_oneof![
        (0u8..8, -1.0e3f32..1.0e3).prop_map(move |seen| Refusal::Settings(out_of_bounds(seen))),
        any::<u32>().prop_map(|expected| Refusal::WrongOffset { expected }),
        Just(Refusal::BadImage(ImageProblem::Golden)),
        Just(Refusal::UnknownRequest),
        ".{0,40}".prop_map(|name| Refusal::Lease { holder: HostName::new(&name) }),
    ]
}

fn slot() -> impl Strategy<Value = SlotState> {
    prop_oneof![
        Just(SlotState::Empty),
        Just(SlotState::Torn),
        Just(SlotState::Invalid(ImageProblem::Golden)),
        any::<(u32, u32)>().prop_map(|(generation, id)| SlotState::Valid { generation, id }),
    ]
}

fn response() -> impl Strategy<Value = Response> {
    let identity = (any::<u16>(), any::<[u16; 3]>(), any::<u32>(), mode(), controller(), exploration());
    let failure =
        prop::option::of("[ -~]{0,120}".prop_map(|text| heapless::String::try_from(&*text).unwrap()));
    let key = prop::option::of(any::<[u8; 8]>().prop_map(KeyId));
    let identity = (identity, slot(), slot(), failure, key);
    let identity = identity.prop_map(|(device, a, b, failure, weights_key)| DeviceIdentity {
        protocol: device.0,
        firmware: device.1,
        device: DeviceKind::HardwareInTheLoop,
        period_us: device.2,
        mode: device.3,
        controller: device.4,
        exploration: device.5,
        slots: [a, b],
        running: Some(Slot::B),
        reset: ResetCause::Watchdog,
        failure,
        weights_key,
    });
    prop_oneof![
        identity.prop_map(Response::Identity),
        (settings(), prop::option::of(settings()))
            .prop_map(|(in_force, pending)| Response::Settings { in_force, pending }),
        mode().prop_map(Response::Mode),
        controller().prop_map(Response::Controller),
        exploration().prop_map(Response::Exploration),
        any::<bool>().prop_map(|on| Response::Telemetry { on }),
        any::<u32>().prop_map(|offset| Response::Progress { offset }),
        any::<u32>().prop_map(|id| Response::Weights { id, slot: Slot::B }),
        Just(Response::Done),
        refusal().prop_map(Response::Refused),
        any::<u8>().prop_map(|free| Response::Queued { free }),
        any::<u32>().prop_map(|ticks| Response::Timing(TickTimes { ticks, ..TickTimes::default() })),
        (any::<u16>(), any::<u32>(), mode()).prop_map(|(boot, first, mode)| {
            let recording = if let Mode::Fault(fault) = mode {
                RecordingState::Fault(fault)
            } else {
                RecordingState::Running
            };
            Response::Recorder(RecorderStatus { boot, recording, fast: Held { first, ..HELD }, ..STATUS })
        }),
        (any::<u32>(), prop::collection::vec(any::<u8>(), 0..=PAGE_BYTES)).prop_map(|(first, bytes)| {
            Response::Recorded(Page {
                part: RecorderPart::Log,
                first,
                bytes: Vec::from_slice(&bytes).unwrap(),
            })
        }),
        any::<(u32, u32)>().prop_map(|(present, indicated)| Response::Alarms(alarms(present, indicated))),
        any::<u16>().prop_map(|pause_left| Response::Audio(AudioStatus { pause_left, ..AUDIO })),
        prop::collection::vec(-100.0f32..100.0, 0..=REPORT_STEPS).prop_map(|values| {
            let result = |value| StepResult { outcome: Outcome::Failed(Finding::Leak), value };
            Response::SelfTest(values.into_iter().map(result).collect())
        }),
        (prop::option::of(".{0,40}"), any::<bool>()).prop_map(|(name, yours)| {
            let holder = name.map(|name| HostName::new(&name));
            Response::Lease(LeaseStatus { holder, yours })
        }),
        (any::<u16>(), prop::option::of(calibration()))
            .prop_map(|(stored, calibration)| Response::Calibration { stored, calibration }),
        sweep().prop_map(Response::Sweep),
    ]
}

fn event() -> impl Strategy<Value = Event> {
    let flow = prop::option::of(-2.0f32..2.0);
    let samples = (any::<u32>(), any::<u32>(), prop::array::uniform5(-100.0f32..100.0), flow);
    let samples = samples.prop_map(|(breath, tick, values, flow)| sample(breath, tick, values, flow));
    let samples = prop::collection::vec(samples, 0..=BATCH_SAMPLES);
    prop_oneof![
        (any::<u32>(), any::<u64>(), any::<u32>(), samples).prop_map(
            |(sequence, first, dropped, samples)| {
                let counters = Counters { dropped, ..Counters::default() };
                batch(sequence, first, counters, &samples)
            }
        ),
        (any::<u32>(), 0.0f32..50.0, prop::option::of(0.0f32..0.3), any::<u8>()).prop_map(
            |(breath, peak_pressure, leak, adopted)| Event::Breath(BreathSummary {
                breath,
                mean_absolute_error: 1.5,
                peak_pressure,
                end_pressure: 5.0,
                leak,
                lesson: Lesson::Forget,
                adopted,
            })
        ),
        any::<u64>().prop_map(|tick| Event::Alarm { fault: Fault::HighPressure, tick }),
        any::<u64>().prop_map(|tick| Event::Unacknowledged { fault: Fault::HighPressure, tick }),
    ]
}

fn to_host() -> impl Strategy<Value = ToHost> {
    prop_oneof![
        (any::<u16>(), response()).prop_map(|(sequence, response)| ToHost::Response { sequence, response }),
        event().prop_map(ToHost::Event),
    ]
}

proptest! {
    #[test]
    fn every_request_arrives_as_it_was_sent(sequence: u16, request in request(), host: Option<u32>) {
        let message = ToDevice { sequence, request, host };
        prop_assert_eq!(read_request(&through(&message)), Ok(message));
    }

    #[test]
    fn every_reply_arrives_as_it_was_sent(message in to_host()) {
        let content = through(&message);
        if let ToHost::Response { response: Response::Identity(identity), .. } = &message {
            prop_assert_eq!(greeted_protocol(&content), Some(identity.protocol));
        }
        prop_assert_eq!(read_reply(&content), Ok(message));
    }

    #[test]
    fn random_contents_never_panic(content in prop::collection::vec(any::<u8>(), 0..600)) {
        let _ = greeted_protocol(&content);
        if let Ok(message) = read_request(&content) {
            prop_assert!(read_request(&through(&message)).is_ok());
        }
        if let Ok(ToHost::Event(Event::Telemetry(batch))) = read_reply(&content) {
            prop_assert!(batch.samples.len() <= BATCH_SAMPLES);
        }
    }
}
