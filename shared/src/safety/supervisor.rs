//! The supervisor: everything that stands between a controller's wish and the valves.
//!
//! Each tick the monitors look at the reading, at the pressure, at the breath and at what the valve must have delivered. What
//! they find leads down the [`super::ladder`] or into the latched safe state, which ends only by
//! [`Supervisor::clear`], asked for by an operator. The learned part of a command gets through only while everything is
//! proven in this very tick, and never faster than [`RESIDUAL_SLEW`].

use super::alarms::{Action, Fault};
use super::breathing::Breathing;
use super::filter::ValveCommand;
use super::ladder::{CAP, Ladder, Level};
use super::monitors::{Monitors, Times};
use super::opinion::Opinion;
use super::pressure::{Bearable, Pressure};
use super::reading::Reading;
use crate::breath::{Breath, Phase, period_s};
use crate::control::{COMMAND_MAX, Wish};
use crate::math;

/// How fast the learned part of a command may change, percent per second: through the whole range in 4 ms.
pub const RESIDUAL_SLEW: f32 = 25_000.0;
/// Ticks that may be missed within a breath.
const MISSED_MAX: u32 = 5;

/// Monitors, ladder and latch.
#[derive(Clone, Debug, PartialEq)]
pub struct Supervisor {
    period_us: u32,
    monitors: Monitors,
    times: Times,
    /// Change of the learned part allowed in a tick, percent.
    slew: f32,
    fault: Option<Fault>,
    raised: Option<Fault>,
    reading: Reading,
    pressure: Pressure,
    breathing: Breathing,
    opinion: Opinion,
    ladder: Ladder,
    /// The inspiration was ended at the pressure limit.
    cut: bool,
    missed: u32,
    proven: bool,
    /// Learned part of the last command, percent.
    learned: f32,
    applied: f32,
    venting: bool,
}

impl Supervisor {
    /// Nothing has happened yet; control period in microseconds.
    pub fn new(period_us: u32, monitors: Monitors) -> Self {
        Self {
            period_us,
            monitors,
            times: Times::new(period_us),
            slew: RESIDUAL_SLEW * period_s(period_us),
            fault: None,
            raised: None,
            reading: Reading::new(),
            pressure: Pressure::new(),
            breathing: Breathing::new(),
            opinion: Opinion::new(period_us),
            ladder: Ladder::new(),
            cut: false,
            missed: 0,
            proven: false,
            learned: 0.0,
            applied: 0.0,
            venting: true,
        }
    }

    /// The latched fault.
    pub fn fault(&self) -> Option<Fault> {
        self.fault
    }

    /// The newest finding that nobody has asked for yet.
    pub fn take_raised(&mut self) -> Option<Fault> {
        self.raised.take()
    }

    /// Who commands the inspiratory valve.
    pub fn level(&self) -> Level {
        if self.missed > 0 { self.ladder.level().max(Level::Pid) } else { self.ladder.level() }
    }

    /// Whether the running inspiration was ended at the pressure limit.
    pub fn cut(&self) -> bool {
        self.cut
    }

    /// Elastance, cmH2O/mL, and resistance, cmH2O/(L/s), of the lung as the second opinion knows it.
    pub fn lung(&self) -> Option<(f32, f32)> {
        self.opinion.lung()
    }

    /// Ticks have been missed since the last one.
    pub fn missed(&mut self, ticks: u32) {
        self.missed = self.missed.saturating_add(ticks);
        if self.missed >= MISSED_MAX {
            self.found(Fault::MissedTicks);
        }
    }

    /// Takes in one reading; the pressure to control with, or none while there is nothing to believe. `tick` is that of the
    /// running breath, none while no breath runs.
    #[inline]
    pub fn check(&mut self, reading: f32, breath: &Breath, tick: Option<u32>) -> Option<f32> {
        let believed = self.reading.check(reading, tick.is_some(), self.monitors, &self.times);
        self.proven = believed.fresh;
        if let Some(fault) = believed.fault {
            self.found(fault);
        }
        let pressure = believed.pressure?;
        if believed.fresh {
            self.check_pressure(pressure, breath);
        }
        if let Some(tick) = tick {
            self.check_breath(pressure, breath, tick);
        }
        if self.fault.is_some() { None } else { Some(pressure) }
    }

    fn check_pressure(&mut self, pressure: f32, breath: &Breath) {
        let settings = breath.settings();
        let (limit, peep) = (settings.pressure_limit, settings.peep);
        match self.pressure.check(pressure, limit, peep, self.venting, self.monitors, &self.times) {
            Bearable::Yes => {}
            Bearable::EndBreath => {
                if !self.cut && !self.venting {
                    self.opinion.learn();
                }
                self.cut = true;
            }
            Bearable::No(fault) => self.found(fault),
        }
    }

