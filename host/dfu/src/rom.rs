//! A boot loader in software: the states of the standard DFU 1.1, the commands and errors of ST's ROM (AN3156), and the tests on it.

use std::collections::BTreeMap;

use firmware_file::{Content, Firmware, KeyPair, Package, Part, ReleaseKey, Seed, read, write};

use crate::{DfuError, Failed, Layout, Session, Transfer, run};

/// Names of the interface of the boards' chips.
pub const F405: &str = "@Internal Flash  /0x08000000/04*016Kg,01*064Kg,07*128Kg";
pub const F446: &str = "@Internal Flash  /0x08000000/04*016Kg,01*064Kg,03*128Kg";

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Idle = 2,
    DownloadSync = 3,
    DownloadBusy = 4,
    DownloadIdle = 5,
    UploadIdle = 9,
    Error = 10,
}

struct Rom {
    layout: Layout,
    flash: BTreeMap<u32, u8>,
    state: State,
    status: u8,
    pointer: u32,
    /// What a download has left to do at the next status.
    pending: Option<(u16, Vec<u8>)>,
    erased: Vec<u32>,
    written: Vec<u32>,
    write_protected: Option<u32>,
    read_protected: bool,
    /// Transfers until it is unplugged.
    lives: usize,
    /// Bit that its flash does not keep.
    worn: Option<u32>,
    /// Status reports while an erase runs.
    busy: u32,
}

impl Rom {
    fn new(layout: &str) -> Self {
        Self {
            layout: Layout::parse(layout).unwrap(),
            flash: BTreeMap::new(),
            state: State::Idle,
            status: 0,
            pointer: 0x0800_0000,
            pending: None,
            erased: vec![],
            written: vec![],
            write_protected: None,
            read_protected: false,
            lives: usize::MAX,
            worn: None,
            busy: 1,
        }
    }

    fn transfer(&mut self, transfer: &Transfer) -> Result<Vec<u8>, Failed> {
        self.lives = self.lives.checked_sub(1).ok_or(Failed::Gone)?;
        match transfer {
            Transfer::Out { request: 1, value, data } => self.download(*value, data),
            Transfer::Out { request: 4, .. } if self.state == State::Error => Ok(self.to(State::Idle)),
            Transfer::Out { request: 6, .. } if self.state != State::Error => Ok(self.to(State::Idle)),
            Transfer::In { request: 2, value, length } => self.upload(*value, *length),
            Transfer::In { request: 3, length: 6, .. } => Ok(self.report()),
            Transfer::Wait(ms) => {
                assert!(*ms > 0);
                Ok(vec![])
            }
            other => panic!("the boot loader knows no {other:?} in the state {:?}", self.state),
        }
    }

    fn to(&mut self, state: State) -> Vec<u8> {
        self.state = state;
        vec![]
    }

    fn stall(&mut self) -> Result<Vec<u8>, Failed> {
        (self.state, self.status) = (State::Error, 15);
        Err(Failed::Stalled)
    }

    fn download(&mut self, block: u16, data: &[u8]) -> Result<Vec<u8>, Failed> {
        if ![State::Idle, State::DownloadIdle].contains(&self.state) || data.is_empty() || data.len() > 2048 {
            return self.stall();
        }
        self.pending = Some((block, data.to_vec()));
        self.busy = 2;
        Ok(self.to(State::DownloadSync))
    }

    fn upload(&mut self, block: u16, length: u16) -> Result<Vec<u8>, Failed> {
        if self.read_protected || block < 2 || ![State::Idle, State::UploadIdle].contains(&self.state) {
            return self.stall();
        }
        self.state = State::UploadIdle;
        let start = self.pointer + u32::from(block - 2) * 2048;
        Ok((start..start + u32::from(length)).map(|at| self.read(at)).collect())
    }

    fn read(&self, address: u32) -> u8 {
        let bit = u8::from(self.worn == Some(address));
        self.flash.get(&address).copied().unwrap_or(0xFF) ^ bit
    }

