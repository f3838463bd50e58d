//! The alarms of a device with their times, from what it reports: present, or not yet acknowledged.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use monitoring::words;
use shared::device::annunciator::AudioStatus;
use shared::link::messages::AlarmStatus;
use shared::safety::alarms::{Action, Fault, Priority};

use crate::stream::AlarmInfo;

/// What is known about an alarm.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Entry {
    present: bool,
    /// None if it was there before the first report.
    since_ms: Option<u64>,
    acknowledged: bool,
}

/// Indicated alarms; empty before the first report.
#[derive(Clone, Debug, Default)]
pub struct AlarmList {
    entries: BTreeMap<Fault, Entry>,
    /// Whether the device has reported.
    reported: bool,
}

impl AlarmList {
    /// An alarm has begun, at a time in ms since 1970; true if it is new.
    pub fn began(&mut self, fault: Fault, now_ms: u64) -> bool {
        let new = !self.entries.get(&fault).is_some_and(|entry| entry.present);
        let before = self.entries.get(&fault).filter(|entry| entry.present);
        let since_ms = before.map_or(Some(now_ms), |entry| entry.since_ms);
        self.entries.insert(fault, Entry { present: true, since_ms, acknowledged: false });
        new
    }

    /// The device repeats an alarm that is not acknowledged yet, also one whose condition has ended; true if it was not listed.
    pub fn repeated(&mut self, fault: Fault, now_ms: u64) -> bool {
        match self.entries.get_mut(&fault) {
            Some(entry) => {
                entry.acknowledged = false;
                false
            }
            // Its beginning was lost on the line. The next report says whether its condition still holds.
            None => self.began(fault, now_ms),
        }
    }

    /// Takes the device's report; alarms that it names no more have ended. Returns those that have begun since the last report; none at
    /// the first one.
    pub fn report(&mut self, status: &AlarmStatus, now_ms: u64) -> Vec<Fault> {
        self.entries.retain(|fault, _| status.indicated.has(*fault) || status.present.has(*fault));
        let begun = std::mem::replace(&mut self.reported, true).then_some(now_ms);
        let mut new = Vec::new();
        for fault in status.indicated.faults().chain(status.present.faults()) {
            let present = status.present.has(fault);
            let known = self.entries.get(&fault).copied();
            let entry = match known {
                // It comes back: that is a new alarm.
                Some(known) if present && !known.present => {
                    new.push(fault);
                    Entry { present, since_ms: Some(now_ms), acknowledged: false }
                }
                Some(known) => Entry { present, ..known },
                None => {
                    new.extend(begun.map(|_| fault));
                    Entry { present, since_ms: begun, acknowledged: false }
                }
            };
            self.entries.insert(fault, entry);
        }
        new
    }

    /// Takes the state of the sounder: whatever is more urgent than the alarm for which it sounds was acknowledged.
    pub fn heard(&mut self, audio: &AudioStatus) {
        for (fault, entry) in &mut self.entries {
            if audio.priority.is_none_or(|priority| fault.alarm().priority > priority) {
                entry.acknowledged = true;
            }
        }
    }

    /// An operator has acknowledged all alarms.
    pub fn acknowledge(&mut self) {
        self.entries.retain(|_, entry| entry.present);
        self.entries.values_mut().for_each(|entry| entry.acknowledged = true);
    }

    /// The device has restarted and raises its alarms again.
    pub fn clear(&mut self) {
        self.entries.clear();
    }

    /// The alarms, the most urgent first; of equal ones those that are present, then the newest.
    pub fn list(&self) -> Vec<AlarmInfo> {
        let mut entries: Vec<(&Fault, &Entry)> = self.entries.iter().collect();
        entries
            .sort_by_key(|(fault, entry)| Reverse((fault.alarm().priority, entry.present, entry.since_ms)));
        let info = |(fault, entry): (&Fault, &Entry)| AlarmInfo {
            id: fault.alarm().id,
            text: words::fault(*fault),
            priority: fault.alarm().priority.name(),
            present: entry.present,
            since_ms: entry.since_ms,
            acknowledged: entry.acknowledged,
        };
        entries.into_iter().map(info).collect()
    }

    /// Number of alarms of a priority.
    pub fn count(&self, priority: Priority) -> usize {
        self.entries.keys().filter(|fault| fault.alarm().priority == priority).count()
    }

    /// Present alarms because of which the ventilator does not trust a controller or a reading, in words.
    pub fn distrust(&self) -> Vec<&'static str> {
        let present = self.entries.iter().filter(|(_, entry)| entry.present);
        let distrusts = present.filter(|(fault, _)| fault.alarm().action != Action::Report);
        distrusts.map(|(fault, _)| words::fault(*fault)).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::safety::indications::FaultSet;
    use shared::safety::ladder::Level;

    fn set(faults: &[Fault]) -> FaultSet {
        FaultSet::from_bits(faults.iter().fold(0, |bits, fault| bits | 1 << *fault as u32))
    }

    fn status(present: &[Fault], indicated: &[Fault]) -> AlarmStatus {
        AlarmStatus { present: set(present), indicated: set(indicated), level: Level::Learned }
    }

