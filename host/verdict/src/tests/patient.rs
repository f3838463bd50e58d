//! A ventilated patient with known events: a schedule of breaths and of muscle pressures on a lung with one R and one C.

use super::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, Normal};

/// Time of a simulation step, s.
const STEP_S: f64 = 2.5e-4;
/// Compliance of the circuit, L/cmH2O, and resistance of the expiratory valve, cmH2O/(L/s).
const CIRCUIT: f64 = 1.5e-3;
const OUTLET: f64 = 4.0;
/// Flow per cmH2O of error, and highest flow, of the inspiratory valve, L/s.
const GAIN: f64 = 0.5;
const MOST: f64 = 2.0;

/// Time constant with which muscles relax, s.
const RELAXES_S: f64 = 0.08;

/// Muscle pressure that rises as a quarter of a sine for some time, and then relaxes.
#[derive(Debug, Clone, Copy)]
pub struct Effort {
    pub at_s: f64,
    pub for_s: f64,
    /// cmH2O; positive draws gas in.
    pub peak: f64,
}

/// Lung, settings and sensors.
#[derive(Debug, Clone, Copy)]
pub struct Case {
    pub r: f64,
    /// mL/cmH2O.
    pub c: f64,
    pub peep: f64,
    pub drive: f64,
    pub inspiration_s: f64,
    /// Time from breath to breath, s.
    pub interval_s: f64,
    /// Flow in expirations, L/s, and leak at 30 cmH2O, L/s.
    pub bias: f64,
    pub leak: f64,
    /// Noise (sd) of pressure, cmH2O, and flow, L/s.
    pub noise: (f64, f64),
    pub period_us: u32,
    /// The heart's oscillation: frequency, Hz, and amplitudes of flow, L/s, and pressure, cmH2O.
    pub heart: [f64; 3],
}

impl Case {
    pub fn draw(random: &mut ChaCha8Rng) -> Self {
        let interval_s: f64 = 60.0 / random.random_range(10.0..25.0);
        Self {
            r: random.random_range(5.0..50.0),
            c: random.random_range(15.0..60.0),
            peep: random.random_range(3.0..12.0),
            drive: random.random_range(8.0..20.0),
            inspiration_s: (interval_s * random.random_range(0.25_f64..0.4)).min(1.2),
            interval_s,
            bias: random.random_range(0.0..0.15),
            leak: random.random_range(0.0..0.15),
            noise: (random.random_range(0.01..0.15), random.random_range(0.001..0.015)),
            period_us: [1_000, 5_000, 10_000, 20_000][random.random_range(0..4)],
            heart: [0.0; 3],
        }
    }

    /// A recording of breaths that begin at these times, s, up to the last one's end.
    pub fn record(&self, starts: &[f64], efforts: &[Effort], seed: u64) -> Recording {
        let mut random = ChaCha8Rng::seed_from_u64(seed);
        let [paw_noise, flow_noise] = [self.noise.0, self.noise.1].map(|sd| Normal::new(0.0, sd).unwrap());
        let mut recording = Recording::with_extras(
            Provenance::new(self.period_us, "patient"),
            &[Extra::FlowIn, Extra::FlowOut],
        );
        let mut lung = Lung { pressure: self.peep, volume: 0.0 };
        let ticks = |s: f64| (s * 1e6 / f64::from(self.period_us)).round() as u32;
        let end = ticks(starts[starts.len() - 1] + self.interval_s);
        let (mut breath, mut first) = (0, ticks(starts[0]));
        for tick in ticks(starts[0])..end {
            if starts.get(breath + 1).is_some_and(|next| ticks(*next) == tick) {
                (breath, first) = (breath + 1, tick);
            }
            let inspires = tick - first < ticks(self.inspiration_s);
            let phase = self.heart[0] * f64::from(tick) * f64::from(self.period_us) * 1e-6;
            let [_, flow_beat, paw_beat] =
                self.heart.map(|peak| peak * (std::f64::consts::TAU * phase).sin());
            let flow = self.advance(&mut lung, inspires, f64::from(tick), efforts)
                + flow_beat
                + flow_noise.sample(&mut random);
            let pip = (self.peep + self.drive) as f32;
            recording.push(Row {
                breath: breath as u32,
                tick: tick - first,
                phase: if inspires { INSPIRATION } else { EXPIRATION },
                target: if inspires { pip } else { self.peep as f32 },
                pressure: (lung.pressure + paw_beat + paw_noise.sample(&mut random)) as f32,
                pip,
                peep: self.peep as f32,
                flow_in: Some(flow.max(0.0) as f32),
                flow_out: Some((-flow).max(0.0) as f32),
                ..Row::default()
            });
        }
        recording
    }

    /// Runs one sample period; returns the flow into lung and leak, L/s.
    fn advance(&self, lung: &mut Lung, inspires: bool, tick: f64, efforts: &[Effort]) -> f64 {
        let period_s = f64::from(self.period_us) * 1e-6;
        let (steps, mut flow) = ((period_s / STEP_S).round() as u32, 0.0);
        for step in 0..steps {
            let muscles = muscles(efforts, tick * period_s + f64::from(step) * STEP_S);
            let into = (lung.pressure - self.peep - 1e3 * lung.volume / self.c + muscles) / self.r;
            let leak = self.leak * (lung.pressure.max(0.0) / 30.0).sqrt();
            let error = self.peep + self.drive - lung.pressure;
            let valve = if inspires { (GAIN * error + leak).clamp(0.0, MOST) } else { self.bias };
            let out = if inspires { 0.0 } else { (lung.pressure - self.peep).max(0.0) / OUTLET };
            lung.pressure += STEP_S / CIRCUIT * (valve - out - into - leak);
            lung.volume += STEP_S * into;
            flow += (into + leak) / f64::from(steps);
        }
        flow
    }
}

struct Lung {
    /// Airway pressure, cmH2O.
    pressure: f64,
    /// Gas above the volume at PEEP, L.
    volume: f64,
}

fn muscles(efforts: &[Effort], t: f64) -> f64 {
    let of = |effort: &Effort| match t - effort.at_s {
        t if t < 0.0 => 0.0,
        t if t < effort.for_s => effort.peak * (std::f64::consts::FRAC_PI_2 * t / effort.for_s).sin(),
        t => effort.peak * (-(t - effort.for_s) / RELAXES_S).exp(),
    };
    efforts.iter().map(of).sum()
}
