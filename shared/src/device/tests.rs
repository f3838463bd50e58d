mod alarms;
mod calibration;
mod lease;
mod recorder;
mod self_test;
mod silence;
mod store;
mod summaries;
mod sweep;
mod trust;

use std::boxed::Box;
use std::vec::Vec;

use proptest::prelude::*;

use super::control::{Control, QUEUE_LENGTH};
use super::server::{DeviceFacts, Server, Store};
use super::*;
use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
use crate::calibration::Calibration;
use crate::calibration::stored::StoredCalibrations;
use crate::control::features::FeatureSpec;
use crate::control::memory::{LEARNING, Lesson};
use crate::control::network::Network;
use crate::control::pid::PidGains;
use crate::control::residual::{Residual, ResidualSpec};
use crate::flash::FlashError;
use crate::flash::nor::Nor;
use crate::link::host_name::HostName;
use crate::link::messages::{AlarmStatus, CHUNK_BYTES, DeviceKind, Event, Request, ToDevice, ToHost};
use crate::link::refusal::Refusal;
use crate::link::telemetry::PackedSample;
use crate::recorder::{Boot, Recorder, RecorderMemory, RecorderPart};
use crate::reset::ResetCause;
use crate::safety::ladder::Level;
use crate::safety::monitors::Monitors;
use crate::sensor::Readings;
use crate::timing::TickTime;
use crate::weights::slots::{Slot, SlotState, StoreError};
use crate::weights::trust::Trust;
use crate::weights::{IMAGE_BYTES, Identity, ImageProblem, decode, encode};

const CORE_HZ: u32 = 168_000_000;
/// Length of a sector of the flash, bytes.
const SECTOR: usize = 4096;
const TICKS_OF_A_BREATH: usize = 3000;
/// Token of the host that steers.
const HOST: Option<u32> = Some(7);

/// A device without a chip: both halves, a plant with a constant 5 cmH2O, and the messages that would go over the link.
struct Rig {
    control: Control,
    server: Server<'static>,
    reports: Vec<ControlReport>,
    events: Vec<ToHost>,
    sequence: u16,
    ticks: u32,
    flash: Flash,
    restarts: usize,
    recorder: Recorder<'static>,
}

/// Flash that keeps the stored images apart from the calibrations, and fails as it is set to.
struct Flash {
    images: Vec<[u8; IMAGE_BYTES]>,
    cells: Nor<4, SECTOR>,
    calibrations: StoredCalibrations,
    fails: Option<StoreError>,
    /// Descriptions of benches; none of a device that simulates no bench.
    benches: Option<Vec<Vec<u8>>>,
}

impl Flash {
    fn new() -> Self {
        let mut cells = Nor::new();
        let calibrations = StoredCalibrations::open(&mut cells, 0, SECTOR as u32);
        Self { images: Vec::new(), cells, calibrations, fails: None, benches: None }
    }

    fn failing() -> Self {
        Self { fails: Some(StoreError::Flash(FlashError::Operation)), ..Self::new() }
    }
}

impl Store for Flash {
    fn store_weights(&mut self, image: &[u8; IMAGE_BYTES]) -> (Result<Slot, StoreError>, [SlotState; 2]) {
        if let Some(error) = self.fails {
            return (Err(error), [SlotState::Empty, SlotState::Torn]);
        }
        self.images.push(*image);
        let id = decode(image).unwrap().id;
        (Ok(Slot::B), [SlotState::Empty, SlotState::Valid { generation: 4, id }])
    }

    fn store_calibration(&mut self, calibration: &Calibration) -> Result<u16, Refusal> {
        self.cells.supply = if self.fails.is_some() { 0 } else { usize::MAX };
        let stored = self.calibrations.store(&mut self.cells, calibration);
        stored.map(|()| self.calibrations.count()).map_err(|_| Refusal::CalibrationStorage)
    }

    fn set_bench(&mut self, description: &[u8]) -> Result<(), Refusal> {
        self.benches.as_mut().ok_or(Refusal::NoBench)?.push(description.to_vec());
        Ok(())
    }

    fn calibration(&mut self, back: u16) -> (u16, Option<Calibration>) {
        (self.calibrations.count(), self.calibrations.get(&mut self.cells, back))
    }
}

