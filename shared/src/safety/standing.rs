//! Finds a pressure reading that stands still, with the noise of a working sensor, while gas goes in and out of the lung.
//!
//! A common cause can make both pressure sensors read a constant: a converter, a reference, a trapped pressure. Each denies
//! nothing to the other then. The flow sensor does: gas that goes in raises the pressure, and gas that comes out lowers it.
//! So a reading is lost that
//! * stands still above PEEP in an inspiration whose gas should have raised it ([`Standing::stands_above`]),
//! * has stood still in an expiration in which a lung's gas came out ([`Standing::denies_outflow`]), or
//! * stands still so high above PEEP that the gas which has stayed in the lung cannot explain it ([`Standing::denies_balance`]), or
//!   leaves hardly any room for a breath without that gas, whether it stands still or not ([`Standing::lacks_gas`]).
//!
//! For the same reason PIP follows a high baseline only if the pressure swings with the breath ([`Standing::swings`]).

use super::breath_monitor::ABOVE_PEEP;
use crate::breath::Moment;

/// Change of the smoothed pressure within a phase from which it moves, cmH2O: more than noise causes. Fulfils: no-response.
pub const MOVES: f32 = 0.6;
/// Fall that the expired gas must bring, and that shows a valve which opens, cmH2O.
pub const FALL: f32 = 3.0;
/// Share of a baseline's height above PEEP that the gas in the lung must explain.
pub const EXPLAINED: f32 = 0.3;

/// Weight of a breath in the mean of the gas that is lost.
const OF_A_BREATH: f32 = 0.3;

/// State; nothing has moved before the first breath.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Standing {
    /// Smoothed pressure at the start of the running phase, cmH2O, and whether it has moved since then.
    start: f32,
    moved: bool,
    /// Highest smoothed pressure of the running phase, cmH2O.
    highest: f32,
    /// Fall of the smoothed pressure over the last expiration, cmH2O.
    fall: f32,
    /// Whether it stood still in the last whole inspiration, and in the last expiration.
    inspiration: bool,
    expiration: bool,
    /// Gas that has gone into the lung and has not come out again since the baseline was last at PEEP, mL.
    balance: f32,
    /// Mean gas that does not come out in breaths from PEEP to PEEP, mL.
    lost: Option<f32>,
    /// Gas that came out before the last expiration, mL: muscles that relax press some into the circuit.
    before: f32,
}

impl Standing {
    /// Records the smoothed pressure of a tick of a breath, cmH2O.
    #[inline]
    pub fn observe(&mut self, moment: &Moment, smooth: f32) {
        if moment.tick == 0 {
            (self.expiration, self.fall) = (!self.moved, self.start - smooth);
            (self.start, self.moved, self.highest) = (smooth, false, smooth);
        } else if moment.tick == moment.breath.inspiration_ticks() {
            self.inspiration = !self.moved;
            (self.start, self.moved, self.highest) = (smooth, false, smooth);
        }
        if smooth > self.highest {
            self.highest = smooth;
        }
        let stands = (smooth - self.start).abs() <= MOVES;
        self.moved |= !stands;
    }

    /// There is no pressure in this tick: the phase proves nothing.
    pub fn unseen(&mut self) {
        self.moved = true;
    }

    /// Whether the pressure has moved in the running phase.
    pub fn has_moved(&self) -> bool {
        self.moved
    }

    /// Whether the pressure fell over the last expiration as it does through an open valve.
    pub fn falls(&self) -> bool {
        self.fall >= FALL
    }

    /// Smoothed pressure at the start of the running phase, cmH2O.
    pub fn start(&self) -> f32 {
        self.start
    }

    /// Highest smoothed pressure of the running phase, cmH2O.
    pub fn highest(&self) -> f32 {
        self.highest
    }

    /// At the end of a breath: whether the pressure has moved in its inspiration and in its expiration.
    pub fn swings(&self) -> bool {
        self.moved && !self.inspiration
    }

    /// Whether the pressure has stood still since the start of the inspiration, above this PEEP, cmH2O. Near PEEP an effort can take
    /// the rise away.
    pub fn stands_above(&self, peep: f32) -> bool {
        !self.moved && self.start > peep + ABOVE_PEEP
    }

    /// Ends an inspiration in which so much gas came out, mL.
    pub fn inspired(&mut self, expired: f32) {
        self.before = expired;
    }

    /// Gas that came out in the last breath before its expiration, mL.
    pub fn expired_before(&self) -> f32 {
        self.before
    }

    /// Adds the gas that did not come out in the last breath, mL; `high`: expirations in a row that have ended above PEEP. Returns what
    /// has stayed in the lung: not what breaths from PEEP to PEEP lose, as to a leak.
    pub fn add(&mut self, kept: f32, high: u32) -> f32 {
        if high == 0 {
            self.lost = Some(self.lost.map_or(kept, |lost| lost + OF_A_BREATH * (kept - lost)));
        }
        let stays = kept - self.lost.unwrap_or(0.0).max(0.0);
        self.balance = stays + if high > 1 { self.balance } else { 0.0 };
        stays
    }

    /// Whether the pressure stood still in the last expiration although its gas, mL, must have lowered it at this elastance, cmH2O/mL.
    pub fn denies_outflow(&self, expired: f32, elastance: f32) -> bool {
        self.expiration && expired * elastance >= FALL
    }

