//! Tests of the checks of the flow sensor.

use super::*;

/// Ticks of 10 ms, with 1 s of inspiration and 2 s of expiration.
const PERIOD_US: u32 = 10_000;
const TICKS: (u32, u32) = (100, 200);
/// Rise of the breaths, cmH2O.
const RISE: f32 = 20.0;

/// A sensor, a valve and a lung that gives out in 2 s what it has taken in.
struct Run {
    monitor: FlowMonitor,
    state: FlowState,
    /// Flow of the valve in inspirations by its model, and what the lung gets of it, L/s.
    valve: f32,
    lung: f32,
    /// Leak in inspirations and expirations, L/s, which the valve makes up for.
    leak: (f32, f32),
    rise: Option<f32>,
}

impl Run {
    fn new() -> Self {
        let monitor = FlowMonitor::new(PERIOD_US, Monitors::ALL);
        Self {
            monitor,
            state: FlowState::default(),
            valve: 0.43,
            lung: 0.4,
            leak: (0.0, 0.0),
            rise: Some(RISE),
        }
    }

    /// A breath that the sensor shows in its way, from the true flow, L/s; what is found.
    fn breath(&mut self, sensor: impl Fn(f32) -> f32) -> Option<Fault> {
        for tick in 0..TICKS.0 + TICKS.1 {
            let inspires = tick < TICKS.0;
            let (flow, valve) = if inspires {
                (self.lung + self.leak.0, self.valve + self.leak.0)
            } else {
                (self.leak.1 - 0.5 * self.lung, self.leak.1 + 0.02)
            };
            let noise = 0.002 * ((tick * 7 % 5) as f32 - 2.0);
            self.monitor.add(&mut self.state, sensor(flow + noise), valve, inspires);
        }
        if let Some(rise) = self.rise {
            self.state.rose(rise);
        }
        self.state.start_breath();
        self.monitor.judge(&mut self.state, self.rise.is_none())
    }

    /// The number of breaths until the sensor is out of use, of at most 20.
    fn lost_after(&mut self, sensor: impl Fn(f32) -> f32) -> Option<usize> {
        (1..=20).find(|_| self.breath(&sensor) == Some(Fault::FlowSensorLost))
    }

    /// A run with some good breaths.
    fn known() -> Self {
        let mut run = Self::new();
        (0..5).for_each(|_| assert_eq!(run.breath(|flow| flow), None));
        run
    }
}

/// Noise of a sensor at a constant, L/s, with the true flow's last digits.
fn noisy(constant: f32) -> impl Fn(f32) -> f32 {
    move |flow| constant + 0.004 * ((flow.to_bits() % 64) as f32 / 32.0 - 1.0)
}

#[test]
fn a_reading_that_repeats_itself_for_a_breath_is_lost_at_once_at_any_value_but_zero() {
    for constant in [0.02, 0.1, 0.3, -0.1] {
        assert_eq!(Run::known().lost_after(|_| constant), Some(1), "{constant} L/s");
        let mut occluded = Run { valve: 0.04, lung: 0.0, ..Run::known() };
        assert_eq!(occluded.lost_after(|_| constant), Some(1), "{constant} L/s in an occluded tube");
    }
}

#[test]
fn a_quiet_sensor_may_show_no_flow_in_an_occluded_tube_but_not_while_the_pressure_is_reached() {
    let coarse = |flow: f32| 0.05 * (20.0 * flow + if flow < 0.0 { -0.5 } else { 0.5 }).trunc();
    let mut run = Run::new();
    (0..5).for_each(|_| assert_eq!(run.breath(coarse), None));
    assert_eq!(Run { valve: 0.04, lung: 0.0, ..run }.lost_after(coarse), None);
    assert_eq!(run.lost_after(|_| 0.0), Some(2));
    let mut noisy = Run { valve: 0.04, lung: 0.0, ..Run::known() };
    assert_eq!(noisy.lost_after(|_| 0.0), Some(1), "it had noise before");
}

#[test]
fn a_reading_that_stands_still_with_noise_is_lost_after_two_breaths() {
    for constant in [0.0, 0.02, 0.1, 0.3, 0.43, -0.1] {
        assert_eq!(Run::known().lost_after(noisy(constant)), Some(2), "{constant} L/s");
        assert_eq!(Run::new().lost_after(noisy(constant)), Some(2), "{constant} L/s from the start");
    }
}

#[test]
fn a_reading_with_noise_that_repeats_itself_is_lost_within_the_breath() {
    let ticks = |noisy: bool, flow: &dyn Fn(u32) -> f32| {
        let mut run = Run::known();
        run.state.noisy = noisy;
        (1..=100).find(|tick| {
            run.monitor.add(&mut run.state, flow(*tick), 0.3, false);
            run.state.is_lost()
        })
    };
    assert_eq!(ticks(true, &|_| 0.2), Some(11), "100 ms after the first");
    assert_eq!(ticks(false, &|_| 0.2), None, "a sensor without noise may repeat itself");
    assert_eq!(ticks(true, &|tick| 0.2 + 1e-3 * (tick % 2) as f32), None);
}

