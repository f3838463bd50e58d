//! The virtual board: the unchanged firmware image in QEMU, with a plant on its plant line and a link to connect to.
//!
//! QEMU models the core and some of the chip; the package `shim` models the rest. Time on the board is virtual: it
//! passes with the instructions executed and stops while the plant computes an answer, so a run does not depend on the
//! speed of the machine.

#![forbid(unsafe_code)]
#![cfg(unix)]

mod error;
mod guardian;
mod lockstep;
mod pipes;
mod processor;
mod qemu;

pub use error::{EmulatorError, FLASH_BYTES};
pub use lockstep::{LockstepPlant, Paced, PlantEnd};

use std::fs::{self, File};
use std::io::Read;
use std::net::{IpAddr, Ipv4Addr, SocketAddr, TcpListener};
use std::path::{Path, PathBuf};
use std::process::ExitStatus;
use std::time::{Duration, Instant};

use shim::backup::Domain;
use tempfile::TempDir;

use error::tried;
use guardian::{Guarded, Surroundings};
use pipes::{PlantThread, name};

/// File with the output of QEMU and the shim.
const LOG_FILE: &str = "qemu.log";
/// File locked while a board runs in a folder.
const LOCK_FILE: &str = "running.lock";
/// Longest time for the shim to start, even on a busy machine.
const START_PATIENCE: Duration = Duration::from_mins(1);
/// Interval of the checks whether QEMU is alive while it starts.
const LOOK: Duration = Duration::from_millis(20);

/// Configuration of a virtual board.
#[derive(Clone, Debug, Default)]
pub struct EmulatorConfig {
    /// The firmware's ELF file.
    pub firmware: PathBuf,
    /// The shim's ELF file.
    pub shim: PathBuf,
    /// Folder of the board, for one board at a time; it keeps the flash and the backup domain between runs. `None`: a temporary folder.
    pub folder: Option<PathBuf>,
    /// Address at which the link listens, where port 0 picks a free one. `None`: a free port of this machine.
    pub link: Option<SocketAddr>,
    /// Content of the changeable sectors of the flash, [`FLASH_BYTES`] bytes. `None`: the folder's content; erased in a new folder.
    pub flash: Option<Vec<u8>>,
    /// How long the supply was away since the folder's last board, while a cell supplied the backup domain; counted from the
    /// last second that the board's calendar clock had begun. `None`: there was no cell, so the domain has lost its content.
    pub supply_away: Option<Duration>,
    /// Whether a debugger can connect.
    pub debugger: bool,
}

/// Picks a free port of this machine.
const FREE_PORT: SocketAddr = SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0);

/// Opens a listening socket; returns its address too.
fn listen(address: SocketAddr) -> Result<(SocketAddr, TcpListener), EmulatorError> {
    let listener = TcpListener::bind(address);
    let listener = listener.and_then(|listener| Ok((listener.local_addr()?, listener)));
    listener.map_err(|error| EmulatorError::Listen { address, error })
}

/// A running virtual board. Dropping it ends QEMU and the plant's thread.
#[derive(Debug)]
pub struct Emulator {
    qemu: Guarded,
    plant: PlantThread,
    address: SocketAddr,
    debugger: Option<SocketAddr>,
    folder: Folder,
}

