//! Tests of the virtual board (QEMU and the shim), with a small probe as its firmware.
//!
//! The probe is the example `probe` of `firmware/shim`; its module documentation lists the requests.
#![cfg(unix)]

use std::fs;
use std::io::{Read, Write};
use std::net::TcpStream;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::time::{Duration, Instant};

use emulator::{Emulator, EmulatorConfig, EmulatorError, FLASH_BYTES, PlantEnd};
use shim::rcc::ResetCause;
use tests::debugger::{Debugger, symbol};

/// Environment variable with the folder of the images.
const IMAGES: &str = "EUPNEA_IMAGES";
/// Offset of the weights slots from the start of the flash, for the flash driver.
const SLOT_A: u32 = 0x000C_0000;
const SLOT_B: u32 = 0x000E_0000;
const SECTOR: u32 = 0x0002_0000;
/// Start of the flash that the file holds: calibrations and copies of the flight recorder come before the weights slots.
const FILE: u32 = SLOT_A - 3 * SECTOR;
/// A branch to itself.
const BRANCH_TO_SELF: [u8; 2] = [0xFE, 0xE7];
/// Longest wait for an answer.
const PATIENCE: Duration = Duration::from_secs(30);
/// Bytes from this value on are a hello, which the probe sends back.
const FIRST_HELLO: u8 = 0x80;
/// Time until the next hello, since the probe may not have opened its port yet.
const AGAIN: Duration = Duration::from_millis(50);

fn image(name: &str) -> PathBuf {
    let folder = std::env::var_os(IMAGES).expect("run: cargo xtask qemu-test");
    Path::new(&folder).join(format!("{name}.elf"))
}

fn config() -> EmulatorConfig {
    EmulatorConfig { firmware: image("probe"), shim: image("shim"), ..EmulatorConfig::default() }
}

/// A plant that echoes every request.
struct Echo;

impl PlantEnd for Echo {
    fn answer(&mut self, request: &[u8]) -> Vec<u8> {
        request.to_vec()
    }
}

/// A plant that never answers.
struct Silence;

impl PlantEnd for Silence {
    fn answer(&mut self, _: &[u8]) -> Vec<u8> {
        Vec::new()
    }
}

/// A board with the probe.
struct Probe {
    board: Emulator,
    link: TcpStream,
}

impl Probe {
    fn start(config: EmulatorConfig) -> Self {
        Self::with(config, Echo)
    }

    fn with(config: EmulatorConfig, plant: impl PlantEnd + Send + 'static) -> Self {
        let board = Emulator::start(config, plant).expect("the board starts");
        let link = TcpStream::connect(board.address()).expect("the link is open");
        link.set_nodelay(true).unwrap();
        let mut probe = Self { board, link };
        probe.await_start();
        probe
    }

    /// Sends hellos until the probe answers the latest one, so that no answer is left unread.
    fn await_start(&mut self) {
        self.link.set_read_timeout(Some(AGAIN)).unwrap();
        let begun = Instant::now();
        for hello in (FIRST_HELLO..=u8::MAX).cycle() {
            assert!(
                begun.elapsed() < PATIENCE,
                "the probe does not answer; QEMU said:\n{}",
                self.board.log()
            );
            self.link.write_all(&[hello]).unwrap();
            let mut answer = [0; 1];
            while self.link.read_exact(&mut answer).is_ok() {
                if answer == [hello] {
                    self.link.set_read_timeout(Some(PATIENCE)).unwrap();
                    return;
                }
            }
        }
    }

    fn send(&mut self, letter: u8, a: u32, b: u32) {
        let mut request = [0; 12];
        request[0] = letter;
        request[4..8].copy_from_slice(&a.to_le_bytes());
        request[8..].copy_from_slice(&b.to_le_bytes());
        self.link.write_all(&request).unwrap();
    }

