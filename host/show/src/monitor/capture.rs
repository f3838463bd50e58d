//! A device's news as an MCAP file, for Foxglove and `PlotJuggler`, while the monitor watches.
//!
//! Like a view, a capture reads no clock: it takes each piece of news with the time at which it came. Samples
//! and alarms get the time of their control tick, so that the line's delays do not show.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use data::export::ExportError;
use data::export::mcap::{
    BreathPosition, Counts, Field, Flow, McapWriter, Message, Pressure, Valves, is_missing, is_unknown,
};
use data::provenance::git_revision;
use data::recording::phase_number;
use serde::Serialize;
use serde_json::json;
use shared::link::messages::{DeviceIdentity, Event, Response};
use shared::link::telemetry::{BreathSummary, TelemetryBatch};
use shared::safety::alarms::Fault;
use shared::settings::Settings;
use shared::ventilator::opening;
use shared::weights::ImageId;

use super::News;
use super::words;
use device::LineCounters;

/// Longest time for which news are only in memory, ns: as much is lost if the program is killed.
const FLUSH_EVERY_NS: u64 = 1_000_000_000;

/// Figures of a breath that has ended.
#[derive(Debug, Serialize)]
struct Breath {
    number: u32,
    #[serde(skip_serializing_if = "is_unknown")]
    mean_error: f32,
    #[serde(skip_serializing_if = "is_unknown")]
    peak: f32,
    #[serde(skip_serializing_if = "is_unknown")]
    end: f32,
    #[serde(skip_serializing_if = "is_missing")]
    leak: Option<f32>,
    lesson: &'static str,
    adopted: u8,
}

impl Message for Breath {
    const TOPIC: &'static str = "/breaths";
    const SCHEMA: &'static str = "eupnea.BreathSummary";
    const FIELDS: &'static [Field] = &[
        ("number", "integer", "number of the breath"),
        ("mean_error", "number", "mean of abs(pressure - target) over the inspiration, cmH2O"),
        ("peak", "number", "highest pressure, cmH2O"),
        ("end", "number", "last pressure of the breath, cmH2O"),
        ("leak", "number", "leak of the circuit that the breaths before have shown, L/s at 1 cmH2O"),
        ("lesson", "string", "what the controller made of the breath: adopt, discard or forget"),
        ("adopted", "integer", "breaths that the learned controller then remembers, at most 4"),
    ];
}

/// An alarm that a monitor of the device has raised.
#[derive(Debug, Serialize)]
struct Alarm {
    id: &'static str,
    priority: &'static str,
    text: &'static str,
    tick: u64,
}

impl Message for Alarm {
    const TOPIC: &'static str = "/alarms";
    const SCHEMA: &'static str = "eupnea.Alarm";
    const FIELDS: &'static [Field] = &[
        ("id", "string", "stable name of the alarm"),
        ("priority", "string", "high, medium or low"),
        ("text", "string", "the alarm in words"),
        ("tick", "integer", "control tick at which it began, since the device started"),
    ];
}

/// A moment that a user has marked.
#[derive(Debug, Serialize)]
struct Marker<'a> {
    text: &'a str,
}

impl Message for Marker<'_> {
    const TOPIC: &'static str = "/markers";
    const SCHEMA: &'static str = "eupnea.Marker";
    const FIELDS: &'static [Field] = &[("text", "string", "what the user has written")];
}

/// State of the device, once a second and when the connection is lost.
#[derive(Debug, Default, Serialize)]
struct Status {
    connected: bool,
    mode: String,
    controller: String,
    in_command: &'static str,
    indicated_alarms: String,
    steered_by: String,
    #[serde(skip_serializing_if = "is_unknown")]
    pip: f32,
    #[serde(skip_serializing_if = "is_unknown")]
    peep: f32,
    #[serde(skip_serializing_if = "is_unknown")]
    rate: f32,
    damaged_frames: u64,
    lost_batches: u64,
    dropped_samples: u32,
    missed_ticks: u32,
    worst_tick_us: u32,
    #[serde(skip_serializing_if = "is_unknown")]
    mean_tick_us: f32,
}

impl Message for Status {
    const TOPIC: &'static str = "/device";
    const SCHEMA: &'static str = "eupnea.Device";
    const FIELDS: &'static [Field] = &[
        ("connected", "boolean", "whether the device answers"),
        ("mode", "string", "mode of the ventilator"),
        ("controller", "string", "the running controller"),
        ("in_command", "string", "level of the ladder that commands the inspiratory valve"),
        ("indicated_alarms", "string", "names of the indicated alarms, the most urgent first"),
        ("steered_by", "string", "the program that holds the lease"),
        ("pip", "number", "PIP in force, cmH2O"),
        ("peep", "number", "PEEP in force, cmH2O"),
        ("rate", "number", "set rate in force, breaths per minute"),
        ("damaged_frames", "integer", "damaged frames to the host"),
        ("lost_batches", "integer", "batches of samples lost on the line"),
        ("dropped_samples", "integer", "reports dropped by the device"),
        ("missed_ticks", "integer", "control ticks that did not run"),
        ("worst_tick_us", "integer", "longest control tick, us"),
        ("mean_tick_us", "number", "mean control tick, us"),
    ];
}

