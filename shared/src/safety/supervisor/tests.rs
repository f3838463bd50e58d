//! Tests of the supervisor.

use super::*;
use crate::breath::{DEFAULT_PERIOD_US, Phase, paper_settings};
use crate::math;
use core::ops::Range;
use proptest::prelude::*;
use std::vec::Vec;

mod bounds;
mod sensors;
mod volumes;

fn breath() -> Breath {
    Breath::new(&paper_settings(20.0), DEFAULT_PERIOD_US).unwrap()
}

/// A supervisor with its state.
struct Run {
    supervisor: Supervisor,
    state: SupervisorState,
    /// Readings and tick of the last check in a breath.
    last: Option<(Readings, u32)>,
}

impl Run {
    fn new() -> Self {
        let supervisor = Supervisor::new(DEFAULT_PERIOD_US, Monitors::ALL);
        Self { supervisor, state: SupervisorState::default(), last: None }
    }

    /// The believed pressure at a reading of the only sensor.
    fn check(&mut self, reading: f32, tick: Option<u32>) -> Option<f32> {
        self.check_all(reading.into(), tick)
    }

    fn check_all(&mut self, readings: Readings, tick: Option<u32>) -> Option<f32> {
        self.last = tick.map(|tick| (readings, tick));
        let Some(tick) = tick else {
            self.supervisor.watch(&mut self.state, &readings, &breath());
            return None;
        };
        let breath = breath();
        let belief = self.supervisor.check(&mut self.state, &readings, breath.at(tick))?;
        (self.state.reading != Reading::Lost).then_some(belief.pressure)
    }

    /// The command after the last check.
    fn filter(&mut self, output: ControlOutput, u_out: bool) -> ValveCommand {
        let breath = breath();
        let belief = self
            .last
            .and_then(|(readings, tick)| self.supervisor.belief(&self.state, &readings, breath.at(tick)));
        match belief {
            Some(belief) => self.supervisor.command(&mut self.state, &belief, output, u_out),
            None => self.supervisor.rest(&mut self.state),
        }
    }

    /// The command in a tick of the inspiration.
    fn command(&mut self, output: ControlOutput) -> ValveCommand {
        self.filter(output, false)
    }

    /// An effort of the patient at the end of a tick.
    fn effort(&mut self, tick: u32) {
        assert!(self.supervisor.end_tick(&mut self.state, &breath().at(tick), true));
    }

    /// The command of backup ventilation in a tick of the inspiration, percent.
    fn backup(&self, tick: u32) -> f32 {
        self.supervisor.backup_command(&self.state, &breath().at(tick))
    }

    fn missed(&mut self, ticks: u32) {
        self.supervisor.missed(&mut self.state, ticks);
    }

    /// Runs ticks of a breath at a constant pressure and controller output; returns the commands, percent.
    fn breathe(&mut self, ticks: Range<u32>, pressure: f32, output: ControlOutput) -> Vec<f32> {
        ticks
            .map(|tick| {
                let inspires = breath().phase(tick) == Phase::Inspiration;
                self.check(pressure + dither(tick), Some(tick));
                self.filter(output, !inspires).u_in()
            })
            .collect()
    }
}

/// What becomes of a breath's pressure.
#[derive(Clone, Copy)]
enum Lung {
    /// It rises with the volume, by its elastance in cmH2O/mL.
    Elastic(f32),
    /// It stays at PEEP, whatever the valve delivers.
    Dead,
}

impl Run {
    /// A breath with a command in percent throughout its inspiration; the tick at which the pressure no longer responded.
    fn inspire(&mut self, lung: Lung, command: f32) -> Option<u32> {
        let mut pressure = 5.0_f32;
        let responded = self.state.unresponsive.is_none();
        for tick in 0..breath().total_ticks() {
            let inspires = breath().phase(tick) == Phase::Inspiration;
            let rise = match lung {
                Lung::Elastic(elastance) if inspires && !self.state.cut() && tick > 0 => {
                    elastance * self.state.lung.volume()
                }
                _ => 0.0,
            };
            // No faster down than a lung empties.
            pressure = (5.0 + rise).max(pressure - 2.0);
            self.check(pressure + dither(tick), Some(tick));
            if responded && self.state.unresponsive.is_some() {
                return Some(tick);
            }
            self.filter(ControlOutput::plain(command), !inspires);
        }
        None
    }

