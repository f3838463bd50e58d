//! The figures of a breath, computed from its samples while they come.
//!
//! Flow and volumes are those of the device's flow sensor ([`measured`]); without one they are estimated ([`flow`]). A breath with
//! missing samples, or whose start was not seen, has no figures. A leak is what the device reports: without a flow sensor it looks
//! like a softer lung.

pub mod flow;
pub mod measured;

use std::collections::VecDeque;

use monitoring::curve::Tracking;
use shared::breath::{Phase, period_s};
use shared::settings::Settings;
use shared::ventilator::{Sample, opening};

use crate::stream::BreathFigures;
use crate::stream::frame::Point;
use flow::FlowModel;
use measured::MeasuredFlow;

/// Time at the end of a phase over which the pressure is averaged, s.
const END_S: f32 = 0.05;
/// Time over which the minute volume is averaged, s.
const AVERAGED_S: f32 = 30.0;
/// Ticks by which a breath may be shorter than set before an effort must have ended it.
const EARLY_TICKS: u32 = 2;
/// Time after which a breath has no figures, s: the slowest takes 15 s, and a lung that empties slowly 30 s more.
const LONGEST_S: f32 = 60.0;
/// Seconds in a minute.
const MINUTE: f32 = 60.0;
/// From mL to L.
const LITRES: f32 = 1e-3;

/// Takes the samples of a device one by one.
#[derive(Debug)]
pub struct BreathMeter {
    period_us: u32,
    period_s: f32,
    flow: FlowModel,
    measured: MeasuredFlow,
    next_tick: u64,
    breath: Option<Running>,
    /// Whether an effort has ended the last breath, if its length is known.
    ended_early: bool,
    /// PEEP of the last breath's target, cmH2O.
    peep: Option<f32>,
    /// Tidal volumes, mL, and lengths, s, of the last breaths, at most about [`AVERAGED_S`].
    volumes: VecDeque<(f32, f32)>,
}

/// The running breath, of which no sample is missing so far.
#[derive(Debug)]
struct Running {
    number: u32,
    triggered: bool,
    ticks: u32,
    /// Pressures and targets of the inspiration, cmH2O.
    pressures: Vec<f64>,
    targets: Vec<f64>,
    /// Last pressures, cmH2O, at most [`END_S`].
    tail: VecDeque<f32>,
    /// Mean of the tail at the end of the inspiration, cmH2O.
    plateau: Option<f32>,
    peak: f32,
    /// Last target, cmH2O.
    target: f32,
    /// Inspired volume, mL.
    tidal_volume: f32,
    /// Sum of the roots of the pressures, cmH2O^0.5, to which the flow of a leak is proportional.
    roots: f32,
}

impl BreathMeter {
    /// A meter for a device with this control period, microseconds.
    pub fn new(period_us: u32) -> Self {
        Self {
            period_us,
            period_s: period_s(period_us),
            flow: FlowModel::new(period_us),
            measured: MeasuredFlow::new(period_us),
            next_tick: 0,
            breath: None,
            ended_early: false,
            peep: None,
            volumes: VecDeque::new(),
        }
    }

    /// Sets the leak as the device knows it, L/s at 1 cmH2O; none without a flow sensor.
    pub fn leak(&mut self, leak: Option<f32>) {
        self.measured.set_leak(leak);
    }

    /// Takes the sample of a control tick; returns it with flow and volume and, at the start of a breath, the figures of the one
    /// before. `settings` are those in force, if they are known.
    pub fn take(
        &mut self,
        tick: u64,
        sample: &Sample,
        settings: Option<&Settings>,
    ) -> (Point, Option<BreathFigures>) {
        // A breath without an end would fill the memory.
        let endless = |breath: &Running| breath.ticks as f32 * self.period_s > LONGEST_S;
        if tick != self.next_tick || self.breath.as_ref().is_some_and(endless) {
            self.interrupted();
        }
        self.next_tick = tick + 1;
        let figures = if sample.tick == 0 { self.start_breath(sample, settings) } else { None };
        let peep = self.peep.or(settings.map(|settings| settings.peep)).unwrap_or(sample.pressure);
        // The model follows every tick, so that it is ready when the sensor fails.
        let estimated = self.flow.take(sample, peep, self.ended_early);
        let (flow, volume) = self.measured.take(sample, peep).unwrap_or(estimated);
        let tail = ((END_S / self.period_s) as usize).max(1);
        if let Some(breath) = &mut self.breath {
            breath.take(sample, volume, tail);
        }
        let point = Point {
            pressure: sample.pressure,
            target: sample.target,
            u_in: sample.u_in,
            u_out: opening(sample.u_out),
            learned: sample.learned,
            flow,
            volume,
            phase: sample.phase,
        };
        (point, figures)
    }

    /// Samples are missing: nothing is known about the running breath.
    fn interrupted(&mut self) {
        self.breath = None;
        self.ended_early = false;
        self.flow.interrupted();
        self.measured.interrupted();
        self.volumes.clear();
    }

