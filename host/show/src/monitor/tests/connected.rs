//! The session against a simulated device: keys reach it, its news arrive, and a broken line is reopened.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serialport::{SerialPort, TTYPort};

use super::*;
use crate::monitor::session::Session;
use device::Device;
use device::port::{Address, BAUD, Port};
use device::simulated::Simulated;
use plant::bench::BenchConfig;

/// Longest time that any step here may take.
const LONG: Duration = Duration::from_mins(1);

/// A socket that a monitor can connect to repeatedly.
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

/// Takes news until the view satisfies `expected`.
fn watch(session: &Session, view: &mut View, what: &str, expected: impl Fn(&View) -> bool) {
    let deadline = Instant::now() + LONG;
    while !expected(view) {
        assert!(Instant::now() < deadline, "{what} did not come: {:?} {:?}", view.known().mode, view.message);
        session.next(Duration::from_millis(100)).iter().for_each(|news| view.take(news));
    }
}

fn press(session: &Session, view: &mut View, key: Key) {
    session.ask(view.press(key).unwrap());
}

/// Presses start until the self-test has ended: a start does not wait for it, because it could act long after the key.
fn start(session: &Session, view: &mut View) {
    let deadline = Instant::now() + LONG;
    while view.known().mode != Some(Mode::Ventilating) {
        assert!(Instant::now() < deadline, "it did not start: {:?}", view.message);
        view.message = None;
        press(session, view, Key::StartStop);
        watch(session, view, "an answer", |view| {
            view.known().mode == Some(Mode::Ventilating) || matches!(view.message, Some(Notice::Warning(_)))
        });
    }
}

fn watched() -> (Socket, Simulated, TcpStream, Session, View) {
    let (socket, address) = Socket::new();
    let device = Device::connect(&address).unwrap();
    let (simulated, cable) = socket.plug_in();
    let mut view = View::new(address.to_string(), KNOWN_GOOD);
    let session = Session::start(device);
    watch(&session, &mut view, "the first look", |view| view.known().times.is_some());
    (socket, simulated, cable, session, view)
}

#[test]
fn an_operator_starts_sets_and_stops_a_device() {
    let (_socket, _simulated, _cable, session, mut view) = watched();
    assert_eq!(view.known().mode, Some(Mode::Standby), "looking at a device does not start it");
    press(&session, &mut view, Key::StartStop);
    watch(&session, &mut view, "a refusal", |view| matches!(view.message, Some(Notice::Warning(_))));
    // The device may still test itself; then this is its first reason.
    while warning(&view).contains("self-test") {
        view.message = None;
        press(&session, &mut view, Key::StartStop);
        watch(&session, &mut view, "a refusal", |view| matches!(view.message, Some(Notice::Warning(_))));
    }
    assert!(warning(&view).contains("key c"), "{}", warning(&view));
    press(&session, &mut view, Key::Confirm);
    start(&session, &mut view);
    watch(&session, &mut view, "breaths", |view| view.breaths.len() >= 2 && view.window.last().is_some());
    assert_eq!(view.known().mode, Some(Mode::Ventilating));
    press(&session, &mut view, Key::PipUp);
    watch(&session, &mut view, "the new PIP", |view| {
        view.known().in_force.is_some_and(|settings| (settings.pip - 21.0).abs() < 1e-6)
            && view.known().pending.is_none()
    });
    press(&session, &mut view, Key::Controller);
    watch(&session, &mut view, "a refusal", |view| matches!(view.message, Some(Notice::Warning(_))));
    assert!(warning(&view).contains("no valid weights"), "{}", warning(&view));
    press(&session, &mut view, Key::StartStop);
    watch(&session, &mut view, "standby", |view| view.known().mode == Some(Mode::Standby));
    session.leave();
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
    let mut view = View::new(address.to_string(), KNOWN_GOOD);
    let session = Session::start(device);
    watch(&session, &mut view, "the first look", |view| view.known().times.is_some());
    press(&session, &mut view, Key::Confirm);
    start(&session, &mut view);
    watch(&session, &mut view, "samples", |view| view.window.last().is_some());
    // From here on no request arrives. The session goes on asking for 6 s before it gives the line up.
    deaf.store(true, Ordering::Relaxed);
    let (mut samples, deadline) = (0, Instant::now() + LONG);
    loop {
        assert!(Instant::now() < deadline, "the line is not given up");
        match session.next(Duration::from_millis(100)) {
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
fn a_broken_line_is_told_and_opened_again_and_nothing_is_pushed() {
    let (socket, simulated, cable, session, mut view) = watched();
    press(&session, &mut view, Key::PipUp);
    watch(&session, &mut view, "the answer", |view| view.known().pending.is_some());
    cable.shutdown(std::net::Shutdown::Both).unwrap();
    drop(simulated);
    watch(&session, &mut view, "the loss", |view| view.known().lost.is_some());
    session.ask(Request::Start);
    watch(
        &session,
        &mut view,
        "what was not sent",
        |view| matches!(&view.message, Some(Notice::Warning(text)) if text.contains("nothing was sent")),
    );
    let (_another, _cable) = socket.plug_in();
    watch(&session, &mut view, "the greeting", |view| {
        view.known().lost.is_none() && view.known().in_force.is_some()
    });
    assert_eq!(view.known().pending, None);
    assert_eq!(view.known().mode, Some(Mode::Standby), "the start from before never reached it");
    assert_eq!(view.known().in_force, Some(&Settings::default()), "nor did the settings");
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

    let session = Session::start(Device::connect(&address).unwrap());
    let mut view = View::new(address.to_string(), KNOWN_GOOD);
    watch(&session, &mut view, "the first look", |view| view.known().times.is_some());
    press(&session, &mut view, Key::Confirm);
    start(&session, &mut view);
    watch(&session, &mut view, "telemetry", |view| view.window.last().is_some());
    session.leave();

    let mut device = Device::connect(&address).unwrap();
    assert_eq!(device.identify().unwrap().mode, Mode::Ventilating);
    // News sent before the greeting have arrived by now.
    let _ = device.events().try_iter().count();
    device.identify().unwrap();
    let telemetry = device.events().try_iter().filter(|event| matches!(event, Event::Telemetry(_))).count();
    assert_eq!(telemetry, 0);
}