    /// When a reading that stays at PEEP was called silent: the softer the lung is believed to be, the later.
    fn silent_after(&mut self) -> u32 {
        let tick = self.inspire(Lung::Dead, 100.0);
        assert_eq!((self.state.level(), self.state.fault()), (Level::Backup, None));
        assert!(self.state.indications().present().has(Fault::NoResponse));
        tick.unwrap_or_default()
    }
}

/// Lungs of 50 and 10 mL/cmH2O.
const SOFT: Lung = Lung::Elastic(0.02);
const STIFF: Lung = Lung::Elastic(0.1);

/// Noise of a working sensor.
fn dither(tick: u32) -> f32 {
    0.07 * ((tick * 7 % 5) as f32 - 2.0)
}

const LEARNED: ControlOutput = ControlOutput { base: 20.0, command: 24.0 };

#[test]
fn what_is_learned_gets_through_while_all_is_proven() {
    let commands = Run::new().breathe(0..100, 15.0, LEARNED);
    assert!(commands.iter().all(|u| (u - 24.0).abs() < f32::EPSILON));
}

#[test]
fn a_bridged_reading_takes_the_learned_part_out_for_that_tick() {
    let mut run = Run::new();
    run.breathe(0..10, 15.0, LEARNED);
    assert_eq!(run.check(f32::NAN, Some(10)), Some(15.0 + dither(9)));
    assert!((run.command(LEARNED).u_in() - 20.0).abs() < 1e-4);
    assert!((run.breathe(11..12, 15.0, LEARNED)[0] - 24.0).abs() < 1e-4);
}

#[test]
fn the_learned_part_cannot_move_faster_than_its_slew() {
    let hostile = |base, command| ControlOutput { base, command };
    let mut run = Run::new();
    let up = run.breathe(0..5, 15.0, hostile(0.0, 100.0));
    let expected = [25.0, 50.0, 75.0, 100.0, 100.0];
    assert!(up.iter().zip(expected).all(|(u, wanted)| (u - wanted).abs() < 1e-3), "{up:?}");
    let down = run.breathe(5..8, 15.0, hostile(100.0, 0.0));
    assert!(down.windows(2).all(|pair| (pair[1] - pair[0]).abs() <= 25.0 + 1e-3), "{down:?}");
}

/// Verifies: command-capped.
#[test]
fn the_cap_of_the_capped_pid_takes_effect_at_once() {
    let mut run = Run::new();
    run.breathe(0..10, 15.0, ControlOutput::plain(90.0));
    run.state.ladder.step_down(Level::CappedPid);
    assert!((run.breathe(10..11, 15.0, ControlOutput::plain(90.0))[0] - 40.0).abs() < f32::EPSILON);
}

#[test]
fn a_noisy_sensor_leaves_the_capped_pid() {
    let mut run = Run::new();
    let noisy = |tick: u32| 15.0 + 1.2 * ((tick * 7 % 5) as f32 - 2.0);
    for tick in 0..200 {
        run.check(noisy(tick), Some(tick));
        run.command(LEARNED);
    }
    assert_eq!(run.state.take_begun(), Some(Fault::ReadingNoisy));
    assert_eq!((run.state.level(), run.state.fault()), (Level::CappedPid, None));
    run.check(noisy(200), Some(200));
    assert_eq!(run.state.take_begun(), None, "told once");
}

