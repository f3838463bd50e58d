//! A line at whose other end is something else than a device.

use std::io::{Read, Write};
use std::net::TcpListener;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use device::port::Address;
use device::{Device, DeviceError};
use shared::link::frame::{FRAME_BYTES, encode_frame};
use shared::link::messages::{Response, ToHost};
use shared::ventilator::Mode;

/// What asking once may take: four times 1.5 s, and what a busy machine adds.
const LONG: Duration = Duration::from_secs(20);

/// What a greeting becomes at the end of a line that sends these bytes again and again.
fn greeted_by(bytes: Vec<u8>) -> DeviceError {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = Address::Tcp(listener.local_addr().unwrap().to_string());
    let stop = Arc::new(AtomicBool::new(false));
    let stopped = Arc::clone(&stop);
    let stranger = thread::spawn(move || {
        let (mut stream, _) = listener.accept().unwrap();
        stream.set_write_timeout(Some(Duration::from_millis(50))).unwrap();
        stream.set_read_timeout(Some(Duration::from_millis(1))).unwrap();
        while !stopped.load(Ordering::Relaxed) {
            let _ = (stream.write(&bytes), stream.read(&mut [0; 256]));
        }
    });
    let begun = Instant::now();
    let error = Device::connect(&address).unwrap().identify().unwrap_err();
    assert!(begun.elapsed() < LONG, "{:?}", begun.elapsed());
    stop.store(true, Ordering::Relaxed);
    stranger.join().unwrap();
    error
}

#[test]
fn answers_without_end_to_what_was_not_asked_end_in_a_report_of_them() {
    let other = ToHost::Response { sequence: 40_000, response: Response::Mode(Mode::Standby) };
    let frame = encode_frame(&other, &mut [0; FRAME_BYTES]).unwrap().repeat(400);
    let error = greeted_by(frame);
    let DeviceError::Babbles { heard, .. } = &error else { panic!("{error}") };
    assert!(heard.answers > 1000 && (heard.corrupt, heard.events) == (0, 0), "{error}");
    assert!(error.to_string().contains("answers under other sequence numbers"), "{error}");
}

#[test]
fn text_of_another_program_ends_in_a_report_of_its_bytes() {
    let error = greeted_by(b"SSH-2.0-OpenSSH_9.6\r\n".to_vec());
    assert!(matches!(&error, DeviceError::Babbles { heard, .. } if heard.bytes > 0), "{error}");
    assert!(error.to_string().contains("check the line's speed"), "{error}");
}