/// The control half with a learned controller, if any.
fn control(kind: DeviceKind, learned: Option<&Residual>) -> Control {
    let mut control = Control::new(kind, DEFAULT_PERIOD_US, CORE_HZ).unwrap();
    if let Some(learned) = learned {
        control.learn(learned);
    }
    control
}

impl Rig {
    fn new(learned: Option<&Residual>) -> Self {
        Self::trusting(learned, Trust::Development)
    }

    fn trusting(learned: Option<&Residual>, trust: Trust) -> Self {
        let blank = DeviceFacts::blank(DeviceKind::HardwareInTheLoop);
        let facts = DeviceFacts { firmware: [1, 2, 3], trust, ..blank };
        let memory: &'static RecorderMemory = Box::leak(Box::new(RecorderMemory::new()));
        let boot = Boot { cause: facts.reset, failed: false, weights: None, restored: false };
        Self {
            recorder: Recorder::attach(memory, boot),
            control: control(facts.device, learned).with_monitors(Monitors::ANY_PLANT),
            server: Server::new(facts, memory),
            reports: Vec::new(),
            events: Vec::new(),
            sequence: 0,
            ticks: 0,
            flash: Flash::new(),
            restarts: 0,
        }
    }

    fn run(&mut self, ticks: usize) {
        self.run_at(ticks, 5.0);
    }

    fn run_at(&mut self, ticks: usize, pressure: f32) {
        self.run_on(ticks, |_| pressure.into());
    }

    /// The same, and no gas comes out: above the limit the valves do not obey.
    fn run_blocked(&mut self, ticks: usize, pressure: f32) {
        self.run_on(ticks, |_| Readings { flow: 0.0, ..pressure.into() });
    }

    /// Runs ticks on readings by the tick of the breath.
    fn run_on(&mut self, ticks: usize, readings: impl Fn(u32) -> Readings) {
        for _ in 0..ticks {
            let readings = readings(self.control.state().tick());
            let output = self.control.step(readings);
            self.ticks += 1;
            let Self { control, reports, recorder, .. } = self;
            recorder.record(&control.moment(readings.airway, &output, 0));
            control.report(&output, &mut |report| {
                reports.push(report);
                true
            });
            for report in self.reports.drain(..) {
                self.events.extend(self.server.report(&report));
            }
        }
    }

    /// A request of the host that steers.
    fn ask(&mut self, request: Request) -> Response {
        if request.changes() {
            self.ask_by(HOST, Request::AcquireLease { name: HostName::new("test"), take_over: false });
        }
        self.ask_by(HOST, request)
    }

    /// A request of any host.
    fn ask_by(&mut self, host: Option<u32>, request: Request) -> Response {
        self.sequence += 1;
        self.ask_as(self.sequence, host, request)
    }

    /// Starts ventilation with the default settings.
    fn start(&mut self) {
        self.ask(Request::ApplySettings(Settings::default()));
        assert_eq!(self.ask(Request::Start), Response::Mode(Mode::Ventilating));
    }

    fn ask_as(&mut self, sequence: u16, host: Option<u32>, request: Request) -> Response {
        let request = ToDevice { sequence, request, host };
        let answer = self.server.serve(&request, self.ticks, &mut self.control, &mut self.flash);
        self.restarts += usize::from(answer.restart);
        let ToHost::Response { sequence: answered, response } = answer.message else {
            panic!("no answer: {answer:?}")
        };
        assert_eq!(answered, sequence);
        response
    }

    /// The summaries of the breaths so far.
    fn breaths(&self) -> Vec<BreathSummary> {
        let summary = |event: &ToHost| match event {
            ToHost::Event(Event::Breath(summary)) => Some(*summary),
            _ => None,
        };
        self.events.iter().filter_map(summary).collect()
    }

    fn samples(&self) -> Vec<Sample> {
        let batches = self.events.iter().filter_map(|event| match event {
            ToHost::Event(Event::Telemetry(batch)) => Some(batch),
            _ => None,
        });
        batches.flat_map(|batch| batch.samples.iter().map(PackedSample::unpack)).collect()
    }
}

/// Starts ventilation with the default settings.
fn begin(control: &mut Control) {
    control.execute(&ControlRequest::Apply(Settings::default()));
    control.execute(&ControlRequest::Start);
}

fn residual() -> Residual {
    let spec = ResidualSpec {
        period_us: DEFAULT_PERIOD_US,
        gains: KNOWN_GOOD,
        lambda: 1.0,
        authority: 50.0,
        features: FeatureSpec::default(),
    };
    Residual::new(spec, Network::zero()).unwrap()
}