    fn start_breath(&mut self, sample: &Sample, settings: Option<&Settings>) -> Option<BreathFigures> {
        let ended = self.breath.take();
        let figures = ended.as_ref().and_then(|breath| self.figures(breath, settings));
        self.ended_early = ended.as_ref().is_some_and(|breath| self.is_early(breath, settings));
        self.peep = ended.as_ref().map(|breath| breath.target).or(self.peep);
        self.breath = Some(Running::new(sample.breath, self.ended_early));
        figures
    }

    /// Whether a breath was shorter than set.
    fn is_early(&self, breath: &Running, settings: Option<&Settings>) -> bool {
        settings.is_some_and(|settings| {
            let set = MINUTE / settings.rate / self.period_s;
            ((breath.ticks + EARLY_TICKS) as f32) < set
        })
    }

    fn figures(&mut self, breath: &Running, settings: Option<&Settings>) -> Option<BreathFigures> {
        let inspiration = breath.pressures.len() as u32;
        // Stopped during its inspiration, or started in the middle of nowhere.
        let (plateau, expiration) = (breath.plateau?, breath.ticks.checked_sub(inspiration)?);
        let length = breath.ticks as f32 * self.period_s;
        let measured = self.measured.is_measured();
        // Of a breath with many missing readings no volume is known.
        let tidal_volume = (measured != Some(false)).then_some(breath.tidal_volume);
        let lung = if measured.is_some() { self.measured.lung() } else { self.flow.lung() };
        let mut figures = BreathFigures {
            number: breath.number,
            pip: Some(breath.peak),
            plateau: Some(plateau),
            peep: breath.tail_mean(),
            tidal_volume,
            minute_volume: tidal_volume.map(|volume| self.minute_volume(volume, length)),
            rate: Some(MINUTE / length),
            rate_set: settings.map(|settings| settings.rate),
            ie: (inspiration > 0).then(|| expiration as f32 / inspiration as f32),
            resistance: lung.map(|lung| lung.resistance),
            compliance: lung.map(|lung| 1.0 / lung.elastance),
            leak: self.measured.leak().map(|leak| leak * breath.mean_root() * MINUTE),
            estimated: measured.is_none(),
            triggered: breath.triggered,
            ..BreathFigures::default()
        };
        self.score(breath, &mut figures);
        Some(figures)
    }

    /// Fills in error, rise and overshoot, as `trainer evaluate` scores them.
    fn score(&self, breath: &Running, figures: &mut BreathFigures) {
        let pip = breath.targets.iter().copied().fold(f64::MIN, f64::max) as f32;
        let way = (f64::from(breath.target), f64::from(pip));
        let period = f64::from(self.period_us) * 1e-6;
        let tracking = Tracking::of(way, period, &breath.pressures, &breath.targets);
        figures.error = Some(tracking.error as f32);
        figures.rise_ms = Some(tracking.rise_ms as f32);
        figures.overshoot = Some(tracking.overshoot as f32);
    }

    /// The minute volume after a breath of this volume, mL, and length, s; L/min.
    fn minute_volume(&mut self, tidal_volume: f32, length: f32) -> f32 {
        self.volumes.push_back((tidal_volume, length));
        let covered = |volumes: &VecDeque<(f32, f32)>| volumes.iter().map(|(_, length)| length).sum::<f32>();
        while self.volumes.len() > 1 && covered(&self.volumes) > AVERAGED_S {
            self.volumes.pop_front();
        }
        let volume: f32 = self.volumes.iter().map(|(volume, _)| volume).sum();
        volume * LITRES * MINUTE / covered(&self.volumes)
    }
}

impl Running {
    fn new(number: u32, triggered: bool) -> Self {
        Self {
            number,
            triggered,
            ticks: 0,
            pressures: Vec::new(),
            targets: Vec::new(),
            tail: VecDeque::new(),
            plateau: None,
            peak: f32::NEG_INFINITY,
            target: 0.0,
            tidal_volume: 0.0,
            roots: 0.0,
        }
    }

    /// Takes a sample with the volume so far, mL; the tail has this many samples.
    fn take(&mut self, sample: &Sample, volume: f32, tail: usize) {
        self.ticks += 1;
        self.target = sample.target;
        self.roots += sample.pressure.max(0.0).sqrt();
        self.peak = self.peak.max(sample.pressure);
        if sample.phase == Phase::Inspiration {
            self.pressures.push(sample.pressure.into());
            self.targets.push(sample.target.into());
            self.tidal_volume = volume;
        } else if self.plateau.is_none() {
            self.plateau = self.tail_mean();
        }
        self.tail.push_back(sample.pressure);
        while self.tail.len() > tail {
            self.tail.pop_front();
        }
    }

    /// Mean root of the pressure, cmH2O^0.5.
    fn mean_root(&self) -> f32 {
        self.roots / self.ticks as f32
    }

    /// Mean of the last pressures, cmH2O.
    fn tail_mean(&self) -> Option<f32> {
        let sum: f32 = self.tail.iter().sum();
        (!self.tail.is_empty()).then(|| sum / self.tail.len() as f32)
    }
}

#[cfg(test)]
mod tests;
