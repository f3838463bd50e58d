//! The alarms to report to a host: none is dropped, and each is repeated until an operator acknowledges it.
//!
//! An alarm waits here until the queue to the host has room, and it takes that room before the next sample does. Every
//! [`REPEAT_TIME`] all unacknowledged alarms are reported again, so that a host learns of them that was not there, did not
//! read, or received a damaged frame.

use super::ControlReport;
use crate::math;
use crate::safety::alarms::{ALARMS, Fault};
use crate::safety::indications::FaultSet;

/// Time between two reports of an alarm that nobody has acknowledged, s. Fulfils: alarm-repeats.
pub const REPEAT_TIME: f32 = 5.0;

/// Alarms that have begun, and which of them to report.
#[derive(Clone, Debug)]
pub struct AlarmEvents {
    /// Begun and not reported yet.
    begun: FaultSet,
    /// To be repeated.
    due: FaultSet,
    /// Control tick at which each began last.
    ticks: [u64; ALARMS.len()],
    repeat_ticks: u32,
    /// Ticks until the next repetition.
    left: u32,
}

impl AlarmEvents {
    /// No alarm; for a control period in microseconds.
    pub fn new(period_us: u32) -> Self {
        let repeat_ticks = math::ticks(REPEAT_TIME, period_us);
        let none = FaultSet::default();
        Self { begun: none, due: none, ticks: [0; ALARMS.len()], repeat_ticks, left: repeat_ticks }
    }

    /// Whether alarms of earlier ticks have not been reported yet.
    #[inline]
    pub fn are_waiting(&self) -> bool {
        !(self.begun.is_empty() && self.due.is_empty())
    }

    /// Adds an alarm that begins in this tick.
    pub fn begin(&mut self, fault: Fault, tick: u64) {
        self.begun.add(fault);
        self.ticks[fault as usize % ALARMS.len()] = tick;
    }

    /// Lets a tick pass after which these alarms are not acknowledged.
    #[inline]
    pub fn tick(&mut self, unacknowledged: FaultSet) {
        if unacknowledged.is_empty() {
            (self.due, self.left) = (unacknowledged, self.repeat_ticks);
            return;
        }
        self.left = self.left.saturating_sub(1);
        if self.left == 0 {
            (self.due, self.left) = (unacknowledged, self.repeat_ticks);
        }
        debug_assert!((1..=self.repeat_ticks).contains(&self.left));
        debug_assert!(self.due.bits() & !unacknowledged.bits() == 0, "what is acknowledged is not repeated");
    }

    /// Reports one alarm, if there is one, through `room`, which returns false if it has no room for a report.
    pub fn report(&mut self, room: &mut dyn FnMut(ControlReport) -> bool) {
        let tick = |fault: Fault| self.ticks[fault as usize % ALARMS.len()];
        if let Some(fault) = self.begun.faults().next() {
            if room(ControlReport::Alarm { fault, tick: tick(fault) }) {
                self.begun.remove(fault);
                self.due.remove(fault);
            }
        } else if let Some(fault) = self.due.faults().next()
            && room(ControlReport::Unacknowledged { fault, tick: tick(fault) })
        {
            self.due.remove(fault);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::vec::Vec;

    use super::*;

    const PERIOD_US: u32 = 1000;
    const EVERY: usize = 5000;

    fn set(faults: &[Fault]) -> FaultSet {
        faults.iter().fold(FaultSet::default(), |mut set, fault| {
            set.add(*fault);
            set
        })
    }

    /// What is reported in a number of ticks, each with its tick from 0.
    fn reports(
        events: &mut AlarmEvents,
        ticks: usize,
        unacknowledged: &[Fault],
    ) -> Vec<(usize, ControlReport)> {
        let mut reports = Vec::new();
        for tick in 0..ticks {
            events.tick(set(unacknowledged));
            events.report(&mut |report| {
                reports.push((tick, report));
                true
            });
        }
        reports
    }

    #[test]
    fn an_alarm_is_reported_once_and_repeated_until_it_is_acknowledged() {
        let mut events = AlarmEvents::new(PERIOD_US);
        let fault = Fault::Leak;
        events.begin(fault, 77);
        let first = reports(&mut events, EVERY - 1, &[fault]);
        assert_eq!(first, [(0, ControlReport::Alarm { fault, tick: 77 })]);
        let again = ControlReport::Unacknowledged { fault, tick: 77 };
        assert_eq!(reports(&mut events, 2 * EVERY, &[fault]), [(0, again), (EVERY, again)]);
        assert_eq!(reports(&mut events, 3 * EVERY, &[]), []);
    }

    #[test]
    fn an_alarm_that_begins_again_is_repeated_with_its_last_tick() {
        let mut events = AlarmEvents::new(PERIOD_US);
        let fault = Fault::Leak;
        events.begin(fault, 77);
        events.begin(fault, 99);
        assert_eq!(reports(&mut events, 1, &[fault])[0].1, ControlReport::Alarm { fault, tick: 99 });
        let again = reports(&mut events, EVERY, &[fault]);
        assert_eq!(again.last().unwrap().1, ControlReport::Unacknowledged { fault, tick: 99 });
    }

    #[test]
    fn it_waits_for_room_even_if_it_is_acknowledged_meanwhile() {
        let mut events = AlarmEvents::new(PERIOD_US);
        let fault = Fault::Restarted;
        events.begin(fault, 0);
        for tick in 0..3 * EVERY {
            assert!(events.are_waiting());
            events.tick(if tick < 10 { set(&[fault]) } else { set(&[]) });
            events.report(&mut |_| false);
        }
        assert_eq!(reports(&mut events, 100, &[]), [(0, ControlReport::Alarm { fault, tick: 0 })]);
        assert!(!events.are_waiting());
    }

    #[test]
    fn a_repetition_waits_for_room_and_is_dropped_when_it_is_acknowledged() {
        let mut events = AlarmEvents::new(PERIOD_US);
        for _ in 0..EVERY {
            assert!(!events.are_waiting());
            events.tick(set(&[Fault::Leak]));
        }
        events.report(&mut |_| false);
        assert!(events.are_waiting());
        assert_eq!(reports(&mut events, 1, &[]), []);
    }

    #[test]
    fn new_alarms_come_before_repeated_ones_and_one_in_each_tick() {
        let mut events = AlarmEvents::new(PERIOD_US);
        let all = [Fault::ReadingNotANumber, Fault::Leak, Fault::Restarted];
        let repeated = reports(&mut events, EVERY + 2, &all);
        assert_eq!(repeated.iter().map(|(tick, _)| *tick).collect::<Vec<_>>(), [4999, 5000, 5001]);
        let mut events = AlarmEvents::new(PERIOD_US);
        (0..EVERY).for_each(|_| events.tick(set(&all)));
        events.begin(Fault::Occlusion, 1);
        let first = reports(&mut events, 4, &all);
        assert!(matches!(first[0].1, ControlReport::Alarm { fault: Fault::Occlusion, .. }));
        assert_eq!(first.len(), 4);
    }

    #[test]
    fn the_first_report_of_an_alarm_is_not_followed_by_its_repetition() {
        let mut events = AlarmEvents::new(PERIOD_US);
        let fault = Fault::Leak;
        events.begin(fault, 3);
        (0..EVERY).for_each(|_| events.tick(set(&[fault])));
        assert_eq!(reports(&mut events, 100, &[fault]).len(), 1);
    }
}