fn image() -> ([u8; IMAGE_BYTES], u32) {
    let mut bytes = [0; IMAGE_BYTES];
    encode(&residual(), &Identity::default(), &mut bytes).unwrap();
    (bytes, decode(&bytes).unwrap().id)
}

fn upload(rig: &mut Rig, (bytes, id): &([u8; IMAGE_BYTES], u32)) {
    let begun = rig.ask(Request::BeginWeights { length: IMAGE_BYTES as u32, id: *id });
    assert_eq!(begun, Response::Progress { offset: 0 });
    for (index, chunk) in bytes.chunks(CHUNK_BYTES).enumerate() {
        let (offset, bytes) = ((index * CHUNK_BYTES) as u32, heapless::Vec::from_slice(chunk).unwrap());
        let progress = rig.ask(Request::WeightsChunk { offset, bytes });
        assert_eq!(progress, Response::Progress { offset: offset + chunk.len() as u32 });
    }
}

#[test]
fn a_new_device_greets_in_standby_with_the_cautious_pid() {
    let Response::Identity(identity) = Rig::new(None).ask(Request::Identify) else { panic!("no greeting") };
    assert_eq!((identity.mode, identity.controller), (Mode::Standby, ControllerChoice::Pid(KNOWN_GOOD)));
    assert_eq!((identity.firmware, identity.reset), ([1, 2, 3], ResetCause::PowerOn));
}

#[test]
fn a_device_with_weights_runs_them_and_one_without_refuses_to() {
    let mut with = Rig::new(Some(&residual()));
    assert!(
        matches!(with.ask(Request::Identify), Response::Identity(i) if i.controller == ControllerChoice::Learned)
    );
    let chosen = with.ask(Request::SetController(ControllerChoice::Learned));
    assert_eq!(chosen, Response::Controller(ControllerChoice::Learned));
    let mut without = Rig::new(None);
    let refused = without.ask(Request::SetController(ControllerChoice::Learned));
    assert_eq!(refused, Response::Refused(Refusal::NoWeights));
}

#[test]
fn weights_of_another_control_period_are_not_run() {
    let spec = ResidualSpec { period_us: 2000, ..*residual().spec() };
    let mut rig = Rig::new(Some(&Residual::new(spec, Network::zero()).unwrap()));
    let refused = rig.ask(Request::SetController(ControllerChoice::Learned));
    assert_eq!(refused, Response::Refused(Refusal::NoWeights));
}

#[test]
fn every_breath_takes_the_oldest_settings_waiting_and_the_last_ones_stay() {
    let mut rig = Rig::new(None);
    rig.ask(Request::Telemetry { on: true });
    for (pip, free) in [(10.0, 15), (30.0, 14), (20.0, 13)] {
        assert_eq!(rig.ask(Request::QueueSettings(paper_settings(pip))), Response::Queued { free });
    }
    rig.ask(Request::Start);
    rig.run(4 * TICKS_OF_A_BREATH);
    rig.ask(Request::Stop);
    rig.run(1);
    let targets: Vec<_> = rig.samples().iter().filter(|s| s.tick == 500).map(|s| s.target as i32).collect();
    assert_eq!(targets, [10, 30, 20, 20]);
    assert_eq!(rig.samples().len(), 4 * TICKS_OF_A_BREATH, "every tick arrives, the last batch too");
}

#[test]
fn telemetry_flows_while_it_is_on_and_tells_of_refused_frames() {
    let mut rig = Rig::new(None);
    rig.server.corrupt_frames(7);
    rig.start();
    rig.run(200);
    assert_eq!(rig.samples().len(), 0);
    rig.ask(Request::Telemetry { on: true });
    rig.run(200);
    let batch = rig.events.iter().rev().find_map(|event| match event {
        ToHost::Event(Event::Telemetry(batch)) => Some(batch),
        _ => None,
    });
    assert_eq!(batch.unwrap().counters.corrupt_frames, 7);
}

