//! Origin of a recording, a simulator or a report, with enough detail to reproduce it.

use std::fs::File;
use std::io::{self, Read};
use std::process::Command;
use std::sync::OnceLock;

use crc::{CRC_64_XZ, Crc, Table};
use serde::{Deserialize, Serialize};

use crate::identity::TestRun;

/// Version of the recording format; this program writes and reads only this one.
pub const FORMAT: u32 = 1;

/// Origin of a recording, stored as JSON beside the data.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Version of the recording format, [`FORMAT`].
    pub format: u32,
    /// Control period in microseconds.
    pub period_us: u32,
    /// Revision of the program, see [`git_revision`].
    pub git_revision: String,
    /// Seed of all random numbers.
    pub seed: u64,
    /// Name of the plant: a bench preset, a ventilator, a data set.
    pub plant: String,
    /// Parameters of the plant as TOML; empty if unknown.
    pub plant_parameters: String,
    /// Settings in force, as the recording command interpreted them.
    pub settings: serde_json::Value,
    /// Id of the controller's weights; empty if a PID ran alone.
    pub weights_id: String,
    /// Source of the rows: a bench, a port, an imported table.
    pub source: String,
    /// Test runs, indexed by the column `group`, such as `CT_AIR:3`.
    #[serde(default)]
    pub groups: Vec<TestRun>,
    /// Remarks for people.
    pub notes: Vec<String>,
}

impl Provenance {
    /// Origin with only this program's revision, the control period and the source filled in.
    pub fn new(period_us: u32, source: impl Into<String>) -> Self {
        Self {
            format: FORMAT,
            period_us,
            git_revision: git_revision(),
            seed: 0,
            plant: String::new(),
            plant_parameters: String::new(),
            settings: serde_json::Value::Null,
            weights_id: String::new(),
            source: source.into(),
            groups: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// Control period in seconds.
    pub fn period_s(&self) -> f64 {
        f64::from(self.period_us) * 1e-6
    }
}

/// Revision of the program: twelve digits of its source tree's commit, with `-dirty` if a tracked file has changed.
///
/// A release has the value of `EUPNEA_GIT_REVISION` at build time and does not look for its tree. `unknown` without the tree or
/// without git. It is determined once per process, so that all files of one run agree.
pub fn git_revision() -> String {
    static REVISION: OnceLock<String> = OnceLock::new();
    REVISION
        .get_or_init(|| match RELEASED {
            Some(revision) => revision.to_owned(),
            None => from_git(TREE).unwrap_or_else(|| "unknown".to_owned()),
        })
        .clone()
}

/// Revision of a release.
const RELEASED: Option<&str> = option_env!("EUPNEA_GIT_REVISION");
/// The source tree. A release names no folder of the machine that built it, so that another machine builds the same bytes.
const TREE: &str = if RELEASED.is_some() { "" } else { env!("CARGO_MANIFEST_DIR") };

/// Id of the running program itself: a checksum of its file. Unlike the revision it does not change when the source tree does, and
/// differs between two builds of one dirty revision. `unknown` if the file cannot be read.
pub fn build_id() -> String {
    static ID: OnceLock<String> = OnceLock::new();
    ID.get_or_init(|| {
        // Linux keeps the file under this name even if it has been replaced.
        let program = File::open("/proc/self/exe");
        let sum = program.or_else(|_| File::open(std::env::current_exe()?)).and_then(checksum);
        sum.map_or_else(|_| "unknown".to_owned(), |sum| format!("{sum:016x}"))
    })
    .clone()
}

/// Checksum of what a reader has left. An unoptimised program has a hundred megabytes, so sixteen bytes are taken at once.
fn checksum(mut reader: impl Read) -> io::Result<u64> {
    static SUM: Crc<u64, Table<16>> = Crc::<u64, Table<16>>::new(&CRC_64_XZ);
    let (mut digest, mut part) = (SUM.digest(), vec![0; 1 << 16]);
    loop {
        match reader.read(&mut part)? {
            0 => return Ok(digest.finalize()),
            count => digest.update(&part[..count]),
        }
    }
}

/// Asks git about the source tree, not about the current folder, which may be another repository.
fn from_git(tree: &str) -> Option<String> {
    let revision = git(tree, &["rev-parse", "--short=12", "HEAD"])?;
    let changes = git(tree, &["status", "--porcelain", "--untracked-files=no"])?;
    Some(if changes.is_empty() { revision } else { format!("{revision}-dirty") })
}

fn git(folder: &str, arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").arg("-C").arg(folder).args(arguments).output().ok()?;
    if !output.status.success() {
        return None;
    }
    Some(String::from_utf8(output.stdout).ok()?.trim().to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_revision_is_a_commit_or_says_that_it_is_unknown() {
        let revision = git_revision();
        let commit = revision.strip_suffix("-dirty").unwrap_or(&revision);
        let is_commit = commit.len() == 12 && commit.bytes().all(|digit| digit.is_ascii_hexdigit());
        assert!(is_commit || revision == RELEASED.unwrap_or("unknown"), "{revision}");
    }

    #[test]
    fn the_checksum_of_a_file_is_that_of_xz_however_long_it_is() {
        assert_eq!(checksum(&b"123456789"[..]).unwrap(), CRC_64_XZ.check);
        let long: Vec<u8> = (0..200_001_u32).map(|place| (place % 251) as u8).collect();
        assert_eq!(checksum(&long[..]).unwrap(), Crc::<u64>::new(&CRC_64_XZ).checksum(&long));
    }

    #[test]
    fn a_folder_without_a_repository_has_no_revision() {
        let folder = tempfile::tempdir().unwrap();
        assert_eq!(git(folder.path().to_str().unwrap(), &["rev-parse", "HEAD"]), None);
    }

    #[test]
    fn json_round_trip_keeps_every_field_and_every_digit() {
        let provenance = Provenance {
            seed: u64::MAX,
            plant: "bench \"r20c20\"".to_owned(),
            plant_parameters: "r = 20.0\n".to_owned(),
            settings: serde_json::json!({ "kp": 0.1 + 0.2, "pip": [10, 35] }),
            groups: vec!["CT_AIR:3".into()],
            notes: vec!["ÿ µ 𝛿".to_owned()],
            ..Provenance::new(1_000, "test")
        };
        let text = serde_json::to_string(&provenance).unwrap();
        assert_eq!(serde_json::from_str::<Provenance>(&text).unwrap(), provenance);
    }
}
