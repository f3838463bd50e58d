//! Independent watchdog (RM0090, section 21): once started, it counts down from the reload value with a prescaled 32 kHz
//! clock, and resets the chip at zero unless it is fed.

use crate::store::Store;

const KEY_FEED: u32 = 0xAAAA;
const KEY_ACCESS: u32 = 0x5555;
const KEY_START: u32 = 0xCCCC;
/// Cycle of the watchdog's oscillator, ns.
const CYCLE_NS: u64 = 31_250;

/// The watchdog.
#[derive(Clone, Debug)]
pub struct Iwdg {
    prescaler: u32,
    reload: u32,
    /// Whether prescaler and reload value are writable.
    open: bool,
    running: bool,
    /// Reload value with which the current countdown began.
    begun: u32,
    /// Time since the countdown began, up to `seen`.
    elapsed_ns: u64,
    /// Time of the last check, ns.
    seen: u32,
}

impl Iwdg {
    /// The watchdog after a reset.
    pub(crate) const fn new() -> Self {
        Self {
            prescaler: 0,
            reload: 0xFFF,
            open: false,
            running: false,
            begun: 0xFFF,
            elapsed_ns: 0,
            seen: 0,
        }
    }

    /// The word at an offset; zero where there is no register. New values take effect at once, so the status, which reports
    /// pending ones, is always zero.
    pub fn read(&self, offset: u32) -> u32 {
        match offset {
            4 => self.prescaler,
            8 => self.reload,
            _ => 0,
        }
    }

    /// Stores to an offset at time `now`, ns, wrapping. If that feeds the running watchdog, returns the time since the last
    /// feeding, ns.
    pub fn write(&mut self, offset: u32, store: Store, now: u32) -> Option<u64> {
        match offset {
            0 => return self.key(store.bits(), now),
            4 if self.open => self.prescaler = store.bits() & 7,
            8 if self.open => self.reload = store.bits() & 0xFFF,
            _ => {}
        }
        None
    }

    fn key(&mut self, key: u32, now: u32) -> Option<u64> {
        let fed = self.running.then(|| self.elapsed_ns + u64::from(now.wrapping_sub(self.seen)));
        self.open = key == KEY_ACCESS;
        match key {
            KEY_START => self.running = true,
            KEY_FEED => {}
            _ => return None,
        }
        (self.begun, self.elapsed_ns, self.seen) = (self.reload, 0, now);
        fed.filter(|_| key == KEY_FEED)
    }

    /// Whether the watchdog has expired. Must be called at least once per wrap of the clock.
    pub fn expired(&mut self, now: u32) -> bool {
        self.elapsed_ns += u64::from(now.wrapping_sub(self.seen));
        self.seen = now;
        self.running && self.elapsed_ns >= self.timeout_ns()
    }

    /// Time from feeding to reset, ns.
    fn timeout_ns(&self) -> u64 {
        // Values above 6 also divide by 256.
        let divider = 4 << self.prescaler.min(6);
        u64::from(self.begun + 1) * divider * CYCLE_NS
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const MS: u32 = 1_000_000;

    /// A watchdog started at 5 ms with a timeout of 10 ms: 80 cycles of 4 / 32 kHz.
    fn started() -> Iwdg {
        let mut watchdog = Iwdg::new();
        watchdog.write(0, Store::word(KEY_ACCESS), 0);
        watchdog.write(4, Store::word(0), 0);
        watchdog.write(8, Store::word(79), 0);
        watchdog.write(0, Store::word(KEY_START), 5 * MS);
        watchdog
    }

    #[test]
    fn it_expires_at_its_timeout_and_not_before() {
        let mut watchdog = started();
        assert!(!watchdog.expired(15 * MS - 1));
        assert!(watchdog.expired(15 * MS));
    }

    #[test]
    fn before_it_is_started_it_never_expires() {
        let mut watchdog = Iwdg::new();
        assert!((0..100).all(|n: u32| !watchdog.expired(n.wrapping_mul(4000 * MS))));
    }

    #[test]
    fn feeding_restarts_the_countdown_and_returns_the_gap() {
        let mut watchdog = started();
        assert!(!watchdog.expired(10 * MS));
        assert_eq!(watchdog.write(0, Store::word(KEY_FEED), 14 * MS), Some(9_000_000));
        assert!(!watchdog.expired(24 * MS - 1));
        assert!(watchdog.expired(24 * MS));
    }

    #[test]
    fn a_new_reload_value_holds_from_the_next_feeding() {
        let mut watchdog = started();
        watchdog.write(0, Store::word(KEY_ACCESS), 6 * MS);
        watchdog.write(8, Store::word(159), 6 * MS);
        assert!(watchdog.clone().expired(15 * MS));
        watchdog.write(0, Store::word(KEY_FEED), 14 * MS);
        assert!(!watchdog.expired(34 * MS - 1));
        assert!(watchdog.expired(34 * MS));
    }

    #[test]
    fn without_the_key_prescaler_and_reload_value_stay() {
        let mut watchdog = started();
        watchdog.write(4, Store::word(6), 6 * MS);
        watchdog.write(8, Store::word(0xFFF), 6 * MS);
        assert_eq!((watchdog.read(4), watchdog.read(8)), (0, 79));
    }

    #[test]
    fn a_timeout_longer_than_the_clocks_range_is_kept() {
        let mut watchdog = Iwdg::new();
        watchdog.write(0, Store::word(KEY_ACCESS), 0);
        watchdog.write(4, Store::word(6), 0);
        watchdog.write(0, Store::word(KEY_START), 0);
        // 4096 cycles of 8 ms are 32.768 s; the clock wraps every 4.29 s.
        let seconds = (1..).find(|&s: &u32| watchdog.expired(s.wrapping_mul(1000 * MS)));
        assert_eq!(seconds, Some(33));
    }

    #[test]
    fn a_wrong_key_does_nothing() {
        let mut watchdog = started();
        assert_eq!(watchdog.write(0, Store::word(0x1234), 9 * MS), None);
        assert!(watchdog.expired(15 * MS));
    }
}
