//! Telemetry: the samples of all ticks in batches, with counters of losses, and a summary of each breath.
//!
//! A batch contains samples of consecutive control ticks. Its sequence number shows how many batches were lost on the
//! line, its counters what was lost before: dropped samples, corrupt frames from the host, missed ticks.

use heapless::Vec;
use serde::{Deserialize, Serialize};

use crate::breath::Phase;
use crate::control::memory::Lesson;
use crate::ventilator::Sample;

/// Most samples in a batch.
pub const BATCH_SAMPLES: usize = 16;

/// A [`Sample`] in the link's encoding, lossless to the last bit: about 20 bytes, and 4 more for each of a perturbation, a learned
/// part and a flow.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct PackedSample {
    breath: u32,
    tick: u32,
    phase: Phase,
    u_out: bool,
    target: f32,
    pressure: f32,
    u_in: f32,
    /// None for exactly +0.0, the most common value.
    explore: Option<f32>,
    /// The same.
    learned: Option<f32>,
    flow: Option<f32>,
}

impl PackedSample {
    /// Packs a sample.
    pub fn pack(sample: &Sample) -> Self {
        let Sample { breath, tick, phase, target, pressure, u_in, u_out, explore, learned, flow } = *sample;
        let [explore, learned] = [explore, learned].map(|part| (part.to_bits() != 0).then_some(part));
        Self { breath, tick, phase, u_out, target, pressure, u_in, explore, learned, flow }
    }

    /// Unpacks the sample.
    pub fn unpack(&self) -> Sample {
        let Self { breath, tick, phase, u_out, target, pressure, u_in, explore, learned, flow } = *self;
        let [explore, learned] = [explore, learned].map(|part| part.unwrap_or(0.0));
        Sample { breath, tick, phase, target, pressure, u_in, u_out, explore, learned, flow }
    }
}

/// Losses since the start, and the duration of control ticks.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Counters {
    /// Reports that did not fit into the device's queue.
    pub dropped: u32,
    /// Corrupt frames from the host, and bytes lost in the device's receiver.
    pub corrupt_frames: u32,
    /// Control ticks that did not run.
    pub missed_ticks: u32,
    /// Longest control tick, microseconds.
    pub worst_tick_us: u32,
    /// Mean control tick, microseconds.
    pub mean_tick_us: f32,
}

/// A batch: samples of consecutive ticks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct TelemetryBatch {
    /// Number of the batch, wrapping.
    pub sequence: u32,
    /// Control tick of the first sample, since the device started.
    pub first_tick: u64,
    /// Counters when the batch was closed.
    pub counters: Counters,
    /// The samples.
    pub samples: Vec<PackedSample, BATCH_SAMPLES>,
}

/// Collects samples into batches (device).
#[derive(Clone, Debug, Default)]
pub struct Batcher {
    sequence: u32,
    first_tick: u64,
    samples: Vec<PackedSample, BATCH_SAMPLES>,
}

impl Batcher {
    /// Adds a tick's sample; returns a batch when it is full, or when the new sample does not follow the last one.
    pub fn push(&mut self, tick: u64, sample: &Sample, counters: &Counters) -> Option<TelemetryBatch> {
        let follows = self.first_tick.wrapping_add(self.samples.len() as u64) == tick;
        let closed = if follows { None } else { self.flush(counters) };
        if self.samples.is_empty() {
            self.first_tick = tick;
        }
        debug_assert!(self.first_tick.wrapping_add(self.samples.len() as u64) == tick, "ticks in a row");
        debug_assert!(!self.samples.is_full());
        // There is room: a batch is closed as soon as it is full.
        let _ = self.samples.push(PackedSample::pack(sample));
        if self.samples.is_full() {
            return self.flush(counters);
        }
        closed
    }

    /// Closes the batch, for instance when ventilation stops; none if it is empty.
    pub fn flush(&mut self, counters: &Counters) -> Option<TelemetryBatch> {
        if self.samples.is_empty() {
            return None;
        }
        let sequence = self.sequence;
        self.sequence = sequence.wrapping_add(1);
        Some(TelemetryBatch {
            sequence,
            first_tick: self.first_tick,
            counters: *counters,
            samples: core::mem::take(&mut self.samples),
        })
    }
}

/// Counts batches lost on the line (host).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LossCounter {
    next: Option<u32>,
    lost: u64,
}

