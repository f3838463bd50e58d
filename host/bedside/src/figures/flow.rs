//! Flow and volume without a flow sensor, as the device's own safety monitors estimate them.
//!
//! In the inspiration the flow is that of the nominal inspiratory valve at its commands ([`LungEstimator`]), which includes what a
//! leak and the tubes take. In the expiration it is what the estimated lung gives out at the measured pressure; before there is
//! an estimate, it is unknown.

use shared::breath::{Phase, period_s};
use shared::safety::lung_estimator::{LungEstimate, LungEstimator, LungState};
use shared::ventilator::Sample;

/// Lowest resistance against which a lung expires, cmH2O/(L/s): the tubes have as much.
const RESISTANCE_MIN: f32 = 2.0;

/// Estimates flow and volume tick by tick.
#[derive(Debug)]
pub struct FlowModel {
    estimator: LungEstimator,
    state: LungState,
    period: f32,
    /// Pressure at the start of the breath, cmH2O, and gas in the lung since then, mL; none if the start was not seen.
    breath: Option<(f32, f32)>,
    phase: Phase,
    triggered: bool,
}

impl FlowModel {
    /// A model for a control period, microseconds.
    pub fn new(period_us: u32) -> Self {
        Self {
            estimator: LungEstimator::new(period_us),
            state: LungState::default(),
            period: period_s(period_us),
            breath: None,
            phase: Phase::Expiration,
            triggered: false,
        }
    }

    /// Samples are missing: the volume is unknown until the next breath.
    pub fn interrupted(&mut self) {
        self.breath = None;
    }

    /// The lung as estimated last.
    pub fn lung(&self) -> Option<LungEstimate> {
        self.state.last_estimate()
    }

    /// Flow, L/s, and volume since the start of the breath, mL, at a sample; NaN while unknown. PEEP in cmH2O; `triggered` if an
    /// effort has started the breath.
    pub fn take(&mut self, sample: &Sample, peep: f32, triggered: bool) -> (f32, f32) {
        if sample.tick == 0 {
            self.state.start_inspiration(sample.pressure, peep);
            self.breath = Some((sample.pressure.min(peep), 0.0));
            self.triggered = triggered;
        }
        if self.phase == Phase::Inspiration && sample.phase != Phase::Inspiration && self.breath.is_some() {
            self.estimator.end_inspiration(&mut self.state, self.triggered);
        }
        self.phase = sample.phase;
        let found = match sample.phase {
            Phase::Inspiration => self.inspire(sample.pressure),
            Phase::Fall | Phase::Expiration => self.expire(sample.pressure),
        };
        self.estimator.applied(&mut self.state, sample.u_in);
        found
    }

    fn inspire(&mut self, pressure: f32) -> (f32, f32) {
        let Some((_, volume)) = &mut self.breath else { return (f32::NAN, f32::NAN) };
        if pressure.is_finite() {
            // Its finding is the device's business.
            let _ = self.estimator.check(&mut self.state, pressure, false);
        } else {
            self.estimator.deliver(&mut self.state, None);
        }
        *volume = self.state.volume();
        (self.state.flow(), *volume)
    }

    fn expire(&mut self, pressure: f32) -> (f32, f32) {
        let (Some((start, volume)), Some(lung)) = (&mut self.breath, self.state.last_estimate()) else {
            return (f32::NAN, f32::NAN);
        };
        // With a resistance below that of a single tick the volume would swing.
        let lowest = RESISTANCE_MIN.max(1000.0 * lung.elastance * self.period);
        let flow = (pressure - *start - lung.elastance * *volume) / lung.resistance.max(lowest);
        if flow.is_finite() {
            *volume += 1000.0 * flow * self.period;
        }
        (flow, *volume)
    }
}
