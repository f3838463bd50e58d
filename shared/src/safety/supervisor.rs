//! The supervisor: all checks and limits between a controller's output and the valves.
//!
//! In each tick the monitors check the reading, the pressure, the breath and the response to the delivered gas. A finding
//! leads down the [`super::ladder`] or into the latched safe state, which only an operator can end
//! ([`SupervisorState::clear`]). The learned part of a command is applied only in ticks with a fresh, plausible reading,
//! and changes no faster than [`RESIDUAL_SLEW`].

use super::alarms::{Action, Fault};
use super::breath_monitor::{BreathInput, BreathMonitor, BreathState};
use super::filter::ValveCommand;
use super::ladder::{CAP, Ladder, Level};
use super::lung_estimator::{LungEstimator, LungState};
use super::monitors::Monitors;
use super::pressure_monitor::{PressureFinding, PressureInput, PressureMonitor, PressureState};
use super::reading_monitor::{ReadingMonitor, ReadingState};
use crate::breath::{Breath, Phase, period_s};
use crate::control::{COMMAND_MAX, ControlOutput};
use crate::math;

/// Fastest change of the learned part of a command, percent per second: the whole range takes 4 ms.
pub const RESIDUAL_SLEW: f32 = 25_000.0;
/// Missed ticks within a breath at which the safe state is latched.
const MISSED_MAX: u32 = 5;

/// Configuration: the monitors, and the slew of the learned part.
#[derive(Clone, Debug, PartialEq)]
pub struct Supervisor {
    monitors: Monitors,
    reading: ReadingMonitor,
    pressure: PressureMonitor,
    breath: BreathMonitor,
    lung: LungEstimator,
    /// Largest change of the learned part in a tick, percent.
    slew: f32,
}

/// State of the monitors, of the ladder and of the latched fault.
#[derive(Clone, Debug, PartialEq)]
pub struct SupervisorState {
    fault: Option<Fault>,
    raised: Option<Fault>,
    reading: ReadingState,
    pressure: PressureState,
    breath: BreathState,
    lung: LungState,
    ladder: Ladder,
    /// Whether the inspiration was ended at the pressure limit.
    cut: bool,
    missed: u32,
    proven: bool,
    /// Learned part of the last command, percent.
    learned: f32,
    applied: f32,
    venting: bool,
}

impl Supervisor {
    /// A supervisor with these monitors for a control period in microseconds.
    pub fn new(period_us: u32, monitors: Monitors) -> Self {
        Self {
            monitors,
            reading: ReadingMonitor::new(period_us, monitors),
            pressure: PressureMonitor::new(period_us, monitors),
            breath: BreathMonitor::new(period_us, monitors),
            lung: LungEstimator::new(period_us),
            slew: RESIDUAL_SLEW * period_s(period_us),
        }
    }

    /// The enabled monitors.
    pub fn monitors(&self) -> Monitors {
        self.monitors
    }

    /// Reports ticks missed since the last one.
    pub fn missed(&self, state: &mut SupervisorState, ticks: u32) {
        state.missed = state.missed.saturating_add(ticks);
        if state.missed >= MISSED_MAX {
            self.found(state, Fault::MissedTicks);
        }
    }

    /// Checks one reading. Returns the pressure to control with; none before the first good reading and while a fault is
    /// latched. `tick` is that of the running breath, none while no breath runs.
    #[inline]
    pub fn check(
        &self,
        state: &mut SupervisorState,
        reading: f32,
        breath: &Breath,
        tick: Option<u32>,
    ) -> Option<f32> {
        let believed = self.reading.check(&mut state.reading, reading, tick.is_some());
        state.proven = believed.fresh;
        if let Some(fault) = believed.fault {
            self.found(state, fault);
        }
        let pressure = believed.pressure?;
        if believed.fresh {
            self.check_pressure(state, pressure, breath);
        }
        if let Some(tick) = tick {
            self.check_breath(state, pressure, breath, tick);
        }
        if state.fault.is_some() { None } else { Some(pressure) }
    }

    fn check_pressure(&self, state: &mut SupervisorState, pressure: f32, breath: &Breath) {
        let settings = breath.settings();
        let (limit, peep) = (settings.pressure_limit, settings.peep);
        let input = PressureInput { pressure, limit, peep, venting: state.venting };
        match self.pressure.check(&mut state.pressure, &input) {
            PressureFinding::Normal => {}
            PressureFinding::EndInspiration => {
                if !state.cut && !state.venting {
                    state.lung.end_inspiration();
                }
                state.cut = true;
            }
            PressureFinding::Alarm(fault) => self.found(state, fault),
        }
    }

