//! Advice beside a sore spot: its likely cause, with the figures that say so. Where they do not decide, there is none.

use std::ops::Range;

use serde::Serialize;

use crate::breath::Breath;
use crate::limits::Kind;
use crate::response::{Inspiration, Response, onset};
use data::recording::Recording;

/// Most breaths of a lung that are looked at.
const MOST: usize = 8;
/// Fewest swings of an oscillation: the fall from an overshoot and its recovery are not one.
const SWINGS: usize = 3;
/// Fewest swings of a limit cycle, which does not decay.
const CYCLES: usize = 4;
/// Periods of an oscillation that a loop's delay explains, in delays. A loop that its delay brings to the edge swings with
/// about four; the slower lags of lung and valve make more of it, a gain beyond the edge less.
const PERIOD: (f64, f64) = (2.5, 8.0);
/// Delay from which it, and not the gain, is named, s: a quick proportional valve and its sensor need less.
const LATE_S: f64 = 0.035;
/// Play that is named, percent of the full command, and the residual with it as a share of that without.
const PLAY_PERCENT: f64 = 7.0;
const WITH_PLAY: f64 = 0.75;
/// Largest movement of the command that a play matters in, in plays.
const MOVEMENT: f64 = 6.0;
/// Part of the gas that flows in and does not come back with a leak.
const LEAK: f64 = 0.1;
/// Fewest breaths that show a leak.
const LEAKING: usize = 3;

/// The cause of a sore spot.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Cause {
    /// The controller's gain is too high.
    Gain,
    /// The pressure follows the command late.
    Delay,
    /// The valve has play.
    Play,
    /// The circuit leaks.
    Leak,
}

/// The likely cause of a sore spot.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Advice {
    /// The cause.
    pub cause: Cause,
    /// The cause in words, with its figures.
    pub text: String,
}

/// Knows the commands and flows of the judged breaths.
#[derive(Debug, Clone, Copy)]
pub(super) struct Adviser<'a> {
    pub recording: &'a Recording,
    /// The judged pressure, and its noise, cmH2O (sd).
    pub pressure: &'a [f32],
    pub noise: f64,
}