    fn check_breath(&mut self, pressure: f32, breath: &Breath, tick: u32) {
        if tick == 0 {
            self.start_breath(pressure, breath.settings().peep);
        }
        let inspires = breath.phase(tick) == Phase::Inspiration;
        if inspires && !self.cut {
            let silent = self.opinion.check(pressure, &self.times);
            if silent && self.monitors.has(Fault::NoResponse) {
                self.found(Fault::NoResponse);
            }
        }
        let seen = (pressure, self.applied, self.opinion.volume());
        if let Some(fault) = self.breathing.check(seen, (breath, tick, self.cut), self.monitors, &self.times)
        {
            self.found(fault);
        }
        if tick + 1 == breath.inspiration_ticks() && !self.cut {
            self.opinion.learn();
        }
    }

    /// Judges the breath that has ended, and starts the next one.
    fn start_breath(&mut self, pressure: f32, peep: f32) {
        if let Some(fault) = self.ladder.breath_ended(self.cut) {
            self.found(fault);
        }
        (self.cut, self.missed, self.learned) = (false, 0, 0.0);
        self.opinion.start(pressure, peep);
    }

    /// Acts on a finding as its alarm's row says.
    fn found(&mut self, fault: Fault) {
        if !self.monitors.has(fault) || self.fault.is_some() {
            return;
        }
        let level = self.ladder.level();
        match fault.alarm().action {
            Action::Tell => {}
            Action::Vent => self.fault = Some(fault),
            Action::Pid => self.ladder.step_down(Level::Pid),
            Action::CappedPid => self.ladder.step_down(Level::CappedPid),
        }
        let ends_breaths = matches!(fault, Fault::LearnedDistrusted | Fault::CommandCapped);
        if self.fault.is_some() || ends_breaths || self.ladder.level() != level {
            self.raised = Some(fault);
        }
    }

    /// The safety filter: makes the wish a command, as far as it is trusted. While a fault is latched the command is the
    /// safe one; above the pressure limit the valves vent.
    #[inline]
    pub fn command(&mut self, wish: Wish, u_out: bool) -> ValveCommand {
        let u_in = self.trusted_part(wish);
        let vents = self.fault.is_some() || (self.cut && !u_out);
        let command = if vents { ValveCommand::SAFE } else { ValveCommand::limited(u_in, u_out) };
        (self.applied, self.venting) = (command.u_in(), command.u_out());
        self.opinion.applied(command.u_in());
        command
    }

    /// The wish without what is not trusted of it, percent. What is learned fades in and out at the slew, so that a hand-over
    /// is no bump.
    fn trusted_part(&mut self, wish: Wish) -> f32 {
        let level = self.level();
        let trusted = self.proven && level == Level::Learned;
        let wanted = if trusted { wish.command - wish.base } else { 0.0 };
        let change = wanted - self.learned;
        if trusted && change.abs() <= self.slew {
            self.learned = wanted;
            return wish.command;
        }
        self.learned += math::limit(change, -self.slew, self.slew);
        let cap = if level == Level::CappedPid { CAP } else { COMMAND_MAX };
        (wish.base + self.learned).min(cap)
    }

    /// No breath runs: the safe command.
    pub fn rest(&mut self) -> ValveCommand {
        self.command(Wish::default(), true)
    }

    /// Ventilation starts: breaths of an earlier run do not count.
    pub fn begin(&mut self) {
        *self = Self { reading: self.reading, fault: self.fault, ..Self::new(self.period_us, self.monitors) };
    }