#[test]
fn the_end_of_ventilation_is_reported_once() {
    let mut control = Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, CORE_HZ).unwrap();
    let stops = |control: &mut Control| {
        let output = control.step(5.0);
        let mut stops = 0;
        control.report(&output, &mut |report| {
            stops += usize::from(report == ControlReport::Stopped);
            true
        });
        stops
    };
    assert_eq!(stops(&mut control), 0, "in standby");
    begin(&mut control);
    assert_eq!((stops(&mut control), stops(&mut control)), (0, 0));
    control.execute(&ControlRequest::Stop);
    assert_eq!((stops(&mut control), stops(&mut control)), (1, 0));
}

#[test]
fn the_queue_has_an_end_and_refuses_nonsense() {
    let mut rig = Rig::new(None);
    for _ in 0..QUEUE_LENGTH {
        assert!(matches!(rig.ask(Request::QueueSettings(paper_settings(10.0))), Response::Queued { .. }));
    }
    let full = rig.ask(Request::QueueSettings(paper_settings(10.0)));
    assert_eq!(full, Response::Refused(Refusal::QueueFull));
    let nonsense = rig.ask(Request::QueueSettings(paper_settings(f32::NAN)));
    assert!(matches!(nonsense, Response::Refused(Refusal::Settings(_))));
    rig.ask(Request::Stop);
    assert_eq!(rig.ask(Request::QueueSettings(paper_settings(10.0))), Response::Queued { free: 15 });
}

#[test]
fn a_repeated_request_is_answered_again_and_done_once() {
    let mut rig = Rig::new(None);
    rig.ask(Request::Stop);
    let first = rig.ask_as(9, HOST, Request::QueueSettings(paper_settings(10.0)));
    let again = rig.ask_as(9, HOST, Request::QueueSettings(paper_settings(10.0)));
    assert_eq!((&first, &again), (&Response::Queued { free: 15 }, &Response::Queued { free: 15 }));
    assert!(
        matches!(rig.ask_as(9, HOST, Request::Identify), Response::Identity(_)),
        "a greeting is always new"
    );
}

#[test]
fn controller_and_exploration_change_at_the_breath_boundary() {
    let mut rig = Rig::new(None);
    rig.ask(Request::Telemetry { on: true });
    rig.start();
    rig.run(10);
    let mut always = Exploration { boundary_probability: 1.0, ..Exploration::default() };
    always.boundary_height = (20.0, 20.0);
    rig.ask(Request::SetExploration(Some(always)));
    rig.ask(Request::SetController(ControllerChoice::Pid(PidGains::default())));
    rig.run(TICKS_OF_A_BREATH);
    rig.ask(Request::Stop);
    rig.run(1);
    let samples = rig.samples();
    assert!(samples[..1000].iter().all(|s| s.explore == 0.0 && s.u_in > 40.0), "the running breath goes on");
    let next = &samples[TICKS_OF_A_BREATH];
    assert!(
        (next.explore - 20.0).abs() < 1e-3 && (next.u_in - 20.0).abs() < 1e-3,
        "gains of zero: exploration alone"
    );
}

#[test]
fn exploration_that_makes_no_sense_is_refused_and_the_running_one_stays() {
    let mut rig = Rig::new(None);
    let paper = Exploration::default();
    assert_eq!(rig.ask(Request::SetExploration(Some(paper))), Response::Exploration(Some(paper)));
    for wrong in [
        Exploration { boundary_probability: 1.5, ..paper },
        Exploration { triangle_height: (-30.0, 101.0), ..paper },
        Exploration { boundary_duration: (f32::NAN, 0.3), ..paper },
    ] {
        let refused = rig.ask(Request::SetExploration(Some(wrong)));
        assert_eq!(refused, Response::Refused(Refusal::Exploration), "{wrong:?}");
    }
    assert!(matches!(rig.ask(Request::Identify), Response::Identity(i) if i.exploration == Some(paper)));
    assert_eq!(rig.ask(Request::SetExploration(None)), Response::Exploration(None));
}

/// What explores in the breaths of a device that no request has reached since the first one started.
fn left_alone(monitors: Monitors) -> (Rig, Vec<bool>) {
    let mut rig = Rig::new(None);
    rig.control = rig.control.with_monitors(monitors);
    rig.ask(Request::Telemetry { on: true });
    let always =
        Exploration { boundary_probability: 1.0, boundary_height: (20.0, 20.0), ..Exploration::default() };
    rig.ask(Request::SetExploration(Some(always)));
    rig.start();
    rig.run(6 * TICKS_OF_A_BREATH);
    let starts = rig.samples().into_iter().filter(|sample| sample.tick == 0);
    let explored = starts.map(|sample| sample.explore > 0.0).collect();
    (rig, explored)
}