#[test]
fn a_missed_tick_does_not_lift_the_cap() {
    let mut run = Run::new();
    run.state.ladder.step_down(Level::CappedPid);
    run.missed(1);
    assert_eq!(run.state.level(), Level::CappedPid);
    assert!((run.breathe(10..11, 15.0, ControlOutput::plain(90.0))[0] - 40.0).abs() < f32::EPSILON);
}

#[test]
fn a_missed_tick_hands_over_to_the_pid_until_the_breath_ends_and_five_for_longer() {
    let mut run = Run::new();
    run.breathe(0..10, 15.0, LEARNED);
    run.missed(1);
    assert_eq!((run.state.level(), run.state.fault()), (Level::Pid, None));
    assert!((run.breathe(10..12, 15.0, LEARNED)[1] - 20.0).abs() < 1e-4);
    run.breathe(0..1, 15.0, LEARNED);
    assert_eq!(run.state.level(), Level::Learned);
    run.missed(5);
    assert_eq!((run.state.take_begun(), run.state.fault()), (Some(Fault::MissedTicks), None));
    run.breathe(0..1, 15.0, LEARNED);
    assert_eq!(run.state.level(), Level::Pid);
}

#[test]
fn above_the_limit_the_breath_vents_and_the_next_one_goes_on() {
    let mut run = Run::new();
    run.breathe(0..100, 55.0, LEARNED);
    run.breathe(100..110, 60.5, LEARNED);
    assert!(run.state.cut());
    assert_eq!(run.command(LEARNED), ValveCommand::SAFE);
    for tick in 110..120 {
        run.breathe(tick..tick + 1, 60.0 - 5.0 * (tick - 109) as f32, LEARNED);
    }
    run.breathe(120..1000, 7.0, LEARNED);
    assert_eq!(run.command(LEARNED), ValveCommand::SAFE, "until the breath has ended");
    let expiration = run.breathe(1000..3000, 5.0, ControlOutput::plain(5.0));
    assert!(expiration.iter().all(|u| (u - 5.0).abs() < f32::EPSILON), "the bias");
    assert!((run.breathe(0..1, 5.0, LEARNED)[0] - 24.0).abs() < 1e-4);
    assert_eq!((run.state.fault(), run.state.take_begun()), (None, None), "a cough is no alarm");
}

#[test]
fn a_latched_fault_stays_and_commands_the_safe_state_until_it_is_cleared() {
    let mut run = Run::new();
    for tick in 0..720 {
        // No gas comes out.
        run.check_all(Readings { flow: 0.0, ..(76.0 + dither(tick)).into() }, Some(tick));
        run.filter(LEARNED, tick >= 1000);
    }
    assert_eq!(run.state.take_begun(), Some(Fault::HardLimit));
    for tick in 0..1000 {
        assert_eq!(run.check(5.0 + dither(tick), None), None);
        assert_eq!(run.command(LEARNED), ValveCommand::SAFE);
    }
    run.state.begin();
    assert_eq!(run.state.fault(), Some(Fault::HardLimit));
    run.state.clear();
    assert_eq!(run.state.fault(), None);
}

/// A good breath at a constant command; its plateau is 25 cmH2O.
fn good_breath(run: &mut Run, both_sensors: bool) {
    for tick in 0..breath().total_ticks() {
        let inspires = breath().phase(tick) == Phase::Inspiration;
        let pressure = if inspires { 25.0 } else { 5.0 };
        let outlet = if both_sensors { pressure + dither(tick + 3) } else { f32::NAN };
        let readings = Readings { outlet, ..Readings::from(pressure + dither(tick)) };
        run.check_all(readings, Some(tick));
        run.filter(ControlOutput::plain(30.0), !inspires);
    }
}

