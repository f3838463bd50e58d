//! The steps on an ideal machine, at their limits. Those on the virtual bench are in `host/device/tests/self_test.rs`.

use super::*;
use crate::weights::ImageProblem;

const PERIOD_US: u32 = 1000;
const TICK_S: f32 = 1e-3;
/// Ticks of an observation at rest.
const REST: usize = 500;
const PEEP: f32 = 5.0;

const SOUND: BootFindings =
    BootFindings { program: Some(true), memory: Some(true), slots: [SlotState::Empty; 2] };

/// A machine without any delay or noise.
#[derive(Clone, Copy, Debug)]
struct Machine {
    pressure: f32,
    /// Compliance of circuit and test lung, mL/cmH2O.
    compliance: f32,
    /// Flow at full command of the test, L/s, and that of a leak, cmH2O/s.
    supply: f32,
    leak: f32,
    /// Flow through the inspiratory valve when it is closed, L/s.
    seeps: f32,
    /// Opening of the relief valve, cmH2O.
    relief: f32,
    /// Whether the expiratory valve opens.
    opens: bool,
    /// Factor of the flow sensor.
    meter: f32,
}

const MACHINE: Machine = Machine {
    pressure: PEEP,
    compliance: 20.0,
    supply: 0.15,
    leak: 0.0,
    seeps: 0.0,
    relief: 70.0,
    opens: true,
    meter: 1.0,
};
/// With a closed patient port.
const CLOSED: Machine = Machine { compliance: 1.5, meter: 0.0, ..MACHINE };

impl Machine {
    fn step(&mut self, command: ValveCommand) -> Readings {
        let flow = if command.u_in() > 0.0 { self.supply } else { self.seeps };
        if command.u_out() && self.opens {
            self.pressure = PEEP;
        } else {
            self.pressure += (flow * 1000.0 / self.compliance - self.leak) * TICK_S;
        }
        self.pressure = self.pressure.min(self.relief);
        Readings { airway: self.pressure, outlet: f32::NAN, flow: flow * self.meter }
    }
}

/// Runs a check to its end; its results, and the highest pressure.
fn check(mut machine: Machine, check: Check) -> ([StepResult; 3], f32) {
    let mut test = SelfTest::none(PERIOD_US);
    test.begin(check).unwrap();
    let (mut command, mut peak) = (ValveCommand::SAFE, 0.0_f32);
    for _ in 0..15_000 {
        let readings = machine.step(command);
        peak = peak.max(readings.airway);
        command = test.step(&readings, &Settings::default(), false).unwrap_or(ValveCommand::SAFE);
    }
    assert_eq!(command, ValveCommand::SAFE);
    let report = test.report();
    ([Step::Valves, Step::Circuit, Step::Relief].map(|step| report[step as usize]), peak)
}

fn outcomes(machine: Machine, which: Check) -> [Outcome; 3] {
    check(machine, which).0.map(|result| result.outcome)
}

use Outcome::{Failed, NotRun, Passed, Runs};

#[test]
fn a_sound_circuit_passes_with_its_compliance_and_rise_time() {
    let ([valves, circuit, relief], peak) = check(MACHINE, Check::Circuit);
    assert_eq!([valves.outcome, circuit.outcome, relief.outcome], [Passed, Passed, NotRun]);
    assert!((circuit.value - 20.0).abs() < 0.2, "{circuit:?}");
    assert!((valves.value - 2.0).abs() < 0.02, "15 cmH2O at 7.5 cmH2O/s: {valves:?}");
    assert!((peak - 20.0).abs() < 0.1, "{peak}");
}

#[test]
fn a_check_of_the_circuit_takes_its_times() {
    let (mut test, mut machine, mut command) = (SelfTest::none(PERIOD_US), MACHINE, ValveCommand::SAFE);
    test.begin(Check::Circuit).unwrap();
    let ticks = (1..10_000).find(|_| {
        let readings = machine.step(command);
        command = test.step(&readings, &Settings::default(), false).unwrap_or(ValveCommand::SAFE);
        test.report()[Step::Valves as usize].outcome != Runs
    });
    // Rest 0.2 s, rise 2 s, spread 0.5 s, hold 1 s, release 2 s.
    assert!(ticks.is_some_and(|ticks| (5690..=5715).contains(&ticks)), "{ticks:?}");
}

