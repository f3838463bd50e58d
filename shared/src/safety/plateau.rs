//! Compares the two pressure sensors at the end of inspirations, where hardly any flow separates them: a gain that is wrong shows
//! there, not at PEEP.
//!
//! Which of two readings is wrong is told by the gas: in breaths in which the sensors agreed, a volume raised the pressure by so much.
//! A sensor by which the same gas raises it much more, or much less, is wrong. Before there was such a breath, the lower one counts as
//! wrong.

use super::monitors::in_a_row;
use crate::breath::Moment;

/// Difference at the end of a phase above which one of the sensors is wrong, cmH2O. Fulfils: sensors-disagree.
pub const DOUBTFUL: f32 = 2.0;
/// Highest resistance of the tube between them, cmH2O/(L/s): a flow that compensates a leak drops pressure in it.
pub const TUBE: f32 = 4.0;
/// Share of the pressure by which sound sensors may differ besides: their gains are not exact.
pub const GAIN: f32 = 0.05;
/// Inspirations in a row with a larger difference after which the worse sensor is not used.
pub const APART_BREATHS: u32 = 2;
/// Weight of a new breath in the rise that the gas causes.
const NEW: f32 = 0.3;
/// Least volume that tells how much it raises the pressure, mL.
const LEAST_VOLUME: f32 = 1.0;

/// State of the comparison.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Plateau {
    /// Sums of both pressures, cmH2O, and of the valve's flow, L/s, over the window at the end of the running inspiration.
    sums: [f32; 3],
    count: u32,
    /// Rise of the pressure per volume in inspirations in which the sensors agreed, cmH2O/mL.
    rise: Option<f32>,
    /// Inspirations in a row in which they did not.
    apart: u32,
}

/// What a comparison says.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Judgement {
    /// The sensors agree.
    Agree,
    /// They do not, for the first time.
    Apart,
    /// The airway sensor is wrong.
    AirwayWrong,
    /// The outlet sensor is wrong.
    OutletWrong,
}