#[test]
fn without_any_sensor_the_commands_of_good_breaths_are_repeated_and_the_sensor_that_returns_ends_it() {
    let mut run = Run::new();
    (0..3).for_each(|_| good_breath(&mut run, false));
    for tick in 0..5 {
        run.check(f32::NAN, Some(tick));
    }
    assert_eq!((run.state.level(), run.state.fault()), (Level::Backup, None));
    let begun = [run.state.take_begun(), run.state.take_begun()];
    assert_eq!(begun, [Some(Fault::ReadingNotANumber), Some(Fault::BackupVentilation)]);
    let command = run.backup(500);
    assert!((command - 30.0).abs() < 0.1, "{command}");
    (0..2).for_each(|_| good_breath(&mut run, false));
    assert_eq!(run.state.level(), Level::Learned);
}

#[test]
fn backup_ventilation_delivers_nothing_at_a_predicted_pressure_near_the_limit() {
    let mut run = Run::new();
    assert_eq!(run.inspire(STIFF, 100.0), None);
    run.check(f32::NAN, Some(0));
    for tick in 1..1000 {
        run.check(f32::NAN, Some(tick));
        let command = run.backup(tick);
        let command = ControlOutput::plain(if command > 0.0 { 100.0 } else { 0.0 });
        run.filter(command, false);
    }
    let pressure = run.state.lung.predicted_pressure().unwrap();
    assert!((54.0..62.0).contains(&pressure), "{pressure} at a limit of 60");
}

#[test]
fn the_outlet_sensor_takes_over_from_a_lost_airway_sensor() {
    let mut run = Run::new();
    (0..2).for_each(|_| good_breath(&mut run, true));
    for tick in 0..40 {
        let readings = Readings { airway: f32::NAN, outlet: 14.0 + dither(tick), flow: f32::NAN };
        run.check_all(readings, Some(tick));
    }
    let readings = Readings { airway: f32::NAN, outlet: 14.0, flow: f32::NAN };
    assert_eq!(run.check_all(readings, Some(40)), Some(14.0));
    assert_eq!((run.state.level(), run.state.fault()), (Level::Learned, None));
    assert_eq!(run.state.take_begun(), Some(Fault::ReadingNotANumber));
}

#[test]
fn a_lost_outlet_sensor_is_a_message() {
    let mut run = Run::new();
    good_breath(&mut run, true);
    good_breath(&mut run, false);
    assert_eq!((run.state.level(), run.state.take_begun()), (Level::Learned, Some(Fault::OutletSensorLost)));
}

#[test]
fn breaths_that_end_at_the_limit_lead_down_the_ladder_and_each_step_is_told() {
    let mut run = Run::new();
    let mut told = || {
        assert_eq!(run.inspire(STIFF, 100.0), None);
        (run.state.level(), run.state.take_begun())
    };
    assert_eq!((told(), told()), ((Level::Learned, None), (Level::Learned, None)));
    assert_eq!(told(), (Level::Pid, Some(Fault::LearnedDistrusted)));
    assert_eq!(told(), (Level::CappedPid, Some(Fault::HighPressure)), "three in a row");
    assert_eq!(run.state.take_begun(), Some(Fault::CommandCapped));
}

#[test]
fn breaths_that_a_cough_ends_are_no_strikes_and_three_in_a_row_an_alarm() {
    let mut run = Run::new();
    (0..2).for_each(|_| assert_eq!(run.inspire(SOFT, 30.0), None));
    let mut alarms = Vec::new();
    for _ in 0..4 {
        for tick in 0..breath().total_ticks() {
            let inspires = breath().phase(tick) == Phase::Inspiration;
            let cough = if (700..750).contains(&tick) { 60.0 } else { 0.0 };
            let rise = if inspires && !run.state.cut() { 0.02 * run.state.lung.volume() } else { 0.0 };
            run.check(5.0 + rise + cough + dither(tick), Some(tick));
            run.filter(ControlOutput::plain(30.0), !inspires);
        }
        alarms.extend(run.state.take_begun());
    }
    assert!(alarms.contains(&Fault::HighPressure) && run.state.level() < Level::CappedPid, "{alarms:?}");
    assert!(!alarms.contains(&Fault::LearnedDistrusted), "the gas does not explain the pressure");
}

