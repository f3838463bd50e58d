//! What drawn cases need of the supervisor: each runs with all of its parts, and again without each part that can matter.

use serde::{Deserialize, Serialize};
use shared::safety::alarms::Fault;
use shared::safety::indications::FaultSet;
use shared::safety::responses::Response;

use super::case::Case;
use super::generator::Generator;
use super::promise::Reference;
use super::run::{Observed, run};
use super::tally::{CASES, DrawError};
use crate::faults::parts::Part;
use campaign::{Sums, Work};
use progress::{Stage, Task};
use ventilator::SourceError;

/// The cases of a seed; its units are the cases.
#[derive(Debug)]
pub struct Needing {
    seed: u64,
    generator: Generator,
}

/// In how many cases a part makes a difference.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Need {
    /// Cases that break a promise without it, but not with it.
    pub broken: u64,
    /// Cases that break one with it, but not without it.
    pub kept: u64,
    /// Cases in which an alarm, of whatever priority, names the cause with it, and none does without it.
    pub unnamed: u64,
}

/// The needs of all cases so far.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Needs {
    /// Cases.
    pub cases: u64,
    /// Cases that break a promise with all parts.
    pub failed: u64,
    /// In the order of [`Part::all`].
    parts: Vec<Need>,
}

impl Needing {
    /// The cases of a seed.
    ///
    /// # Errors
    /// A family that cannot be read.
    pub fn new(seed: u64) -> Result<Self, SourceError> {
        Ok(Self { seed, generator: Generator::new(seed)? })
    }
}

impl Needs {
    /// What is needed of each part.
    pub fn each(&self) -> impl Iterator<Item = (Part, Need)> {
        Part::all().zip(self.parts.iter().copied())
    }

    /// The parts that no case needs, though one could.
    pub fn idle(&self) -> impl Iterator<Item = Part> {
        let idle =
            |(part, need): &(Part, Need)| need.broken == 0 && need.unnamed == 0 && !is_out_of_reach(*part);
        self.each().filter(idle).map(|(part, _)| part)
    }
}

impl Work for Needing {
    type Question = u64;
    type Sums = Needs;
    type Error = DrawError;

    fn question(&self) -> u64 {
        self.seed
    }

    fn nothing(&self) -> Needs {
        Needs { cases: 0, failed: 0, parts: vec![Need::default(); Part::all().count()] }
    }

    fn stage(&self) -> (Stage, f64) {
        (CASES, 1.0)
    }

    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<Needs>, DrawError> {
        let case = self.generator.draw(number);
        let reference = Reference::of(&case)?;
        let judged = |seen: &Observed| (!reference.broken(seen).is_empty(), is_named(&case, seen));
        let (fails, named) = judged(reference.whole());
        let mut parts = Vec::new();
        for part in Part::all() {
            if task.stopped() {
                return Ok(None);
            }
            let mut need = Need::default();
            if can_matter(part, reference.whole().indicated) {
                let (fails_without, named_without) = judged(&run(&case, case.onset_s(), part.others())?);
                need.broken = u64::from(fails_without && !fails);
                need.kept = u64::from(fails && !fails_without);
                need.unnamed = u64::from(named && !named_without);
            }
            parts.push(need);
        }
        task.advance(1);
        Ok(Some(Needs { cases: 1, failed: u64::from(fails), parts }))
    }
}

impl Sums for Needs {
    type Unit = Self;

    fn add(&mut self, _: u64, one: Self) {
        self.absorb(one);
    }

    fn absorb(&mut self, other: Self) {
        self.cases += other.cases;
        self.failed += other.failed;
        for (sum, need) in self.parts.iter_mut().zip(other.parts) {
            sum.broken += need.broken;
            sum.kept += need.kept;
            sum.unnamed += need.unnamed;
        }
    }
}

/// Whether an alarm that is indicated after the beginning of the first fault names a fault.
fn is_named(case: &Case, seen: &Observed) -> bool {
    let mut indicated = seen.windows.iter().flat_map(|window| window.indicated.faults());
    indicated.any(|fault| case.is_named_by(fault))
}

