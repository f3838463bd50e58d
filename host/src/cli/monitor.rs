//! `trainer monitor`: writes what a device reports, as lines or once, and as an MCAP file.

use std::io::{Write, stdout};
use std::path::{Path, PathBuf};
use std::time::{Duration, SystemTime, UNIX_EPOCH};

use anyhow::bail;
use clap::{Arg, ArgAction};
use serde::Serialize;
use shared::device::annunciator::AudioStatus;
use shared::link::messages::{AlarmStatus, DeviceIdentity, LeaseStatus};
use shared::safety::alarms::Fault;
use shared::safety::ladder::Level;
use shared::settings::{FIELDS, Settings};
use shared::timing::TickTimes;

use crate::args::port::warn_of_development_build;
use crate::command::{Command, Context, Output, OutputArgs};
use data::export::mcap::Counts;
use device::port::Address;
use device::{Device, DeviceError, LineCounters};
use show::monitor::News;
use show::monitor::capture::Capture;
use show::monitor::plain::Lines;
use show::monitor::session::Session;
use show::monitor::words;
use show::report::{Cell, Table};

/// Write a device's breaths, alarms, state and losses as lines
#[derive(Debug, clap::Args)]
#[command(arg = plain(), after_help = "\
Examples:
  trainer monitor --port /dev/ttyACM0
  trainer monitor --port tcp:localhost:5555 | tee night.log
  trainer monitor --port COM3 --once --json -
  trainer monitor --port /dev/ttyACM0 --mcap night.mcap

The monitor only reads: it changes nothing on the device, and when it ends, ventilation continues.
`trainer serve` shows charts in a browser and, with --steer, starts, stops and sets the device.

--mcap also writes every sample, alarm and the device's state to a new file that Foxglove and
PlotJuggler open. Ctrl-C finishes the file, also while the connection is lost; a program that is
killed loses the last second at most (docs/FILES.md).")]
pub struct Args {
    /// The device's address: /dev/ttyACM0, COM3, serial:NAME?baud=N or tcp:HOST:PORT
    #[arg(long, value_name = "PORT")]
    port: Address,
    /// Print the device's state once and exit
    #[arg(long)]
    once: bool,
    #[command(flatten)]
    output: OutputArgs,
    #[arg(
        long,
        value_name = "FILE.mcap",
        conflicts_with = "once",
        help = "Also write samples, alarms and state to this new file, for Foxglove and PlotJuggler"
    )]
    mcap: Option<PathBuf>,
}

/// The option that names the default.
fn plain() -> Arg {
    let plain = Arg::new("plain").long("plain").action(ArgAction::SetTrue);
    plain.conflicts_with("once").help("Write lines as the state changes, until Ctrl-C [default]")
}

/// Longest wait for news before it checks whether to stop.
const PATIENCE: Duration = Duration::from_millis(100);

impl Command for Args {
    type Outcome = Outcome;

    fn output(&self) -> Output<'_> {
        self.output.json()
    }

    fn run(&self, context: &Context<'_>) -> anyhow::Result<Option<Outcome>> {
        if self.output.json.is_some() && !self.once && self.mcap.is_none() {
            bail!(
                "--json writes the state once, or what --mcap has written: add --once or --mcap, or omit --json"
            );
        }
        let mut device = Device::connect(&self.port)?;
        if self.once {
            return once(self, &mut device, context).map(|state| Some(Outcome::State(Box::new(state))));
        }
        // Report a device that does not answer immediately; later, wait for a lost device to return.
        let identity = device.identify()?;
        warn_of_development_build(&identity);
        let mut file = McapFile::new(self, &identity)?;
        let session = Session::start(device);
        write_lines(&session, &mut file, self.output.json.as_deref() == Some(Path::new("-")), context);
        session.leave();
        Ok(file.finish(context)?.map(Outcome::Captured))
    }
}