#[test]
fn the_compliance_has_its_bounds() {
    let circuit = |meter| outcomes(Machine { meter, ..MACHINE }, Check::Circuit)[1];
    assert_eq!([circuit(0.03), circuit(5.9)], [Passed; 2]);
    assert_eq!(circuit(0.02), Failed(Finding::NoFlow));
    assert_eq!(circuit(-1.0), Failed(Finding::NoFlow));
    assert_eq!(circuit(6.1), Failed(Finding::Compliance));
    assert!(check(Machine { meter: f32::NAN, ..MACHINE }, Check::Circuit).0[1].value.is_nan());
}

#[test]
fn a_pressure_that_does_not_rise_in_8_s_fails() {
    let slow = |supply| outcomes(Machine { supply, ..MACHINE }, Check::Circuit);
    assert_eq!(slow(0.038), [Passed, Passed, NotRun]);
    assert_eq!(slow(0.037), [Failed(Finding::NoRise), NotRun, NotRun]);
}

#[test]
fn a_pressure_that_falls_by_3_cmh2o_in_a_second_is_a_leak() {
    let leaky = |leak| outcomes(Machine { leak, supply: 0.3, ..MACHINE }, Check::Circuit);
    assert_eq!(leaky(2.9), [Passed, Passed, NotRun]);
    assert_eq!(leaky(3.1), [Passed, Failed(Finding::Leak), NotRun]);
}

#[test]
fn an_inspiratory_valve_that_lets_gas_through_fails() {
    let seeping = |seeps| outcomes(Machine { seeps, ..MACHINE }, Check::Circuit)[0];
    assert_eq!(seeping(0.058), Passed);
    assert_eq!(seeping(0.062), Failed(Finding::RisesByItself));
    let ([valves, ..], peak) = check(Machine { seeps: 0.8, ..MACHINE }, Check::Circuit);
    assert_eq!(valves.outcome, Failed(Finding::RisesByItself));
    assert!(peak < 45.0, "{peak}");
}

#[test]
fn an_expiratory_valve_that_does_not_open_fails() {
    let stuck = Machine { opens: false, ..MACHINE };
    assert_eq!(outcomes(stuck, Check::Circuit), [Failed(Finding::NoFall), Passed, NotRun]);
    assert_eq!(outcomes(Machine { opens: false, ..CLOSED }, Check::Relief)[2], Failed(Finding::NoFall));
}

#[test]
fn the_check_of_the_relief_valve_ends_at_a_low_pressure_if_a_patient_is_connected() {
    // R50C5 and C2 lungs take 5 and 2 of 6.5 and 3.5 mL/cmH2O; a sensor may be off by 0.02 L/s.
    for (compliance, meter) in [(6.5, 0.77), (3.5, 0.57), (20.0, 0.9)] {
        let ([.., relief], peak) = check(Machine { compliance, meter, ..MACHINE }, Check::Relief);
        assert_eq!(relief.outcome, Failed(Finding::PortOpen));
        assert!(peak < 25.0, "{peak} cmH2O at {compliance} mL/cmH2O");
    }
    let off = check(Machine { meter: 0.02 / 0.15, ..CLOSED }, Check::Relief).0[2];
    assert_eq!(off.outcome, Passed);
}

#[test]
fn the_relief_valve_opens_between_60_and_80_cmh2o() {
    let relief = |relief| check(Machine { relief, ..CLOSED }, Check::Relief).0[2];
    for opening in [60.5, 70.0, 79.5] {
        let found = relief(opening);
        assert!(found.outcome == Passed && (found.value - opening).abs() < 0.1, "{found:?}");
    }
    assert_eq!(relief(59.5).outcome, Failed(Finding::ReliefEarly));
    assert_eq!(relief(80.5).outcome, Failed(Finding::ReliefLate));
    assert_eq!(relief(14.0).outcome, Failed(Finding::NoRise), "less than 10 cmH2O are no plateau");
    let ([.., late], peak) = check(Machine { relief: 200.0, ..CLOSED }, Check::Relief);
    assert_eq!(late.outcome, Failed(Finding::ReliefLate));
    assert!((85.0..86.0).contains(&peak), "{peak}");
}

