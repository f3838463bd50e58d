//! Recordings of a lung that is known exactly, with the flaws that recordings have: a late flow, a leak, few samples, sensors that drift,
//! and a patient who breathes against the ventilator.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use data::provenance::Provenance;
use data::recording::{EXPIRATION, Extra, INSPIRATION, Recording, Row};

/// Step of the simulation, s.
const STEP_S: f64 = 0.0005;
/// Time constant in which the ventilator lets the pressure fall, s.
const FALL_S: f64 = 0.05;
/// Length of a patient's effort, s.
const EFFORT_S: f64 = 0.7;

/// A lung, its ventilation, and the flaws of the recording.
#[derive(Clone, Copy, Debug)]
pub(super) struct Simulated {
    /// R, cmH2O/(L/s), and R2.
    pub(super) resistance: f64,
    pub(super) turbulence: f64,
    /// Compliance, mL/cmH2O.
    pub(super) compliance: f64,
    pub(super) peep: f64,
    pub(super) drive: f64,
    /// Time constant of the pressure's rise, s.
    pub(super) rise_s: f64,
    pub(super) inspiration_s: f64,
    pub(super) breath_s: f64,
    pub(super) breaths: u32,
    /// Sample period, s.
    pub(super) period_s: f64,
    /// Standard deviations of the noise of pressure (cmH2O) and flow (L/s).
    pub(super) noise: [f64; 2],
    /// Delay of the flow's column, s.
    pub(super) late_s: f64,
    /// Leak between flow sensor and lung, mL/s per cmH2O.
    pub(super) leak: f64,
    /// Offset of the flow, L/s, at the beginning and at the end.
    pub(super) offset: [f64; 2],
    /// Share of the breaths with an effort of the patient, and its peak, cmH2O.
    pub(super) efforts: (f64, f64),
    pub(super) seed: u64,
}

/// A recording without flaws, of a lung and a ventilation drawn from the seed.
pub(super) fn sound(seed: u64) -> Simulated {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut between = |low: f64, high: f64| rng.random_range(low..high);
    let log = |low: f64, high: f64, share: f64| low * (high / low).powf(share);
    let (resistance, compliance) = (log(5.0, 40.0, between(0.0, 1.0)), log(10.0, 60.0, between(0.0, 1.0)));
    let inspiration_s = between(0.7, 1.5);
    let breath_s: f64 =
        inspiration_s + (4.0 * resistance * compliance / 1000.0).clamp(between(1.2, 2.5), 4.0);
    Simulated {
        resistance,
        turbulence: between(0.0, 6.0),
        compliance,
        peep: between(0.0, 12.0),
        drive: between(8.0, 25.0),
        rise_s: between(0.02, 0.12),
        inspiration_s,
        breath_s: (breath_s / STEP_S).round() * STEP_S,
        breaths: between(6.0, 24.0) as u32,
        period_s: 0.01,
        noise: [between(0.03, 0.2), between(0.002, 0.01)],
        late_s: 0.0,
        leak: 0.0,
        offset: [0.0; 2],
        efforts: (0.0, 0.0),
        seed,
    }
}

/// The same with each flaw in about half of the draws.
pub(super) fn flawed(seed: u64) -> Simulated {
    let mut rng = ChaCha8Rng::seed_from_u64(seed ^ 0x5eed);
    let mut half = |low: f64, high: f64| {
        let drawn = rng.random_range(low..high);
        if rng.random_bool(0.5) { drawn } else { 0.0 }
    };
    let (late_s, leak) = (half(0.005, 0.06), half(0.5, 5.0));
    let offset = [half(-0.03, 0.03), half(-0.03, 0.03)];
    let efforts = (half(0.05, 0.3), half(2.0, 10.0));
    let coarse = half(0.0, 1.0) > 0.0;
    let period_s = if coarse { 0.04 } else { [0.005, 0.01, 0.02][rng.random_range(0..3)] };
    Simulated { period_s, late_s, leak, offset, efforts, ..sound(seed) }
}

impl Simulated {
    /// Pressure at the airway at this time of a breath, cmH2O.
    fn airway(&self, time_s: f64) -> f64 {
        let risen = |time: f64| self.drive * (1.0 - (-time / self.rise_s).exp());
        if time_s < self.inspiration_s {
            return self.peep + risen(time_s);
        }
        self.peep + risen(self.inspiration_s) * (-(time_s - self.inspiration_s) / FALL_S).exp()
    }

    /// Flow into the lung at this pressure beyond its elastic recoil, L/s.
    fn flow(&self, driving: f64) -> f64 {
        let (linear, square) = (self.resistance, self.turbulence);
        let size = driving.abs();
        driving.signum() * 2.0 * size / (linear + (linear * linear + 4.0 * square * size).sqrt())
    }

    /// Net flow at the sensor at every step, L/s.
    fn flows(&self, rng: &mut ChaCha8Rng) -> Vec<f64> {
        let steps = (self.breath_s / STEP_S).round() as u32;
        let mut volume_ml = self.peep * self.compliance;
        let mut flows = Vec::new();
        for _ in 0..self.breaths {
            let effort = if rng.random_bool(self.efforts.0) { self.efforts.1 } else { 0.0 };
            let from_s = rng.random_range(0.0..self.breath_s - EFFORT_S);
            for step in 0..steps {
                let time_s = f64::from(step) * STEP_S;
                let phase = ((time_s - from_s) / EFFORT_S).clamp(0.0, 1.0);
                let muscle = effort * (std::f64::consts::PI * phase).sin();
                let airway = self.airway(time_s);
                let flow = self.flow(airway + muscle - volume_ml / self.compliance);
                volume_ml += 1000.0 * flow * STEP_S;
                flows.push(flow + self.leak / 1000.0 * airway);
            }
        }
        flows
    }

    /// The recording: samples at the period, whose phase against the breaths differs from breath to breath.
    pub(super) fn record(&self) -> Recording {
        let mut rng = ChaCha8Rng::seed_from_u64(self.seed);
        let flows = self.flows(&mut rng);
        let total_s = flows.len() as f64 * STEP_S;
        let mut recording = Recording::with_extras(
            Provenance::new((1e6 * self.period_s) as u32, "simulated"),
            &[Extra::FlowIn, Extra::FlowOut],
        );
        let (mut breath_before, mut tick) = (u32::MAX, 0);
        for row in 0.. {
            let time_s = (f64::from(row) + 0.37) * self.period_s;
            if time_s >= total_s {
                break;
            }
            let breath = (time_s / self.breath_s) as u32;
            tick = if breath == breath_before { tick + 1 } else { 0 };
            breath_before = breath;
            let in_breath = time_s - f64::from(breath) * self.breath_s;
            let mut noise = || -> f64 { StandardNormal.sample(&mut rng) };
            let seen = (((time_s - self.late_s) / STEP_S).max(0.0).round() as usize).min(flows.len() - 1);
            let offset = self.offset[0] + (self.offset[1] - self.offset[0]) * time_s / total_s;
            recording.push(Row {
                breath,
                tick,
                phase: if in_breath < self.inspiration_s { INSPIRATION } else { EXPIRATION },
                pressure: (self.airway(in_breath) + self.noise[0] * noise()) as f32,
                flow_in: Some((flows[seen] + offset + self.noise[1] * noise()) as f32),
                flow_out: Some(0.0),
                ..Row::default()
            });
        }
        recording
    }
}
