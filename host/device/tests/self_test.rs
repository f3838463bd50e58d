//! The self-test of a device on the virtual bench: each step passes on a sound machine, and fails with an injected fault.
//! Verifies: self-test.

use plant::bench::{BenchConfig, BenchPlant, Failure};
use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
use shared::device::control::Control;
use shared::device::self_test::{BootFindings, Check, Finding, Outcome, Report, Step};
use shared::device::{ControlReply, ControlRequest};
use shared::link::messages::{DeviceKind, Response};
use shared::link::refusal::Refusal;
use shared::safety::filter::ValveCommand;
use shared::sensor::Readings;
use shared::settings::Settings;
use shared::ventilator::Mode;
use shared::weights::ImageProblem;
use shared::weights::slots::SlotState;
use virtual_chip::Rig;

/// Ticks in which every check has ended.
const LONG: usize = 15_000;

/// A change of the readings: what a sensor does wrong.
type Distortion = fn(Readings, u32) -> Readings;

/// A device on a bench.
struct Machine {
    rig: Rig,
    distortion: Distortion,
    /// Highest true pressure so far, cmH2O.
    peak: f64,
}

const SOUND: BootFindings =
    BootFindings { program: Some(true), memory: Some(true), slots: [SlotState::Empty; 2] };

impl Machine {
    fn new(config: &BenchConfig, boot: &BootFindings) -> Self {
        let mut control = Control::new(DeviceKind::Ventilator, DEFAULT_PERIOD_US, 1_000_000).unwrap();
        control.require_self_test(boot);
        let plant = BenchPlant::at_rest(config, 5.0, 3).unwrap();
        Self { rig: Rig::new(control, plant, 5.0), distortion: |readings, _| readings, peak: 0.0 }
    }

    fn run(&mut self, ticks: usize) {
        for _ in 0..ticks {
            self.rig.follow();
            self.rig.run_plant();
            let readings = (self.distortion)(self.rig.readings(), self.rig.ticks);
            self.rig.step(readings);
            self.peak = self.peak.max(self.rig.plant.bench.airway_pressure());
        }
    }

    fn ask(&mut self, request: &ControlRequest) -> Response {
        let reply = self.rig.control.execute(request);
        let ControlReply::Response(response) = reply else { panic!("{reply:?}") };
        response
    }

    fn start(&mut self) -> Response {
        self.ask(&ControlRequest::Apply(Settings::default()));
        self.ask(&ControlRequest::Start)
    }

    fn report(&mut self) -> Report {
        match self.ask(&ControlRequest::SelfTest(None)) {
            Response::SelfTest(report) => report,
            other => panic!("{other:?}"),
        }
    }

    fn outcome(&mut self, step: Step) -> Outcome {
        self.report()[step as usize].outcome
    }

    /// Runs a check to its end.
    fn check(&mut self, check: Check) -> Report {
        assert!(matches!(self.ask(&ControlRequest::SelfTest(Some(check))), Response::SelfTest(_)));
        self.run(LONG);
        self.report()
    }
}

fn lung() -> BenchConfig {
    BenchConfig::paper(20.0, 20.0)
}

/// A lung whose tube is occluded: the patient port is closed.
fn closed_port() -> Machine {
    let mut machine = Machine::new(&lung(), &SOUND);
    machine.rig.plant.bench.fail(Failure::TubeOccluded);
    machine.run(1000);
    machine
}

#[test]
fn a_sound_machine_passes_and_starts() {
    let mut machine = Machine::new(&lung(), &SOUND);
    machine.run(1);
    assert_eq!(machine.start(), Response::Refused(Refusal::SelfTestRuns));
    machine.run(1000);
    for step in [Step::Program, Step::Weights, Step::Memory, Step::Sensors] {
        assert_eq!(machine.outcome(step), Outcome::Passed, "{step:?}");
    }
    let at_rest = machine.report()[Step::Sensors as usize].value;
    assert!((at_rest - 5.0).abs() < 0.5, "{at_rest}");
    assert_eq!(machine.start(), Response::Mode(Mode::Ventilating));
}

#[test]
fn what_the_start_of_the_chip_finds_prevents_ventilation() {
    let invalid = SlotState::Invalid(ImageProblem::Checksum);
    for (boot, step, finding) in [
        (BootFindings { program: Some(false), ..SOUND }, Step::Program, Finding::Program),
        (BootFindings { memory: Some(false), ..SOUND }, Step::Memory, Finding::Memory),
        (BootFindings { slots: [SlotState::Empty, invalid], ..SOUND }, Step::Weights, Finding::Weights),
    ] {
        let mut machine = Machine::new(&lung(), &boot);
        machine.run(2000);
        assert_eq!(machine.start(), Response::Refused(Refusal::SelfTestFailed { step, finding }));
        assert_eq!(machine.rig.control.mode(), Mode::Standby);
    }
}

