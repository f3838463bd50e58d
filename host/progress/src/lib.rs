//! Progress reports of long work, and requests to stop it.
//!
//! Work takes a [`Progress`] and opens a [`Task`] in it for each of its stages. The observer receives an [`Event`]
//! whenever a task has advanced. Work that consists of other work passes down [`Task::part`]: the steps of the parts,
//! which may run in parallel, count in the whole.
#![forbid(unsafe_code)]

use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};

/// A stage of some work, by its label on the screen: what is done, with the unit of its steps where the words do not say it. The work
/// has it as a constant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct Stage(pub &'static str);

/// Progress of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Event<'a> {
    /// Subject of the work, such as a lung's name; empty if there is only one.
    pub subject: &'a str,
    /// Round of a run, from 0.
    pub round: Option<usize>,
    /// The current stage.
    pub stage: Stage,
    /// Number of steps done. Events of tasks whose parts run in parallel may arrive out of order.
    pub done: usize,
    /// Total number of steps as far as known; it may grow.
    pub total: usize,
}

impl Event<'_> {
    /// The label of the stage, with subject and round.
    pub fn label(&self) -> String {
        let subject = if self.subject.is_empty() { String::new() } else { format!("{}: ", self.subject) };
        let round = self.round.map_or_else(String::new, |round| format!("round {}: ", round + 1));
        format!("{subject}{round}{}", self.stage.0)
    }
}

/// Receives progress and carries the request to stop.
#[derive(Clone, Copy)]
pub struct Progress<'a> {
    receiver: Receiver<'a>,
    stop: &'a AtomicBool,
    subject: &'a str,
    round: Option<usize>,
}

#[derive(Clone, Copy)]
enum Receiver<'a> {
    Observer(&'a (dyn Fn(&Event<'_>) + Sync)),
    Whole(&'a Task<'a>),
}

static NEVER: AtomicBool = AtomicBool::new(false);

impl<'a> Progress<'a> {
    /// Reports to `observer`; work stops at the next suitable point once `stop` is set.
    pub fn new(observer: &'a (dyn Fn(&Event<'_>) + Sync), stop: &'a AtomicBool) -> Self {
        Self { receiver: Receiver::Observer(observer), stop, subject: "", round: None }
    }

    /// Reports nothing; stops like [`Self::new`].
    pub fn quiet(stop: &'a AtomicBool) -> Self {
        Self::new(&|_| (), stop)
    }

    /// Reports nothing and never stops.
    pub fn silent() -> Progress<'static> {
        Progress::quiet(&NEVER)
    }

    /// Whether to stop.
    pub fn stopped(&self) -> bool {
        self.stop.load(Ordering::Relaxed)
    }

    /// A copy for work on `subject`.
    #[must_use]
    pub fn of(&self, subject: &'a str) -> Self {
        Self { subject, ..*self }
    }

    /// A copy for a round (from 0).
    #[must_use]
    pub fn round(&self, round: usize) -> Self {
        Self { round: Some(round), ..*self }
    }

    /// Begins a stage of `total` steps.
    pub fn task(&self, stage: Stage, total: usize) -> Task<'a> {
        let task = Task { progress: *self, stage, done: AtomicUsize::new(0), total: AtomicUsize::new(total) };
        task.report(0);
        task
    }
}

/// A stage in progress, shared by all threads that work on it.
pub struct Task<'a> {
    progress: Progress<'a>,
    stage: Stage,
    done: AtomicUsize,
    total: AtomicUsize,
}

