//! The session against a simulated device: requests reach it, its news arrive, and a broken line is reopened.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use monitoring::reported::Reported;
use serialport::{SerialPort, TTYPort};

use super::*;
use crate::monitor::session::Session;
use device::Device;
use device::port::{Address, BAUD, Port};
use device::simulated::Simulated;
use plant::bench::BenchConfig;

/// Longest time that any step here may take.
const LONG: Duration = Duration::from_mins(1);

/// A socket that a session can connect to repeatedly.
struct Socket(TcpListener);

impl Socket {
    fn new() -> (Self, Address) {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = Address::Tcp(listener.local_addr().unwrap().to_string());
        (Self(listener), address)
    }

    /// Connects a new simulated device to the next caller; dropping the second part breaks that line.
    fn plug_in(&self) -> (Simulated, TcpStream) {
        let (stream, _) = self.0.accept().unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        let cable = stream.try_clone().unwrap();
        let reader: Box<dyn Read + Send> = Box::new(stream.try_clone().unwrap());
        let writer: Box<dyn Write + Send> = Box::new(stream);
        (Simulated::start(&BenchConfig::paper(20.0, 20.0), Port { reader, writer }).unwrap(), cable)
    }
}

/// A session, and what its news have shown.
struct Watched {
    session: Session,
    reported: Reported,
    breaths: usize,
    samples: usize,
    /// The last refusal or failure of a request.
    refusal: Option<String>,
}

impl Watched {
    /// Watches a device until its first poll has been answered.
    fn start(device: Device) -> Self {
        let session = Session::start(device);
        let mut watched =
            Self { session, reported: Reported::default(), breaths: 0, samples: 0, refusal: None };
        watched.until("the first poll", |watched| watched.reported.times.is_some());
        watched
    }

    /// Takes news until they have shown what is expected.
    fn until(&mut self, what: &str, expected: impl Fn(&Self) -> bool) {
        let deadline = Instant::now() + LONG;
        while !expected(self) {
            assert!(
                Instant::now() < deadline,
                "{what} did not come: {:?} {:?}",
                self.reported.mode,
                self.refusal
            );
            if let Some(news) = self.session.next(Duration::from_millis(100)) {
                self.take(&news);
            }
        }
    }

    fn take(&mut self, news: &News) {
        self.reported.take(news);
        match news {
            News::Event(Event::Telemetry(batch)) => self.samples += batch.samples.len(),
            News::Event(Event::Breath(_)) => self.breaths += 1,
            News::Answer { result: Err(reason), .. } => self.refusal = Some(reason.clone()),
            _ => {}
        }
    }

    /// The reason why a request is not carried out.
    fn refused(&mut self, request: Request) -> String {
        self.refusal = None;
        self.session.ask(request);
        self.until("a refusal", |watched| watched.refusal.is_some());
        self.refusal.take().unwrap()
    }

    /// Sends settings, and starts as soon as the self-test has ended: a start does not wait for it.
    fn start_ventilation(&mut self) {
        self.session.ask(Request::ApplySettings(Settings::default()));
        let deadline = Instant::now() + LONG;
        while self.reported.mode != Some(Mode::Ventilating) {
            assert!(Instant::now() < deadline, "it did not start: {:?}", self.refusal);
            self.refusal = None;
            self.session.ask(Request::Start);
            self.until("an answer", |watched| {
                watched.reported.mode == Some(Mode::Ventilating) || watched.refusal.is_some()
            });
        }
    }
}

fn watched() -> (Socket, Simulated, TcpStream, Watched) {
    let (socket, address) = Socket::new();
    let device = Device::connect(&address).unwrap();
    let (simulated, cable) = socket.plug_in();
    (socket, simulated, cable, Watched::start(device))
}

#[test]
fn an_operator_starts_sets_and_stops_a_device() {
    let (_socket, _simulated, _cable, mut watched) = watched();
    assert_eq!(watched.reported.mode, Some(Mode::Standby), "watching a device does not start it");
    let mut reason = watched.refused(Request::Start);
    // The device may still test itself; then this is its first reason.
    while reason.contains("self-test") {
        reason = watched.refused(Request::Start);
    }
    assert!(reason.contains("no settings were sent"), "{reason}");
    watched.start_ventilation();
    watched.until("breaths", |watched| watched.breaths >= 2 && watched.samples > 0);
    assert_eq!(watched.reported.mode, Some(Mode::Ventilating));
    let settings = Settings { pip: 21.0, ..Settings::default() };
    watched.session.ask(Request::ApplySettings(settings));
    watched.until("the new PIP", |watched| {
        watched.reported.in_force == Some(settings) && watched.reported.pending.is_none()
    });
    let reason = watched.refused(Request::SetController(ControllerChoice::Learned));
    assert!(reason.contains("no valid weights"), "{reason}");
    watched.session.ask(Request::Stop);
    watched.until("standby", |watched| watched.reported.mode == Some(Mode::Standby));
    watched.session.leave();
}

