//! Access to files of the host: the slots, and the pipes to and from the plant.

use shim::backup::{self, Domain};
use shim::bus::Outside;
use shim::flash::{ERASED, Operation, SLOTS, SLOTS_BYTES};
use shim::plant_port::Line;
use shim::record::{Handles, Record};

use super::registers;
use super::semihosting::{self, CREATE, READ, UPDATE, write};

/// Bytes written at once for an erase.
const PAGE: usize = 512;
/// Bytes sent to the plant at once.
const PIECE: usize = 256;

static ERASED_PAGE: [u8; PAGE] = [ERASED; PAGE];
/// Unread bytes of the plant's answer.
static mut ANSWER_LEFT: u32 = 0;

/// Opens all files that are not open since an earlier start, and loads the slots.
pub fn open(record: &mut Record) {
    if record.files.flash == 0 {
        let name = shim::FLASH_FILE;
        let file = semihosting::open(name, UPDATE).or_else(|| semihosting::open(name, CREATE));
        let Some(file) = file else { semihosting::fail(c"shim: cannot open or create flash.bin\n") };
        record.files.flash = file;
        let present = semihosting::length(file).min(SLOTS_BYTES);
        erase(file, present, SLOTS_BYTES - present);
        open_backup(record);
        open_plant(record);
    }
    load(record.files.flash, 0, SLOTS_BYTES);
}

/// Opens the file with the backup domain, and loads it; a new one contains a domain whose cell was just inserted.
fn open_backup(record: &mut Record) {
    let name = shim::BACKUP_FILE;
    let file = semihosting::open(name, UPDATE).or_else(|| semihosting::open(name, CREATE));
    let Some(file) = file else { semihosting::fail(c"shim: cannot open or create backup.bin\n") };
    record.files.backup = file;
    if semihosting::length(file) == backup::BYTES as u32 {
        // SAFETY: nothing else uses the domain yet, and any content of it is valid.
        unsafe { semihosting::read_to(file, backup::ADDRESS, backup::BYTES as u32) };
    } else {
        // SAFETY: as above.
        unsafe { super::domain() }.renew();
        (0..backup::WORDS).for_each(|place| Files(record.files).keep(place));
    }
}

/// Opens the pipes to the plant, if they exist, and reports the shim's start to the host.
fn open_plant(record: &mut Record) {
    let answer = semihosting::open(shim::ANSWER_PIPE, READ);
    let request = answer.and_then(|_| semihosting::open(shim::REQUEST_PIPE, UPDATE));
    if let (Some(request), Some(answer)) = (request, answer) {
        (record.files.request, record.files.answer) = (request, answer);
        Files(record.files).send(&[]);
    }
}

/// Writes erased bytes to the file.
fn erase(file: u32, offset: u32, bytes: u32) {
    semihosting::seek(file, offset);
    let mut left = bytes as usize;
    while left > 0 {
        let page = &ERASED_PAGE[..left.min(PAGE)];
        write(file, page);
        left -= page.len();
    }
}

/// Loads a part of the slots from the file.
fn load(file: u32, offset: u32, bytes: u32) {
    semihosting::seek(file, offset);
    // SAFETY: the slots are memory of the firmware, whose content changes on the chip as well when flash is erased or
    // programmed.
    let read = unsafe { semihosting::read_to(file, SLOTS + offset, bytes) };
    if read != bytes {
        semihosting::fail(c"shim: flash.bin is too short\n");
    }
}

/// Environment of the models, implemented by the open files.
pub struct Files(pub Handles);

impl Line for Files {
    fn send(&mut self, bytes: &[u8]) {
        if self.0.request == 0 {
            return;
        }
        let mut frame = [0; 2 + PIECE];
        let bytes = &bytes[..bytes.len().min(PIECE)];
        frame[..2].copy_from_slice(&(bytes.len() as u16).to_le_bytes());
        frame[2..2 + bytes.len()].copy_from_slice(bytes);
        // In one write: with a part of a frame the host would wait for the rest.
        write(self.0.request, &frame[..2 + bytes.len()]);
        let mut length = [0; 2];
        self.read(&mut length[..1]);
        self.read(&mut length[1..]);
        // SAFETY: only the hard fault, the system tick while the line is idle and, before them, the start use it.
        unsafe { ANSWER_LEFT = u16::from_le_bytes(length).into() };
    }

    #[inline]
    fn receive(&mut self, bytes: &mut [u8]) -> usize {
        // SAFETY: as above.
        let left = unsafe { ANSWER_LEFT } as usize;
        if left == 0 {
            return 0;
        }
        let length = left.min(bytes.len());
        let read = self.read(&mut bytes[..length]);
        // SAFETY: as above.
        unsafe { ANSWER_LEFT -= read as u32 };
        read
    }
}

impl Files {
    /// Reads bytes of the plant's answer, at least one.
    fn read(&mut self, bytes: &mut [u8]) -> usize {
        match semihosting::read(self.0.answer, bytes) {
            // The process that started QEMU has ended, so QEMU must end too.
            0 => semihosting::fail(c"shim: the plant has closed the line\n"),
            read => read,
        }
    }
}

impl Outside for Files {
    #[inline]
    fn now(&mut self) -> u32 {
        registers::now()
    }

    fn change(&mut self, operation: Operation) {
        // The file first: data that the firmware has seen as stored survives the end of QEMU.
        let file = self.0.flash;
        match operation {
            Operation::Erase { address, bytes } => {
                erase(file, address - SLOTS, bytes);
                load(file, address - SLOTS, bytes);
            }
            Operation::Program { address, width, value } => {
                let (word, shift) = (address & !3, 8 * (address & 3));
                let ones = !(width.mask() << shift);
                let value = registers::read(word) & (ones | value << shift);
                semihosting::seek(file, word - SLOTS);
                write(file, &value.to_le_bytes());
                load(file, word - SLOTS, 4);
            }
        }
    }

    fn domain(&mut self) -> &mut Domain {
        // SAFETY: only the hard fault, the system tick and, before them, the start use it, and none of them while another does.
        unsafe { super::domain() }
    }

    fn keep(&mut self, place: usize) {
        semihosting::seek(self.0.backup, 4 * place as u32);
        let word = self.domain().words()[place % backup::WORDS];
        write(self.0.backup, &word.to_le_bytes());
    }

    fn cut_power(&mut self) {
        semihosting::fail(c"shim: power cut\n")
    }
}