impl Task<'_> {
    /// Adds completed steps.
    pub fn advance(&self, steps: usize) {
        let done = self.done.fetch_add(steps, Ordering::Relaxed) + steps;
        match self.progress.receiver {
            Receiver::Whole(whole) => whole.advance(steps),
            Receiver::Observer(_) => self.report(done),
        }
    }

    /// Sets the number of completed steps; a smaller number than before has no effect.
    pub fn reach(&self, done: usize) {
        self.advance(done.saturating_sub(self.done.load(Ordering::Relaxed)));
    }

    /// Raises the total number of steps, if it is smaller.
    pub fn expect(&self, total: usize) {
        self.total.fetch_max(total, Ordering::Relaxed);
    }

    /// Completes the stage, possibly in fewer steps than expected.
    pub fn finish(&self) {
        let done = self.done.load(Ordering::Relaxed);
        self.total.store(done, Ordering::Relaxed);
        self.report(done);
    }

    /// Whether to stop.
    pub fn stopped(&self) -> bool {
        self.progress.stopped()
    }

    /// Progress for a part of this work: its steps count here, in the same units.
    pub fn part(&self) -> Progress<'_> {
        Progress { receiver: Receiver::Whole(self), ..self.progress }
    }

    /// Reports nothing, and stops when this work does.
    pub fn quiet(&self) -> Progress<'_> {
        Progress::quiet(self.progress.stop)
    }

    fn report(&self, done: usize) {
        if let Receiver::Observer(observer) = self.progress.receiver {
            let Progress { subject, round, .. } = self.progress;
            let total = self.total.load(Ordering::Relaxed);
            observer(&Event { subject, round, stage: self.stage, done, total });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    const COLLECT: Stage = Stage("collect breaths");
    const FIT: Stage = Stage("fit simulators");
    const TRAIN: Stage = Stage("train controller");
    const EVALUATE: Stage = Stage("score waveforms");

    /// Subject, round, stage, done and total of every event of some work.
    type Seen = Vec<(String, Option<usize>, Stage, usize, usize)>;

    fn seen(work: impl Fn(&Progress<'_>)) -> Seen {
        let seen = Mutex::new(Vec::new());
        let note = |e: &Event<'_>| {
            seen.lock().unwrap().push((e.subject.to_owned(), e.round, e.stage, e.done, e.total));
        };
        work(&Progress::new(&note, &AtomicBool::new(false)));
        seen.into_inner().unwrap()
    }

    #[test]
    fn a_label_names_subject_round_and_stage() {
        let alone = Event { subject: "", round: None, stage: COLLECT, done: 0, total: 1 };
        assert_eq!(alone.label(), "collect breaths");
        let event = Event { subject: "lungs/R5C10-0", round: Some(1), stage: FIT, ..alone };
        assert_eq!(event.label(), "lungs/R5C10-0: round 2: fit simulators");
    }

    #[test]
    fn events_tell_what_is_under_way_and_how_far_it_is() {
        let events = seen(|progress| {
            let task = progress.of("R20C20").round(1).task(FIT, 3);
            task.advance(2);
            task.reach(1);
            task.expect(5);
            task.reach(5);
        });
        let at = |done, total| ("R20C20".to_owned(), Some(1), FIT, done, total);
        assert_eq!(events, [at(0, 3), at(2, 3), at(2, 3), at(5, 5)]);
    }

    #[test]
    fn steps_of_parts_count_in_the_whole_and_only_there() {
        let events = seen(|progress| {
            let whole = progress.task(EVALUATE, 4);
            std::thread::scope(|scope| {
                for _ in 0..2 {
                    scope.spawn(|| whole.part().task(COLLECT, 100).advance(2));
                }
            });
            whole.finish();
        });
        assert!(events.iter().all(|event| event.2 == EVALUATE && event.4 == 4), "{events:?}");
        assert_eq!(events.len(), 4);
        assert_eq!(events[3].3, 4);
    }

    #[test]
    fn a_request_to_stop_reaches_every_part() {
        let stop = AtomicBool::new(false);
        let progress = Progress::quiet(&stop);
        let task = progress.task(TRAIN, 1);
        assert!(!task.part().stopped());
        stop.store(true, Ordering::Relaxed);
        assert!(task.part().stopped() && task.stopped() && !Progress::silent().stopped());
    }
}