    fn ask(&mut self, letter: u8, a: u32, b: u32) -> [u32; 2] {
        self.send(letter, a, b);
        let mut answer = [0; 8];
        let read = self.link.read_exact(&mut answer);
        read.unwrap_or_else(|error| panic!("{}: {error}; QEMU said:\n{}", letter as char, self.board.log()));
        let [first, second] = [0, 4].map(|at| u32::from_le_bytes([0, 1, 2, 3].map(|n| answer[at + n])));
        [first, second]
    }

    /// Makes the board restart, and waits until it has restarted.
    fn restart_by(&mut self, letter: u8, a: u32) {
        self.send(letter, a, 0);
        self.await_start();
    }

    fn reset_flags(&mut self) -> u32 {
        self.ask(b'c', 0, 0)[0]
    }

    fn word(&mut self, offset: u32) -> u32 {
        self.ask(b'r', offset, 0)[0]
    }

    fn program(&mut self, offset: u32, value: u32) {
        assert_eq!(self.ask(b'p', offset, value)[0], 0, "programming is accepted");
    }
}

#[test]
fn the_clocks_start_and_the_core_runs_at_168_mhz() {
    let [flags, clock] = Probe::start(config()).ask(b'c', 0, 0);
    assert_eq!(clock, 168_000_000);
    assert_eq!(flags & 0xFE00_0000, ResetCause::PowerOn.flags());
}

#[test]
fn programming_clears_bits_and_only_erasing_sets_them() {
    let mut probe = Probe::start(config());
    assert_eq!(probe.word(SLOT_A), 0xFFFF_FFFF, "a new board's flash is erased");
    probe.program(SLOT_A, 0xFFFF_0FF0);
    probe.program(SLOT_A, 0x0FFF_FFFF);
    assert_eq!(probe.word(SLOT_A), 0x0FFF_0FF0);
    probe.program(SLOT_B + SECTOR - 4, 0x1234_5678);
    assert_eq!(probe.ask(b'e', SLOT_A, SECTOR)[0], 0, "erasing is accepted");
    assert_eq!(probe.word(SLOT_A), 0xFFFF_FFFF);
    assert_eq!(probe.word(SLOT_B + SECTOR - 4), 0x1234_5678, "the other slot is left alone");
}

#[test]
fn the_programs_own_sectors_are_not_erased() {
    let mut probe = Probe::start(config());
    assert_eq!(probe.ask(b'e', FILE - SECTOR, SECTOR)[0], 1);
}

#[test]
fn what_was_programmed_outlives_a_reset() {
    let mut probe = Probe::start(config());
    probe.program(SLOT_A + 16, 0xCAFE_F00D);
    probe.restart_by(b's', 0);
    assert_eq!(probe.word(SLOT_A + 16), 0xCAFE_F00D);
    assert_eq!(probe.reset_flags() & 0xFE00_0000, ResetCause::Software.flags());
}

#[test]
fn what_was_programmed_outlives_a_loss_of_power_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let on = || EmulatorConfig { folder: Some(folder.path().to_owned()), ..config() };
    for number in 0..5 {
        let mut probe = Probe::start(on());
        probe.program(SLOT_B + 4 * number, number);
        probe.board.kill();
        let flash = probe.board.flash().unwrap();
        assert_eq!(flash.len(), FLASH_BYTES);
        let at = (SLOT_B - FILE + 4 * number) as usize;
        assert_eq!(flash[at..at + 4], number.to_le_bytes());
    }
    let mut probe = Probe::start(on());
    assert_eq!([0, 1, 2, 3, 4].map(|number| probe.word(SLOT_B + 4 * number)), [0, 1, 2, 3, 4]);
    assert_eq!(probe.reset_flags() & 0xFE00_0000, ResetCause::PowerOn.flags());
}

#[test]
fn a_board_starts_with_the_flash_it_is_given() {
    let flash = (0..FLASH_BYTES).map(|n| (n / 4) as u8).collect();
    let mut probe = Probe::start(EmulatorConfig { flash: Some(flash), ..config() });
    assert_eq!(probe.word(SLOT_A + 4 * 7), 0x0707_0707);
}

