//! The learned part of a command: what the controller's PID would have commanded in the same state is taken off.
//!
//! A device does not report this part. Its PID is known: it has reported the gains, or it runs weights that come with this program.
//! The PID computes here what it computes there, from the same samples; only while the valve is saturated, or after the safety
//! filter has changed a command, can its integral differ for the rest of that breath.

use shared::breath::Phase;
use shared::control::Observation;
use shared::control::pid::{Pid, PidGains, PidState};
use shared::safety::ladder::Level;
use shared::ventilator::Sample;

/// Follows the PID inside a device.
#[derive(Clone, Debug)]
pub struct LearnedShare {
    pid: Option<Pid>,
    /// Level of the ladder that commands, if it is known.
    level: Option<Level>,
    state: PidState,
    /// Whether the running breath was seen from its start.
    whole: bool,
    period_us: u32,
}

impl LearnedShare {
    /// For a device with this control period, microseconds, whose gains are not known yet.
    pub fn new(period_us: u32) -> Self {
        Self { pid: None, level: None, state: PidState::new(), whole: false, period_us }
    }

    /// Sets the gains of the device's PID, if they are known. The running breath then stays unknown.
    pub fn gains(&mut self, gains: Option<PidGains>) {
        if self.pid.map(|pid| pid.gains()) != gains {
            self.pid = gains.and_then(|gains| Pid::new(gains, self.period_us).ok());
            self.whole = false;
        }
    }

    /// Sets the level that commands the valve, if it is known. [`Level::Pid`] also stands for a controller that is a PID.
    pub fn level(&mut self, level: Option<Level>) {
        self.level = level;
    }

    /// Samples are missing.
    pub fn interrupted(&mut self) {
        self.whole = false;
    }

    /// The learned part of the command of a sample, percent. NaN if it is not known, or if neither the learned controller nor its
    /// PID commands: then the command has no learned part, and what it differs by from the PID means nothing.
    pub fn take(&mut self, sample: &Sample, peep: f32) -> f32 {
        if sample.tick == 0 {
            (self.state, self.whole) = (PidState::new(), true);
        }
        let Some(pid) = self.pid.as_ref().filter(|_| self.whole) else { return f32::NAN };
        if sample.phase != Phase::Inspiration {
            return 0.0;
        }
        let Sample { pressure, target, tick, .. } = *sample;
        let seen = Observation { pressure, target, pip: target, peep, tick };
        let base = pid.step(&mut self.state.clone(), &seen, 0.0).base;
        let learned = sample.u_in - sample.explore - base;
        pid.step(&mut self.state, &seen, learned);
        match self.level {
            Some(Level::Learned) => learned,
            Some(Level::Pid) => 0.0,
            Some(Level::CappedPid | Level::Backup) | None => f32::NAN,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GAINS: PidGains = PidGains { p: 2.0, i: 20.0, d: 0.01 };

    fn sample(tick: u32, pressure: f32, u_in: f32) -> Sample {
        let phase = if tick < 1000 { Phase::Inspiration } else { Phase::Expiration };
        Sample {
            breath: 0,
            tick,
            phase,
            target: 20.0,
            pressure,
            u_in,
            u_out: tick >= 1000,
            explore: 0.0,
            learned: 0.0,
            flow: None,
        }
    }

    /// Shares of a breath with the command of a PID and this learned part.
    fn shares(share: &mut LearnedShare, learned: impl Fn(u32) -> f32) -> Vec<f32> {
        let (pid, mut state) = (Pid::new(GAINS, 1000).unwrap(), PidState::new());
        let take = |tick: u32| {
            let pressure = 20.0 - 12.0 * (-0.01 * f64::from(tick)).exp() as f32;
            let seen = Observation { pressure, target: 20.0, pip: 20.0, peep: 5.0, tick };
            let command = if tick < 1000 { pid.step(&mut state, &seen, learned(tick)).command } else { 5.0 };
            share.take(&sample(tick, pressure, command), 5.0)
        };
        (0..1500).map(take).collect()
    }

    fn known() -> LearnedShare {
        let mut share = LearnedShare::new(1000);
        share.gains(Some(GAINS));
        share.level(Some(Level::Learned));
        share
    }

    #[test]
    fn the_share_is_what_was_added_to_the_pid() {
        let added = |tick: u32| 5.0 * (tick as f32 * 0.01).sin();
        for (tick, share) in (0..).zip(shares(&mut known(), added)) {
            let expected = if tick < 1000 { added(tick) } else { 0.0 };
            assert!((share - expected).abs() < 1e-3, "{tick}: {share}, not {expected}");
        }
    }

    #[test]
    fn a_pid_alone_has_no_learned_share() {
        assert!(shares(&mut known(), |_| 0.0).iter().all(|share| share.abs() < 1e-3));
    }

    #[test]
    fn only_the_learned_controller_has_a_learned_part() {
        let inspiration = |level| {
            let mut share = known();
            share.level(level);
            shares(&mut share, |_| 7.0)[..1000].to_vec()
        };
        assert!(inspiration(Some(Level::Learned)).iter().all(|share| (share - 7.0).abs() < 1e-3));
        assert!(inspiration(Some(Level::Pid)).iter().all(|share| *share == 0.0));
        for level in [Some(Level::CappedPid), Some(Level::Backup), None] {
            assert!(inspiration(level).iter().all(|share| share.is_nan()), "{level:?}");
        }
    }

    #[test]
    fn without_the_gains_or_the_start_of_the_breath_it_is_unknown() {
        assert!(shares(&mut LearnedShare::new(1000), |_| 0.0).iter().all(|share| share.is_nan()));
        let mut share = known();
        assert!(share.take(&sample(5, 10.0, 30.0), 5.0).is_nan(), "the start was not seen");
        assert!(!share.take(&sample(0, 10.0, 30.0), 5.0).is_nan());
        share.interrupted();
        assert!(share.take(&sample(1, 10.0, 30.0), 5.0).is_nan());
    }
}