#[test]
fn a_host_that_falls_silent_ends_the_exploration_and_nothing_else() {
    let silent = |rig: &Rig| {
        let alarm = |event: &ToHost| {
            matches!(event, ToHost::Event(Event::Alarm { fault: Fault::HostSilent, tick: 10_000 }))
        };
        rig.events.iter().filter(|event| alarm(event)).count()
    };
    let others = Fault::all().filter(|fault| *fault != Fault::HostSilent && !Monitors::ANY_PLANT.has(*fault));
    let (mut rig, explored) = left_alone(others.fold(Monitors::ALL, Monitors::without));
    assert_eq!(explored, [true, true, true, true, false, false], "10 s end in the fourth breath");
    assert_eq!(silent(&rig), 1);
    let Response::Identity(identity) = rig.ask(Request::Identify) else { panic!("no greeting") };
    assert_eq!((identity.mode, identity.exploration), (Mode::Ventilating, None));
    let (rig, explored) = left_alone(Monitors::ANY_PLANT);
    assert_eq!((explored, silent(&rig)), (std::vec![true; 6], 0), "a plant that nobody has to watch");
}

/// The alarms of a new device's first ticks after a start that found this.
fn alarms_after(cause: ResetCause, interrupted: bool, slots: [SlotState; 2]) -> Vec<Fault> {
    let mut control = Control::new(DeviceKind::Ventilator, DEFAULT_PERIOD_US, CORE_HZ).unwrap();
    control.report_boot(cause, interrupted, &slots);
    (0..4).filter_map(|_| control.step(5.0).alarm).collect()
}

#[test]
fn a_device_that_has_restarted_by_itself_says_so_once() {
    let after = |cause, interrupted| alarms_after(cause, interrupted, [SlotState::Empty; 2]);
    for requested in [ResetCause::PowerOn, ResetCause::Pin, ResetCause::Software, ResetCause::Other] {
        assert_eq!(after(requested, false), [], "{requested:?}");
        assert_eq!(after(requested, true), [Fault::Restarted], "{requested:?}, while it ventilated");
    }
    for unrequested in [ResetCause::BrownOut, ResetCause::Watchdog] {
        assert_eq!(after(unrequested, false), [Fault::Restarted], "{unrequested:?}");
    }
}

#[test]
fn weights_that_a_start_refuses_are_told_after_the_restart() {
    let valid = SlotState::Valid { generation: 1, id: 2 };
    let after = |slots, interrupted| alarms_after(ResetCause::PowerOn, interrupted, slots);
    assert_eq!(after([SlotState::Empty, valid], false), []);
    for refused in [SlotState::Torn, SlotState::Invalid(ImageProblem::Golden)] {
        assert_eq!(after([valid, refused], false), [Fault::WeightsRefused], "{refused:?}");
        assert_eq!(after([refused, valid], true), [Fault::Restarted, Fault::WeightsRefused], "{refused:?}");
    }
}

/// How long a tick took that so many were missed before.
fn late(missed: u32) -> TickTime {
    TickTime { latency: 20, work: 4000, period: None, missed }
}

#[test]
fn ticks_that_are_missed_reach_the_ladder() {
    let mut control = control(DeviceKind::Ventilator, Some(&residual()));
    begin(&mut control);
    let mut tick = |missed| {
        let mode = control.step(5.0).mode;
        control.record(&late(missed));
        (mode, control.state().level())
    };
    assert_eq!(tick(0), (Mode::Ventilating, Level::Learned));
    assert_eq!(tick(1), (Mode::Ventilating, Level::Pid));
    for _ in 0..10 {
        assert_eq!(tick(0), (Mode::Ventilating, Level::Pid), "counted once");
    }
    tick(4);
    assert_eq!(tick(0), (Mode::Ventilating, Level::Pid));
    assert!(control.state().indications().present().has(Fault::MissedTicks));
}