#[test]
fn samples_go_on_while_an_answer_is_awaited_that_the_line_has_lost() {
    let (socket, address) = Socket::new();
    let device = Device::connect(&address).unwrap();
    let (stream, _) = socket.0.accept().unwrap();
    stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
    let deaf = Arc::new(AtomicBool::new(false));
    let reader = Box::new(LossyReader { from: stream.try_clone().unwrap(), deaf: Arc::clone(&deaf) });
    let port = Port { reader, writer: Box::new(stream) };
    let _simulated = Simulated::start(&BenchConfig::paper(20.0, 20.0), port).unwrap();
    let mut watched = Watched::start(device);
    watched.start_ventilation();
    watched.until("samples", |watched| watched.samples > 0);
    // From here on no request arrives. The session goes on asking for 6 s before it gives the line up.
    deaf.store(true, Ordering::Relaxed);
    let (mut samples, deadline) = (0, Instant::now() + LONG);
    loop {
        assert!(Instant::now() < deadline, "the line is not given up");
        match watched.session.next(Duration::from_millis(100)) {
            Some(News::Answer { result: Err(_), .. }) => break,
            Some(News::Event(Event::Telemetry(batch))) => samples += batch.samples.len(),
            // What was answered just before.
            Some(News::Answer { result: Ok(_), .. }) => samples = 0,
            _ => {}
        }
    }
    assert!(samples > 1000, "{samples} samples while it waited");
}

/// A reader that loses everything while it is deaf.
struct LossyReader {
    from: TcpStream,
    deaf: Arc<AtomicBool>,
}

impl Read for LossyReader {
    fn read(&mut self, buffer: &mut [u8]) -> std::io::Result<usize> {
        let count = self.from.read(buffer)?;
        if self.deaf.load(Ordering::Relaxed) && count > 0 {
            return Err(std::io::ErrorKind::TimedOut.into());
        }
        Ok(count)
    }
}

#[test]
fn a_broken_line_is_reported_and_opened_again_and_nothing_is_pushed() {
    let (socket, simulated, cable, mut watched) = watched();
    watched.session.ask(Request::ApplySettings(Settings { pip: 21.0, ..Settings::default() }));
    watched.until("the answer", |watched| watched.reported.pending.is_some());
    cable.shutdown(std::net::Shutdown::Both).unwrap();
    drop(simulated);
    watched.until("the loss", |watched| watched.reported.lost.is_some());
    assert!(watched.refused(Request::Start).contains("nothing was sent"));
    let (_another, _cable) = socket.plug_in();
    watched.until("the greeting", |watched| {
        watched.reported.lost.is_none() && watched.reported.in_force.is_some()
    });
    assert_eq!(watched.reported.pending, None);
    assert_eq!(watched.reported.mode, Some(Mode::Standby), "the start from before never reached it");
    assert_eq!(watched.reported.in_force, Some(Settings::default()), "nor did the settings");
}

#[test]
fn a_device_goes_on_ventilating_without_telemetry_when_its_monitor_leaves() {
    // A pseudo-terminal lasts as long as its end is held open, like a cable that stays plugged in.
    let (mut master, cable) = TTYPort::pair().unwrap();
    master.set_timeout(Duration::from_millis(2)).unwrap();
    let address = Address::Serial { name: cable.name().unwrap(), baud: BAUD };
    let reader = Box::new(master.try_clone_native().unwrap());
    // A device that cannot send for this long gives up; on a busy machine the reader may be late.
    master.set_timeout(LONG).unwrap();
    let port = Port { reader, writer: Box::new(master) };
    let _simulated = Simulated::start(&BenchConfig::paper(20.0, 20.0), port).unwrap();

    let mut watched = Watched::start(Device::connect(&address).unwrap());
    watched.start_ventilation();
    watched.until("telemetry", |watched| watched.samples > 0);
    watched.session.leave();

    let mut device = Device::connect(&address).unwrap();
    assert_eq!(device.identify().unwrap().mode, Mode::Ventilating);
    // News sent before the greeting have arrived by now.
    let _ = device.events().try_iter().count();
    device.identify().unwrap();
    let telemetry = device.events().try_iter().filter(|event| matches!(event, Event::Telemetry(_))).count();
    assert_eq!(telemetry, 0);
}