    /// Forgets the fault, by an operator's wish.
    pub fn clear(&mut self) {
        *self = Self::new(self.period_us, self.monitors);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{DEFAULT_PERIOD_US, paper_settings};
    use proptest::prelude::*;
    use std::vec::Vec;

    fn breath() -> Breath {
        Breath::new(&paper_settings(20.0), DEFAULT_PERIOD_US).unwrap()
    }

    fn supervisor() -> Supervisor {
        Supervisor::new(DEFAULT_PERIOD_US, Monitors::ALL)
    }

    /// A living sensor about a pressure.
    fn dither(tick: u32) -> f32 {
        0.07 * ((tick * 7 % 5) as f32 - 2.0)
    }

    /// Ticks of a breath at a constant pressure with a constant wish.
    fn run(supervisor: &mut Supervisor, ticks: core::ops::Range<u32>, pressure: f32, wish: Wish) -> Vec<f32> {
        ticks
            .map(|tick| {
                let inspires = breath().phase(tick) == Phase::Inspiration;
                supervisor.check(pressure + dither(tick), &breath(), Some(tick));
                supervisor.command(wish, !inspires).u_in()
            })
            .collect()
    }

    const LEARNED: Wish = Wish { base: 20.0, command: 24.0 };

    #[test]
    fn what_is_learned_gets_through_while_all_is_proven() {
        let commands = run(&mut supervisor(), 0..100, 15.0, LEARNED);
        assert!(commands.iter().all(|u| (u - 24.0).abs() < f32::EPSILON));
    }

    #[test]
    fn a_bridged_reading_takes_the_learned_part_out_for_that_tick() {
        let mut supervisor = supervisor();
        run(&mut supervisor, 0..10, 15.0, LEARNED);
        assert_eq!(supervisor.check(f32::NAN, &breath(), Some(10)), Some(15.0 + dither(9)));
        assert!((supervisor.command(LEARNED, false).u_in() - 20.0).abs() < 1e-4);
        assert!((run(&mut supervisor, 11..12, 15.0, LEARNED)[0] - 24.0).abs() < 1e-4);
    }

    #[test]
    fn the_learned_part_cannot_move_faster_than_its_slew() {
        let hostile = |base, command| Wish { base, command };
        let mut supervisor = supervisor();
        let up = run(&mut supervisor, 0..5, 15.0, hostile(0.0, 100.0));
        let expected = [25.0, 50.0, 75.0, 100.0, 100.0];
        assert!(up.iter().zip(expected).all(|(u, wanted)| (u - wanted).abs() < 1e-3), "{up:?}");
        let down = run(&mut supervisor, 5..8, 15.0, hostile(100.0, 0.0));
        assert!(down.windows(2).all(|pair| (pair[1] - pair[0]).abs() <= 25.0 + 1e-3), "{down:?}");
    }

    #[test]
    fn a_missed_tick_hands_over_to_the_pid_until_the_breath_ends_and_five_latch() {
        let mut supervisor = supervisor();
        run(&mut supervisor, 0..10, 15.0, LEARNED);
        supervisor.missed(1);
        assert_eq!((supervisor.level(), supervisor.fault()), (Level::Pid, None));
        assert!((run(&mut supervisor, 10..12, 15.0, LEARNED)[1] - 20.0).abs() < 1e-4);
        run(&mut supervisor, 0..1, 15.0, LEARNED);
        assert_eq!(supervisor.level(), Level::Learned);
        supervisor.missed(5);
        assert_eq!(supervisor.fault(), Some(Fault::MissedTicks));
    }

    #[test]
    fn above_the_limit_the_breath_vents_and_the_next_one_goes_on() {
        let mut supervisor = supervisor();
        run(&mut supervisor, 0..100, 55.0, LEARNED);
        run(&mut supervisor, 100..110, 60.5, LEARNED);
        assert!(supervisor.cut());
        assert_eq!(supervisor.command(LEARNED, false), ValveCommand::SAFE);
        for tick in 110..120 {
            run(&mut supervisor, tick..tick + 1, 60.0 - 5.0 * (tick - 109) as f32, LEARNED);
        }
        run(&mut supervisor, 120..1000, 7.0, LEARNED);
        assert_eq!(supervisor.command(LEARNED, false), ValveCommand::SAFE, "until the breath has ended");
        run(&mut supervisor, 1000..3000, 5.0, Wish { base: 5.0, command: 5.0 });
        assert!((run(&mut supervisor, 0..1, 5.0, LEARNED)[0] - 24.0).abs() < 1e-4);
        assert_eq!((supervisor.fault(), supervisor.take_raised()), (None, None), "a cough is no alarm");
    }

    #[test]
    fn a_latched_fault_stays_and_commands_the_safe_state_until_it_is_cleared() {
        let mut supervisor = supervisor();
        for tick in 0..5 {
            supervisor.check(f32::NAN, &breath(), Some(tick));
        }
        assert_eq!(supervisor.take_raised(), Some(Fault::ReadingNotANumber));
        for tick in 0..1000 {
            assert_eq!(supervisor.check(5.0 + dither(tick), &breath(), None), None);
            assert_eq!(supervisor.command(LEARNED, false), ValveCommand::SAFE);
        }
        supervisor.begin();
        assert_eq!(supervisor.fault(), Some(Fault::ReadingNotANumber));
        supervisor.clear();
        assert_eq!(supervisor.fault(), None);
    }

    proptest! {
        /// Whatever a network says: the command never strays from the PID's by more than the slew allows, tick by tick.
        #[test]
        fn no_network_moves_the_command_faster_than_the_slew(
            wishes in prop::collection::vec((0.0f32..=100.0, prop::num::f32::ANY), 1..300),
        ) {
            let (mut supervisor, mut learned) = (supervisor(), 0.0);
            for (tick, (base, wild)) in wishes.into_iter().enumerate() {
                let wish = Wish { base, command: math::limit(wild, 0.0, 100.0) };
                supervisor.check(15.0 + dither(tick as u32), &breath(), Some(tick as u32));
                let command = supervisor.command(wish, false).u_in();
                let now = command - base;
                prop_assert!((0.0..=100.0).contains(&command));
                prop_assert!((now - learned).abs() <= 25.0 + base.max(100.0 - base) + 1e-3);
                learned = now;
            }
        }
    }
}