#[test]
fn a_stiff_lung_that_does_not_answer_is_found_early_in_the_next_breath() {
    let mut run = Run::new();
    assert_eq!(run.inspire(STIFF, 40.0), None);
    assert!(run.silent_after() < 200);
}

#[test]
fn a_lung_is_known_from_a_breath_that_ended_at_the_limit() {
    let mut run = Run::new();
    assert_eq!(run.inspire(STIFF, 100.0), None);
    assert!(run.silent_after() < 200);
}

/// A lung is known from two inspirations, so one that were taken in twice would be enough.
#[test]
fn each_breath_tells_of_the_lung_once() {
    for (command, ends) in [(40.0, "by the clock"), (100.0, "at the limit")] {
        let mut run = Run::new();
        assert_eq!(run.inspire(STIFF, command), None);
        for tick in 1000..1100 {
            // No faster up or down than a sensor follows.
            let cough = 10.0 * (tick - 1000).min(1040_u32.saturating_sub(tick)) as f32;
            run.check(5.0 + cough.min(60.0) + dither(tick), Some(tick));
            run.filter(ControlOutput::plain(5.0), true);
        }
        assert!(run.state.cut(), "the cough has reached the limit, and must be one that ends an inspiration");
        assert!(run.state.lung.last_estimate().is_some() && !run.state.lung.is_known(), "ended {ends}");
        assert_eq!(run.inspire(STIFF, command), None);
        assert!(run.state.lung.is_known(), "the second one");
    }
}

/// In whole breaths the slew has taken it out long before; this is what bounds it if an expiration ever lasts less than 4 ticks.
#[test]
fn a_breath_begins_without_the_learned_part_of_the_last_one() {
    let mut run = Run::new();
    let learned = ControlOutput { base: 10.0, command: 90.0 };
    assert!(run.breathe(0..1000, 15.0, learned)[999] > 89.0);
    run.check(15.0, Some(0));
    assert!((run.command(ControlOutput::plain(10.0)).u_in() - 10.0).abs() < f32::EPSILON);
}

#[test]
fn a_pressure_that_answers_again_leads_to_the_pid_first() {
    let mut run = Run::new();
    (0..2).for_each(|_| assert_eq!(run.inspire(SOFT, 40.0), None));
    assert_eq!(run.state.level(), Level::Learned);
    run.silent_after();
    for answered in 1..=RESPONSES {
        assert_eq!(run.state.level(), Level::Backup, "inspiration {answered}");
        assert_eq!(run.inspire(SOFT, 40.0), None);
    }
    assert_eq!(run.state.level(), Level::Pid);
    assert!(!run.state.indications().present().has(Fault::LearnedDistrusted), "no strike has led there");
}

#[test]
fn the_volume_is_that_of_the_inspiration_until_its_end_or_the_limit() {
    let (mut run, bias) = (Run::new(), ControlOutput::plain(20.0));
    run.breathe(0..1000, 15.0, bias);
    let volume = run.state.lung.volume();
    assert!((140.0..150.0).contains(&volume), "{volume} mL at 0.161 L/s less the back-pressure");
    run.breathe(1000..3000, 5.0, bias);
    assert!((run.state.lung.volume() - volume).abs() < f32::EPSILON);
    run.breathe(0..500, 55.0, bias);
    run.breathe(500..510, 60.5, bias);
    assert!(run.state.cut());
    let volume = run.state.lung.volume();
    run.breathe(510..600, 55.0, bias);
    assert!((run.state.lung.volume() - volume).abs() < f32::EPSILON);
}