    fn ids(list: &AlarmList) -> Vec<&'static str> {
        list.list().iter().map(|alarm| alarm.id).collect()
    }

    #[test]
    fn an_alarm_stays_listed_with_its_time_until_the_device_ends_it() {
        let mut list = AlarmList::default();
        assert!(list.began(Fault::Disconnection, 1000));
        assert!(!list.began(Fault::Disconnection, 1500), "repeated until it is acknowledged");
        list.report(&status(&[Fault::Disconnection], &[Fault::Disconnection]), 2000);
        list.report(&status(&[], &[Fault::Disconnection]), 3000);
        let alarm = &list.list()[0];
        assert_eq!((alarm.since_ms, alarm.present, alarm.acknowledged), (Some(1000), false, false));
        list.report(&status(&[], &[]), 4000);
        assert_eq!(ids(&list), [""; 0]);
    }

    #[test]
    fn the_most_urgent_alarm_is_first() {
        let mut list = AlarmList::default();
        let faults = [Fault::Leak, Fault::HighPressure, Fault::Disconnection, Fault::Restarted];
        list.report(&status(&faults, &faults), 5);
        let priorities: Vec<Priority> = list
            .list()
            .iter()
            .map(|alarm| faults.iter().find(|fault| fault.alarm().id == alarm.id).unwrap().alarm().priority)
            .collect();
        assert!(priorities.is_sorted_by(|one, next| one >= next), "{priorities:?}");
        let counted: usize = [Priority::Low, Priority::Medium, Priority::High]
            .iter()
            .map(|priority| list.count(*priority))
            .sum();
        assert_eq!(counted, 4);
    }

    #[test]
    fn an_acknowledged_alarm_is_marked_until_it_comes_back() {
        let mut list = AlarmList::default();
        let leak = [Fault::Leak];
        list.report(&status(&leak, &leak), 1);
        list.acknowledge();
        assert!(list.list()[0].acknowledged);
        list.report(&status(&leak, &leak), 2);
        assert!(list.list()[0].acknowledged && list.list()[0].since_ms.is_none());
        list.report(&status(&[], &leak), 3);
        list.report(&status(&leak, &leak), 4);
        assert!(!list.list()[0].acknowledged && list.list()[0].since_ms == Some(4));
    }

    #[test]
    fn a_repetition_of_an_alarm_that_has_ended_does_not_raise_it_again() {
        let mut list = AlarmList::default();
        assert!(list.began(Fault::Disconnection, 1000));
        list.report(&status(&[], &[Fault::Disconnection]), 2000);
        let before = list.clone();
        assert!(!list.repeated(Fault::Disconnection, 6000));
        assert_eq!(list.list(), before.list(), "neither present nor since changes");
        assert!(list.repeated(Fault::Leak, 6000), "its beginning was lost");
        assert_eq!(list.list().iter().filter(|alarm| alarm.present).count(), 1);
    }

    #[test]
    fn a_report_has_the_alarms_whose_own_message_was_lost() {
        let mut list = AlarmList::default();
        let [leak, both] = [&[Fault::Leak][..], &[Fault::Leak, Fault::HighPressure]];
        assert_eq!(list.report(&status(leak, leak), 1), [], "it was there before");
        assert_eq!(list.report(&status(both, both), 2), [Fault::HighPressure]);
        assert_eq!(list.report(&status(both, both), 3), []);
        assert!(!list.repeated(Fault::HighPressure, 4) && !list.began(Fault::HighPressure, 5), "it is known");
        assert_eq!(list.report(&status(leak, both), 6), []);
        assert_eq!(list.report(&status(both, both), 7), [Fault::HighPressure], "it is back");
    }

    #[test]
    fn the_beginning_of_an_alarm_that_was_there_before_the_first_report_is_unknown() {
        let mut list = AlarmList::default();
        list.report(&status(&[Fault::Leak], &[Fault::Leak]), 7);
        let both = [Fault::Leak, Fault::HighPressure];
        list.report(&status(&both, &both), 8);
        let since: Vec<_> = list.list().iter().map(|alarm| alarm.since_ms).collect();
        assert_eq!(since, [Some(8), None]);
        list.clear();
        list.report(&status(&both, &both), 9);
        assert!(list.list().iter().all(|alarm| alarm.since_ms == Some(9)), "a restart raises them again");
    }

    #[test]
    fn the_sounder_shows_what_another_operator_has_acknowledged() {
        let mut list = AlarmList::default();
        let both = [Fault::HighPressure, Fault::Leak];
        list.report(&status(&both, &both), 1);
        list.heard(&AudioStatus { priority: Some(Fault::HighPressure.alarm().priority), pause_left: 0 });
        assert!(list.list().iter().all(|alarm| !alarm.acknowledged));
        list.heard(&AudioStatus { priority: None, pause_left: 0 });
        assert!(list.list().iter().all(|alarm| alarm.acknowledged));
    }

    #[test]
    fn distrusted_is_what_changes_the_controller_or_the_reading() {
        let mut list = AlarmList::default();
        let faults = [Fault::Leak, Fault::ReadingFrozen, Fault::LearnedDistrusted];
        list.report(&status(&faults, &faults), 1);
        let mut expected = [Fault::ReadingFrozen, Fault::LearnedDistrusted].map(words::fault);
        let mut found = list.distrust();
        expected.sort_unstable();
        found.sort_unstable();
        assert_eq!(found, expected);
    }
}