    fn check_breath(&self, state: &mut SupervisorState, pressure: f32, breath: &Breath, tick: u32) {
        if tick == 0 {
            self.start_breath(state, pressure, breath.settings().peep);
        }
        let inspires = breath.phase(tick) == Phase::Inspiration;
        if inspires && !state.cut {
            let silent = self.lung.check(&mut state.lung, pressure);
            if silent && self.monitors.has(Fault::NoResponse) {
                self.found(state, Fault::NoResponse);
            }
        }
        let (command, volume) = (state.applied, state.lung.volume());
        let input = BreathInput { breath, tick, cut: state.cut, pressure, command, volume };
        if let Some(fault) = self.breath.check(&mut state.breath, &input) {
            self.found(state, fault);
        }
        if tick + 1 == breath.inspiration_ticks() && !state.cut {
            state.lung.end_inspiration();
        }
    }

    /// Updates the ladder with the breath that has ended, and starts the next one.
    fn start_breath(&self, state: &mut SupervisorState, pressure: f32, peep: f32) {
        if let Some(fault) = state.ladder.breath_ended(state.cut) {
            self.found(state, fault);
        }
        (state.cut, state.missed, state.learned) = (false, 0, 0.0);
        state.lung.start_inspiration(pressure, peep);
    }

    /// Responds to a finding as specified in its row of the alarm table.
    fn found(&self, state: &mut SupervisorState, fault: Fault) {
        if !self.monitors.has(fault) || state.fault.is_some() {
            return;
        }
        let level = state.ladder.level();
        match fault.alarm().action {
            Action::Tell => {}
            Action::Vent => state.fault = Some(fault),
            Action::Pid => state.ladder.step_down(Level::Pid),
            Action::CappedPid => state.ladder.step_down(Level::CappedPid),
        }
        let ends_breaths = matches!(fault, Fault::LearnedDistrusted | Fault::CommandCapped);
        if state.fault.is_some() || ends_breaths || state.ladder.level() != level {
            state.raised = Some(fault);
        }
    }

    /// The safety filter: converts the trusted part of a controller's output to a valve command. The command is the safe one
    /// while a fault is latched and for the rest of an inspiration that was ended at the pressure limit.
    #[inline]
    pub fn command(&self, state: &mut SupervisorState, output: ControlOutput, u_out: bool) -> ValveCommand {
        let u_in = self.trusted_part(state, output);
        let vents = state.fault.is_some() || (state.cut && !u_out);
        let command = if vents { ValveCommand::SAFE } else { ValveCommand::limited(u_in, u_out) };
        (state.applied, state.venting) = (command.u_in(), command.u_out());
        self.lung.applied(&mut state.lung, command.u_in());
        command
    }

    /// The trusted part of the output, percent. The learned part fades in and out at the slew, so that no hand-over is a
    /// larger step; the cap takes effect at once.
    fn trusted_part(&self, state: &mut SupervisorState, output: ControlOutput) -> f32 {
        let level = state.level();
        let trusted = state.proven && level == Level::Learned;
        let wanted = if trusted { output.command - output.base } else { 0.0 };
        let change = wanted - state.learned;
        if trusted && change.abs() <= self.slew {
            state.learned = wanted;
            return output.command;
        }
        state.learned += math::limit(change, -self.slew, self.slew);
        let cap = if level == Level::CappedPid { CAP } else { COMMAND_MAX };
        (output.base + state.learned).min(cap)
    }

    /// The safe command, for ticks without a breath.
    pub fn rest(&self, state: &mut SupervisorState) -> ValveCommand {
        self.command(state, ControlOutput::default(), true)
    }
}

impl SupervisorState {
    /// The latched fault.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// The newest alarm that has not been taken yet.
    pub fn take_raised(&mut self) -> Option<Fault> {
        self.raised.take()
    }

    /// Level of the ladder that commands the inspiratory valve.
    pub fn level(&self) -> Level {
        if self.missed > 0 { self.ladder.level().max(Level::Pid) } else { self.ladder.level() }
    }

    /// Whether the running inspiration was ended at the pressure limit.
    pub fn cut(&self) -> bool {
        self.cut
    }

    /// Starts ventilation: resets everything except the reading monitor and a latched fault.
    pub fn begin(&mut self) {
        *self = Self { reading: self.reading, fault: self.fault, ..Self::default() };
    }

    /// Clears the latched fault and all other state, when an operator acknowledges the fault.
    pub fn clear(&mut self) {
        *self = Self::default();
    }
}