/// Writes lines until Ctrl-C, or until the reader closes the output; none if it is only for JSON.
fn write_lines(session: &Session, file: &mut McapFile, only_json: bool, context: &Context<'_>) {
    let mut lines = Lines::default();
    while !context.stopped() {
        let Some(news) = session.next(PATIENCE) else { continue };
        if file.take(&news) {
            eprintln!(
                "warning: the file of --mcap ends here, because it cannot be written; watching goes on"
            );
        }
        for line in lines.take(&news) {
            if !only_json && writeln!(stdout(), "{line}").is_err() {
                return;
            }
        }
    }
}

/// The file of `--mcap`, if it is requested.
struct McapFile(Option<(PathBuf, Capture)>);

impl McapFile {
    fn new(args: &Args, identity: &DeviceIdentity) -> anyhow::Result<Self> {
        let capture = |path: &PathBuf| {
            Ok((path.clone(), Capture::create(path, &args.port.to_string(), identity, now_ns())?))
        };
        args.mcap.as_ref().map(capture).transpose().map(Self)
    }

    /// Writes a piece of news; true if that fails for the first time. A full disk does not end the monitor: an
    /// operator may need it.
    fn take(&mut self, news: &News) -> bool {
        self.0.as_mut().is_some_and(|(_, capture)| capture.take(news, now_ns()))
    }

    /// Finishes the file and reports what it contains, or why it is not complete.
    fn finish(self, context: &Context<'_>) -> anyhow::Result<Option<Captured>> {
        let Some((path, capture)) = self.0 else { return Ok(None) };
        let messages = capture.finish()?;
        context.saved(&path);
        Ok(Some(Captured { file: path, messages }))
    }
}

/// Time, ns since 1970.
fn now_ns() -> u64 {
    let since = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default();
    since.as_nanos().try_into().unwrap_or(u64::MAX)
}

/// The content of `--json`.
#[derive(Debug, Serialize)]
#[serde(untagged)]
pub enum Outcome {
    State(Box<State>),
    Captured(Captured),
}

/// The content of `--json` with `--mcap`.
#[derive(Debug, Serialize)]
pub struct Captured {
    file: PathBuf,
    /// Number of messages of each topic.
    messages: Counts,
}

/// The content of `--json` with `--once`.
#[derive(Debug, Serialize)]
pub struct State {
    port: String,
    identity: DeviceIdentity,
    settings: Settings,
    next_settings: Option<Settings>,
    /// None of what the device does not report.
    alarms: Option<Alarms>,
    audio: Option<AudioStatus>,
    lease: Option<LeaseStatus>,
    ticks: Option<TickTimes>,
    line: LineCounters,
}

/// Stable names of alarms, and the level of the ladder.
#[derive(Debug, Serialize)]
struct Alarms {
    present: Vec<&'static str>,
    /// The most urgent first.
    indicated: Vec<&'static str>,
    level: Level,
    #[serde(skip)]
    status: AlarmStatus,
}

impl From<AlarmStatus> for Alarms {
    fn from(status: AlarmStatus) -> Self {
        let id = |fault: Fault| fault.alarm().id;
        let indicated = words::indicated(&status).into_iter().map(id).collect();
        Self { present: status.present.faults().map(id).collect(), indicated, level: status.level, status }
    }
}

fn once(args: &Args, device: &mut Device, context: &Context<'_>) -> anyhow::Result<State> {
    let identity = device.identify()?;
    warn_of_development_build(&identity);
    let (settings, next_settings) = device.settings()?;
    let alarms = known(device.alarms())?.map(Alarms::from);
    let audio = known(device.audio())?;
    let lease = known(device.lease())?;
    let ticks = known(device.timing(false))?;
    let (port, line) = (args.port.to_string(), device.counters());
    let state = State { port, identity, settings, next_settings, alarms, audio, lease, ticks, line };
    context.table(&table(&state));
    Ok(state)
}

/// What a device reports; none if it does not know the request.
fn known<T>(reported: Result<T, DeviceError>) -> Result<Option<T>, DeviceError> {
    match reported {
        Err(DeviceError::Unknown(_)) => Ok(None),
        reported => reported.map(Some),
    }
}

