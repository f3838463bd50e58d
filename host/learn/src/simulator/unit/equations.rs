//! The equations of a unit over a tick: its valve, and its lung behind the circuit.
#![expect(
    clippy::inline_always,
    reason = "vector operations are compiled for the unit detected at run time only where they are inlined"
)]

use engine::number::Number;

use super::{PER_UNIT, UnitConfig, VALVE, lung, valve};
use crate::simulator::trajectory::Equations;

/// What is given for a breath: the logarithms of a unit's numbers; pressure, PEEP and the last plateau,
/// cmH2O; inspiratory and expiratory time of the breath before, s; the command at rest and that at the end of
/// the last inspiration, percent.
pub(super) const GIVEN: usize = PER_UNIT + KNOWN;
const KNOWN: usize = 7;
/// Numbers of a breath: those of [`valve::numbers`], full flow, supply, those of [`lung::numbers`].
pub(super) const NUMBERS: usize = valve::NUMBERS + 2 + lung::NUMBERS;
/// Pieces of the state: actuator, stem, expiratory opening, airway, alveolar and sensed pressure.
pub(super) const STATE: usize = valve::STATE + lung::STATE;
/// Place of the sensed pressure in the state.
pub(super) const SENSED: usize = STATE - 1;
/// Inputs of a tick: the newer and the older one of the commands around the dead time, percent; PEEP, cmH2O; the flow that is
/// drawn out of the circuit, as a share of the valve's full flow.
pub(super) const INPUTS: usize = 4;

/// The equations at a control period.
#[derive(Clone, Copy, Debug)]
pub(super) struct UnitEquations {
    /// Control period, s.
    tick: f32,
}

impl UnitEquations {
    pub fn new(config: &UnitConfig) -> Self {
        Self { tick: config.timing.block_s() }
    }

    /// Dead time of a unit in ticks.
    pub fn dead_time<Q: Number>(self, logarithm: Q) -> Q {
        valve::ticks(logarithm.exp(), self.tick)
    }

    /// The numbers of a breath.
    pub fn numbers<Q: Number>(self, unit: [Q; PER_UNIT]) -> [Q; NUMBERS] {
        let [
            valve @ ..,
            full_flow,
            supply,
            r,
            turbulence,
            c,
            leak,
            circuit,
            closing,
            orifice,
            sensor,
            _,
            inflection,
        ] = unit;
        let lung = [r, turbulence, c, leak, circuit, closing, orifice, sensor, inflection];
        let (valve, lung) = (valve::numbers(valve, self.tick), lung::numbers(lung, self.tick));
        let all = [&valve[..], &[full_flow, supply], &lung].concat();
        std::array::from_fn(|n| all[n])
    }

    /// Share of the last plateau above PEEP that is still in the lung when a breath starts, after breaths of these phases, s.
    pub fn left<Q: Number>(unit: &[Q; PER_UNIT], phases: [Q; 2]) -> Q {
        let [r, c, outward] = [lung::RESISTANCE, lung::COMPLIANCE, lung::OUTWARD].map(|n| unit[VALVE + n]);
        lung::left_in_lung(phases, [r, c, outward])
    }

    /// The state in which a breath starts: the valve at rest, with the stem where this play has left it after
    /// the last inspiration, the expiratory valve open, and this share left in the lung.
    pub fn start<Q: Number>(
        [left, play]: [Q; 2],
        [pressure, peep, plateau, rest, before]: [Q; 5],
    ) -> [Q; STATE] {
        let alveolar = peep + (plateau - peep) * left;
        let stem = valve::held(before, rest, play);
        [rest, stem, pressure.constant(1.0), pressure, alveolar, pressure]
    }
}

impl Equations<GIVEN, NUMBERS, STATE, INPUTS> for UnitEquations {
    fn begin<Q: Number>(&self, given: [Q; GIVEN]) -> ([Q; NUMBERS], [Q; STATE]) {
        let [logarithms @ .., pressure, peep, plateau, inspiration, expiration, rest, before] = given;
        let unit = logarithms.map(Q::exp);
        let left = Self::left(&unit, [inspiration, expiration]);
        (self.numbers(unit), Self::start([left, unit[valve::PLAY]], [pressure, peep, plateau, rest, before]))
    }

    #[inline(always)]
    fn tick<Q: Number>(numbers: [Q; NUMBERS], before: [Q; STATE], inputs: [Q; INPUTS]) -> [Q; STATE] {
        let [part, share, play, zone, exponent, full_flow, supply, lung @ ..] = numbers;
        let [actuator, stem, lung_before @ ..] = before;
        let [newer, older, peep, drawn] = inputs;
        let valve = [part, share, play, zone, exponent];
        let ([actuator, stem], opening) = valve::tick(valve, [actuator, stem], [newer, older]);
        let [closing, p, a, sensed] =
            lung::tick(lung, lung_before, [full_flow * opening, full_flow * drawn, supply, peep]);
        [actuator, stem, closing, p, a, sensed]
    }
}