#[test]
fn a_reversed_sensor_and_one_far_off_are_lost_after_four_breaths() {
    for gain in [-1.0, 0.2, 0.4, 2.2, 4.0] {
        assert_eq!(Run::known().lost_after(|flow| gain * flow), Some(4), "a gain of {gain}");
    }
    assert_eq!(Run::new().lost_after(|flow| -flow), Some(4), "from the start");
    for offset in [-0.3, 0.3, 1.0] {
        assert_eq!(Run::known().lost_after(|flow| flow + offset), Some(4), "{offset} L/s");
    }
}

#[test]
fn more_gas_out_than_in_is_an_offset_after_five_breaths() {
    assert_eq!(Run::known().lost_after(|flow| flow - 0.1), Some(5));
    let mut run = Run::known();
    // A lung that gives out what it had for a few breaths.
    for gas in [0.4, 0.3, 0.2, 0.1, 0.0] {
        assert_eq!(run.breath(|flow| if flow < 0.0 { flow - gas } else { flow }), None);
    }
}

#[test]
fn more_gas_in_than_the_valve_gives_is_an_offset_whatever_the_lung() {
    let mut small = Run { valve: 0.08, lung: 0.05, ..Run::new() };
    (0..5).for_each(|_| assert_eq!(small.breath(|flow| flow), None));
    assert_eq!(small.lost_after(|flow| flow + 0.3), Some(4));
}

#[test]
fn gains_and_offsets_of_working_sensors_are_none_of_its_business() {
    for (gain, offset) in [(0.8, -0.05), (0.8, 0.05), (1.2, -0.05), (1.2, 0.05), (1.0, 0.0)] {
        let sensor = |flow: f32| gain * flow + offset;
        assert_eq!(Run::known().lost_after(sensor), None, "{gain}, {offset} L/s");
        assert_eq!(Run::new().lost_after(sensor), None, "{gain}, {offset} L/s from the start");
    }
}

#[test]
fn a_leak_is_gas_that_the_valve_gives() {
    // 1 L/s at 30 cmH2O, at a PEEP of 5 and of 15.
    for (leak, lung) in [((0.9, 0.4), 0.4), ((0.9, 0.7), 0.1), ((0.2, 0.1), 0.4)] {
        let mut run = Run { lung, leak, ..Run::known() };
        assert_eq!(run.lost_after(|flow| flow), None, "{leak:?} L/s");
        assert_eq!(Run { lung, leak, ..Run::new() }.lost_after(|flow| flow), None, "from the start");
    }
}

#[test]
fn a_newborns_machine_gives_a_fifth_of_the_models_gas() {
    let mut run = Run { valve: 0.2, lung: 0.03, ..Run::new() };
    assert_eq!(run.lost_after(|flow| flow), None);
    assert_eq!(run.lost_after(|flow| 0.4 * flow), Some(4));
}

#[test]
fn another_lung_is_another_usual_volume() {
    let mut run = Run { valve: 0.25, lung: 0.15, ..Run::known() };
    (0..9).for_each(|_| assert_eq!(run.breath(|flow| flow), None));
    assert_eq!(run.lost_after(|flow| 0.4 * flow), Some(4));
}

#[test]
fn a_single_breath_with_another_gas_makes_no_wrong_share_the_usual_one() {
    for fault in [|flow: f32| 0.4 * flow, |flow: f32| flow + 0.3] {
        let mut run = Run::known();
        (run.lung, run.valve) = (0.2, 0.23);
        run.breath(fault);
        (run.lung, run.valve) = (0.4, 0.43);
        assert!(run.lost_after(fault).is_some_and(|breaths| breaths <= 4));
    }
}

#[test]
fn without_its_pressure_a_breath_tells_nothing_of_the_gas() {
    let mut run = Run::known();
    for tick in 0..3 * (TICKS.0 + TICKS.1) {
        // The supply is lost: the valve is open, and nothing comes.
        let (inspires, noise) = (tick % 300 < TICKS.0, 0.002 * ((tick * 7 % 5) as f32 - 2.0));
        run.monitor.add(&mut run.state, noise, if inspires { 1.6 } else { 0.0 }, inspires);
        if tick % 300 == 299 {
            run.state.start_breath();
            assert_eq!(run.monitor.judge(&mut run.state, false), None);
        }
    }
}

#[test]
fn little_gas_tells_nothing() {
    // 40 mL for the circuit, and 60 more tell.
    for (valve, lost) in [(0.0999, None), (0.1001, Some(4))] {
        let mut run = Run { valve, lung: 0.06, ..Run::new() };
        assert_eq!(run.lost_after(|flow| -flow), lost, "{valve} L/s");
    }
}

#[test]
fn a_lost_sensor_is_used_again_after_five_seconds_of_sound_breaths() {
    let mut run = Run::known();
    assert_eq!(run.lost_after(|_| 0.1), Some(1));
    assert_eq!(run.breath(|flow| flow), Some(Fault::FlowSensorLost));
    assert!(run.state.is_doubtful());
    assert_eq!((run.breath(|flow| flow), run.state.is_lost()), (None, false));
    assert_eq!(run.lost_after(noisy(0.1)), Some(2));
    run.breath(|flow| flow);
    run.breath(noisy(0.1));
    assert_eq!(run.breath(|flow| flow), Some(Fault::FlowSensorLost), "5 s in a row");
    assert_eq!(run.breath(|flow| flow), None);
}