impl Adviser<'_> {
    /// The likely cause of a kind of trouble in the `worst` of a lung's breaths.
    pub fn advice(&self, kind: Kind, worst: &Breath, lung: &[&Breath]) -> Option<Advice> {
        // A perturbed breath does not show the controller alone.
        if self.recording.explore[worst.rows.clone()].iter().any(|percent| *percent != 0.0) {
            return None;
        }
        let figures = &worst.figures;
        let below = |value: Option<f64>| value.is_some_and(|value| value < 0.0);
        match kind {
            Kind::Overshoot | Kind::Undershoot | Kind::Oscillation => self.oscillation(worst, lung),
            Kind::BelowPeep => self.leak(lung),
            Kind::Baseline if below(figures.end_expiration.map(|end| end - worst.peep)) => self.leak(lung),
            Kind::Plateau if below(figures.plateau_bias) => self.leak(lung),
            Kind::Slope if below(figures.slope) => self.leak(lung),
            Kind::Rise if !figures.reached => self.leak(lung),
            _ => None,
        }
    }

    /// The cause of an oscillation: play, or gain and delay.
    fn oscillation(&self, worst: &Breath, lung: &[&Breath]) -> Option<Advice> {
        let swings = worst.figures.swings.filter(|swings| swings.count >= SWINGS)?;
        let period_s = 1.0 / swings.frequency?;
        let similar: Vec<&Breath> =
            lung.iter().copied().filter(|breath| breath.figures.bridged == 0).take(MOST).collect();
        if swings.count >= CYCLES
            && let Some(play) = self.play(worst, &similar)
        {
            return Some(play);
        }
        let mut onsets: Vec<f64> = similar.iter().filter_map(|breath| self.onset(breath)).collect();
        onsets.sort_by(f64::total_cmp);
        let delay_s = *onsets.get(onsets.len() / 2)?;
        let delays = period_s / delay_s;
        // A coarse recording does not tell whether the delay is long.
        let undecided = (delay_s - LATE_S).abs() < self.recording.provenance.period_s();
        if undecided || !(PERIOD.0..=PERIOD.1).contains(&delays) {
            return None;
        }
        let (period, delay) = (1e3 * period_s, 1e3 * delay_s);
        let figures = format!("a period of {period:.0} ms is {delays:.1} times the delay of {delay:.0} ms");
        Some(if delay_s >= LATE_S {
            let text = format!("probably the delay between command and pressure: {figures}");
            Advice { cause: Cause::Delay, text }
        } else {
            Advice { cause: Cause::Gain, text: format!("probably too high a gain: {figures}") }
        })
    }

    /// The valve's play, if commands as small as a few plays keep the pressure swinging.
    fn play(&self, worst: &Breath, lung: &[&Breath]) -> Option<Advice> {
        let rows = self.inspiration(worst);
        let commands = &self.recording.u_in[rows.start + rows.len() / 2..rows.end];
        let most = commands.iter().copied().fold(f32::NEG_INFINITY, f32::max);
        let movement = f64::from(most - commands.iter().copied().fold(f32::INFINITY, f32::min));
        let all: Vec<Inspiration> = lung.iter().map(|breath| self.curves(breath)).collect();
        let response = Response::fit(&all, self.recording.provenance.period_s())?;
        let Response { play_percent, with_play } = response;
        let shows =
            play_percent >= PLAY_PERCENT && with_play <= WITH_PLAY && movement <= MOVEMENT * play_percent;
        shows.then(|| Advice {
            cause: Cause::Play,
            text: format!(
                "probably the valve's play: commands that move by {movement:.0} % keep the pressure swinging, and a play of \
                 {play_percent:.0} % explains it {:.1} times as well as none",
                1.0 / with_play
            ),
        })
    }

    /// A leak, if the whole breaths of a lung lack gas in their expirations.
    fn leak(&self, lung: &[&Breath]) -> Option<Advice> {
        let lacks: Vec<[f64; 2]> = lung.iter().filter_map(|breath| self.lack(breath)).take(MOST).collect();
        let leaks = lacks.len() >= LEAKING && lacks.iter().all(|[lack, inflow]| *lack >= LEAK * inflow);
        let mean = |n: usize| lacks.iter().map(|both| both[n]).sum::<f64>() / lacks.len() as f64;
        leaks.then(|| Advice {
            cause: Cause::Leak,
            text: format!(
                "probably a leak, unless a flow sensor is off: {:.0} of {:.0} mL that flow in ({:.0} %) do not come back",
                mean(0),
                mean(1),
                100.0 * mean(0) / mean(1)
            ),
        })
    }

    /// Volume of a whole breath that flows in and does not come back, and that flows in, mL.
    fn lack(&self, breath: &Breath) -> Option<[f64; 2]> {
        breath.figures.breath_s?;
        let (into, out) = (self.recording.flow_in.as_ref()?, self.recording.flow_out.as_ref()?);
        let net = || breath.rows.clone().map(|row| f64::from(into[row]) - f64::from(out[row]));
        let ml = |sum: f64| 1e3 * sum * self.recording.provenance.period_s();
        let both = [ml(net().sum()), ml(net().map(|flow| flow.max(0.0)).sum())];
        both.iter().all(|volume| volume.is_finite()).then_some(both)
    }

    /// Time from the command that starts a breath to its pressure, s.
    fn onset(&self, breath: &Breath) -> Option<f64> {
        let way = breath.figures.level - breath.peep;
        onset(&self.curves(breath), way, self.noise, self.recording.provenance.period_s())
    }

    fn curves(&self, breath: &Breath) -> Inspiration {
        let of =
            |column: &[f32]| column[self.inspiration(breath)].iter().map(|value| f64::from(*value)).collect();
        Inspiration { command: of(&self.recording.u_in), pressure: of(self.pressure) }
    }

    /// Rows of the inspiration of a breath without missing ones.
    fn inspiration(&self, breath: &Breath) -> Range<usize> {
        let ticks = (breath.figures.inspiration_s / self.recording.provenance.period_s()).round() as usize;
        breath.rows.start..breath.rows.start + ticks - breath.figures.bridged
    }
}