#[test]
fn a_slow_rise_is_no_plateau_but_an_open_port() {
    // 9 cmH2O/s are less than 1 cmH2O in 0.1 s, and above 10 cmH2O a plateau.
    let outcome = |supply| outcomes(Machine { supply, ..CLOSED }, Check::Relief)[2];
    assert_eq!(outcome(0.0135), Failed(Finding::ReliefEarly));
    assert_eq!(outcome(0.003), Failed(Finding::NoRise));
}

#[test]
fn without_a_reading_the_valves_are_safe_and_the_check_fails() {
    for which in [Check::Circuit, Check::Relief] {
        let (mut test, mut machine) = (SelfTest::none(PERIOD_US), Machine { meter: 0.0, ..MACHINE });
        test.begin(which).unwrap();
        let mut command = ValveCommand::SAFE;
        for _ in 0..1000 {
            command = test.step(&machine.step(command), &Settings::default(), false).unwrap();
        }
        assert!(!command.u_out() && command.u_in() > 0.0);
        let lost = Readings { airway: f32::NAN, ..machine.step(command) };
        assert_eq!(test.step(&lost, &Settings::default(), false), Some(ValveCommand::SAFE));
        wait(&mut test, 3000, PEEP);
        let step = if which == Check::Relief { Step::Relief } else { Step::Valves };
        assert_eq!(test.report()[step as usize].outcome, Failed(Finding::NoReading));
    }
}

#[test]
fn an_alarm_ends_a_check() {
    let mut test = SelfTest::none(PERIOD_US);
    test.begin(Check::Circuit).unwrap();
    assert_eq!(test.step(&MACHINE.clone().step(ValveCommand::SAFE), &Settings::default(), true), None);
    let report = test.report();
    let [valves, circuit] = [Step::Valves, Step::Circuit].map(|step| report[step as usize].outcome);
    assert_eq!([valves, circuit], [Failed(Finding::Alarm), NotRun]);
    assert!(test.begin(Check::Relief).is_ok(), "another one can begin");
}

fn at_rest(airway: f32, outlet: f32, flow: f32) -> Readings {
    Readings { airway, outlet, flow }
}

/// Lets ticks pass in standby with both pressure sensors at a pressure.
fn wait(test: &mut SelfTest, ticks: usize, pressure: f32) {
    for _ in 0..ticks {
        test.step(&at_rest(pressure, pressure, 0.0), &Settings::default(), false);
    }
}

/// The outcome of the step `sensors` with a reading for each tick.
fn rest(reading: impl Fn(usize) -> Readings) -> Outcome {
    let mut test = SelfTest::after_boot(PERIOD_US, &SOUND);
    for tick in 0..REST {
        assert_eq!(test.report()[Step::Sensors as usize].outcome, Runs);
        assert_eq!(test.step(&reading(tick), &Settings::default(), false), None, "the valves stay safe");
    }
    test.report()[Step::Sensors as usize].outcome
}

#[test]
fn the_sensors_at_rest_have_their_limits() {
    let constant = |airway, outlet, flow| rest(|_| at_rest(airway, outlet, flow));
    assert_eq!(constant(5.0, 5.0, 0.0), Passed);
    assert_eq!(constant(5.0, f32::NAN, f32::NAN), Passed, "a machine with one sensor");
    assert_eq!([constant(-1.9, -1.9, 0.0), constant(7.9, 7.9, 0.0)], [Passed; 2]);
    assert_eq!([constant(-2.1, -2.1, 0.0), constant(8.1, 8.1, 0.0)], [Failed(Finding::NotAtRest); 2]);
    assert_eq!([constant(3.1, 5.0, 0.0), constant(5.0, 3.1, 0.0)], [Passed; 2]);
    assert_eq!([constant(2.9, 5.0, 0.0), constant(5.0, 2.9, 0.0)], [Failed(Finding::SensorsDiffer); 2]);
    assert_eq!([constant(5.0, 5.0, 0.29), constant(5.0, 5.0, -0.29)], [Passed; 2]);
    assert_eq!([constant(5.0, 5.0, 0.31), constant(5.0, 5.0, -0.31)], [Failed(Finding::FlowAtRest); 2]);
    assert_eq!(constant(f32::NAN, 5.0, 0.0), Failed(Finding::NoReading));
    assert_eq!(constant(f32::INFINITY, 5.0, 0.0), Failed(Finding::NoReading));
}