impl LossCounter {
    /// Takes a batch's sequence number; returns the number of missing batches before it.
    pub fn arrived(&mut self, sequence: u32) -> u32 {
        let missing = self.next.map_or(0, |next| sequence.wrapping_sub(next));
        self.next = Some(sequence.wrapping_add(1));
        self.lost += u64::from(missing);
        missing
    }

    /// Keeps the count but accepts any next sequence number.
    #[must_use]
    pub fn restarted(self) -> Self {
        Self { next: None, ..self }
    }

    /// Batches lost so far.
    pub fn lost(&self) -> u64 {
        self.lost
    }
}

/// Summary of a breath.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct BreathSummary {
    /// Number of the breath.
    pub breath: u32,
    /// Mean absolute pressure error over the inspiration, the score, cmH2O.
    pub mean_absolute_error: f32,
    /// Highest pressure, cmH2O.
    pub peak_pressure: f32,
    /// Last pressure of the breath, cmH2O.
    pub end_pressure: f32,
    /// Leak of the circuit as known when the breath ended, L/s at 1 cmH2O: that of the breaths before it. None before it is
    /// measured, and without a flow sensor.
    pub leak: Option<f32>,
    /// What the controller made of the breath; [`Lesson::Forget`] too if it forgets because the next breath has other settings.
    pub lesson: Lesson,
    /// Breaths that the learned controller then remembers, at most [`crate::control::memory::LEARNING`]; 0 for a PID.
    pub adopted: u8,
}

/// What the ventilator has found out by the end of a breath, beyond its samples; the fields are those of [`BreathSummary`].
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Findings {
    /// Leak of the circuit, L/s at 1 cmH2O.
    pub leak: Option<f32>,
    /// What the controller made of the breath.
    pub lesson: Lesson,
    /// Breaths that the learned controller remembers.
    pub adopted: u8,
}

/// Computes breath summaries from samples.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct BreathMeter {
    breath: u32,
    inspiration: u32,
    expired: bool,
    error_sum: f32,
    peak: f32,
    last: f32,
}

impl BreathMeter {
    /// Adds a sample; at the first one of a breath returns the summary of the previous breath with these findings, unless that
    /// was stopped during its inspiration.
    pub fn take(&mut self, sample: &Sample, findings: impl FnOnce() -> Findings) -> Option<BreathSummary> {
        let summary = if sample.tick == 0 { self.restart(sample, findings) } else { None };
        if sample.phase == Phase::Inspiration {
            self.inspiration += 1;
            self.error_sum += (sample.pressure - sample.target).abs();
        } else {
            self.expired = true;
        }
        if sample.pressure > self.peak {
            self.peak = sample.pressure;
        }
        self.last = sample.pressure;
        summary
    }

