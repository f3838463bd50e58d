//! What the bench knows of the flow sensor in a breath.

/// Error of a sound sensor: three standard deviations of the units' gains.
const SOUND: f64 = 0.1;
/// Variance of the flow from which a breath shows the gain, (L/s)^2.
const MOVES: f64 = 1e-6;

/// Truth about the flow sensor in a breath: its readings against the flow.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FlowTruth {
    count: f64,
    flow: f64,
    reading: f64,
    flow_flow: f64,
    flow_reading: f64,
    /// Gas that went in and out, mL.
    moved: f64,
}

impl FlowTruth {
    /// Adds the reading and the flow of a tick of 1 ms, L/s.
    pub(super) fn add(&mut self, reading: f32, flow: f64) {
        let reading = f64::from(reading);
        if reading.is_nan() {
            return;
        }
        self.count += 1.0;
        self.flow += flow;
        self.reading += reading;
        self.flow_flow += flow * flow;
        self.flow_reading += flow * reading;
        self.moved += flow.abs();
    }

    /// Slope of the readings over the flow: 1 for a right sensor.
    fn gain(&self) -> f64 {
        let count = self.count.max(1.0);
        let variance = self.flow_flow / count - (self.flow / count).powi(2);
        let covariance = self.flow_reading / count - self.flow * self.reading / count.powi(2);
        if variance > MOVES { covariance / variance } else { 1.0 }
    }

    /// Gas that the sensor shows without any flow, mL; negative outwards.
    fn imagined(&self) -> f64 {
        self.reading - self.gain() * self.flow
    }

    /// Share of the inspired gas that a wrong zero makes vanish or appear, beyond the error of a sound sensor.
    pub fn lost_share(&self) -> f64 {
        let share = self.imagined().abs() / (0.5 * self.moved).max(1.0);
        if share > SOUND { share } else { 0.0 }
    }

    /// The least and the most that a volume may look like, mL: itself with a sound sensor, whose error is the judge's tolerance.
    pub fn shown(&self, volume: f64) -> (f64, f64) {
        let (gain, lost) = (self.gain(), self.lost_share());
        let gain = if (gain - 1.0).abs() > SOUND { gain } else { 1.0 };
        (volume * (gain.min(1.0) - lost), volume * (gain.max(1.0) + lost))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Half a litre in and out, seen by a sensor.
    fn breath(reads: impl Fn(f64) -> f64) -> FlowTruth {
        let mut flow = FlowTruth::default();
        for ms in 0..2000 {
            let now = if ms < 1000 { 0.5 } else { -0.5 };
            flow.add(reads(now) as f32, now);
        }
        flow
    }

    #[test]
    fn a_sound_sensor_shows_the_volume() {
        for reads in [|flow: f64| flow, |flow: f64| 1.08 * flow, |flow: f64| flow + 0.01] {
            let sound = breath(reads);
            assert_eq!((sound.shown(500.0), sound.lost_share()), ((500.0, 500.0), 0.0));
        }
    }

    #[test]
    fn a_wrong_sensor_shows_another_volume_and_another_loss() {
        let (least, most) = breath(|flow| 0.7 * flow).shown(500.0);
        assert!((least - 350.0).abs() < 1.0 && (most - 500.0).abs() < 1.0, "{least} {most}");
        let (least, most) = breath(|flow| 1.4 * flow).shown(500.0);
        assert!((least - 500.0).abs() < 1.0 && (most - 700.0).abs() < 1.0, "{least} {most}");
        let shifted = breath(|flow| flow + 0.05);
        assert!((shifted.lost_share() - 0.2).abs() < 1e-3, "0.1 of 0.5 L");
        assert!((shifted.shown(500.0).0 - 400.0).abs() < 1.0);
    }
}
