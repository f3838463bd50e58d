//! Statistics of the control ticks: latency, work and period, in core clock cycles.

use serde::{Deserialize, Serialize};

/// Nominal timeout of the chip's watchdog, us. Its RC oscillator runs at 17 to 47 kHz (data sheet; nominal 32), so the real
/// timeout is 34 to 94 ms. Fulfils: tick-watchdog.
pub const WATCHDOG_US: u32 = 50_000;
/// Upper bound of the watchdog's real timeout, us.
pub const WATCHDOG_MAX_US: u32 = 2 * WATCHDOG_US;
/// Longest silence of the host that steers a device before its lease lapses, s.
pub const LEASE_S: f32 = 5.0;
/// Bins of the histogram: below 1 us, below 2 us, below 4 us and so on; the last one is open-ended.
pub const BINS: usize = 12;

/// Shortest, mean and longest of a set of times, in core clock cycles.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct CycleStats {
    /// Shortest time, cycles.
    pub shortest: u32,
    /// Mean time, cycles.
    pub mean: f32,
    /// Longest time, cycles.
    pub longest: u32,
}

/// Statistics of the control ticks since they were last cleared.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TickTimes {
    /// Core clock frequency, Hz, to convert cycles to time.
    pub core_hz: u32,
    /// Number of ticks that ran.
    pub ticks: u32,
    /// Number of ticks that did not run.
    pub missed: u32,
    /// Time from when the tick was due to its first instruction.
    pub latency: CycleStats,
    /// Time from the pressure reading to the end of the tick, without the wait for a plant's answer.
    pub work: CycleStats,
    /// Time from the start of one tick to the start of the next.
    pub period: CycleStats,
    /// Number of ticks by work, see [`BINS`].
    pub histogram: [u32; BINS],
}

impl TickTimes {
    /// Converts cycles to microseconds.
    pub fn microseconds(&self, cycles: f32) -> f32 {
        cycles * 1.0e6 / (self.core_hz.max(1) as f32)
    }
}

/// Times of one tick, in core clock cycles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TickTime {
    /// See [`TickTimes::latency`].
    pub latency: u32,
    /// See [`TickTimes::work`].
    pub work: u32,
    /// See [`TickTimes::period`]; none for the first tick and after missed ticks.
    pub period: Option<u32>,
    /// Ticks missed since the last one that ran.
    pub missed: u32,
}

/// Accumulates the statistics.
#[derive(Clone, Debug)]
pub struct TickTimer {
    core_hz: u32,
    ticks: u32,
    missed: u32,
    latency: Sum,
    work: Sum,
    period: Sum,
    histogram: [u32; BINS],
}

impl TickTimer {
    /// Empty statistics; `core_hz` is the core clock frequency, Hz.
    pub const fn new(core_hz: u32) -> Self {
        let (latency, work, period) = (Sum::NONE, Sum::NONE, Sum::NONE);
        Self { core_hz, ticks: 0, missed: 0, latency, work, period, histogram: [0; BINS] }
    }

    /// Adds one tick.
    pub fn record(&mut self, tick: &TickTime) {
        self.ticks = self.ticks.saturating_add(1);
        self.missed = self.missed.saturating_add(tick.missed);
        self.latency.add(tick.latency);
        self.work.add(tick.work);
        if let Some(period) = tick.period {
            self.period.add(period);
        }
        let bin = &mut self.histogram[bin(tick.work / (self.core_hz / 1_000_000).max(1))];
        *bin = bin.saturating_add(1);
    }

    /// Clears the statistics.
    pub fn clear(&mut self) {
        *self = Self::new(self.core_hz);
    }

    /// Number of ticks that did not run.
    pub fn missed(&self) -> u32 {
        self.missed
    }

    /// Longest and mean work of a tick, microseconds.
    pub fn work_us(&self) -> (u32, f32) {
        let times = self.times();
        (times.microseconds(times.work.longest as f32) as u32, times.microseconds(times.work.mean))
    }

    /// The statistics so far.
    pub fn times(&self) -> TickTimes {
        let Self { core_hz, ticks, missed, histogram, .. } = *self;
        let [latency, work, period] = [self.latency, self.work, self.period].map(Sum::span);
        TickTimes { core_hz, ticks, missed, latency, work, period, histogram }
    }
}

/// Histogram bin of a time in microseconds: its number of binary digits.
fn bin(microseconds: u32) -> usize {
    ((u32::BITS - microseconds.leading_zeros()) as usize).min(BINS - 1)
}

#[derive(Clone, Copy, Debug)]
struct Sum {
    count: u32,
    total: u64,
    shortest: u32,
    longest: u32,
}

impl Sum {
    const NONE: Self = Self { count: 0, total: 0, shortest: u32::MAX, longest: 0 };

    fn add(&mut self, cycles: u32) {
        self.count = self.count.saturating_add(1);
        self.total += u64::from(cycles);
        self.shortest = self.shortest.min(cycles);
        self.longest = self.longest.max(cycles);
        debug_assert!(self.count > 0);
        debug_assert!(self.shortest <= self.longest);
    }

    fn span(self) -> CycleStats {
        if self.count == 0 {
            return CycleStats::default();
        }
        let mean = self.total as f32 / self.count as f32;
        CycleStats { shortest: self.shortest, mean, longest: self.longest }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const CORE_HZ: u32 = 168_000_000;

    fn tick(work: u32) -> TickTime {
        TickTime { latency: 20, work, period: Some(168_000), missed: 0 }
    }

    #[test]
    fn spans_hold_shortest_mean_and_longest() {
        let mut timer = TickTimer::new(CORE_HZ);
        for work in [1680, 3360, 8400] {
            timer.record(&tick(work));
        }
        let times = timer.times();
        assert_eq!((times.ticks, times.work.shortest, times.work.longest), (3, 1680, 8400));
        assert!((times.microseconds(times.work.mean) - 26.667).abs() < 0.01);
        assert_eq!(timer.work_us().0, 50);
        assert_eq!((times.period.shortest, times.period.longest), (168_000, 168_000));
    }

    #[test]
    fn a_tick_falls_into_the_bin_of_its_microseconds() {
        for (microseconds, expected) in [(0, 0), (1, 1), (2, 2), (3, 2), (4, 3), (1023, 10), (u32::MAX, 11)] {
            assert_eq!(bin(microseconds), expected, "{microseconds} us");
        }
        let mut timer = TickTimer::new(CORE_HZ);
        timer.record(&tick(168 * 5));
        assert_eq!(timer.times().histogram[3], 1);
    }

    #[test]
    fn missed_ticks_are_counted_and_give_no_period() {
        let mut timer = TickTimer::new(CORE_HZ);
        timer.record(&TickTime { period: None, missed: 7, ..tick(100) });
        assert_eq!((timer.missed(), timer.times().period), (7, CycleStats::default()));
        timer.clear();
        assert_eq!(timer.times(), TickTimer::new(CORE_HZ).times());
    }
}
