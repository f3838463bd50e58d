//! Flow, volume and lung as a flow sensor shows them.
//!
//! The sensor reads the flow at the airway. Volume and lung are without the gas of a leak, as far as the device knows the leak.

use shared::breath::{Phase, period_s};
use shared::safety::lung_estimator::{LungEstimate, LungFit, TELLING_VOLUME};
use shared::safety::volumes::MEASURED;
use shared::ventilator::Sample;

/// Takes the flow readings of a device.
#[derive(Debug)]
pub struct MeasuredFlow {
    period: f32,
    /// Leak as the device knows it, L/s at 1 cmH2O.
    leak: Option<f32>,
    breath: Option<Breath>,
    lung: Option<LungEstimate>,
}

/// The running breath, which began with a reading.
#[derive(Debug, Default)]
struct Breath {
    /// Pressure at its start, cmH2O.
    start: f32,
    /// Gas in the lung since its start, mL.
    volume: f32,
    ticks: u32,
    read: u32,
    /// The fit to the inspiration, until that ends.
    fit: Option<LungFit>,
}

impl MeasuredFlow {
    /// For a device with this control period, microseconds.
    pub fn new(period_us: u32) -> Self {
        Self { period: period_s(period_us), leak: None, breath: None, lung: None }
    }

    /// Sets the leak, L/s at 1 cmH2O, if the device knows it.
    pub fn set_leak(&mut self, leak: Option<f32>) {
        self.leak = leak;
    }

    /// The leak, L/s at 1 cmH2O, if the device knows it.
    pub fn leak(&self) -> Option<f32> {
        self.leak
    }

    /// Samples are missing: the volume is unknown until the next breath.
    pub fn interrupted(&mut self) {
        self.breath = None;
    }

    /// The lung as measured last.
    pub fn lung(&self) -> Option<LungEstimate> {
        self.lung
    }

    /// Whether the running breath, or the one that has just ended, is measured; none if it did not begin with a reading.
    pub fn is_measured(&self) -> Option<bool> {
        self.breath.as_ref().map(|breath| breath.read as f32 >= MEASURED * breath.ticks as f32)
    }

    /// Flow, L/s, and volume since the start of the breath, mL, at a sample; none in a breath that did not begin with a reading. The
    /// flow is NaN at a sample without one. PEEP in cmH2O.
    pub fn take(&mut self, sample: &Sample, peep: f32) -> Option<(f32, f32)> {
        if sample.tick == 0 {
            let start = sample.pressure.min(peep);
            self.breath =
                sample.flow.map(|_| Breath { start, fit: Some(LungFit::default()), ..Breath::default() });
        }
        let breath = self.breath.as_mut()?;
        breath.ticks += 1;
        if sample.phase != Phase::Inspiration
            && let Some(fit) = breath.fit.take()
            && breath.volume >= TELLING_VOLUME
        {
            self.lung = fit.solve().or(self.lung);
        }
        let Some(flow) = sample.flow else { return Some((f32::NAN, breath.volume)) };
        breath.read += 1;
        // Without a pressure nothing is known about the leak's flow.
        let leaked = self.leak.unwrap_or_default() * sample.pressure.max(0.0).sqrt();
        breath.add(flow - leaked, sample.pressure, self.period);
        Some((flow, breath.volume))
    }
}

impl Breath {
    /// Adds a tick of `period` seconds with a flow into the lung, L/s, at a pressure, cmH2O.
    fn add(&mut self, flow: f32, pressure: f32, period: f32) {
        self.volume += 1000.0 * flow * period;
        if let Some(fit) = self.fit.as_mut().filter(|_| pressure.is_finite()) {
            fit.add(self.volume, flow, pressure - self.start);
        }
    }
}