#[test]
fn what_is_not_known_or_only_torn_prevents_nothing() {
    let boot = BootFindings { program: None, memory: None, slots: [SlotState::Torn, SlotState::Empty] };
    let mut machine = Machine::new(&lung(), &boot);
    machine.run(1000);
    assert_eq!([Step::Program, Step::Memory].map(|step| machine.outcome(step)), [Outcome::NotRun; 2]);
    assert_eq!(machine.start(), Response::Mode(Mode::Ventilating));
}

#[test]
fn an_interrupted_ventilation_resumes_whatever_the_self_test_finds() {
    let boot = BootFindings { program: Some(false), memory: Some(false), ..SOUND };
    let mut machine = Machine::new(&lung(), &boot);
    machine.run(2);
    machine.rig.control.resume(&paper_settings(20.0)).unwrap();
    machine.run(2000);
    assert_eq!(machine.rig.control.mode(), Mode::Ventilating);
}

/// Every way in which a sensor is wrong at rest.
const WRONG_SENSORS: [(Distortion, Finding); 7] = [
    (|r, tick| Readings { airway: if tick % 4 == 0 { f32::NAN } else { r.airway }, ..r }, Finding::NoReading),
    (|r, tick| Readings { outlet: if tick % 4 == 0 { f32::NAN } else { r.outlet }, ..r }, Finding::NoReading),
    (|r, tick| Readings { airway: r.airway + if tick % 2 == 0 { 1.0 } else { -1.0 }, ..r }, Finding::Noisy),
    (|r, _| Readings { airway: r.airway + 3.0, ..r }, Finding::SensorsDiffer),
    (|r, _| Readings { airway: r.airway + 6.0, outlet: r.outlet + 6.0, ..r }, Finding::NotAtRest),
    (|r, _| Readings { airway: r.airway - 9.0, outlet: r.outlet - 9.0, ..r }, Finding::NotAtRest),
    (|r, _| Readings { flow: r.flow - 0.5, ..r }, Finding::FlowAtRest),
];

#[test]
fn a_sensor_that_is_wrong_at_rest_prevents_ventilation_until_it_is_right() {
    for (distortion, finding) in WRONG_SENSORS {
        let mut machine = Machine::new(&lung(), &SOUND);
        machine.distortion = distortion;
        machine.run(8000);
        assert_eq!(machine.outcome(Step::Sensors), Outcome::Failed(finding));
        let refused = machine.start();
        // A missing or noisy airway sensor may also count as unsound.
        let failed = Refusal::SelfTestFailed { step: Step::Sensors, finding };
        assert!(
            refused == Response::Refused(failed) || refused == Response::Refused(Refusal::NoSensor),
            "{finding:?}: {refused:?}"
        );
        machine.distortion = |readings, _| readings;
        machine.run(8000);
        assert_eq!(machine.start(), Response::Mode(Mode::Ventilating), "{finding:?}");
    }
}

#[test]
fn once_passed_the_sensors_are_left_to_the_monitors() {
    let mut machine = Machine::new(&lung(), &SOUND);
    machine.run(1000);
    machine.distortion = |r, _| Readings { flow: r.flow - 0.5, ..r };
    machine.run(3000);
    assert_eq!(machine.start(), Response::Mode(Mode::Ventilating), "a patient may breathe at the machine");
}

/// A machine at the pressure of the air, whose sensors are off.
fn open_circuit(distortion: Distortion) -> Machine {
    let mut machine = Machine::new(&lung(), &SOUND);
    machine.rig.plant.bench.fail(Failure::Disconnected);
    machine.distortion = distortion;
    machine.run(3000);
    machine
}

