//! A [`virtual_chip`] at the end of any line, at the pace of a clock: it replaces the firmware where there is no emulator, and lets
//! tests examine the line's effect on a device.

mod served;

use std::io::{Read, Write};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, channel};
use std::thread::{self, JoinHandle};
use std::time::{Duration, Instant};

use shared::breath::DEFAULT_PERIOD_US;
use shared::recorder::RecorderMemory;
use shared::ventilator::Mode;

use crate::line::patient;
use crate::port::Port;
use plant::bench::{BenchConfig, BenchError, BenchPlant};
pub use served::{ServeError, Served, ServedConfig};
use virtual_chip::Chip;
pub use virtual_chip::PlantFault;

/// Number of control ticks between two checks of the line.
const TICKS_AT_ONCE: usize = 16;
/// Pause between checks in standby.
const STANDBY_PAUSE: Duration = Duration::from_millis(1);
/// Largest factor by which a simulated device is faster than a chip: its flight recorder must not overwrite entries faster than a
/// host can read them.
pub const MOST_PACE: u32 = 100;

/// A running simulated device; ends when dropped.
pub struct Simulated {
    stop: Arc<AtomicBool>,
    thread: Option<JoinHandle<()>>,
}

impl Simulated {
    /// Runs a device on a bench at the end of a line, at most [`MOST_PACE`] times as fast as a chip.
    ///
    /// # Errors
    /// A bench that cannot be built.
    pub fn start(bench: &BenchConfig, port: Port) -> Result<Self, BenchError> {
        // Report a bench that cannot be built here, not in the thread.
        let bench = BenchPlant::new(bench)?;
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = Arc::clone(&stop);
        let thread = thread::spawn(move || {
            // It survives the device's resets, like the chip's memory.
            let memory = Box::new(RecorderMemory::new());
            Paced::new(Chip::new(bench, &memory), MOST_PACE).run(port, &stopped);
        });
        Ok(Self { stop, thread: Some(thread) })
    }
}

impl Drop for Simulated {
    fn drop(&mut self) {
        self.stop.store(true, Ordering::Relaxed);
        if let Some(thread) = self.thread.take() {
            // A device that panicked has already reported it.
            let _ = thread.join();
        }
    }
}

/// A chip that runs at the pace of a clock.
struct Paced<'a> {
    chip: Chip<'a>,
    /// Shortest time of [`TICKS_AT_ONCE`] ticks while it ventilates.
    ticks_time: Duration,
    /// Faults to inject, if the device is served.
    injected: Option<Receiver<PlantFault>>,
}

impl<'a> Paced<'a> {
    /// A chip that runs at most `pace` times as fast as a real one.
    fn new(chip: Chip<'a>, pace: u32) -> Self {
        let period = Duration::from_micros(u64::from(DEFAULT_PERIOD_US));
        Self { chip, ticks_time: period * TICKS_AT_ONCE as u32 / pace, injected: None }
    }

    /// Runs ticks and handles the line until it ends.
    fn run(&mut self, port: Port, stop: &Arc<AtomicBool>) {
        let (mut writer, heard) = (port.writer, listen(port.reader, Arc::clone(stop)));
        while !stop.load(Ordering::Relaxed) {
            match heard.recv_timeout(self.ticks()) {
                Ok(bytes) => bytes.iter().for_each(|byte| self.chip.hear(*byte)),
                Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => return,
            }
            if writer.write_all(self.chip.out()).is_err() {
                return;
            }
            self.chip.out().clear();
        }
    }

    /// Runs a few ticks; returns the time until the next ones are due.
    fn ticks(&mut self) -> Duration {
        let begun = Instant::now();
        self.take_faults();
        for _ in 0..TICKS_AT_ONCE {
            self.chip.tick();
        }
        // Nothing is measured in standby, so there is no hurry.
        match self.chip.mode() {
            Mode::Ventilating => self.ticks_time.saturating_sub(begun.elapsed()),
            _ => STANDBY_PAUSE,
        }
    }
}

/// Reads a line in its own thread.
fn listen(mut reader: Box<dyn Read + Send>, stop: Arc<AtomicBool>) -> Receiver<Vec<u8>> {
    let (bytes, heard) = channel();
    thread::spawn(move || {
        let mut chunk = [0; 256];
        while !stop.load(Ordering::Relaxed) {
            match reader.read(&mut chunk) {
                Ok(0) => return,
                Ok(count) if bytes.send(chunk[..count].to_vec()).is_err() => return,
                Ok(_) => {}
                Err(error) if patient(error.kind()) => {}
                Err(_) => return,
            }
        }
    });
    heard
}
