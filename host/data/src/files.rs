//! Writes files so that a reader sees either the old content or the new, never a part.
//!
//! What is not a plain file keeps what it is: links are followed, pipes and devices receive the content, and a file that may only be
//! read is refused.

use std::fs::{self, File};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Free space without which no work begins, bytes.
pub const ROOM: u64 = 1 << 20;

/// Checks that the disk of a path, which need not exist yet, has this many free bytes.
///
/// # Errors
/// [`ErrorKind::StorageFull`], with both numbers; or the file system's own error.
pub fn check_room(path: &Path, bytes: u64) -> io::Result<()> {
    let path = in_whole(path);
    let Some(folder) = path.ancestors().find(|folder| folder.is_dir()) else { return Ok(()) };
    let space = fs4::statvfs(folder)?;
    // A file system without a size of its own, as some on a network, tells nothing.
    if space.total_space() == 0 || space.available_space() >= bytes {
        return Ok(());
    }
    let megabytes = |bytes: u64| bytes as f64 / 1e6;
    let reason = format!(
        "the disk of {} has {:.1} MB free, and {:.1} MB are needed: free some space, choose another disk, or ask for less",
        folder.display(),
        megabytes(space.available_space()),
        megabytes(bytes)
    );
    Err(io::Error::new(ErrorKind::StorageFull, reason))
}

/// Where the content of a path goes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Target {
    /// A plain file, all links resolved, or one that does not exist yet.
    File(PathBuf),
    /// A pipe or a device, which receives the content.
    Stream(PathBuf),
}

impl Target {
    /// What is at a path.
    ///
    /// # Errors
    /// A folder, a file that may only be read, or links that lead nowhere.
    pub fn of(path: &Path) -> io::Result<Self> {
        let there = match fs::metadata(path) {
            Ok(there) => there,
            Err(error) if error.kind() == ErrorKind::NotFound => return Ok(Self::File(resolved(path)?)),
            Err(error) => return Err(error),
        };
        if there.is_dir() {
            return Err(io::Error::new(ErrorKind::IsADirectory, "it is a folder: name a file"));
        }
        // A redirected standard output is a plain file too, but others write to it as well.
        if !there.is_file() || path.starts_with("/dev") || path.starts_with("/proc") {
            return Ok(Self::Stream(path.to_owned()));
        }
        if there.permissions().readonly() {
            let reason = "it may only be read: choose another file, or change its permissions";
            return Err(io::Error::new(ErrorKind::PermissionDenied, reason));
        }
        fs::canonicalize(path).map(Self::File)
    }
}

/// A path at which nothing is yet, without the links that lead there.
fn resolved(path: &Path) -> io::Result<PathBuf> {
    match fs::read_link(path) {
        // The file system has refused circles already.
        Ok(target) => resolved(&path.parent().map_or_else(|| target.clone(), |folder| folder.join(&target))),
        Err(_) => Ok(in_whole(path)),
    }
}

/// A path with the whole path of its folder, if there is one: two names of the same file are then alike.
fn in_whole(path: &Path) -> PathBuf {
    let folder = path.parent().map(|folder| if folder == Path::new("") { Path::new(".") } else { folder });
    match (folder.map(fs::canonicalize), path.file_name()) {
        (Some(Ok(folder)), Some(name)) => folder.join(name),
        _ => path.to_owned(),
    }
}

/// Content on its way to its target: a temporary file, which takes the target's place once it is whole.
#[derive(Debug)]
pub struct Draft {
    temporary: PathBuf,
    target: Target,
}

impl Draft {
    /// A draft for this path. Missing parent folders are created.
    ///
    /// # Errors
    /// That of [`Target::of`], or the folder cannot be created.
    pub fn of(path: &Path) -> io::Result<Self> {
        let target = Target::of(path)?;
        let temporary = match &target {
            Target::File(file) => temporary(file)?,
            Target::Stream(_) => temporary(&std::env::temp_dir().join("stream"))?,
        };
        Ok(Self { temporary, target })
    }

    /// Where to write the content.
    pub fn path(&self) -> &Path {
        &self.temporary
    }

    /// Puts the whole content in its place.
    ///
    /// # Errors
    /// The file system's error; the old file is unchanged.
    pub fn complete(self) -> io::Result<()> {
        match &self.target {
            Target::File(file) => fs::rename(&self.temporary, file),
            Target::Stream(stream) => {
                let mut content = File::open(&self.temporary)?;
                io::copy(&mut content, &mut File::options().write(true).open(stream)?).map(drop)
            }
        }
    }
}

impl Drop for Draft {
    fn drop(&mut self) {
        // Once it is in its place, no temporary file exists; a leftover one is harmless.
        let _ = fs::remove_file(&self.temporary);
    }
}

/// Atomically replaces `path` by `bytes`: a temporary file beside it is synced, then renamed.
///
/// Missing parent folders are created.
///
/// # Errors
/// The file system's error; the old file is unchanged and no temporary file is left.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let draft = Draft::of(path)?;
    write_synced(draft.path(), bytes)?;
    draft.complete()
}