#[test]
fn a_fed_watchdog_leaves_the_board_alone() {
    let mut probe = Probe::start(EmulatorConfig { debugger: true, ..config() });
    assert_eq!(probe.ask(b'f', 500, 5_000)[0], 500, "all of it without a reset");
    let mut debugger = Debugger::connect(probe.board.debugger_address().unwrap()).unwrap();
    let record = debugger.record().unwrap();
    assert_eq!(record.starts, record.watchdog_resets + 1);
    assert!(record.feeds >= 500, "{record:?}");
    assert!((900_000..=5_000_000).contains(&record.longest_gap_ns), "{record:?}");
}

#[test]
fn a_hung_image_is_reset_and_can_read_the_cause() {
    let mut probe = Probe::start(config());
    probe.reset_flags();
    probe.restart_by(b'h', 50_000);
    assert_eq!(probe.reset_flags() & 0xFE00_0000, ResetCause::Watchdog.flags());
    probe.restart_by(b's', 0);
    assert_eq!(
        probe.reset_flags() & 0xFE00_0000,
        ResetCause::Software.flags(),
        "the cause is reported for one start"
    );
}

#[test]
fn a_debugger_hangs_the_image_and_the_watchdog_frees_it() {
    let mut probe = Probe::start(EmulatorConfig { debugger: true, ..config() });
    probe.send(b'f', u32::MAX, 50_000);
    let mut debugger = Debugger::connect(probe.board.debugger_address().unwrap()).unwrap();
    let [main, feed] = ["main", "probe_feed"].map(|name| symbol(&image("probe"), name).unwrap());
    debugger.run_to(feed).unwrap();
    assert_eq!(debugger.registers().unwrap()[15], feed);
    let kept = debugger.read(feed, 2).unwrap();
    debugger.write(feed, &BRANCH_TO_SELF).unwrap();
    // The change survives the reset, so undo it at the start of the next run.
    debugger.run_to(main).unwrap();
    debugger.write(feed, &kept).unwrap();
    let record = debugger.record().unwrap();
    assert_eq!((record.starts, record.watchdog_resets), (2, 1));
    debugger.detach().unwrap();
    probe.await_start();
    assert_eq!(probe.reset_flags() & ResetCause::Watchdog.flags(), ResetCause::Watchdog.flags());
}

#[test]
fn the_debugger_sees_the_pins() {
    let probe = Probe::start(EmulatorConfig { debugger: true, ..config() });
    let mut debugger = Debugger::connect(probe.board.debugger_address().unwrap()).unwrap();
    let [a, _] = debugger.record().unwrap().ports;
    let alternate = 2;
    for pin in [2, 3, 9, 10] {
        assert_eq!(a.mode(pin), alternate, "the serial ports' pin {pin}");
    }
}

#[test]
fn frames_go_to_the_plant_and_back_in_every_tick() {
    let mut probe = Probe::start(EmulatorConfig { debugger: true, ..config() });
    let ticks = 5_000;
    let begun = Instant::now();
    let [good, instructions] = probe.ask(b'x', ticks, 0);
    let seconds = begun.elapsed().as_secs_f64();
    println!("exchange: {instructions} instructions; {:.1} x real time", f64::from(ticks) / 1000.0 / seconds);
    assert_eq!(good, ticks);
    assert!(instructions < 20_000, "an exchange must fit into a tick beside the rest: {instructions}");
}

#[test]
fn a_trap_costs_few_instructions() {
    let [clocks, port] = Probe::start(config()).ask(b'm', 0, 0);
    println!("a load from the clocks: {clocks} instructions, a look at the plant port: {port}");
    assert!(clocks <= 200 && port <= 200, "{clocks} {port}");
}

#[test]
fn a_silent_plant_holds_nothing_up() {
    let mut probe = Probe::with(config(), Silence);
    assert_eq!(probe.ask(b'x', 20, 0)[0], 0);
    assert_eq!(probe.ask(b'c', 0, 0)[1], 168_000_000);
}