/// An alarm that is in the file.
#[derive(Clone, Copy, Debug)]
struct Written {
    /// Control tick at which it began.
    tick: u64,
    /// Number of batches that had come before it.
    batches: u64,
}

/// A file that is being written.
#[expect(missing_debug_implementations, reason = "the library's writer has none")]
pub struct Capture {
    writer: McapWriter<BufWriter<File>>,
    /// The first failure, after which nothing is written.
    failed: Option<ExportError>,
    clock: Clock,
    flushed_ns: u64,
    status: Status,
    /// The last alarm of each kind since the device started.
    alarms: BTreeMap<Fault, Written>,
    /// Number of batches so far.
    batches: u64,
}

impl Capture {
    /// Starts a new file for this device, at this time in ns since 1970.
    ///
    /// # Errors
    /// A file of that name exists, or it cannot be written.
    pub fn create(
        path: &Path,
        port: &str,
        identity: &DeviceIdentity,
        now_ns: u64,
    ) -> Result<Self, ExportError> {
        let mut writer = McapWriter::capture(path)?;
        writer.origin(&json!({
            "source": "monitor",
            "port": port,
            "device": words::identity(identity),
            "period_us": identity.period_us,
            "weights_id": identity.running_id().map_or_else(String::new, |id| ImageId(id).to_string()),
            "git_revision": git_revision(),
            "started_ns": now_ns,
        }))?;
        writer.flush()?;
        Ok(Self {
            writer,
            failed: None,
            clock: Clock { period_ns: 1000 * u64::from(identity.period_us), ..Clock::default() },
            flushed_ns: now_ns,
            status: Status::default(),
            alarms: BTreeMap::new(),
            batches: 0,
        })
    }

    /// Writes a piece of news that came at this time, ns since 1970. The first failure ends the capture; the
    /// return value is true then, once.
    pub fn take(&mut self, news: &News, now_ns: u64) -> bool {
        if self.failed.is_some() {
            return false;
        }
        let written = self.write(news, now_ns, self.clock.now(now_ns)).and_then(|()| {
            if now_ns.saturating_sub(self.flushed_ns) < FLUSH_EVERY_NS {
                return Ok(());
            }
            self.flushed_ns = now_ns;
            self.writer.flush()
        });
        self.failed = written.err();
        self.failed.is_some()
    }

    /// Writes a user's marker at this time, ns since 1970. The first failure ends the capture; the return value is true then,
    /// once.
    pub fn mark(&mut self, text: &str, now_ns: u64) -> bool {
        if self.failed.is_some() {
            return false;
        }
        self.failed = self.writer.write(self.clock.now(now_ns), &Marker { text }).err();
        self.failed.is_some()
    }

    /// Finishes the file; returns the number of messages of each topic.
    ///
    /// # Errors
    /// The first failure of the capture: the file ends there.
    pub fn finish(self) -> Result<Counts, ExportError> {
        match self.failed {
            Some(error) => Err(error),
            None => Ok(self.writer.finish()?.1),
        }
    }

    /// Writes a piece of news; `time_ns` is the time of the device.
    fn write(&mut self, news: &News, now_ns: u64, time_ns: u64) -> Result<(), ExportError> {
        match news {
            News::Event(Event::Telemetry(batch)) => self.samples(batch, now_ns),
            News::Event(Event::Breath(breath)) => {
                let BreathSummary { mean_absolute_error, peak_pressure, end_pressure, .. } = *breath;
                let message = Breath {
                    number: breath.breath,
                    mean_error: mean_absolute_error,
                    peak: peak_pressure,
                    end: end_pressure,
                    leak: breath.leak,
                    lesson: words::lesson(breath.lesson),
                    adopted: breath.adopted,
                };
                self.writer.write(time_ns, &message)
            }
            News::Event(Event::Alarm { fault, tick }) => self.alarm(*fault, *tick, time_ns),
            // The device repeats an alarm until it is acknowledged: it is written if its first report was missed.
            News::Event(Event::Unacknowledged { fault, tick }) => match self.alarms.get(fault) {
                Some(written) if written.tick == *tick => Ok(()),
                _ => self.alarm(*fault, *tick, time_ns),
            },
            News::Answer { result: Ok(response), .. } => {
                self.learn(response);
                Ok(())
            }
            News::Answer { .. } => Ok(()),
            // The last piece of news of a poll.
            News::Traffic(traffic) => {
                self.count(traffic);
                self.writer.write(time_ns, &self.status)
            }
            News::Lost(_) => {
                self.clock.lost();
                self.status.connected = false;
                self.writer.write(time_ns, &self.status)?;
                self.writer.flush()
            }
        }
    }