#[test]
fn zeroing_removes_the_offsets_of_both_pressure_sensors() {
    let mut machine = open_circuit(|r, _| Readings { airway: r.airway + 1.6, outlet: r.outlet - 1.2, ..r });
    assert!(matches!(machine.outcome(Step::Sensors), Outcome::Failed(Finding::SensorsDiffer)));
    let zero = machine.check(Check::Zero)[Step::Zero as usize];
    assert_eq!(zero.outcome, Outcome::Passed);
    assert!((zero.value - 1.6).abs() < 0.4, "{zero:?}");
    assert_eq!(machine.outcome(Step::Sensors), Outcome::Passed, "it runs again with the zeros");
    // Zeroing again changes nothing, and the offset that it reports is the whole one.
    let again = machine.check(Check::Zero)[Step::Zero as usize];
    assert!((again.value - zero.value).abs() < 0.05, "{again:?}");
    machine.rig.plant.bench.restore();
    machine.run(3000);
    machine.start();
    machine.run(2900);
    let output = machine.rig.control.step(Readings { airway: 6.6, outlet: 3.8, flow: 0.0 });
    let pressure = output.sample.unwrap().pressure;
    assert!((pressure - 5.0).abs() < 0.4, "the ventilator sees {pressure} without the offset");
    let moment = machine.rig.control.moment(6.6, &output, 0).reading;
    assert!(
        (moment - pressure).abs() < 1e-6,
        "the flight recorder records what the ventilator saw: {moment}"
    );
}

#[test]
fn a_zero_that_is_too_far_off_is_refused_and_changes_nothing() {
    let mut machine = open_circuit(|r, _| Readings { airway: r.airway + 2.6, outlet: r.outlet + 2.6, ..r });
    let zero = machine.check(Check::Zero)[Step::Zero as usize];
    assert_eq!(zero.outcome, Outcome::Failed(Finding::ZeroTooFar));
    assert!(machine.rig.control.moment(1.0, &machine.rig.control.clone().step(1.0), 0).reading > 0.99);
    let failed = Refusal::SelfTestFailed { step: Step::Zero, finding: Finding::ZeroTooFar };
    assert_eq!(machine.start(), Response::Refused(failed));
    // At PEEP nothing can be zeroed either.
    let mut closed = Machine::new(&lung(), &SOUND);
    closed.run(1000);
    let zero = closed.check(Check::Zero)[Step::Zero as usize];
    assert_eq!(zero.outcome, Outcome::Failed(Finding::ZeroTooFar), "{}", zero.value);
}

#[test]
fn a_sound_circuit_with_a_test_lung_passes_and_its_compliance_is_measured() {
    for (resistance, compliance) in [(5.0, 10.0), (20.0, 20.0), (5.0, 50.0)] {
        let mut machine = Machine::new(&BenchConfig::paper(resistance, compliance), &SOUND);
        machine.run(1000);
        let report = machine.check(Check::Circuit);
        let [valves, circuit] = [Step::Valves, Step::Circuit].map(|step| report[step as usize]);
        assert_eq!((valves.outcome, circuit.outcome), (Outcome::Passed, Outcome::Passed), "{report:?}");
        assert!(
            (f64::from(circuit.value) / compliance - 1.0).abs() < 0.25,
            "{} of {compliance}",
            circuit.value
        );
        assert!(machine.peak < 30.0, "{}", machine.peak);
        assert_eq!(machine.start(), Response::Mode(Mode::Ventilating));
    }
}

#[test]
fn without_a_flow_sensor_the_circuit_passes_without_a_compliance() {
    let mut machine = Machine::new(&lung(), &SOUND);
    machine.distortion = |r, _| Readings { flow: f32::NAN, ..r };
    machine.run(1000);
    let circuit = machine.check(Check::Circuit)[Step::Circuit as usize];
    assert!(circuit.outcome == Outcome::Passed && circuit.value.is_nan());
}

/// The finding of the check of the circuit with a failure, in the first of its steps that fails.
fn finding_with(failure: Failure) -> (Step, Finding) {
    let mut machine = Machine::new(&lung(), &SOUND);
    machine.run(1000);
    machine.rig.plant.bench.fail(failure);
    let report = machine.check(Check::Circuit);
    assert!(machine.peak < 60.0, "{failure:?}: {}", machine.peak);
    let found =
        [Step::Valves, Step::Circuit].into_iter().find_map(|step| match report[step as usize].outcome {
            Outcome::Failed(finding) => Some((step, finding)),
            _ => None,
        });
    let (step, finding) = found.unwrap_or_else(|| panic!("{failure:?}: {report:?}"));
    let refused = Refusal::SelfTestFailed { step, finding };
    machine.rig.plant.bench.restore();
    machine.run(6000);
    assert_eq!(machine.start(), Response::Refused(refused));
    (step, finding)
}

#[test]
fn valves_that_do_not_obey_fail() {
    assert_eq!(finding_with(Failure::InspiratoryValveStuck(0.0)), (Step::Valves, Finding::NoRise));
    assert_eq!(finding_with(Failure::SupplyLost), (Step::Valves, Finding::NoRise));
    assert_eq!(finding_with(Failure::Disconnected), (Step::Valves, Finding::NoRise));
    assert_eq!(finding_with(Failure::InspiratoryValveStuck(20.0)), (Step::Valves, Finding::RisesByItself));
    assert_eq!(finding_with(Failure::ExpiratoryValveClosed), (Step::Valves, Finding::NoFall));
}