#[test]
fn the_plant_stays_on_the_line_over_a_reset() {
    let mut probe = Probe::start(config());
    assert_eq!(probe.ask(b'x', 10, 0)[0], 10);
    probe.restart_by(b's', 0);
    assert_eq!(probe.ask(b'x', 10, 0)[0], 10);
}

#[test]
fn a_plant_that_breaks_ends_the_board() {
    struct Broken;
    impl PlantEnd for Broken {
        fn answer(&mut self, request: &[u8]) -> Vec<u8> {
            assert!(request.is_empty(), "this test lets the plant fail");
            Vec::new()
        }
    }
    let mut probe = Probe::with(config(), Broken);
    probe.send(b'x', 1, 0);
    let status = probe.board.wait().unwrap();
    assert_eq!(status.code(), Some(shim::EXIT_CODE as i32));
    assert!(probe.board.log().contains("the plant has closed the line"), "{}", probe.board.log());
}

#[test]
fn a_dropped_board_leaves_nothing_behind() {
    let folder = tempfile::tempdir().unwrap();
    let probe = Probe::start(EmulatorConfig { folder: Some(folder.path().to_owned()), ..config() });
    let mark = folder.path().to_str().unwrap().to_owned();
    assert_eq!(processes_in(&mark), 1);
    drop(probe);
    assert_eq!(processes_in(&mark), 0);
}

/// Number of QEMU processes with this working folder.
fn processes_in(folder: &str) -> usize {
    let processes = fs::read_dir("/proc").unwrap().flatten();
    let works_there = |entry: &fs::DirEntry| {
        let name = fs::read_to_string(entry.path().join("comm")).unwrap_or_default();
        let place = fs::read_link(entry.path().join("cwd"));
        name.starts_with("qemu") && place.is_ok_and(|place| place.to_str() == Some(folder))
    };
    processes.filter(works_there).count()
}

/// Runs in a separate process, which the test below kills.
#[test]
fn a_killed_parent_child_process() {
    let Some(folder) = std::env::var_os("EUPNEA_PARENT_FOLDER") else { return };
    let _probe = Probe::start(EmulatorConfig { folder: Some(folder.into()), ..config() });
    loop {
        std::thread::park();
    }
}

#[test]
fn a_killed_parent_takes_the_board_with_it() {
    let folder = tempfile::tempdir().unwrap();
    let mark = folder.path().to_str().unwrap();
    let mut parent = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", "a_killed_parent_child_process"])
        .env("EUPNEA_PARENT_FOLDER", folder.path())
        .spawn()
        .unwrap();
    let until = |count: usize| {
        let begun = Instant::now();
        while processes_in(mark) != count {
            assert!(begun.elapsed() < PATIENCE, "{count} boards were expected");
            std::thread::sleep(Duration::from_millis(20));
        }
    };
    until(1);
    parent.kill().unwrap();
    parent.wait().unwrap();
    until(0);
}

#[test]
fn an_image_that_is_none_ends_with_what_qemu_said() {
    // For another processor.
    let wrong = std::env::current_exe().unwrap();
    let refused = Emulator::start(EmulatorConfig { firmware: wrong, ..config() }, Echo);
    let error = refused.err().map(|error| (error.to_string(), matches!(error, EmulatorError::Ended { .. })));
    let (text, ended) = error.expect("it does not start");
    assert!(ended && text.contains("qemu-system-arm"), "{text}");
}

#[test]
fn a_file_that_is_no_image_is_refused() {
    let wrong = tempfile::NamedTempFile::new().unwrap();
    fs::write(wrong.path(), "no image").unwrap();
    let config = EmulatorConfig { shim: wrong.path().to_owned(), ..config() };
    assert!(matches!(Emulator::start(config, Echo), Err(EmulatorError::ImageMissing(_))));
}