impl Default for SupervisorState {
    /// No findings yet; the valves are safe.
    fn default() -> Self {
        Self {
            fault: None,
            raised: None,
            reading: ReadingState::default(),
            pressure: PressureState::default(),
            breath: BreathState::default(),
            lung: LungState::default(),
            ladder: Ladder::default(),
            cut: false,
            missed: 0,
            proven: false,
            learned: 0.0,
            applied: 0.0,
            venting: true,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
    use core::ops::Range;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn breath() -> Breath {
        Breath::new(&paper_settings(20.0), DEFAULT_PERIOD_US).unwrap()
    }

    /// A supervisor with its state.
    struct Run {
        supervisor: Supervisor,
        state: SupervisorState,
    }

    impl Run {
        fn new() -> Self {
            let supervisor = Supervisor::new(DEFAULT_PERIOD_US, Monitors::ALL);
            Self { supervisor, state: SupervisorState::default() }
        }

        fn check(&mut self, reading: f32, tick: Option<u32>) -> Option<f32> {
            self.supervisor.check(&mut self.state, reading, &breath(), tick)
        }

        /// The command in a tick of the inspiration.
        fn command(&mut self, output: ControlOutput) -> ValveCommand {
            self.supervisor.command(&mut self.state, output, false)
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
                    self.supervisor.command(&mut self.state, output, !inspires).u_in()
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
        /// A breath with a command in percent throughout its inspiration; the tick at which a fault was latched.
        fn inspire(&mut self, lung: Lung, command: f32) -> Option<u32> {
            let mut pressure = 5.0_f32;
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
                if self.state.fault().is_some() {
                    return Some(tick);
                }
                self.supervisor.command(&mut self.state, ControlOutput::plain(command), !inspires);
            }
            None
        }

        /// When a reading that stays at PEEP was called silent: the softer the lung is believed to be, the later.
        fn silent_after(&mut self) -> u32 {
            let tick = self.inspire(Lung::Dead, 100.0);
            assert_eq!(self.state.fault(), Some(Fault::NoResponse));
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
        assert_eq!(run.state.take_raised(), Some(Fault::ReadingNoisy));
        assert_eq!((run.state.level(), run.state.fault()), (Level::CappedPid, None));
        run.check(noisy(200), Some(200));
        assert_eq!(run.state.take_raised(), None, "told once");
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
    fn a_missed_tick_hands_over_to_the_pid_until_the_breath_ends_and_five_latch() {
        let mut run = Run::new();
        run.breathe(0..10, 15.0, LEARNED);
        run.missed(1);
        assert_eq!((run.state.level(), run.state.fault()), (Level::Pid, None));
        assert!((run.breathe(10..12, 15.0, LEARNED)[1] - 20.0).abs() < 1e-4);
        run.breathe(0..1, 15.0, LEARNED);
        assert_eq!(run.state.level(), Level::Learned);
        run.missed(5);
        assert_eq!(run.state.fault(), Some(Fault::MissedTicks));
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
        assert_eq!((run.state.fault(), run.state.take_raised()), (None, None), "a cough is no alarm");
    }

    #[test]
    fn a_latched_fault_stays_and_commands_the_safe_state_until_it_is_cleared() {
        let mut run = Run::new();
        for tick in 0..5 {
            run.check(f32::NAN, Some(tick));
        }
        assert_eq!(run.state.take_raised(), Some(Fault::ReadingNotANumber));
        for tick in 0..1000 {
            assert_eq!(run.check(5.0 + dither(tick), None), None);
            assert_eq!(run.command(LEARNED), ValveCommand::SAFE);
        }
        run.state.begin();
        assert_eq!(run.state.fault(), Some(Fault::ReadingNotANumber));
        run.state.clear();
        assert_eq!(run.state.fault(), None);
    }

    #[test]
    fn breaths_that_end_at_the_limit_lead_down_the_ladder_and_each_step_is_told() {
        let mut run = Run::new();
        let mut told = || {
            assert_eq!(run.inspire(STIFF, 100.0), None);
            (run.state.level(), run.state.take_raised())
        };
        assert_eq!((told(), told()), ((Level::Learned, None), (Level::Learned, None)));
        assert_eq!(told(), (Level::Pid, Some(Fault::LearnedDistrusted)));
        assert_eq!(told(), (Level::CappedPid, Some(Fault::CommandCapped)));
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

    /// The softer lung of the last two breaths is believed, so a breath that were taken in twice would push out the other.
    #[test]
    fn each_breath_tells_of_the_lung_once() {
        let mut run = Run::new();
        assert_eq!((run.inspire(SOFT, 40.0), run.inspire(STIFF, 100.0)), (None, None));
        assert!(run.silent_after() > 250, "the second one ended at the limit");
        let mut run = Run::new();
        assert_eq!((run.inspire(SOFT, 40.0), run.inspire(STIFF, 40.0)), (None, None));
        for tick in 1000..1010 {
            run.check(65.0_f32.min(5.0 + 10.0 * (tick - 999) as f32) + dither(tick), Some(tick));
            run.supervisor.command(&mut run.state, ControlOutput::plain(5.0), true);
        }
        assert!(run.silent_after() > 250, "above the limit after the second one");
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
        assert_eq!((run.state.fault(), run.state.take_raised()), (None, None));
    }

    proptest! {
        /// For any output of the network and of its PID, the learned part changes by at most 25 % in a tick, and the command is
        /// the PID's with that part and nothing else.
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
}