fn table(state: &State) -> Table {
    const UNKNOWN: &str = "not reported by this device";
    let State { identity, .. } = state;
    let mut table = Table::new("", &["device", &state.port]);
    let mut row = |name: &str, value: String| table.row(vec![Cell::text(name), Cell::text(value)]);
    row("type", words::identity(identity));
    row("started by", words::reset(identity.reset).to_owned());
    row("mode", words::mode(identity.mode));
    row("controller", words::controller(identity.controller));
    match &state.alarms {
        None => row("alarm", UNKNOWN.to_owned()),
        Some(alarms) => {
            row("in command", words::level(alarms.level).to_owned());
            for fault in words::indicated(&alarms.status) {
                row("alarm", words::alarm(fault, &alarms.status));
            }
            if alarms.indicated.is_empty() {
                row("alarm", "none is indicated".to_owned());
            }
        }
    }
    row("sounder", state.audio.as_ref().map_or_else(|| UNKNOWN.to_owned(), words::audio));
    row("steered by", state.lease.as_ref().map_or_else(|| UNKNOWN.to_owned(), words::lease));
    for field in FIELDS {
        row(&words::name(field), words::setting(field, &state.settings, state.next_settings.as_ref()));
    }
    let Some(ticks) = &state.ticks else {
        row("ticks", UNKNOWN.to_owned());
        return table;
    };
    let us = |cycles: f32| format!("{:.1} us", ticks.microseconds(cycles));
    row("ticks", format!("{}, {} missed", ticks.ticks, ticks.missed));
    row("mean tick", us(ticks.work.mean));
    row("longest tick", us(ticks.work.longest as f32));
    row("longest latency", us(ticks.latency.longest as f32));
    table
}

#[cfg(test)]
mod tests {
    use super::*;
    use shared::link::PROTOCOL;
    use shared::link::host_name::HostName;
    use shared::link::messages::{ControllerChoice, DeviceKind};
    use shared::reset::ResetCause;
    use shared::safety::indications::FaultSet;
    use shared::ventilator::Mode;
    use shared::weights::slots::SlotState;

    #[test]
    fn alarms_have_their_stable_names_the_most_urgent_first() {
        let present = FaultSet::from_bits(1 << Fault::Leak as u32);
        let indicated = FaultSet::from_bits(present.bits() | 1 << Fault::Restarted as u32);
        let alarms = Alarms::from(AlarmStatus { present, indicated, level: Level::Pid });
        assert_eq!((alarms.present, alarms.indicated), (vec!["leak"], vec!["restarted", "leak"]));
        assert_eq!(serde_json::to_value(alarms.level).unwrap(), "Pid");
    }

    #[test]
    fn a_setting_that_waits_for_its_breath_is_shown_beside_the_one_in_force() {
        let identity = DeviceIdentity {
            protocol: PROTOCOL,
            firmware: [0, 1, 0],
            device: DeviceKind::Ventilator,
            period_us: 1000,
            mode: Mode::Ventilating,
            controller: ControllerChoice::Learned,
            exploration: None,
            slots: [SlotState::Empty, SlotState::Empty],
            running: None,
            reset: ResetCause::PowerOn,
            failure: None,
            weights_key: None,
        };
        let settings = Settings::default();
        let next_settings = Some(Settings { pip: 25.0, ..settings });
        let (port, ticks, line) = ("COM3".to_owned(), Some(TickTimes::default()), LineCounters::default());
        let (alarms, audio) = (Some(AlarmStatus::default().into()), Some(AudioStatus::default()));
        let lease = Some(LeaseStatus { holder: Some(HostName::new("anna@icu")), yours: false });
        let state = State { port, identity, settings, next_settings, alarms, audio, lease, ticks, line };
        let text = table(&state).to_plain();
        assert!(text.contains("anna@icu (this program only reads)"), "{text}");
        assert!(text.contains("20 cmH2O, 25 from the next breath on"), "{text}");
        assert_eq!(text.matches("from the next breath on").count(), 1, "{text}");
    }
}
