//! Detects a silent host. Ventilation continues without a host, on the settings in force; exploration ends.

use crate::math;

/// Longest time without a request while ventilating, s. Fulfils: host-silent.
pub const SILENCE_MAX: f32 = 10.0;

/// Measures how long the host has been silent.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HostWatch {
    /// Ticks for which it may be silent.
    allowed: u32,
    /// Ticks since the last request; none before the first request and after the silence was reported.
    silent: Option<u32>,
}

impl HostWatch {
    /// A watch for a control period in microseconds, before the first request.
    pub fn new(period_us: u32) -> Self {
        Self { allowed: math::ticks(SILENCE_MAX, period_us), silent: None }
    }

    /// Records a request of the host.
    pub fn heard(&mut self) {
        self.silent = Some(0);
    }

    /// Counts a tick; true once when the host has been silent for too long.
    #[inline]
    pub fn is_gone(&mut self, ventilating: bool) -> bool {
        let Some(silent) = self.silent.filter(|_| ventilating) else { return false };
        debug_assert!(silent <= self.allowed, "a silence is reported once");
        let gone = silent >= self.allowed;
        self.silent = (!gone).then_some(silent + 1);
        debug_assert!(gone == self.silent.is_none());
        gone
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Ticks at which the host is reported silent.
    fn gone(watch: &mut HostWatch, ticks: usize, ventilating: bool) -> std::vec::Vec<usize> {
        (0..ticks).filter(|_| watch.is_gone(ventilating)).collect()
    }

    #[test]
    fn a_silent_host_is_reported_once_until_it_sends_again() {
        let mut watch = HostWatch::new(1000);
        assert!(gone(&mut watch, 50_000, true).is_empty(), "no host was ever connected");
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