#[test]
fn a_tenth_of_the_readings_may_be_missing() {
    let missing = |every: usize| {
        rest(|tick| at_rest(if tick.is_multiple_of(every) { f32::NAN } else { 5.0 }, 5.0, 0.0))
    };
    // Each missing reading takes three second differences with it.
    assert_eq!(missing(40), Passed);
    assert_eq!(missing(20), Failed(Finding::Noisy));
    assert_eq!(missing(9), Failed(Finding::NoReading));
    assert_eq!(
        rest(|tick| at_rest(5.0, if tick % 2 == 0 { f32::NAN } else { 5.0 }, 0.0)),
        Failed(Finding::NoReading)
    );
}

#[test]
fn noise_is_seen_and_a_drift_is_none() {
    // A sign that changes in every tick has second differences of four times its size.
    let noise = |size: f32| rest(|tick| at_rest(5.0 + if tick % 2 == 0 { size } else { -size }, 5.0, 0.0));
    assert_eq!([noise(0.19), noise(0.20)], [Passed, Failed(Finding::Noisy)]);
    let outlet = |size: f32| rest(|tick| at_rest(5.0, 5.0 + if tick % 2 == 0 { size } else { -size }, 0.0));
    assert_eq!([outlet(0.19), outlet(0.20)], [Passed, Failed(Finding::Noisy)]);
    assert_eq!(rest(|tick| at_rest(4.0 + 0.004 * tick as f32, 4.0 + 0.004 * tick as f32, 0.0)), Passed);
}

#[test]
fn quiet_sensors_pass_at_every_control_period() {
    for (period_us, ticks) in [(250, 2000), (25_000, 20), (26_316, 19), (30_000, 17), (50_000, 10)] {
        let observed = |missing: &[usize]| {
            let mut test = SelfTest::after_boot(period_us, &SOUND);
            for tick in 0..ticks {
                assert_eq!(
                    test.report()[Step::Sensors as usize].outcome,
                    Runs,
                    "{period_us} us, tick {tick}"
                );
                let pressure = if missing.contains(&tick) { f32::NAN } else { 5.0 };
                test.step(&at_rest(pressure, 5.0, 0.0), &Settings::default(), false);
            }
            test.report()[Step::Sensors as usize].outcome
        };
        assert_eq!(observed(&[]), Passed, "{period_us} us");
        // Nine of ten of the differences must be numbers too: a reading takes three with it, the last one only its own.
        let last = observed(&[ticks - 1]);
        assert_eq!(last, if ticks > 10 { Passed } else { Failed(Finding::Noisy) }, "{period_us} us");
    }
}

/// A self-test after a zeroing at these readings.
fn zeroed(mut test: SelfTest, airway: f32, outlet: f32) -> SelfTest {
    test.begin(Check::Zero).unwrap();
    for _ in 0..REST {
        let readings = test.zeroed(at_rest(airway, outlet, 0.0));
        assert_eq!(test.step(&readings, &Settings::default(), false), None);
    }
    test
}

#[test]
fn a_zero_is_subtracted_and_limited() {
    let fresh = || SelfTest::none(PERIOD_US);
    let test = zeroed(fresh(), 1.5, -1.0);
    let readings = test.zeroed(at_rest(11.5, 9.0, 0.3));
    assert!((readings.airway - 10.0).abs() < 1e-3 && (readings.outlet - 10.0).abs() < 1e-3);
    assert!((readings.flow - 0.3).abs() < f32::EPSILON);
    let zero = test.report()[Step::Zero as usize];
    assert!(zero.outcome == Passed && (zero.value - 1.5).abs() < 1e-3, "the larger one: {zero:?}");
    // Twice 1.5 from zero is too far, whatever was subtracted before.
    let far = zeroed(test, 3.0, -1.0);
    let zero = far.report()[Step::Zero as usize];
    assert_eq!(zero.outcome, Failed(Finding::ZeroTooFar));
    let readings = far.zeroed(at_rest(11.5, 9.0, 0.3));
    assert!((zero.value - 3.0).abs() < 1e-3 && (readings.airway - 10.0).abs() < 1e-3, "the old one stays");
    let outlet = zeroed(fresh(), 0.5, -1.9).report()[Step::Zero as usize];
    assert!(outlet.outcome == Passed && (outlet.value + 1.9).abs() < 1e-3);
    assert_eq!(zeroed(fresh(), 0.5, -2.1).report()[Step::Zero as usize].outcome, Failed(Finding::ZeroTooFar));
    assert_eq!(
        zeroed(fresh(), f32::NAN, 0.0).report()[Step::Zero as usize].outcome,
        Failed(Finding::NoReading)
    );
    assert_eq!(zeroed(fresh(), 1.0, f32::NAN).report()[Step::Zero as usize].outcome, Passed);
}

