//! Is a host still there? Ventilation goes on without one, on the settings in force; exploration does not.

use crate::math;

/// A host that says nothing for so long while the ventilator ventilates is gone, s.
pub const SILENCE_MAX: f32 = 10.0;

/// Since when the host has been silent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostWatch {
    /// Ticks that it may be silent.
    allowed: u32,
    /// Ticks since it last spoke; none if it never did or if its silence was told.
    silent: Option<u32>,
}

impl HostWatch {
    /// Nobody has spoken yet; control period in microseconds.
    pub fn new(period_us: u32) -> Self {
        Self { allowed: math::ticks(SILENCE_MAX, period_us), silent: None }
    }

    /// It spoke.
    pub fn heard(&mut self) {
        self.silent = Some(0);
    }

    /// Takes in a tick; whether the host is gone, told once.
    #[inline]
    pub fn is_gone(&mut self, ventilating: bool) -> bool {
        let Some(silent) = self.silent.filter(|_| ventilating) else { return false };
        let gone = silent >= self.allowed;
        self.silent = (!gone).then_some(silent + 1);
        gone
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ticks at which a host is called gone.
    fn gone(watch: &mut HostWatch, ticks: usize, ventilating: bool) -> std::vec::Vec<usize> {
        (0..ticks).filter(|_| watch.is_gone(ventilating)).collect()
    }

    #[test]
    fn a_host_that_falls_silent_is_told_once_until_it_speaks_again() {
        let mut watch = HostWatch::new(1000);
        assert!(gone(&mut watch, 50_000, true).is_empty(), "nobody ever spoke");
        watch.heard();
        assert_eq!(gone(&mut watch, 50_000, true), [10_000]);
        watch.heard();
        assert_eq!(gone(&mut watch, 50_000, true), [10_000]);
    }

    #[test]
    fn in_standby_a_host_may_be_silent() {
        let mut watch = HostWatch::new(1000);
        watch.heard();
        assert!(gone(&mut watch, 50_000, false).is_empty());
    }
}