#[test]
fn a_single_contradiction_is_forgotten_after_five_seconds_that_tell_nothing() {
    let mut run = Run::known();
    run.breath(noisy(0.1));
    (run.valve, run.lung) = (0.05, 0.04);
    run.breath(|flow| flow);
    assert!(run.state.is_doubtful());
    run.breath(|flow| flow);
    assert!(!run.state.is_doubtful());
    // And a reading that stands still is not used again before that time.
    for tick in 0..11 {
        run.monitor.add(&mut run.state, 0.1, 0.1, tick < 10);
    }
    assert!(run.state.is_lost());
    assert_eq!(run.breath(|flow| flow), Some(Fault::FlowSensorLost));
}

#[test]
fn a_sensor_that_was_lost_by_its_gas_is_not_found_by_breaths_without_any() {
    let mut run = Run::known();
    assert_eq!(run.lost_after(noisy(0.1)), Some(2));
    let mut occluded = Run { valve: 0.04, lung: 0.0, ..run };
    for _ in 0..9 {
        assert_eq!(occluded.breath(noisy(0.1)), Some(Fault::FlowSensorLost));
    }
}

#[test]
fn without_a_pressure_gas_that_does_not_arrive_is_an_occlusion_and_one_that_never_stops_a_lost_sensor() {
    let mut run = Run { rise: None, ..Run::known() };
    assert_eq!([run.breath(|flow| flow), run.breath(noisy(0.0))], [None; 2]);
    assert_eq!(run.breath(noisy(0.0)), Some(Fault::Occlusion));
    assert_eq!([run.breath(noisy(0.0)), run.breath(|flow| flow)], [Some(Fault::Occlusion), None]);
    assert_eq!(run.lost_after(noisy(0.3)), Some(2));
    assert_eq!(Run { rise: None, ..Run::new() }.lost_after(noisy(0.0)), None, "nothing is usual yet");
}

#[test]
fn what_a_constant_shows_in_an_inspiration_has_not_reached_the_patient() {
    let mut run = Run::known();
    run.breath(|_| 0.3);
    let reached = |run: &mut Run, flow: f32| {
        (0..100).for_each(|_| run.monitor.add(&mut run.state, flow, 0.0, true));
        run.state.reached(0.01)
    };
    assert!(reached(&mut run, 0.3).abs() < 0.1);
    let mut run = Run::known();
    assert!((reached(&mut run, 0.4) - 400.0).abs() < 2.0);
}

#[test]
fn a_swing_has_no_offset_and_is_that_of_the_lung() {
    let mut run = Run::new();
    let mut swing = |sensor: &dyn Fn(f32) -> f32| {
        run.breath(sensor);
        run.monitor.swing(&run.state)
    };
    let found = [swing(&|flow| flow), swing(&|flow| flow + 0.5), swing(&|flow| -flow), swing(&|_| 0.3)];
    let wanted = [400.0, 400.0, -400.0, 0.0];
    assert!(found.iter().zip(wanted).all(|(found, wanted)| (found - wanted).abs() < 1.0), "{found:?}");
}

#[test]
fn missing_readings_are_no_part_of_a_breath() {
    let mut run = Run::known();
    assert_eq!(run.lost_after(|_| f32::NAN), None, "another monitor finds that");
    (0..3).for_each(|_| run.monitor.add(&mut run.state, 0.1, 0.0, true));
    run.state.start_breath();
    for tick in 0..300 {
        run.monitor.add(&mut run.state, if tick % 3 == 0 { f32::NAN } else { 0.1 }, 0.0, tick < 100);
    }
    run.state.start_breath();
    assert!(run.state.last.is_frozen(false));
    assert!((run.monitor.expiration(&run.state) - 2.0).abs() < 1e-4, "with and without a reading");
}

#[test]
fn without_its_alarm_the_sensor_is_always_used() {
    let mut run = Run::known();
    run.monitor = FlowMonitor::new(PERIOD_US, Monitors::ALL.without(Fault::FlowSensorLost));
    assert_eq!((run.lost_after(|_| 0.1), run.state.is_lost()), (None, false));
}

#[test]
fn a_sensor_that_shows_far_less_hides_gas_at_once_and_one_that_shows_more_after_two_inspirations() {
    let hides = |shown: &[Ordering]| {
        let mut state = FlowState::default();
        for one in shown {
            state.inspired(*one);
        }
        state.hides_gas()
    };
    assert!(hides(&[Ordering::Less]) && hides(&[Ordering::Greater; 2]));
    assert!(!hides(&[Ordering::Greater]) && !hides(&[Ordering::Less, Ordering::Equal]) && !hides(&[]));
    assert!(!hides(&[Ordering::Greater, Ordering::Equal, Ordering::Greater]));
}
