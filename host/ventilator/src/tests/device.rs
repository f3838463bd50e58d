//! A device at a real pseudo-terminal: the line's effect on requests, uploads and recordings.

use std::io::{self, Read, Write};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use serialport::{SerialPort, TTYPort};
use shared::breath::paper_settings;
use shared::control::Controller;
use shared::control::features::FeatureSpec;
use shared::control::network::Network;
use shared::control::pid::Pid;
use shared::control::residual::{Residual, ResidualSpec};
use shared::device::KNOWN_GOOD;
use shared::link::frame::{DECODER_BYTES, FRAME_BYTES, FrameDecoder, Poll, encode_frame};
use shared::link::host_name::HostName;
use shared::link::messages::{DeviceKind, LeaseStatus, Request, Response, ToDevice, ToHost, read_request};
use shared::link::refusal::Refusal;
use shared::recorder::{FAST_ENTRIES, Happening, RecordingState};
use shared::reset::ResetCause;
use shared::settings::Settings;
use shared::ventilator::Mode;
use shared::weights::slots::{Slot, SlotState};
use shared::weights::{IMAGE_BYTES, Identity, encode};

use crate::collect::{CollectConfig, collect};
use crate::{BenchSource, PortSource, Source, SourceError};
use device::port::{Address, BAUD, Port};
use device::simulated::{MOST_PACE, Served, Simulated};
use device::upload::UploadError;
use device::{Device, DeviceError};
use plant::bench::BenchConfig;
use progress::{Event, Progress};

/// Both ends of a pseudo-terminal: the device's end as a line, the host's as an address.
fn terminal() -> (Port, Address, TTYPort) {
    let (mut master, slave) = TTYPort::pair().unwrap();
    master.set_timeout(Duration::from_millis(2)).unwrap();
    let address = Address::Serial { name: slave.name().unwrap(), baud: BAUD };
    let reader = Box::new(master.try_clone_native().unwrap());
    // A long timeout for writes, because the host may be busy.
    master.set_timeout(Duration::from_mins(1)).unwrap();
    (Port { reader, writer: Box::new(master) }, address, slave)
}

/// A simulated device and a connection to it; the terminal stays open while the last part lives.
fn connected() -> (Device, Simulated, TTYPort) {
    let (port, address, slave) = terminal();
    let simulated = Simulated::start(&BenchConfig::paper(20.0, 20.0), port).unwrap();
    (Device::connect(&address).unwrap(), simulated, slave)
}

fn image(p: f32) -> [u8; IMAGE_BYTES] {
    let mut bytes = [0; IMAGE_BYTES];
    encode(&residual(p), &Identity::default(), &mut bytes).unwrap();
    bytes
}

fn residual(p: f32) -> Residual {
    let spec = ResidualSpec {
        period_us: 1000,
        gains: shared::control::pid::PidGains { p, ..KNOWN_GOOD },
        lambda: 1.0,
        authority: 50.0,
        features: FeatureSpec::default(),
    };
    let mut network = Network::zero();
    network.output.bias[0] = 0.05;
    Residual::new(spec, network).unwrap()
}