impl Emulator {
    /// Starts a board with a plant on its line; the firmware starts running. Bytes that reach the link before the
    /// firmware has opened its port are lost.
    ///
    /// # Errors
    /// QEMU or an image is missing, or they do not start together.
    pub fn start(
        config: EmulatorConfig,
        plant: impl PlantEnd + Send + 'static,
    ) -> Result<Self, EmulatorError> {
        qemu::check()?;
        for image in [&config.firmware, &config.shim] {
            if !is_elf(image) {
                return Err(EmulatorError::ImageMissing(image.clone()));
            }
        }
        let images = [config.firmware, config.shim].map(|image| std::path::absolute(&image).unwrap_or(image));
        let folder = Folder::open(config.folder, config.flash)?;
        folder.outlast(config.supply_away)?;
        let (address, link) = listen(config.link.unwrap_or(FREE_PORT))?;
        let (debugger, debug_port) =
            if config.debugger { Some(listen(FREE_PORT)?).unzip() } else { (None, None) };
        let plant =
            PlantThread::start(&folder.path, plant).map_err(tried("cannot open the plant's pipes"))?;
        let command = qemu::command(&images[0], &images[1], config.debugger);
        let log = Path::new(LOG_FILE);
        let surroundings = Surroundings { folder: &folder.path, log, input: Some(link), output: debug_port };
        let qemu = Guarded::start(&command, surroundings).map_err(tried("cannot start QEMU"))?;
        let mut emulator = Self { qemu, plant, address, debugger, folder };
        emulator.await_shim(&images)?;
        Ok(emulator)
    }

    /// Waits until the shim reports over the plant line.
    fn await_shim(&mut self, [firmware, shim]: &[PathBuf; 2]) -> Result<(), EmulatorError> {
        let begun = Instant::now();
        loop {
            if self.plant.started(LOOK) {
                self.plant.release();
                return Ok(());
            }
            let ended = self.qemu.exit_status().map_err(tried("cannot check whether QEMU runs"))?;
            if let Some(status) = ended {
                return Err(EmulatorError::Ended { status, log: self.log() });
            }
            if begun.elapsed() > START_PATIENCE {
                let (firmware, shim) = (firmware.clone(), shim.clone());
                return Err(EmulatorError::Silent { firmware, shim, log: self.log() });
            }
        }
    }

    /// Address of the link; it serves one connection at a time.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// Address for a debugger, if enabled.
    pub fn debugger_address(&self) -> Option<SocketAddr> {
        self.debugger
    }

    /// The present content of the changeable sectors of the flash, [`FLASH_BYTES`] bytes.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn flash(&self) -> Result<Vec<u8>, EmulatorError> {
        fs::read(self.folder.flash()).map_err(tried("cannot read the board's flash"))
    }

    /// The file with the backup domain, [`shim::backup::BYTES`] long once the board has started.
    pub fn backup(&self) -> PathBuf {
        self.folder.backup()
    }

    /// The output of QEMU and the shim so far.
    pub fn log(&self) -> String {
        let log = fs::read(self.folder.path.join(LOG_FILE)).unwrap_or_default();
        String::from_utf8_lossy(&log).trim_end().to_owned()
    }

    /// How QEMU ended; `None` while it runs.
    ///
    /// # Errors
    /// The system cannot report it.
    pub fn exit_status(&mut self) -> Result<Option<ExitStatus>, EmulatorError> {
        self.qemu.exit_status().map_err(tried("cannot check whether QEMU runs"))
    }

    /// Waits until QEMU ends by itself.
    ///
    /// # Errors
    /// The system cannot report it.
    pub fn wait(&mut self) -> Result<ExitStatus, EmulatorError> {
        self.qemu.wait().map_err(tried("cannot wait for QEMU"))
    }

    /// Cuts the power, at any instant; data stored in flash remains. Further calls have no effect.
    pub fn kill(&mut self) {
        self.qemu.kill();
        self.plant.end();
    }
}

impl Drop for Emulator {
    fn drop(&mut self) {
        self.kill();
    }
}

/// Whether a file starts like an ELF file; QEMU would load any other file as raw data.
fn is_elf(path: &Path) -> bool {
    let mut start = [0; 4];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut start));
    read.is_ok() && start == *b"\x7fELF"
}

/// The locked folder of a board.
#[derive(Debug)]
struct Folder {
    path: PathBuf,
    _lock: File,
    /// Removes the folder when dropped.
    _temporary: Option<TempDir>,
}