#[test]
fn without_a_zero_no_bit_of_a_reading_changes() {
    let test = SelfTest::none(PERIOD_US);
    for bits in [0, 0x8000_0000, 0x7FC0_0001, 1, 0x41A0_0000, f32::INFINITY.to_bits()] {
        let readings = test.zeroed(at_rest(f32::from_bits(bits), f32::from_bits(bits), f32::from_bits(bits)));
        assert_eq!([readings.airway, readings.outlet, readings.flow].map(f32::to_bits), [bits; 3]);
    }
}

#[test]
fn a_start_waits_for_what_runs_and_for_nothing_that_was_never_asked_for() {
    assert_eq!(SelfTest::none(PERIOD_US).permit(), Ok(()));
    let mut test = SelfTest::after_boot(PERIOD_US, &SOUND);
    assert_eq!(test.permit(), Err(Refusal::SelfTestRuns));
    wait(&mut test, REST, 5.0);
    assert_eq!(test.permit(), Ok(()));
    test.begin(Check::Relief).unwrap();
    assert_eq!(test.permit(), Err(Refusal::SelfTestRuns));
    assert_eq!(test.begin(Check::Zero), Err(Refusal::SelfTestRuns));
    test.abort();
    assert_eq!((test.permit(), test.report()[Step::Relief as usize].outcome), (Ok(()), NotRun));
}

#[test]
fn a_check_before_the_sensors_have_passed_leaves_them_to_run_after_it() {
    let mut test = zeroed(SelfTest::after_boot(PERIOD_US, &SOUND), 0.5, 0.5);
    let outcome = |test: &SelfTest| test.report()[Step::Sensors as usize].outcome;
    assert_eq!(outcome(&test), Runs);
    wait(&mut test, REST, 5.0);
    assert_eq!(outcome(&test), Passed);
    test.abort();
    assert_eq!(outcome(&test), Passed, "nothing runs that could be aborted");
    // Once passed they do not run again.
    wait(&mut test, 2 * REST, 50.0);
    assert_eq!(outcome(&test), Passed);
}

#[test]
fn sensors_that_fail_are_judged_again_until_they_pass() {
    let mut test = SelfTest::after_boot(PERIOD_US, &SOUND);
    let mut run = |pressure| {
        wait(&mut test, REST, pressure);
        test.permit()
    };
    let failed = Refusal::SelfTestFailed { step: Step::Sensors, finding: Finding::NotAtRest };
    assert_eq!([run(20.0), run(20.0), run(5.0), run(20.0)], [Err(failed), Err(failed), Ok(()), Ok(())]);
}

#[test]
fn a_start_of_the_chip_is_judged() {
    let after = |boot: BootFindings| {
        let report = SelfTest::after_boot(PERIOD_US, &boot).report();
        [Step::Program, Step::Weights, Step::Memory].map(|step| report[step as usize].outcome)
    };
    assert_eq!(after(SOUND), [Passed; 3]);
    let program = Failed(Finding::Program);
    assert_eq!(after(BootFindings { program: Some(false), ..SOUND }), [program, Passed, Passed]);
    assert_eq!(after(BootFindings { program: None, memory: None, ..SOUND }), [NotRun, Passed, NotRun]);
    let memory = Failed(Finding::Memory);
    assert_eq!(after(BootFindings { memory: Some(false), ..SOUND }), [Passed, Passed, memory]);
    let slots = |slot| after(BootFindings { slots: [SlotState::Empty, slot], ..SOUND })[1];
    assert_eq!(slots(SlotState::Torn), Passed);
    assert_eq!(slots(SlotState::Valid { generation: 1, id: 2 }), Passed);
    assert_eq!(slots(SlotState::Invalid(ImageProblem::Checksum)), Failed(Finding::Weights));
    assert_eq!(slots(SlotState::Invalid(ImageProblem::Unsigned)), Passed);
}