    fn samples(&mut self, batch: &TelemetryBatch, now_ns: u64) -> Result<(), ExportError> {
        if self.clock.arrived(batch, now_ns) {
            // Ticks count from zero again, so an equal tick is another alarm. Alarms since the last batch can be those of the new start.
            let ticks = batch.first_tick.saturating_add(batch.samples.len() as u64);
            self.alarms.retain(|_, alarm| alarm.batches == self.batches && alarm.tick < ticks);
        }
        self.batches += 1;
        for (tick, packed) in (batch.first_tick..).zip(&batch.samples) {
            let (time, sample) = (self.clock.time(tick).unwrap_or(now_ns), packed.unpack());
            let (measured, target) = (sample.pressure, sample.target);
            self.writer.write(time, &Pressure { measured, target, truth: None })?;
            let u_out = opening(sample.u_out);
            let (u_in, explore, learned) = (sample.u_in, sample.explore, Some(sample.learned));
            self.writer.write(time, &Valves { u_in, u_out, explore, learned })?;
            if sample.flow.is_some() {
                self.writer.write(time, &Flow { inward: None, outward: None, patient: sample.flow })?;
            }
            self.writer
                .write(time, &BreathPosition::new(sample.breath, phase_number(sample.phase), sample.tick))?;
        }
        Ok(())
    }

    fn alarm(&mut self, fault: Fault, tick: u64, time_ns: u64) -> Result<(), ExportError> {
        self.alarms.insert(fault, Written { tick, batches: self.batches });
        let (id, priority) = (fault.alarm().id, fault.alarm().priority.name());
        let message = Alarm { id, priority, text: words::fault(fault), tick };
        self.writer.write(self.clock.time(tick).unwrap_or(time_ns), &message)
    }

    fn learn(&mut self, response: &Response) {
        let status = &mut self.status;
        status.connected = true;
        match response {
            Response::Identity(DeviceIdentity { mode, controller, period_us, .. }) => {
                self.clock.period_ns = 1000 * u64::from(*period_us);
                status.mode = words::mode(*mode);
                status.controller = words::controller(*controller);
            }
            Response::Mode(mode) => status.mode = words::mode(*mode),
            Response::Controller(choice) => status.controller = words::controller(*choice),
            Response::Alarms(alarms) => {
                status.in_command = words::level(alarms.level);
                let ids: Vec<_> =
                    words::indicated(alarms).into_iter().map(|fault| fault.alarm().id).collect();
                status.indicated_alarms = ids.join(" ");
            }
            Response::Lease(lease) => status.steered_by = words::lease(lease),
            Response::Settings { in_force, .. } => {
                let Settings { pip, peep, rate, .. } = *in_force;
                (status.pip, status.peep, status.rate) = (pip, peep, rate);
            }
            _ => {}
        }
    }

    fn count(&mut self, traffic: &LineCounters) {
        let LineCounters { corrupt, lost_batches, device, .. } = *traffic;
        let status = &mut self.status;
        (status.damaged_frames, status.lost_batches) = (corrupt, lost_batches);
        (status.dropped_samples, status.missed_ticks) = (device.dropped, device.missed_ticks);
        (status.worst_tick_us, status.mean_tick_us) = (device.worst_tick_us, device.mean_tick_us);
    }
}

/// The time of the device, ns since 1970: the wall clock when its first batch came, and from then on its ticks. A
/// device that is emulated faster or more slowly than real time keeps its own pace.
#[derive(Debug, Default)]
struct Clock {
    period_ns: u64,
    /// Time of tick 0; none before the first batch of a connection.
    origin_ns: Option<u64>,
    /// The tick after the latest batch.
    next_tick: u64,
    /// Time at the end of the latest batch, and the time of the wall clock when it came.
    latest: Option<(u64, u64)>,
}

impl Clock {
    /// Time of a control tick.
    fn time(&self, tick: u64) -> Option<u64> {
        self.origin_ns?.checked_add(tick.checked_mul(self.period_ns)?)
    }

    /// Time of the device at this time of the wall clock.
    fn now(&self, now_ns: u64) -> u64 {
        self.latest.map_or(now_ns, |(time, came)| time.saturating_add(now_ns.saturating_sub(came)))
    }

    /// Takes the ticks of a batch. If they do not follow, the device has restarted: they are now. Returns whether it has.
    fn arrived(&mut self, batch: &TelemetryBatch, now_ns: u64) -> bool {
        let past = batch.first_tick.saturating_add(batch.samples.len() as u64);
        let restarted = batch.first_tick < self.next_tick;
        if self.origin_ns.is_none() || restarted {
            self.origin_ns = Some(self.now(now_ns).saturating_sub(past.saturating_mul(self.period_ns)));
        }
        self.next_tick = past;
        self.latest = self.time(past).map(|time| (time, now_ns));
        restarted
    }

    /// Forgets the ticks: while the connection is lost, the device can restart.
    fn lost(&mut self) {
        self.origin_ns = None;
    }
}