#[test]
fn a_tick_missed_in_each_of_three_breaths_is_an_alarm() {
    let begun = |sound: Option<u32>| {
        let mut run = Run::new();
        for number in 0..4 {
            run.breathe(0..2, 15.0, LEARNED);
            run.missed(u32::from(Some(number) != sound));
        }
        run.breathe(0..1, 15.0, LEARNED);
        (run.state.take_begun(), run.state.level())
    };
    assert_eq!(begun(Some(0)), (Some(Fault::MissedTicks), Level::Pid));
    assert_eq!(begun(Some(1)), (None, Level::Learned), "not in a row");
}

#[test]
fn breaths_of_an_earlier_run_do_not_count() {
    let mut run = Run::new();
    run.state.ladder.step_down(Level::Pid);
    run.missed(4);
    run.state.begin();
    assert_eq!(run.state.level(), Level::Learned);
    run.missed(4);
    assert_eq!(run.state.fault(), None);
}

#[test]
fn backup_ventilation_of_a_new_run_knows_nothing_of_the_last_patient() {
    let mut run = Run::new();
    (0..3).for_each(|_| good_breath(&mut run, false));
    let (of_the_last, of_nobody) = (run.backup(500), Run::new().backup(500));
    run.state.begin();
    assert_eq!(run.backup(500).to_bits(), of_nobody.to_bits());
    assert!((of_the_last - of_nobody).abs() > 5.0, "{of_the_last} and {of_nobody} %");
    for tick in 0..5 {
        run.check(f32::NAN, Some(tick));
    }
    assert_eq!(run.state.level(), Level::Backup);
    assert_eq!(run.backup(500).to_bits(), of_nobody.to_bits(), "nor once it commands");
}

#[test]
fn what_the_sensor_said_before_the_start_bridges_the_first_reading() {
    let mut run = Run::new();
    run.check(5.0, None);
    run.state.begin();
    assert_eq!(run.check(f32::NAN, Some(0)), Some(5.0));
}

#[test]
fn a_monitor_that_is_left_out_latches_nothing() {
    let mut run = Run::new();
    run.supervisor = Supervisor::new(DEFAULT_PERIOD_US, Monitors::ANY_PLANT);
    run.missed(5);
    assert_eq!((run.state.fault(), run.state.take_begun()), (None, None));
}

proptest! {
    /// For any output of the network and of its PID, the learned part changes by at most 25 % in a tick, and the command is
    /// the PID's with that part and nothing else. Verifies: residual-slew.
    #[test]
    fn no_network_moves_the_command_faster_than_the_slew(
        outputs in prop::collection::vec((0.0f32..=100.0, prop::num::f32::ANY), 1..300),
    ) {
        let (mut run, mut before) = (Run::new(), 0.0);
        for (tick, (base, wild)) in outputs.into_iter().enumerate() {
            let output = ControlOutput { base, command: math::limit(wild, 0.0, 100.0) };
            run.check(15.0 + dither(tick as u32), Some(tick as u32));
            let command = run.command(output).u_in();
            let learned = run.state.learned;
            prop_assert!((learned - before).abs() <= 25.0 + 1e-3);
            prop_assert!((command - (base + learned).clamp(0.0, 100.0)).abs() <= 1e-3);
            before = learned;
        }
    }
}

#[test]
fn a_breath_that_hardly_rises_lifts_the_cap_until_the_reading_is_noisy_again() {
    // PEEP is 5 and PIP 20: 30 % of the rise end at 9.5 cmH2O.
    let level = |pressure: f32, noise: f32| {
        let mut run = Run::new();
        run.state.ladder.step_down(Level::CappedPid);
        for tick in 0..breath().inspiration_ticks() + 2 {
            run.check(pressure + dither(tick) + noise * ((tick * 7 % 5) as f32 - 2.0), Some(tick));
            run.filter(ControlOutput::plain(2.0), breath().phase(tick) != Phase::Inspiration);
        }
        run.state.level()
    };
    assert_eq!((level(9.2, 0.0), level(9.8, 0.0)), (Level::Pid, Level::CappedPid));
    assert_eq!(level(9.2, 1.2), Level::CappedPid);
}