    /// Status, time until the next one, state. The first status after a download starts its work.
    fn report(&mut self) -> Vec<u8> {
        let mut wait_ms = 0;
        if matches!(self.state, State::DownloadSync | State::DownloadBusy) {
            self.state = State::DownloadBusy;
            self.busy -= 1;
            wait_ms = 100;
            if self.busy == 0 {
                self.status = self.pending.take().map_or(0, |(block, data)| self.carry_out(block, &data));
                self.state = if self.status == 0 { State::DownloadIdle } else { State::Error };
            }
        }
        vec![self.status, wait_ms, 0, 0, self.state as u8, 0]
    }

    /// Carries out a download; its status.
    fn carry_out(&mut self, block: u16, data: &[u8]) -> u8 {
        let address = data.get(1..5).map(|bytes| u32::from_le_bytes(*bytes.first_chunk().unwrap()));
        match (block, data, address) {
            _ if self.read_protected => 11,
            (0, [0x21, ..], Some(address)) if data.len() == 5 => {
                self.pointer = address;
                self.layout.sectors(address, 1).map_or(8, |_| 0)
            }
            (0, [0x41, ..], Some(address)) if data.len() == 5 => self.erase(address),
            (2.., ..) => self.program(self.pointer + u32::from(block - 2) * 2048, data),
            _ => 1,
        }
    }

    fn erase(&mut self, address: u32) -> u8 {
        if self.write_protected == Some(address) {
            return 4;
        }
        self.erased.push(address);
        let next = self.layout.sectors(address, 0x2_0000).ok().and_then(|sectors| sectors.get(1).copied());
        let end = next.unwrap_or(address + 0x2_0000);
        self.flash.retain(|at, _| !(address..end).contains(at));
        0
    }

    fn program(&mut self, start: u32, data: &[u8]) -> u8 {
        self.written.push(start);
        for (at, byte) in (start..).zip(data) {
            assert!(!self.flash.contains_key(&at), "flash at {at:#x} is written without an erase");
            self.flash.insert(at, *byte);
        }
        0
    }
}

fn package(usb_dfu: bool, chip: &str, program: &[u8]) -> Package {
    let pair = KeyPair::from_seed(Seed::new([42; 32]));
    let files = [("p.bin".to_owned(), program.to_vec()), ("weights.bin".to_owned(), vec![7; 5000])].into();
    let part = |content, file: &str, address, bytes: usize| Part {
        content,
        file: file.into(),
        address,
        bytes: bytes as u32,
    };
    let firmware = Firmware {
        version: "0.1.0".into(),
        revision: "1".into(),
        board: "stm32f405".into(),
        chip: chip.into(),
        image: "The main board".into(),
        usb_dfu,
        parts: vec![
            part(Content::Program, "p.bin", 0x0800_0000, program.len()),
            part(Content::Weights, "weights.bin", 0x0804_0000, 5000),
        ],
    };
    read(&write(&firmware, &files, &pair).unwrap(), &ReleaseKey::of(&pair)).unwrap()
}

fn program() -> Vec<u8> {
    (0..20_001_u32).map(|index| (index * 7) as u8).collect()
}

fn session() -> Session {
    Session::new(&package(true, "STM32F405RG", &program()), F405).unwrap()
}

fn flash(rom: &mut Rom) -> Result<(), DfuError> {
    run(session(), |transfer| rom.transfer(transfer), |_, _| {})
}

#[test]
fn a_firmware_is_erased_written_from_the_end_and_read_back() {
    let mut rom = Rom::new(F405);
    let mut seen = vec![];
    run(session(), |transfer| rom.transfer(transfer), |done, all| seen.push((done, all))).unwrap();
    let flashed: Vec<u8> = (0x0800_0000..).take(20_001).map(|at| rom.read(at)).collect();
    assert_eq!(flashed, program());
    assert!((0x0804_0000..0x0804_0000 + 5000).all(|at| rom.read(at) == 7));
    assert_eq!(rom.read(0x0804_0000 + 5000), 0xFF, "nothing beyond");
    let sectors = [0x0800_0000, 0x0800_4000, 0x0804_0000];
    assert_eq!(rom.erased, sectors, "each once, and no other");
    assert!(rom.written.is_sorted_by(|a, b| a > b), "the vector table comes last");
    assert_eq!(rom.state, State::Idle, "the program is not started");
    assert!(seen.is_sorted() && seen.last().is_some_and(|(done, all)| done == all));
}

