//! A learned simulator as a graph: one block of control ticks, with the state of the simulator as an input and an output.
//!
//! A block begins with the state after the last one and takes the commands of its ticks; it gives the pressure after each of them. At
//! the first block of a breath, where the time is zero, the state comes from the input `start`.

use thiserror::Error;

use crate::graph::Builder;
use crate::simulator::block::Block;
use crate::simulator::model::Simulator;

pub use crate::simulator::block::START;

/// Name of the first output.
const PRESSURES: &str = "pressures";

/// Why a simulator cannot be exported.
#[derive(Clone, Debug, PartialEq, Eq, Error)]
pub enum OnnxError {
    /// It takes more than one command.
    #[error(
        "the simulator takes {0} commands in each tick, but only those with one can be exported: fit it to a recording of one valve"
    )]
    Channels(usize),
    /// There is no such unit.
    #[error("the simulator has no unit {asked}: it has {known}, numbered from 0")]
    Unit {
        /// The unit asked for.
        asked: u32,
        /// Number of its units.
        known: usize,
    },
}

/// The file of a simulator. Of a simulator of several units it contains one: without a choice a physical simulator's first, and for a
/// hybrid a ventilator of none of the recorded ones.
///
/// # Errors
/// A simulator with several commands in each tick, or a unit that it does not have.
pub fn simulator(simulator: &Simulator, unit: Option<u32>) -> Result<Vec<u8>, OnnxError> {
    let timing = *simulator.architecture.timing();
    if timing.channels != 1 {
        return Err(OnnxError::Channels(timing.channels));
    }
    let known = simulator.architecture.members();
    if let Some(asked) = unit.filter(|unit| *unit as usize >= known) {
        return Err(OnnxError::Unit { asked, known });
    }
    let mut graph = Builder::new("simulator");
    let block = Block::input(&mut graph, &timing, unit);
    let (pressures, state) = simulator.architecture.graph(&mut graph, &block, &simulator.parameters);
    graph.output(PRESSURES, timing.block_ticks, "pressure after each tick of the block, cmH2O", &pressures);
    let width = state.output(&mut graph);
    let metadata = [
        ("period_us", timing.period_us.to_string()),
        ("block_ticks", timing.block_ticks.to_string()),
        ("state", width.to_string()),
        ("plant", simulator.plant.clone()),
        ("noise", simulator.noise.to_string()),
    ];
    Ok(graph.encode("One block of a learned simulator: see docs/FILES.md of Eupnea", &metadata))
}