#[test]
fn the_plant_gets_each_new_peep_and_one_reset_at_the_start() {
    let mut rig = Rig::new(None);
    assert_eq!(rig.control.plant_change(), control::PlantChange { peep: Some(5.0), reset: None });
    assert_eq!(rig.control.plant_change(), control::PlantChange::default());
    assert_eq!(rig.ask(Request::ResetPlant { seed: 77 }), Response::Done);
    rig.ask(Request::QueueSettings(Settings { peep: 8.0, ..paper_settings(20.0) }));
    assert_eq!(rig.control.plant_change(), control::PlantChange::default(), "not in standby");
    rig.ask(Request::Start);
    assert_eq!(rig.control.plant_change(), control::PlantChange { peep: Some(8.0), reset: Some(77) });
    rig.run(1);
    assert_eq!(rig.control.plant_change(), control::PlantChange::default());
    rig.run(TICKS_OF_A_BREATH - 1);
    assert_eq!(rig.control.plant_change(), control::PlantChange::default());
}

#[test]
fn a_fault_is_an_alarm_after_the_last_samples_and_empties_the_queue() {
    let mut rig = Rig::new(None);
    rig.ask(Request::Telemetry { on: true });
    rig.ask(Request::QueueSettings(paper_settings(20.0)));
    rig.ask(Request::QueueSettings(paper_settings(30.0)));
    rig.ask(Request::Start);
    rig.run(20);
    rig.run_blocked(800, 70.0);
    assert!(matches!(
        rig.events.last(),
        Some(ToHost::Event(Event::Alarm { fault: Fault::HardLimit, tick: 722 }))
    ));
    assert_eq!(rig.samples().len(), 722, "0.7 s above the limit with the valves safe");
    assert_eq!(rig.ask(Request::Start), Response::Refused(Refusal::FaultLatched));
    assert!(matches!(rig.ask(Request::GetSettings), Response::Settings { pending: None, .. }));
    rig.ask(Request::QueueSettings(paper_settings(30.0)));
    rig.run(1);
    assert_eq!(rig.ask(Request::Acknowledge), Response::Mode(Mode::Standby));
    assert_eq!(rig.ask(Request::Acknowledge), Response::Refused(Refusal::NoFault));
    let after = rig.ask(Request::GetSettings);
    assert!(matches!(after, Response::Settings { pending: Some(_), .. }), "what is asked for after it stays");
}

#[test]
fn reports_that_find_no_room_are_counted() {
    let mut control = Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, CORE_HZ)
        .unwrap()
        .with_monitors(Monitors::ANY_PLANT);
    begin(&mut control);
    let mut counted = 0;
    for tick in 0..=64 {
        let output = control.step(5.0);
        control.report(&output, &mut |report| match report {
            ControlReport::Counters(counters) => {
                counted = counters.dropped;
                true
            }
            _ => tick >= 50,
        });
    }
    assert_eq!(counted, 50);
}

#[test]
fn a_ventilator_has_no_plant_to_reset() {
    let mut control = Control::new(DeviceKind::Ventilator, DEFAULT_PERIOD_US, CORE_HZ).unwrap();
    assert_eq!(
        control.execute(&ControlRequest::ResetPlant(1)),
        ControlReply::Response(Response::Refused(Refusal::NoPlant))
    );
}

proptest! {
    /// Every request in any order and mode is answered, and the valves are safe unless a breath runs.
    #[test]
    fn no_order_of_requests_goes_unanswered(kinds in prop::collection::vec((0u8..17, -10.0f32..70.0), 1..60)) {
        let mut rig = Rig::new(Some(&residual()));
        for (kind, value) in kinds {
            let request = match kind {
                0 => Request::Identify,
                1 => Request::ApplySettings(paper_settings(value)),
                2 => Request::QueueSettings(paper_settings(value)),
                3 | 4 => Request::Start,
                5 => Request::Stop,
                6 => Request::Acknowledge,
                7 => Request::SetController(ControllerChoice::Learned),
                8 => Request::SetController(ControllerChoice::Pid(PidGains { p: value, i: 1.0, d: 0.0 })),
                9 => Request::Telemetry { on: value > 20.0 },
                10 => Request::BeginWeights { length: IMAGE_BYTES as u32, id: 3 },
                11 => Request::CommitWeights,
                12 => Request::Reset,
                13 => Request::ReadRecorder { part: RecorderPart::Log, from: value as u32 },
                14 => Request::ClearRecorder,
                15 => Request::GetAlarms,
                16 => Request::CommitBench,
                _ => Request::GetTiming { clear: true },
            };
            rig.ask(request);
            rig.run_at(7, value);
            let output = rig.control.step(value);
            prop_assert!(output.mode == Mode::Ventilating || output.command.u_out());
        }
    }
}