impl Plateau {
    /// Adds the pressures at airway and outlet, cmH2O, and the valve's flow, L/s, of a tick of an inspiration, if there are any and the
    /// tick belongs to the window of this length at its end.
    #[inline]
    pub fn add(&mut self, moment: &Moment, window: u32, values: Option<[f32; 3]>) {
        if moment.tick == 0 {
            (self.sums, self.count) = ([0.0; 3], 0);
        }
        let belongs = moment.breath.inspiration_ticks() - moment.tick <= window;
        if let Some(values) = values.filter(|_| belongs) {
            self.sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += value);
            self.count += 1;
        }
    }

    /// Judges the sensors at the end of an inspiration from this PEEP, cmH2O, that delivered this volume, mL; none without readings of
    /// both.
    pub fn judge(&mut self, peep: f32, volume: f32) -> Option<Judgement> {
        let (sums, count) = (core::mem::take(&mut self.sums), core::mem::take(&mut self.count));
        if count == 0 {
            return None;
        }
        let [airway, outlet, flow] = sums.map(|sum| sum / count as f32);
        let difference = outlet - airway;
        let allowed = DOUBTFUL + GAIN * airway.abs();
        let agree = difference >= -allowed && difference <= allowed + TUBE * flow;
        self.apart = in_a_row(self.apart, !agree);
        if agree {
            self.learn(airway - peep, volume);
            return Some(Judgement::Agree);
        }
        if self.apart < APART_BREATHS {
            return Some(Judgement::Apart);
        }
        let off = |pressure: f32| self.rise.map(|rise| (pressure - peep - rise * volume).abs());
        let airway_wrong = match (off(airway), off(outlet)) {
            (Some(airway), Some(outlet)) => airway > outlet,
            _ => difference > 0.0,
        };
        Some(if airway_wrong { Judgement::AirwayWrong } else { Judgement::OutletWrong })
    }

    /// Whether the sensors agreed at the end of the last inspiration that was judged.
    pub fn agreed(&self) -> bool {
        self.apart == 0
    }

    /// Learns by how much a volume raises the pressure.
    fn learn(&mut self, rise: f32, volume: f32) {
        if volume >= LEAST_VOLUME && rise > 0.0 {
            let new = rise / volume;
            self.rise = Some(self.rise.map_or(new, |rise| rise + NEW * (new - rise)));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::breath::{Breath, DEFAULT_PERIOD_US, paper_settings};

    const VOLUME: f32 = 400.0;

    /// The judgement of an inspiration with these pressures and this flow at its end.
    fn judged(plateau: &mut Plateau, airway: f32, outlet: f32, flow: f32, volume: f32) -> Option<Judgement> {
        let breath = Breath::new(&paper_settings(25.0), DEFAULT_PERIOD_US).unwrap();
        for tick in 0..breath.inspiration_ticks() {
            // What happens before the window does not count.
            let values = if tick < 900 { [0.0, 50.0, 0.0] } else { [airway, outlet, flow] };
            plateau.add(&breath.at(tick), 50, Some(values));
        }
        plateau.judge(5.0, volume)
    }

    /// Verifies: sensors-disagree.
    #[test]
    fn a_wrong_gain_is_found_in_the_second_inspiration_and_the_gas_tells_whose_it_is() {
        for (airway, outlet, wrong) in [
            (25.0, 31.0, Judgement::AirwayWrong),
            (25.0, 20.0, Judgement::AirwayWrong),
            (25.0, 35.0, Judgement::OutletWrong),
            (25.0, 18.0, Judgement::OutletWrong),
        ] {
            let mut plateau = Plateau::default();
            assert_eq!(judged(&mut plateau, 25.0, 25.5, 0.1, VOLUME), Some(Judgement::Agree));
            // With the airway sensor wrong, the pressure and the volume are not what they were.
            let volume =
                if wrong == Judgement::AirwayWrong { VOLUME * (outlet - 5.0) / 20.0 } else { VOLUME };
            let mut again = || judged(&mut plateau, airway, outlet, 0.0, volume);
            assert_eq!((again(), again()), (Some(Judgement::Apart), Some(wrong)), "{airway} {outlet}");
        }
    }

    #[test]
    fn before_the_first_breath_in_which_they_agreed_the_lower_one_is_wrong() {
        let mut plateau = Plateau::default();
        judged(&mut plateau, 25.0, 31.0, 0.0, VOLUME);
        assert_eq!(judged(&mut plateau, 25.0, 31.0, 0.0, VOLUME), Some(Judgement::AirwayWrong));
        assert!(!plateau.agreed());
    }

    #[test]
    fn what_drops_in_the_tube_or_lies_within_the_gain_is_no_difference() {
        let mut plateau = Plateau::default();
        for _ in 0..3 {
            assert_eq!(judged(&mut plateau, 25.0, 31.0, 0.8, VOLUME), Some(Judgement::Agree));
            assert_eq!(judged(&mut plateau, 25.0, 28.2, 0.0, VOLUME), Some(Judgement::Agree));
            assert_eq!(judged(&mut plateau, 25.0, 21.8, 0.0, VOLUME), Some(Judgement::Agree));
        }
        assert_eq!(judged(&mut plateau, 25.0, 28.3, 0.0, VOLUME), Some(Judgement::Apart));
    }

    #[test]
    fn without_readings_nothing_is_judged() {
        let mut plateau = Plateau::default();
        let breath = Breath::new(&paper_settings(25.0), DEFAULT_PERIOD_US).unwrap();
        (0..1000).for_each(|tick| plateau.add(&breath.at(tick), 50, None));
        assert_eq!(plateau.judge(5.0, VOLUME), None);
        judged(&mut plateau, 25.0, 40.0, 0.0, VOLUME);
        assert_eq!(plateau.judge(5.0, VOLUME), None, "an inspiration is judged once");
    }
}