#[test]
fn flashing_begins_from_whatever_an_interrupted_one_has_left() {
    for state in [State::Error, State::DownloadIdle, State::UploadIdle, State::DownloadSync] {
        let mut rom = Rom { state, status: 3, ..Rom::new(F405) };
        flash(&mut rom).unwrap_or_else(|error| panic!("{state:?}: {error}"));
    }
}

#[test]
fn an_unplugged_board_ends_it_at_any_transfer_and_has_no_half_program() {
    let mut rom = Rom::new(F405);
    flash(&mut rom).unwrap();
    let all = usize::MAX - rom.lives;
    for lives in (0..all).step_by(17) {
        let mut rom = Rom { lives, ..Rom::new(F405) };
        assert_eq!(flash(&mut rom), Err(DfuError::Gone), "after {lives} of {all} transfers");
        let table = rom.read(0x0800_0001) == 7;
        assert!(!table || rom.flash.len() == 25_001, "the vector table is there, so everything is");
        (rom.lives, rom.state) = (usize::MAX, State::Idle);
        flash(&mut rom).unwrap();
    }
}

#[test]
fn a_protected_chip_is_named_with_what_to_do() {
    let mut rom = Rom { write_protected: Some(0x0800_4000), ..Rom::new(F405) };
    assert_eq!(flash(&mut rom), Err(DfuError::Refused { address: 0x0800_4000, status: 4 }));
    assert!(rom.written.is_empty(), "nothing is written before all is erased");
    let mut rom = Rom { read_protected: true, ..Rom::new(F405) };
    assert_eq!(flash(&mut rom), Err(DfuError::ReadProtected));
}

#[test]
fn flash_that_does_not_keep_a_bit_is_detected() {
    let mut rom = Rom { worn: Some(0x0800_1234), ..Rom::new(F405) };
    assert_eq!(flash(&mut rom), Err(DfuError::Differs(0x0800_1234)));
}

#[test]
fn a_device_that_never_gets_ready_ends_it() {
    let answer = |state: u8, wait: u8| {
        move |transfer: &Transfer| match transfer {
            Transfer::In { length: 6, .. } => Ok(vec![0, wait, 0, 0, state, 0]),
            _ => Ok(vec![]),
        }
    };
    assert_eq!(run(session(), answer(5, 0), |_, _| {}), Err(DfuError::State(5)), "never idle");
    let mut first = true;
    let busy = |transfer: &Transfer| {
        let state = if std::mem::take(&mut first) { 2 } else { 4 };
        answer(state, 0)(transfer)
    };
    assert_eq!(run(session(), busy, |_, _| {}), Err(DfuError::State(4)), "always busy, and states no time");
    let short = |_: &Transfer| Ok(vec![0; 3]);
    assert_eq!(run(session(), short, |_, _| {}), Err(DfuError::Gone), "a status that is none");
}

#[test]
fn the_firmware_of_another_chip_is_refused_before_anything_is_erased() {
    let refusal = |usb, chip, layout| Session::new(&package(usb, chip, &program()), layout).unwrap_err();
    let chip = || "STM32F405RG".to_owned();
    let other = DfuError::OtherChip { chip: chip(), expected: 1024, found: 512 };
    assert_eq!(refusal(true, "STM32F405RG", F446), other);
    let other = DfuError::OtherChip { chip: "STM32F446RETx".into(), expected: 512, found: 1024 };
    assert_eq!(refusal(true, "STM32F446RETx", F405), other);
    assert_eq!(refusal(false, "STM32F405RG", F405), DfuError::NoUsb("stm32f405".into()));
    let small = "@Internal Flash  /0x08000000/04*016Kg";
    assert_eq!(refusal(true, "STM32L0", small), DfuError::Outside(0x0804_0000));
    let options = "@Option Bytes  /0x1FFFC000/01*016 e";
    assert_eq!(refusal(true, "STM32F405RG", options), DfuError::NoFlash(options.into()));
}