#[test]
fn the_first_failed_step_is_the_reason() {
    let boot = BootFindings { program: Some(false), memory: Some(false), ..SOUND };
    let refused = SelfTest::after_boot(PERIOD_US, &boot).permit().unwrap_err();
    assert_eq!(refused, Refusal::SelfTestFailed { step: Step::Program, finding: Finding::Program });
    let text = std::string::ToString::to_string(&refused);
    assert!(text.contains("self-test step 'program' has failed: the program in flash is damaged"), "{text}");
}

/// The outcomes of a check whose airway pressure is a function of its tick, with a flow of 0.15 L/s throughout or a closed port.
fn by_tick(check: Check, pressure: impl Fn(u32) -> f32) -> [StepResult; 3] {
    let mut test = SelfTest::none(PERIOD_US);
    test.begin(check).unwrap();
    let flow = if check == Check::Relief { 0.0 } else { 0.15 };
    for tick in 0..9000 {
        test.step(&at_rest(pressure(tick), f32::NAN, flow), &Settings::default(), false);
    }
    let report = test.report();
    [Step::Valves, Step::Circuit, Step::Relief].map(|step| report[step as usize])
}

#[test]
fn the_bounds_of_the_circuit_check_are_exact() {
    // A rise after 0.1 s of the fill, a pressure in the middle of the hold, and one that is left in the end.
    let circuit = |rise: f32, held: f32, left: f32| {
        let [valves, circuit, _] = by_tick(Check::Circuit, |tick| match tick {
            ..300 => PEEP,
            300..1200 => PEEP + rise,
            1200..2000 => PEEP + held,
            2000.. => PEEP + left,
        });
        (valves.outcome, circuit)
    };
    let (valves, sound) = circuit(15.0, 15.0, 3.0);
    assert!(valves == Passed && sound.outcome == Passed && (sound.value - 1.0).abs() < 0.05, "{sound:?}");
    assert_eq!(circuit(15.0, 15.0, 3.5).0, Failed(Finding::NoFall));
    assert_eq!(
        [circuit(30.0, 30.0, 0.0).0, circuit(30.5, 30.5, 0.0).0],
        [Passed, Failed(Finding::RisesByItself)]
    );
    assert_eq!(
        [circuit(15.0, 18.0, 0.0).0, circuit(15.0, 18.5, 0.0).0],
        [Passed, Failed(Finding::RisesByItself)]
    );
    assert_eq!(circuit(15.0, 12.0, 0.0).1.outcome, Passed);
    let leak = circuit(15.0, 11.0, 0.0).1;
    assert!(leak.outcome == Failed(Finding::Leak) && (leak.value - 4.0).abs() < 1e-3, "{leak:?}");
}

#[test]
fn the_bounds_of_the_relief_valve_are_exact() {
    let opens = |pressure: f32| {
        by_tick(Check::Relief, |tick| if (300..1000).contains(&tick) { pressure } else { PEEP })[2].outcome
    };
    assert_eq!([opens(60.0), opens(80.0)], [Passed; 2]);
    assert_eq!([opens(59.9), opens(80.1)], [Failed(Finding::ReliefEarly), Failed(Finding::ReliefLate)]);
}

#[test]
fn a_mean_flow_at_the_bound_passes() {
    // 32 ticks, so that the mean is exact.
    let mut test = SelfTest::after_boot(15_625, &SOUND);
    for tick in 0..32 {
        let flow = if tick == 0 { 32.0 * 0.3 } else { 0.0 };
        test.step(&at_rest(PEEP, PEEP, flow), &Settings::default(), false);
    }
    assert_eq!(test.report()[Step::Sensors as usize].outcome, Passed);
}
