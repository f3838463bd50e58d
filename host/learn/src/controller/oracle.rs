//! An oracle: a controller that is told numbers of its unit, to see what there is to gain by knowing them before the first breath.
//!
//! The numbers take the place of what earlier breaths taught, of which a first breath has nothing. A student's own state
//! ([`super::student`]) takes it too. Only in training, on simulators.

use super::config::Told;
use super::memory::Recall;
use super::scenario::Scenario;
use crate::simulator::model::Model;
use crate::simulator::unit::{MACHINE_NUMBERS, UNIT_NUMBERS, scaled};
use engine::Lane;

/// Ticks of a breath in which a student learns its unit.
const STUDENT_TICKS: usize = 50;

/// Tells the breaths of a scenario on a model of units what an oracle says.
pub(super) fn tell(told: Told, model: &Model, scenario: &mut Scenario) {
    let (known, from) = match told {
        Told::Nothing => (0, 0),
        Told::Recurrent => {
            scenario.memory = Some(Recall::of_student());
            return;
        }
        Told::Machine => (MACHINE_NUMBERS, 0),
        Told::Unit => (UNIT_NUMBERS, 0),
        Told::Student => (UNIT_NUMBERS, STUDENT_TICKS),
    };
    let start = &scenario.start;
    let of = |l: usize| scaled(model.parameters(), start.ventilator[l], start.group[l]);
    let numbers = std::array::from_fn(|n| if n < known { Lane::from_fn(|l| of(l)[n]) } else { Lane::ZERO });
    scenario.memory = Some(Recall::told(&numbers, from));
}