/// The result of some work, and its progress as steps done and total steps.
fn observed<T>(work: impl FnOnce(&Progress<'_>) -> T) -> (T, Vec<(usize, usize)>) {
    let steps = Mutex::new(Vec::new());
    let note = |event: &Event<'_>| steps.lock().unwrap().push((event.done, event.total));
    let outcome = work(&Progress::new(&note, &AtomicBool::new(false)));
    (outcome, steps.into_inner().unwrap())
}

#[test]
fn a_device_greets() {
    let (mut device, _simulated, _terminal) = connected();
    let identity = device.identify().unwrap();
    assert_eq!((identity.device, identity.reset), (DeviceKind::Simulated, ResetCause::PowerOn));
}

#[test]
fn weights_arrive_run_after_a_restart_and_are_named() {
    let (mut device, _simulated, _terminal) = connected();
    let (uploaded, steps) = observed(|progress| device.upload(&image(2.0), progress).unwrap());
    assert_eq!((uploaded.slot, steps.last()), (Slot::A, Some(&(IMAGE_BYTES, IMAGE_BYTES))));
    let identity = device.restart().unwrap();
    assert_eq!((identity.running, identity.reset), (Some(Slot::A), ResetCause::Software));
    assert_eq!(device.upload(&image(3.0), &Progress::silent()).unwrap().slot, Slot::B);
}

#[test]
fn a_broken_off_upload_goes_on_and_a_damaged_image_is_not_even_sent() {
    let (mut device, _simulated, _terminal) = connected();
    let image = image(2.0);
    let id = u32::from_le_bytes(*image.last_chunk().unwrap());
    device.request(&Request::BeginWeights { length: IMAGE_BYTES as u32, id }).unwrap();
    let bytes = heapless::Vec::from_slice(&image[..100]).unwrap();
    device.request(&Request::WeightsChunk { offset: 0, bytes }).unwrap();
    device.reconnect().unwrap();
    let (_, steps) = observed(|progress| device.upload(&image, progress).unwrap());
    assert_eq!(steps.iter().find(|(arrived, _)| *arrived > 0), Some(&(100, IMAGE_BYTES)));
    let mut damaged = image;
    damaged[200] ^= 1;
    assert!(matches!(device.upload(&damaged, &Progress::silent()), Err(UploadError::Image(_))));
}

#[test]
fn a_stopped_upload_leaves_both_slots_alone_and_goes_on_later() {
    let (mut device, _simulated, _terminal) = connected();
    let stop = AtomicBool::new(false);
    let stop_on_the_way = |event: &Event<'_>| stop.store(event.done > 0, Ordering::Relaxed);
    let stopped = device.upload(&image(2.0), &Progress::new(&stop_on_the_way, &stop)).unwrap_err();
    assert!(matches!(stopped, UploadError::Device(DeviceError::Stopped)), "{stopped}");
    assert_eq!(device.restart().unwrap().slots, [SlotState::Empty; 2]);
    assert_eq!(device.upload(&image(2.0), &Progress::silent()).unwrap().slot, Slot::A);
}

#[test]
fn reading_the_recorder_stops_when_asked_and_takes_nothing_from_it() {
    let (mut device, _simulated, _terminal) = connected();
    let stopped = device.blackbox(&Progress::quiet(&AtomicBool::new(true))).unwrap_err();
    assert!(matches!(stopped, DeviceError::Stopped), "{stopped}");
    assert_eq!(device.blackbox(&Progress::silent()).unwrap().log.len(), 1);
}

#[test]
fn weights_are_refused_while_ventilating() {
    let (mut device, _simulated, _terminal) = connected();
    device.apply(Settings::default()).unwrap();
    device.start().unwrap();
    let refused = device.upload(&image(2.0), &Progress::silent()).unwrap_err();
    assert!(matches!(refused, UploadError::Device(DeviceError::Refused(Refusal::Ventilating))), "{refused}");
    device.stop().unwrap();
    device.upload(&image(2.0), &Progress::silent()).unwrap();
}

#[test]
fn settings_in_force_and_refusals_come_back() {
    let (mut device, _simulated, _terminal) = connected();
    let wish = paper_settings(25.0);
    assert_eq!(device.apply(wish).unwrap().1, Some(wish));
    let refused = device.apply(paper_settings(80.0)).unwrap_err().to_string();
    assert!(refused.contains("pip is 80 cmH2O"), "{refused}");
}

#[test]
fn a_recording_over_the_line_is_that_of_the_bench_bit_for_bit() {
    let (device, _simulated, _terminal) = connected();
    let lung = BenchConfig::paper(20.0, 20.0);
    let config = CollectConfig { breaths: 20, seed: (1 << 50) + 77, ..CollectConfig::default() };
    let controller = Controller::Residual(residual(3.0));
    let mut bench = BenchSource::new(&lung, controller.clone(), &config.settings, 1000, config.seed).unwrap();
    let here = collect(&mut bench, &controller, &config, &Progress::silent()).unwrap();
    let mut port = PortSource::new(device, config.seed).unwrap();
    let there = collect(&mut port, &controller, &config, &Progress::silent()).unwrap();
    assert_eq!((here.breaths, there.breaths), (20, 20));
    let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
    let (here, there) = (&here.recording, &there.recording);
    assert_eq!(bits(&here.u_in), bits(&there.u_in));
    assert_eq!(bits(&here.pressure), bits(&there.pressure));
    assert_eq!(bits(&here.explore), bits(&there.explore));
    assert_eq!((&here.breath, &here.tick, &here.u_out), (&there.breath, &there.tick, &there.u_out));
}

#[test]
fn a_fault_ends_the_breath_and_can_be_acknowledged() {
    let (device, _simulated, _terminal) = connected();
    let mut port = PortSource::new(device, 1).unwrap();
    let wild = Pid::new(shared::control::pid::PidGains { p: 40.0, i: 900.0, d: 0.0 }, 1000).unwrap();
    port.configure(Controller::Pid(wild), None).unwrap();
    let tight = Settings { pressure_limit: 20.0, ..paper_settings(15.0) };
    let mut ticks = 0;
    let error = port.breath(&tight, &mut |_| ticks += 1).unwrap_err();
    assert!(matches!(error, SourceError::Fault { tick, .. } if tick == ticks), "{error}");
    port.acknowledge().unwrap();
    port.configure(Controller::Pid(Pid::new(KNOWN_GOOD, 1000).unwrap()), None).unwrap();
    port.breath(&paper_settings(15.0), &mut |_| ()).unwrap();
}

/// Passes bytes on, but damages one in every given number.
struct Noisy<T> {
    line: T,
    count: usize,
    every: usize,
}

impl<T: Read> Read for Noisy<T> {
    fn read(&mut self, bytes: &mut [u8]) -> io::Result<usize> {
        let count = self.line.read(bytes)?;
        for byte in &mut bytes[..count] {
            self.count += 1;
            *byte ^= u8::from(self.count.is_multiple_of(self.every)) << 3;
        }
        Ok(count)
    }
}

#[test]
fn requests_get_through_a_line_that_damages_bytes() {
    let (port, address, _slave) = terminal();
    // A message has about 80 bytes: four damaged ones in a row, which end a request, are as good as impossible.
    let reader = Box::new(Noisy { line: port.reader, count: 0, every: 701 });
    let noisy = Port { reader, writer: port.writer };
    let _simulated = Simulated::start(&BenchConfig::paper(20.0, 20.0), noisy).unwrap();
    let mut device = Device::connect(&address).unwrap();
    for pip in (10..40).map(|pip| pip as f32) {
        let applied = device.apply(paper_settings(pip));
        let (_, pending) = applied.unwrap_or_else(|error| panic!("{pip}: {error}, {:?}", device.counters()));
        assert_eq!(pending, Some(paper_settings(pip)));
    }
}

#[test]
fn the_flight_recorder_is_read_while_the_device_ventilates_and_kept_through_a_restart() {
    let (mut device, _simulated, _terminal) = connected();
    device.apply(Settings::default()).unwrap();
    device.start().unwrap();
    let deadline = Instant::now() + Duration::from_mins(1);
    while device.recorder().unwrap().fast.next < 4000 {
        assert!(Instant::now() < deadline, "no breath comes");
    }
    let (running, steps) = observed(|progress| device.blackbox(progress).unwrap());
    assert!(steps.is_sorted_by_key(|(read, _)| *read) && steps.last().is_some_and(|(read, all)| read == all));
    assert_eq!((running.status.recording, running.unread), (RecordingState::Running, 0));
    assert!(running.slow.ticks().any(|tick| tick.pressure > 15.0), "a breath is in it");
    device.stop().unwrap();
    device.restart().unwrap();
    let after = device.blackbox(&Progress::silent()).unwrap();
    assert_eq!((after.status.boot, after.status.recording), (2, RecordingState::Stopped));
    assert_eq!(after.fast.entries.len(), FAST_ENTRIES);
    let again = device.blackbox(&Progress::silent()).unwrap();
    assert_eq!((after.fast, after.slow), (again.fast, again.slow), "it stands still");
    assert!(after.log.starts_with(&running.log));
    let boot = Happening::Boot { cause: ResetCause::Software, failed: false };
    assert_eq!(after.log.last().map(|event| event.happening), Some(boot));
}

/// Another host takes the lease over.
fn taken_over(device: &mut Device) {
    let name = HostName::new("anna@icu");
    device.send_as(0, &Request::AcquireLease { name, take_over: true }).unwrap();
}

#[test]
fn while_another_host_steers_changes_are_refused_with_its_name_until_this_one_takes_over() {
    let (mut device, _simulated, _terminal) = connected();
    device.apply(paper_settings(25.0)).unwrap();
    // A simulated device's seconds are short, so the other host may have to do it again.
    let (before, refused) = loop {
        let before = device.settings().unwrap();
        taken_over(&mut device);
        if let Err(refused) = device.apply(paper_settings(15.0)) {
            break (before, refused.to_string());
        }
    };
    assert!(refused.contains("anna@icu steers this device"), "{refused}");
    assert_eq!(device.settings().unwrap(), before, "reading is free, nothing changed");
    assert!(device.acquire_lease(true).unwrap().yours);
    assert_eq!(device.stop().unwrap(), Mode::Standby);
}

#[test]
fn a_connection_acquires_the_lease_for_its_first_change_and_gives_it_back_at_its_end() {
    let (mut port, address, _slave) = terminal();
    let fake = std::thread::spawn(move || {
        let (mut decoder, mut byte) = (FrameDecoder::<DECODER_BYTES>::new(), [0]);
        let mut requests = Vec::new();
        while requests.last() != Some(&Request::ReleaseLease) {
            if !port.reader.read(&mut byte).is_ok_and(|count| count == 1) {
                continue;
            }
            let Poll::Frame(content) = decoder.push(byte[0]) else { continue };
            let ToDevice { sequence, request, host } = read_request(content).unwrap();
            let steers = requests.iter().any(|earlier| matches!(earlier, Request::AcquireLease { .. }));
            let lease = LeaseStatus { holder: Some(HostName::new("x")), yours: true };
            let response = match &request {
                Request::AcquireLease { name, take_over: false } if *name == device::host_name() => {
                    Response::Lease(lease)
                }
                Request::Stop if steers => Response::Mode(Mode::Standby),
                Request::Stop => Response::Refused(Refusal::NoLease),
                Request::ReleaseLease => Response::Lease(LeaseStatus::default()),
                other => panic!("{other:?}"),
            };
            assert!(host.is_some());
            requests.push(request);
            let mut buffer = [0; FRAME_BYTES];
            let answer = encode_frame(&ToHost::Response { sequence, response }, &mut buffer).unwrap();
            port.writer.write_all(answer).unwrap();
        }
        requests
    });
    let mut device = Device::connect(&address).unwrap();
    device.stop().unwrap();
    device.stop().unwrap();
    drop(device);
    let acquired = Request::AcquireLease { name: device::host_name(), take_over: false };
    let expected = [Request::Stop, acquired, Request::Stop, Request::Stop, Request::ReleaseLease];
    assert_eq!(fake.join().unwrap(), expected);
}

#[test]
fn silence_is_told_with_what_to_look_at() {
    let (_port, address, _slave) = terminal();
    let mut device = Device::connect(&address).unwrap();
    let error = device.identify().unwrap_err();
    assert!(matches!(error, DeviceError::Silent(_)) && error.to_string().contains("cable"), "{error}");
}

#[test]
fn a_device_that_vanishes_is_told_and_can_be_connected_anew() {
    let (port, address, slave) = terminal();
    let mut device = Device::connect(&address).unwrap();
    drop((port, slave));
    assert!(matches!(device.identify(), Err(DeviceError::Gone(_) | DeviceError::Silent(_))));
    assert!(matches!(device.reconnect(), Err(DeviceError::Port(_))));
}

#[test]
fn another_protocol_is_told_with_both_versions() {
    let (mut port, address, _slave) = terminal();
    let mut device = Device::connect(&address).unwrap();
    let answer = (0u8, 1u16, 0u8, 77u16);
    let mut buffer = [0; 64];
    let frame = encode_frame(&answer, &mut buffer).unwrap();
    port.writer.write_all(frame).unwrap();
    let error = device.identify().unwrap_err();
    assert!(matches!(error, DeviceError::Protocol(77)), "{error}");
}

#[test]
fn a_served_device_gives_the_samples_and_the_truth_of_the_bench_also_after_a_host_has_vanished() {
    let (mut bench, seed) = (BenchConfig::paper(20.0, 20.0), 3);
    // A served device has the airway sensor alone.
    bench.flow_sensor.present = false;
    let served = Served::start(&bench, MOST_PACE).unwrap();
    let settings = paper_settings(20.0);
    let pid = Controller::Pid(Pid::new(KNOWN_GOOD, 1000).unwrap());
    let breath = |source: &mut dyn Source| {
        let mut ticks = Vec::new();
        source.configure(pid.clone(), None).unwrap();
        source.breath(&settings, &mut |tick| ticks.push(*tick)).unwrap();
        ticks
    };
    let expected = breath(&mut BenchSource::new(&bench, pid.clone(), &settings, 1000, seed).unwrap());
    let connected = || {
        let source = PortSource::new(Device::connect(served.address()).unwrap(), seed).unwrap();
        source.with_plant("served".into(), bench.to_toml(), served.truth())
    };
    let mut first = connected();
    assert_eq!(breath(&mut first), expected);
    drop(first);
    assert_eq!(breath(&mut connected()), expected);
}
