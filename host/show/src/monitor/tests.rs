//! News as lines and as an MCAP file, and the session against a simulated device.

use shared::breath::Phase;
use shared::control::memory::Lesson;
use shared::device::KNOWN_GOOD;
use shared::device::annunciator::AudioStatus;
use shared::link::PROTOCOL;
use shared::link::host_name::HostName;
use shared::link::messages::{
    AlarmStatus, ControllerChoice, DeviceIdentity, DeviceKind, Event, LeaseStatus, Request, Response,
};
use shared::link::telemetry::{BreathSummary, Counters, PackedSample, TelemetryBatch};
use shared::reset::ResetCause;
use shared::safety::alarms::{Fault, Priority};
use shared::safety::indications::FaultSet;
use shared::safety::ladder::Level;
use shared::settings::Settings;
use shared::timing::{BINS, CycleStats, TickTimes};
use shared::ventilator::{Mode, Sample};
use shared::weights::slots::{Slot, SlotState};
use shared::weights::trust::KeyId;

use super::News;
use super::words;
use device::LineCounters;

mod capture;
mod connected;
mod lines;

const PERIOD_US: u32 = 1000;

/// A ventilator with weights, restarted by its watchdog.
fn identity(mode: Mode) -> DeviceIdentity {
    DeviceIdentity {
        protocol: PROTOCOL,
        firmware: [0, 1, 0],
        device: DeviceKind::Ventilator,
        period_us: PERIOD_US,
        mode,
        controller: ControllerChoice::Pid(KNOWN_GOOD),
        exploration: None,
        slots: [SlotState::Valid { generation: 3, id: 0xBEEF }, SlotState::Empty],
        running: Some(Slot::A),
        reset: ResetCause::Watchdog,
        failure: None,
        weights_key: Some(KeyId([0xAB; 8])),
    }
}

fn answer(request: Request, response: Response) -> News {
    News::Answer { request, result: Ok(response) }
}

fn greeting(mode: Mode) -> News {
    answer(Request::Identify, Response::Identity(identity(mode)))
}

fn in_force(settings: Settings) -> News {
    answer(Request::GetSettings, Response::Settings { in_force: settings, pending: None })
}

fn times(ticks: u32) -> TickTimes {
    let span = |shortest, mean, longest| CycleStats { shortest, mean, longest };
    TickTimes {
        core_hz: 168_000_000,
        ticks,
        missed: 0,
        latency: span(50, 84.0, 336),
        work: span(2100, 2520.0, 3360),
        period: span(167_900, 168_000.0, 168_100),
        histogram: [0; BINS],
    }
}

fn timing(ticks: u32) -> News {
    answer(Request::GetTiming { clear: false }, Response::Timing(times(ticks)))
}

/// A batch starting at this tick of a 3000-tick breath, with a pressure that follows the target.
fn batch(first_tick: u64, pressures: &[f32]) -> TelemetryBatch {
    let sample = |(tick, pressure): (u64, &f32)| {
        let tick = (tick % 3000) as u32;
        let (phase, target, u_in) = match tick {
            0..1000 => (Phase::Inspiration, 20.0, 34.0),
            1000..1500 => (Phase::Fall, 20.0 - 0.03 * (tick - 1000) as f32, 0.0),
            _ => (Phase::Expiration, 5.0, 5.0),
        };
        let u_out = phase != Phase::Inspiration;
        PackedSample::pack(&Sample {
            breath: 0,
            tick,
            phase,
            target,
            pressure: *pressure,
            u_in,
            u_out,
            explore: 0.0,
            learned: 0.0,
            flow: None,
        })
    };
    let samples = (first_tick..).zip(pressures).map(sample).collect();
    TelemetryBatch { sequence: 0, first_tick, counters: Counters::default(), samples }
}

fn telemetry(first_tick: u64, pressures: &[f32]) -> News {
    News::Event(Event::Telemetry(batch(first_tick, pressures)))
}

fn alarm(fault: Fault) -> News {
    News::Event(Event::Alarm { fault, tick: 4321 })
}

/// The answer with these alarms; `gone` are only not yet acknowledged.
fn alarms(present: &[Fault], gone: &[Fault], level: Level) -> News {
    let bits = |faults: &[Fault]| faults.iter().fold(0, |bits, fault| bits | 1 << *fault as u32);
    let [present, gone] = [present, gone].map(bits);
    let [present, indicated] = [present, present | gone].map(FaultSet::from_bits);
    answer(Request::GetAlarms, Response::Alarms(AlarmStatus { present, indicated, level }))
}

/// The answer of a sounder that sounds for an alarm of high priority, and is paused for so many seconds more.
fn sounder(pause_left: u16) -> News {
    let audio = AudioStatus { priority: Some(Priority::High), pause_left };
    answer(Request::GetAudio, Response::Audio(audio))
}

/// The answer of a device that the host of this name steers.
fn steered(holder: Option<&str>, yours: bool) -> News {
    let status = LeaseStatus { holder: holder.map(HostName::new), yours };
    answer(Request::GetLease, Response::Lease(status))
}

fn breath(number: u32) -> News {
    News::Event(Event::Breath(BreathSummary {
        breath: number,
        mean_absolute_error: 1.25,
        peak_pressure: 21.5,
        end_pressure: 5.1,
        leak: Some(0.01),
        lesson: Lesson::Adopt,
        adopted: 2,
    }))
}

#[test]
fn a_development_build_is_called_so() {
    let development = DeviceIdentity { weights_key: None, ..identity(Mode::Standby) };
    assert!(words::identity(&development).ends_with(", development build"));
    assert!(!words::identity(&identity(Mode::Standby)).contains("development"));
    assert_eq!(words::weights_key(&identity(Mode::Standby)), "abababababababab");
}