    fn restart(&mut self, sample: &Sample, findings: impl FnOnce() -> Findings) -> Option<BreathSummary> {
        let ended = core::mem::replace(
            self,
            Self { breath: sample.breath, peak: f32::NEG_INFINITY, ..Self::default() },
        );
        (ended.expired && ended.inspiration > 0).then(|| {
            let Findings { leak, lesson, adopted } = findings();
            BreathSummary {
                breath: ended.breath,
                mean_absolute_error: ended.error_sum / ended.inspiration as f32,
                peak_pressure: ended.peak,
                end_pressure: ended.last,
                leak,
                lesson,
                adopted,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn sample(breath: u32, tick: u32, phase: Phase, pressure: f32) -> Sample {
        Sample {
            breath,
            tick,
            phase,
            target: 20.0,
            pressure,
            u_in: 30.0,
            u_out: phase != Phase::Inspiration,
            explore: 0.0,
            learned: 0.0,
            flow: None,
        }
    }

    fn quiet(tick: u32) -> Sample {
        sample(3, tick, Phase::Inspiration, 12.5)
    }

    #[test]
    fn a_usual_sample_takes_twenty_bytes_and_four_more_for_each_further_value() {
        let bytes =
            |sample: &Sample| postcard::to_slice(&PackedSample::pack(sample), &mut [0; 64]).unwrap().len();
        let quiet = quiet(700);
        assert_eq!(bytes(&quiet), 20);
        let with_flow = Sample { flow: Some(0.5), ..quiet };
        let learned = Sample { learned: 1.5, ..with_flow };
        let exploring = Sample { explore: 8.0, ..learned };
        assert_eq!([with_flow, learned, exploring].map(|sample| bytes(&sample)), [24, 28, 32]);
    }

    #[test]
    fn a_batch_is_closed_when_full_when_ticks_are_missing_and_on_demand() {
        let (mut batcher, counters) = (Batcher::default(), Counters::default());
        let push = |batcher: &mut Batcher, tick: u64| batcher.push(tick, &quiet(tick as u32), &counters);
        for tick in 100..115 {
            assert_eq!(push(&mut batcher, tick), None);
        }
        let full = push(&mut batcher, 115).unwrap();
        assert_eq!((full.sequence, full.first_tick, full.samples.len()), (0, 100, BATCH_SAMPLES));
        assert_eq!(push(&mut batcher, 116), None);
        let cut = push(&mut batcher, 200).unwrap();
        assert_eq!((cut.sequence, cut.first_tick, cut.samples.len()), (1, 116, 1));
        let rest = batcher.flush(&counters).unwrap();
        assert_eq!((rest.sequence, rest.first_tick, rest.samples.len()), (2, 200, 1));
        assert_eq!(batcher.flush(&counters), None);
    }

    #[test]
    fn missing_batches_are_counted_across_the_wrap() {
        let mut loss = LossCounter::default();
        let missing = [u32::MAX - 1, u32::MAX, 2, 3].map(|sequence| loss.arrived(sequence));
        assert_eq!((missing, loss.lost()), ([0, 0, 2, 0], 2));
        let mut restarted = loss.restarted();
        assert_eq!((restarted.arrived(70), restarted.lost()), (0, 2), "whatever comes first follows");
    }

    #[test]
    fn a_summary_holds_score_peak_and_end() {
        let mut meter = BreathMeter::default();
        let none = Findings::default;
        let breath = |number| {
            [
                sample(number, 0, Phase::Inspiration, 16.0),
                sample(number, 1, Phase::Inspiration, 22.0),
                sample(number, 2, Phase::Fall, 15.0),
                sample(number, 3, Phase::Expiration, 5.5),
            ]
        };
        assert!(breath(0).iter().all(|s| meter.take(s, || unreachable!("no breath has ended")).is_none()));
        let (leak, lesson, adopted) = (Some(0.02), Lesson::Discard, 3);
        let (mean_absolute_error, peak_pressure, end_pressure) = (3.0, 22.0, 5.5);
        let expected = BreathSummary {
            breath: 0,
            mean_absolute_error,
            peak_pressure,
            end_pressure,
            leak,
            lesson,
            adopted,
        };
        assert_eq!(meter.take(&breath(1)[0], || Findings { leak, lesson, adopted }), Some(expected));
        let mut below_zero = BreathMeter::default();
        for s in breath(7) {
            below_zero.take(&Sample { pressure: s.pressure - 30.0, ..s }, none);
        }
        let summary = below_zero.take(&breath(8)[0], none).unwrap();
        assert_eq!((summary.breath, summary.peak_pressure as i32), (7, -8));
        assert_eq!(meter.take(&breath(0)[0], none), None, "broken off and restarted");
        let mut late = BreathMeter::default();
        assert_eq!(late.take(&breath(0)[3], none), None);
        assert_eq!(late.take(&breath(1)[0], none), None, "no inspiration was seen");
    }

    proptest! {
        #[test]
        fn packing_loses_no_bit(
            breath: u32, tick: u32, u_out: bool, bits: [u32; 5], flow: Option<u32>,
            phase in prop_oneof![Just(Phase::Inspiration), Just(Phase::Fall), Just(Phase::Expiration)],
        ) {
            let [target, pressure, u_in, explore, learned] = bits.map(f32::from_bits);
            let flow = flow.map(f32::from_bits);
            let sample = Sample { breath, tick, phase, target, pressure, u_in, u_out, explore, learned, flow };
            let mut buffer = [0; 64];
            let bytes = postcard::to_slice(&PackedSample::pack(&sample), &mut buffer).unwrap();
            let back = postcard::from_bytes::<PackedSample>(bytes).unwrap().unpack();
            let values = [back.target, back.pressure, back.u_in, back.explore, back.learned];
            prop_assert_eq!(values.map(f32::to_bits), bits);
            prop_assert_eq!(back.flow.map(f32::to_bits), flow.map(f32::to_bits));
            prop_assert_eq!((back.breath, back.tick, back.phase, back.u_out), (breath, tick, phase, u_out));
        }
    }
}