    /// Whether the pressure stood still in the last expiration, so high above this PEEP, cmH2O, that the gas in the lung does not
    /// explain it at this elastance, cmH2O/mL.
    pub fn denies_balance(&self, peep: f32, elastance: f32) -> bool {
        self.expiration && self.lacks_gas(peep, elastance)
    }

    /// Whether the gas that has stayed in the lung does not explain a pressure so high above this PEEP, cmH2O, at this elastance,
    /// cmH2O/mL.
    pub fn lacks_gas(&self, peep: f32, elastance: f32) -> bool {
        self.balance * elastance < EXPLAINED * (self.start - peep)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{Breath, DEFAULT_PERIOD_US, paper_settings};

    const PEEP: f32 = 5.0;

    fn breath() -> Breath {
        Breath::new(&paper_settings(20.0), DEFAULT_PERIOD_US).unwrap()
    }

    /// The state in the first tick after a breath with these pressures by the tick.
    fn after(pressure: impl Fn(u32) -> f32) -> Standing {
        let (mut standing, breath) = (Standing::default(), breath());
        for tick in 0..breath.total_ticks() {
            standing.observe(&breath.at(tick), pressure(tick));
        }
        standing.observe(&breath.at(0), pressure(0));
        standing
    }

    /// A breath at PIP and PEEP.
    fn swing(tick: u32) -> f32 {
        if (100..1010).contains(&tick) { 20.0 } else { PEEP }
    }

    #[test]
    fn noise_is_no_movement_and_a_change_within_a_phase_is() {
        let denies = |swing: f32| {
            let pressure = |tick: u32| 20.0 + if tick % 200 < 100 { 0.0 } else { swing };
            after(pressure).denies_outflow(100.0, 0.05)
        };
        assert!(denies(0.0) && denies(0.59) && denies(-0.59) && !denies(0.61) && !denies(-0.61));
        assert!(!after(swing).denies_outflow(1000.0, 0.05));
        assert!(!after(|_| f32::NAN).denies_outflow(1000.0, 0.05), "what is no number proves nothing");
    }

    #[test]
    fn gas_that_comes_out_must_lower_the_pressure_by_three() {
        let standing = after(|_| 12.0);
        assert!(standing.denies_outflow(60.0, 0.05) && !standing.denies_outflow(59.0, 0.05));
        let gap = |tick| {
            let (mut standing, breath) = (Standing::default(), breath());
            for tick_now in 0..breath.total_ticks() {
                standing.observe(&breath.at(tick_now), 12.0);
                if tick_now == tick {
                    standing.unseen();
                }
            }
            standing.observe(&breath.at(0), 12.0);
            standing.denies_outflow(60.0, 0.05)
        };
        assert!(gap(500) && !gap(2000), "without a pressure in the expiration nothing is denied");
    }

    #[test]
    fn a_baseline_without_its_gas_is_denied_and_one_with_it_is_not() {
        // 19 cmH2O above PEEP: in a lung of 20 mL/cmH2O they take 380 mL, of which 114 count.
        let denies = |kept: &[f32]| {
            let mut standing = after(|_| 24.0);
            for (high, gas) in (1..).zip(kept) {
                standing.add(*gas, high);
            }
            standing.denies_balance(PEEP, 0.05)
        };
        assert!(denies(&[0.0]) && denies(&[113.0]) && !denies(&[115.0]) && !denies(&[380.0]));
        assert!(denies(&[380.0, -380.0]) && !denies(&[200.0, 0.0]), "over the breaths since it rose");
        let mut standing = after(|_| 24.0);
        standing.add(380.0, 1);
        standing.add(0.0, 0);
        assert!(standing.denies_balance(PEEP, 0.05), "a baseline at PEEP starts again");
        assert!(!after(swing).denies_balance(PEEP, 0.05), "it swings");
    }

    #[test]
    fn what_breaths_from_peep_to_peep_lose_does_not_stay_in_the_lung() {
        let denies = |leaks: bool| {
            let mut standing = after(|_| 24.0);
            standing.add(if leaks { 100.0 } else { 0.0 }, 0);
            let stays = (1..5).map(|high| standing.add(100.0, high)).sum::<f32>();
            (stays as i32, standing.denies_balance(PEEP, 0.05))
        };
        assert_eq!((denies(true), denies(false)), ((0, true), (400, false)));
    }

    #[test]
    fn only_above_peep_does_an_inspiration_stand_still() {
        let stands = |start: f32, later: f32| {
            let (mut standing, breath) = (Standing::default(), breath());
            [start, later].iter().zip(0..).for_each(|(p, tick)| standing.observe(&breath.at(tick), *p));
            standing.stands_above(PEEP)
        };
        assert!(stands(8.1, 8.1) && stands(24.0, 24.5) && !stands(24.0, 24.7));
        assert!(!stands(8.0, 8.0), "an effort may hold it there");
    }

    #[test]
    fn a_pressure_swings_if_both_phases_move_it() {
        let swings = |pressure: fn(u32) -> f32| {
            let (mut standing, breath) = (Standing::default(), breath());
            (0..breath.total_ticks()).for_each(|tick| standing.observe(&breath.at(tick), pressure(tick)));
            standing.swings()
        };
        assert!(swings(swing) && !swings(|_| 24.0));
        assert!(!swings(|tick| if tick < 1000 { 24.0 } else { swing(tick) }), "no rise");
        assert!(!swings(|tick| if tick < 1000 { swing(tick) } else { 24.0 }), "no fall");
    }
}