#[test]
fn a_leak_fails() {
    assert_eq!(finding_with(Failure::Leak(0.1)), (Step::Circuit, Finding::Leak));
}

#[test]
fn a_flow_sensor_that_sees_no_flow_fails() {
    let mut machine = Machine::new(&lung(), &SOUND);
    machine.distortion = |r, _| Readings { flow: 0.0, ..r };
    machine.run(1000);
    let report = machine.check(Check::Circuit);
    assert_eq!(report[Step::Circuit as usize].outcome, Outcome::Failed(Finding::NoFlow));
}

#[test]
fn an_implausible_compliance_fails() {
    let mut machine = Machine::new(&lung(), &SOUND);
    machine.distortion = |r, _| Readings { flow: 8.0 * r.flow, ..r };
    machine.run(1000);
    let report = machine.check(Check::Circuit);
    assert_eq!(report[Step::Circuit as usize].outcome, Outcome::Failed(Finding::Compliance));
}

#[test]
fn the_relief_valve_is_found_at_its_opening_pressure() {
    let mut machine = closed_port();
    let relief = machine.check(Check::Relief)[Step::Relief as usize];
    assert_eq!(relief.outcome, Outcome::Passed, "{relief:?}");
    assert!((68.0..74.0).contains(&relief.value), "{relief:?}");
    assert_eq!(machine.start(), Response::Mode(Mode::Ventilating), "no alarm was latched");
}

#[test]
fn a_relief_valve_that_opens_too_early_or_not_at_all_fails() {
    for (opening, finding) in [(50.0, Finding::ReliefEarly), (200.0, Finding::ReliefLate)] {
        let mut config = lung();
        config.circuit.relief_opening_cmh2o = opening;
        let mut machine = Machine::new(&config, &SOUND);
        machine.rig.plant.bench.fail(Failure::TubeOccluded);
        machine.run(1000);
        let relief = machine.check(Check::Relief)[Step::Relief as usize];
        assert_eq!(relief.outcome, Outcome::Failed(finding), "{relief:?}");
        assert!(machine.peak < 95.0, "{}", machine.peak);
    }
}

#[test]
fn an_open_port_is_no_relief_valve() {
    let mut machine = Machine::new(&lung(), &SOUND);
    machine.rig.plant.bench.fail(Failure::Disconnected);
    machine.run(1000);
    let relief = machine.check(Check::Relief)[Step::Relief as usize];
    assert_eq!(relief.outcome, Outcome::Failed(Finding::PortOpen), "{relief:?}");
}

#[test]
fn checks_are_refused_while_it_ventilates_or_another_runs_and_a_stop_ends_them() {
    let mut machine = Machine::new(&lung(), &SOUND);
    machine.run(1000);
    machine.ask(&ControlRequest::SelfTest(Some(Check::Circuit)));
    machine.run(500);
    assert!(!machine.rig.command.u_out(), "the valves move");
    let refused = Response::Refused(Refusal::SelfTestRuns);
    assert_eq!(machine.ask(&ControlRequest::SelfTest(Some(Check::Relief))), refused);
    assert_eq!(machine.start(), refused);
    machine.ask(&ControlRequest::Stop);
    machine.run(1);
    assert_eq!(machine.rig.command, ValveCommand::SAFE);
    assert_eq!([Step::Valves, Step::Circuit].map(|step| machine.outcome(step)), [Outcome::NotRun; 2]);
    machine.run(3000);
    assert_eq!(machine.start(), Response::Mode(Mode::Ventilating));
    let check = machine.ask(&ControlRequest::SelfTest(Some(Check::Zero)));
    assert_eq!(check, Response::Refused(Refusal::Ventilating));
}

#[test]
fn a_lost_reading_or_an_alarm_ends_a_check_with_safe_valves() {
    let mut machine = Machine::new(&lung(), &SOUND);
    machine.run(1000);
    machine.ask(&ControlRequest::SelfTest(Some(Check::Circuit)));
    machine.run(500);
    machine.distortion = |r, _| Readings { airway: f32::NAN, ..r };
    machine.run(1);
    assert_eq!(machine.rig.command, ValveCommand::SAFE, "at once");
    machine.run(LONG);
    let outcome = machine.outcome(Step::Valves);
    assert!(matches!(outcome, Outcome::Failed(Finding::NoReading | Finding::Alarm)), "{outcome:?}");
}