/// Whether a run in which these alarms were indicated could differ without a part. Most parts act only after their alarm; the others
/// end or lengthen a phase, bridge a reading, or take a sensor out of use before it, or without it.
fn can_matter(part: Part, indicated: FaultSet) -> bool {
    let any = |alarms: &[Fault]| alarms.iter().any(|alarm| indicated.has(*alarm));
    match part {
        Part::Monitor(fault) => match fault {
            Fault::ReadingOutOfRange
            | Fault::ReadingJumps
            | Fault::FlowSensorLost
            | Fault::HighPressure
            | Fault::HardLimit
            | Fault::SustainedPressure
            | Fault::BaselineHigh => true,
            // The outlet sensor has one alarm for all of them.
            Fault::ReadingNotANumber | Fault::ReadingFrozen | Fault::ReadingNoisy => {
                any(&[fault, Fault::OutletSensorLost])
            }
            _ => any(&[fault]),
        },
        Part::Response(Response::Backup | Response::BackupByFlow) => {
            any(&[Fault::BackupVentilation, Fault::NoResponse])
        }
        Part::Response(Response::CappedPid) => any(&[Fault::ReadingNoisy, Fault::CommandCapped]),
        Part::Response(Response::Resume) => any(&[Fault::Restarted]),
        Part::Response(_) => true,
    }
}

/// Whether no drawn case can need a part: none restarts the device, stores weights, silences the host or has a lower limit of the
/// minute volume, and doubt about a learned controller names no fault that is drawn.
pub fn is_out_of_reach(part: Part) -> bool {
    use Fault::{HostSilent, LearnedDistrusted, MinuteVolumeLow, Restarted, WeightsRefused};
    matches!(
        part,
        Part::Monitor(HostSilent | LearnedDistrusted | MinuteVolumeLow | Restarted | WeightsRefused)
            | Part::Response(Response::Resume)
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::draw::promise::broken;
    use progress::Progress;
    use shared::safety::monitors::Monitors;

    #[test]
    fn a_part_that_cannot_matter_changes_nothing() {
        let generator = Generator::new(3).unwrap();
        for number in 0..8 {
            let case = generator.draw(number);
            let whole = run(&case, case.onset_s(), Monitors::ALL).unwrap();
            for part in Part::all().filter(|part| !can_matter(*part, whole.indicated)) {
                let without = run(&case, case.onset_s(), part.others()).unwrap();
                assert!(without == whole, "case {number} without {}", part.name());
            }
        }
    }

    #[test]
    fn a_case_needs_the_parts_without_which_it_breaks_a_promise() {
        let (needing, task) = (Needing::new(3).unwrap(), Progress::silent().task(CASES, 1));
        let found = needing.unit(3, &task).unwrap().unwrap();
        let case = needing.generator.draw(3);
        let fails = |monitors| u64::from(!broken(&case, monitors).unwrap().is_empty());
        assert_eq!(found.failed, fails(Monitors::ALL));
        for (part, need) in found.each() {
            assert_eq!(found.failed + need.broken - need.kept, fails(part.others()), "{}", part.name());
        }
        let needed = |part| found.each().any(|(each, need)| each == part && need.broken == 1);
        assert!(needed(Part::Monitor(Fault::ReadingFrozen)) && !needed(Part::Monitor(Fault::HostSilent)));
    }

    #[test]
    fn a_part_is_idle_if_a_case_could_need_it_and_none_does() {
        let mut found = Needing::new(3).unwrap().nothing();
        let idle = |found: &Needs, fault| found.idle().any(|part| part == Part::Monitor(fault));
        assert!(idle(&found, Fault::Leak) && !idle(&found, Fault::HostSilent));
        found.parts[Fault::Leak as usize].kept = 1;
        assert!(idle(&found, Fault::Leak));
        found.parts[Fault::Leak as usize].unnamed = 1;
        assert!(!idle(&found, Fault::Leak));
    }
}