/// Like [`write_atomically`], for content that is written piece by piece. `failed` turns the file system's errors
/// into the caller's.
///
/// # Errors
/// The first error of `write` or of the file system; the old file is unchanged and no temporary file is left.
pub fn write_streamed<E>(
    path: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> Result<(), E>,
    failed: impl Fn(io::Error) -> E,
) -> Result<(), E> {
    let draft = Draft::of(path).map_err(&failed)?;
    let mut file = BufWriter::new(File::create(draft.path()).map_err(&failed)?);
    write(&mut file)?;
    let file = file.into_inner().map_err(|error| failed(error.into_error()))?;
    file.sync_all().and_then(|()| draft.complete()).map_err(&failed)
}

/// Creates `path` with `bytes`, atomically as [`write_atomically`] does, unless it exists: of several writers, even on different
/// machines, one succeeds. True if it was this one.
///
/// # Errors
/// The file system's error; no temporary file is left.
pub fn create_atomically(path: &Path, bytes: &[u8]) -> io::Result<bool> {
    let temporary = temporary(path)?;
    let created = write_synced(&temporary, bytes).and_then(|()| link(&temporary, path, bytes));
    // Both names are of the same file; a leftover one is harmless.
    let _ = fs::remove_file(&temporary);
    match created {
        Err(error) if error.kind() == ErrorKind::AlreadyExists => Ok(false),
        created => created.map(|()| true),
    }
}

/// Gives a file a second name that must not exist. A file system without hard links gets a second file, which a reader can see before it
/// is whole.
fn link(temporary: &Path, path: &Path, bytes: &[u8]) -> io::Result<()> {
    match fs::hard_link(temporary, path) {
        Err(error) if matches!(error.kind(), ErrorKind::Unsupported | ErrorKind::PermissionDenied) => {
            let mut file = File::create_new(path)?;
            file.write_all(bytes)?;
            file.sync_all()
        }
        linked => linked,
    }
}

/// The path of a temporary file beside `path`. Missing parent folders are created.
///
/// # Errors
/// `path` names no file, or its folder cannot be created.
fn temporary(path: &Path) -> io::Result<PathBuf> {
    let name = path.file_name().ok_or_else(|| {
        io::Error::new(ErrorKind::InvalidInput, "the path has no file name: name a file, not a folder")
    })?;
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    if let Some(folder) = folder {
        fs::create_dir_all(folder)?;
    }
    // The number, random in every call, prevents two writers of the same file, even on different machines, from sharing the temporary
    // file.
    let number = RandomState::new().build_hasher().finish();
    Ok(path.with_file_name(format!(".{}.{number:016x}.tmp", name.to_string_lossy())))
}

/// Writes a value atomically as one line of JSON.
///
/// # Errors
/// A value that JSON cannot represent; otherwise see [`write_atomically`].
pub fn write_json(path: &Path, value: &impl Serialize) -> io::Result<()> {
    write_atomically(path, serde_json::to_string(value)?.as_bytes())
}

/// Like [`write_json`], but indented for readability.
///
/// # Errors
/// See [`write_json`].
pub fn write_json_indented(path: &Path, value: &impl Serialize) -> io::Result<()> {
    write_atomically(path, indented(value)?.as_bytes())
}

/// Creates a file as [`write_json_indented`] writes it, unless it exists.
///
/// # Errors
/// A value that JSON cannot represent; otherwise see [`create_atomically`].
pub fn create_json_indented(path: &Path, value: &impl Serialize) -> io::Result<bool> {
    create_atomically(path, indented(value)?.as_bytes())
}

fn indented(value: &impl Serialize) -> io::Result<String> {
    Ok(serde_json::to_string_pretty(value)? + "\n")
}

/// Reads a file written by [`write_json`]; `None` if it does not exist.
///
/// # Errors
/// The file cannot be read, or contains something else.
pub fn read_json<T: DeserializeOwned>(path: &Path) -> io::Result<Option<T>> {
    match fs::read_to_string(path) {
        Ok(text) => serde_json::from_str(&text).map(Some).map_err(|error| {
            io::Error::new(ErrorKind::InvalidData, format!("{error}; remove it if it is damaged"))
        }),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(None),
        Err(error) => Err(error),
    }
}