impl Folder {
    fn open(given: Option<PathBuf>, flash: Option<Vec<u8>>) -> Result<Self, EmulatorError> {
        let (path, temporary) = if let Some(path) = given {
            (path, None)
        } else {
            let folder = tempfile::Builder::new().prefix("eupnea-board-").tempdir();
            let folder = folder.map_err(tried("cannot make a temporary folder"))?;
            (folder.path().to_owned(), Some(folder))
        };
        fs::create_dir_all(&path).map_err(tried("cannot make the board's folder"))?;
        let lock = File::create(path.join(LOCK_FILE)).map_err(tried("cannot write to the board's folder"))?;
        if lock.try_lock().is_err() {
            return Err(EmulatorError::FolderInUse(path));
        }
        let folder = Self { path, _lock: lock, _temporary: temporary };
        if let Some(flash) = flash {
            if flash.len() != FLASH_BYTES {
                return Err(EmulatorError::FlashSize(flash.len()));
            }
            fs::write(folder.flash(), flash).map_err(tried("cannot write the board's flash"))?;
        }
        Ok(folder)
    }

    fn flash(&self) -> PathBuf {
        self.path.join(name(shim::FLASH_FILE))
    }

    fn backup(&self) -> PathBuf {
        self.path.join(name(shim::BACKUP_FILE))
    }

    /// Lets the backup domain outlast a time without supply, or lose its content.
    fn outlast(&self, supply_away: Option<Duration>) -> Result<(), EmulatorError> {
        let kept = fs::read(self.backup()).ok().filter(|_| supply_away.is_some());
        let mut domain = match kept.as_deref().map(<&[u8; shim::backup::BYTES]>::try_from) {
            Some(Ok(bytes)) => Domain::from_bytes(bytes),
            _ => Domain::new(),
        };
        let seconds = supply_away.unwrap_or_default().as_secs();
        domain.outlast(u32::try_from(seconds).unwrap_or(u32::MAX));
        let bytes: Vec<u8> = domain.words().iter().flat_map(|word| word.to_le_bytes()).collect();
        fs::write(self.backup(), bytes).map_err(tried("cannot write the board's backup domain"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_folder_holds_one_board_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let open = || Folder::open(Some(folder.path().join("board")), None);
        let first = open().unwrap();
        assert!(matches!(open(), Err(EmulatorError::FolderInUse(_))));
        drop(first);
        assert!(open().is_ok());
    }

    #[test]
    fn the_flash_must_fill_all_sectors() {
        let refused = Folder::open(None, Some(vec![0; 1000]));
        assert!(matches!(refused, Err(EmulatorError::FlashSize(1000))));
        let folder = Folder::open(None, Some(vec![7; FLASH_BYTES])).unwrap();
        assert_eq!(fs::read(folder.flash()).unwrap().len(), FLASH_BYTES);
    }

    #[test]
    fn the_backup_domain_outlasts_the_supply_with_a_cell_alone() {
        let folder = Folder::open(None, None).unwrap();
        let new = || Domain::new().words().iter().flat_map(|word| word.to_le_bytes()).collect::<Vec<u8>>();
        folder.outlast(Some(Duration::from_secs(5))).unwrap();
        assert_eq!(fs::read(folder.backup()).unwrap(), new());
        let mut bytes = new();
        // The regulator of its memory is on.
        let end = bytes.len() - 4;
        (bytes[0], bytes[end]) = (7, 1);
        fs::write(folder.backup(), &bytes).unwrap();
        folder.outlast(Some(Duration::from_secs(5))).unwrap();
        assert_eq!(fs::read(folder.backup()).unwrap(), bytes);
        folder.outlast(None).unwrap();
        assert_eq!(fs::read(folder.backup()).unwrap(), new());
    }

    #[test]
    fn a_temporary_folder_goes_with_its_board() {
        let folder = Folder::open(None, None).unwrap();
        let path = folder.path.clone();
        assert!(path.is_dir());
        drop(folder);
        assert!(!path.exists());
    }

    #[test]
    fn errors_say_what_to_do() {
        assert!(EmulatorError::QemuMissing.to_string().ends_with("run: cargo xtask setup"));
        let missing = EmulatorError::ImageMissing("a/firmware".into()).to_string();
        assert_eq!(missing, "a/firmware is missing or not an ELF image; run: cargo xtask firmware");
    }
}