fn write_synced(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let mut file = File::create(path)?;
    file.write_all(bytes)?;
    file.sync_all()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_checked_on_the_disk_of_a_path_that_does_not_exist_yet() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/file.txt");
        check_room(&path, 1).unwrap();
        let refused = check_room(&path, u64::MAX).unwrap_err();
        assert_eq!(refused.kind(), ErrorKind::StorageFull);
        let told = refused.to_string();
        assert!(told.contains(&*folder.path().to_string_lossy()) && told.contains(" MB free"), "{told}");
    }

    fn entries(folder: &Path) -> Vec<String> {
        let mut names: Vec<_> = fs::read_dir(folder)
            .unwrap()
            .map(|entry| entry.unwrap().file_name().to_string_lossy().into_owned())
            .collect();
        names.sort();
        names
    }

    #[test]
    fn replaces_the_old_content_and_creates_folders() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("a/b/file.txt");
        write_atomically(&path, b"old, and longer").unwrap();
        write_atomically(&path, b"new").unwrap();
        assert_eq!(fs::read(&path).unwrap(), b"new");
        assert_eq!(entries(path.parent().unwrap()), ["file.txt"]);
    }

    #[test]
    fn of_several_that_create_a_file_at_once_one_succeeds_and_its_content_stays() {
        let folder = tempfile::tempdir().unwrap();
        let (path, together) = (folder.path().join("a/file.txt"), std::sync::Barrier::new(8));
        let create = |writer: u8| {
            together.wait();
            create_atomically(&path, &[writer; 100]).unwrap().then_some(writer)
        };
        let winners: Vec<u8> = std::thread::scope(|scope| {
            let writers: Vec<_> = (0..8).map(|writer| scope.spawn(move || create(writer))).collect();
            writers.into_iter().filter_map(|writer| writer.join().unwrap()).collect()
        });
        let [winner] = winners[..] else { panic!("{winners:?}") };
        assert_eq!(fs::read(&path).unwrap(), [winner; 100]);
        assert_eq!(entries(path.parent().unwrap()), ["file.txt"]);
    }

    #[test]
    fn a_value_that_json_cannot_hold_writes_no_file() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("map.json");
        let keyed_by_lists = std::collections::BTreeMap::from([(vec![1], 2)]);
        assert!(write_json(&path, &keyed_by_lists).is_err());
        assert!(!path.exists());
    }

    #[test]
    fn content_that_fails_half_way_leaves_the_old_file_alone() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file.txt");
        write_streamed(&path, |file| file.write_all(b"whole"), |error| error).unwrap();
        let broken = write_streamed(
            &path,
            |file| file.write_all(b"half").and_then(|()| Err(io::Error::other("no more"))),
            |error| error,
        );
        assert!(broken.is_err());
        assert_eq!(fs::read(&path).unwrap(), b"whole");
        assert_eq!(entries(folder.path()), ["file.txt"]);
    }

    #[test]
    #[cfg(unix)]
    fn a_link_stays_and_its_target_is_replaced_whether_or_not_it_exists() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        fs::create_dir(at("deep")).unwrap();
        for (link, target) in [("first", "deep/second"), ("deep/second", "../file.txt")] {
            std::os::unix::fs::symlink(target, at(link)).unwrap();
        }
        for content in ["new", "newer"] {
            write_atomically(&at("first"), content.as_bytes()).unwrap();
            assert_eq!(fs::read_to_string(at("file.txt")).unwrap(), content);
            assert!(at("first").is_symlink() && at("deep/second").is_symlink());
        }
        assert_eq!(entries(folder.path()), ["deep", "file.txt", "first"]);
        std::os::unix::fs::symlink("circle", at("circle")).unwrap();
        assert!(write_atomically(&at("circle"), b"x").is_err());
    }

    #[test]
    #[cfg(unix)]
    fn a_pipe_receives_the_content_and_stays_a_pipe() {
        use std::os::unix::fs::FileTypeExt;
        let folder = tempfile::tempdir().unwrap();
        let pipe = folder.path().join("pipe");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        let read = std::thread::scope(|scope| {
            let reader = scope.spawn(|| fs::read(&pipe).unwrap());
            write_atomically(&pipe, b"content").unwrap();
            reader.join().unwrap()
        });
        assert_eq!(read, b"content");
        assert!(fs::metadata(&pipe).unwrap().file_type().is_fifo());
        assert_eq!(entries(folder.path()), ["pipe"]);
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn a_device_is_written_to_and_tells_when_it_is_full() {
        let full = Path::new("/dev/full");
        let error = write_atomically(full, b"content").unwrap_err();
        assert_eq!(error.kind(), ErrorKind::StorageFull);
        write_atomically(Path::new("/dev/null"), b"content").unwrap();
        assert!([full, Path::new("/dev/null")].iter().all(|path| !fs::metadata(path).unwrap().is_file()));
    }

    #[test]
    fn a_file_that_may_only_be_read_is_not_replaced() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("file.txt");
        fs::write(&path, "old").unwrap();
        let mut permissions = fs::metadata(&path).unwrap().permissions();
        permissions.set_readonly(true);
        fs::set_permissions(&path, permissions).unwrap();
        let error = write_atomically(&path, b"new").unwrap_err();
        assert!(error.to_string().contains("may only be read"), "{error}");
        assert_eq!(
            (fs::read(&path).unwrap(), entries(folder.path())),
            (b"old".to_vec(), vec!["file.txt".to_owned()])
        );
    }

    #[test]
    fn a_failure_leaves_no_temporary_file() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("taken");
        fs::create_dir(&taken).unwrap();
        fs::write(taken.join("inside"), b"x").unwrap();
        assert!(write_atomically(&taken, b"a file cannot replace a folder").is_err());
        assert_eq!(entries(folder.path()), ["taken"]);
    }
}
