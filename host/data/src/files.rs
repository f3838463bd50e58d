//! Writes files so that a reader sees either the old content or the new, never a part.

use std::fs::{self, File};
use std::hash::{BuildHasher, Hasher, RandomState};
use std::io::{self, BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde::de::DeserializeOwned;

/// Atomically replaces `path` by `bytes`: a temporary file beside it is synced, then renamed.
///
/// Missing parent folders are created.
///
/// # Errors
/// The file system's error; the old file is unchanged and no temporary file is left.
pub fn write_atomically(path: &Path, bytes: &[u8]) -> io::Result<()> {
    let temporary = temporary(path)?;
    let written = write_synced(&temporary, bytes).and_then(|()| fs::rename(&temporary, path));
    if written.is_err() {
        // Report the first error; a leftover temporary file is harmless.
        let _ = fs::remove_file(&temporary);
    }
    written
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
    let temporary = temporary(path).map_err(&failed)?;
    let written = File::create(&temporary).map_err(&failed).and_then(|file| {
        let mut file = BufWriter::new(file);
        write(&mut file)?;
        let file = file.into_inner().map_err(|error| failed(error.into_error()))?;
        file.sync_all().and_then(|()| fs::rename(&temporary, path)).map_err(&failed)
    });
    if written.is_err() {
        // Report the first error; a leftover temporary file is harmless.
        let _ = fs::remove_file(&temporary);
    }
    written
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

/// The path of a temporary file beside `path`, to be renamed once complete. Missing parent folders are created.
///
/// # Errors
/// `path` names no file, or its folder cannot be created.
pub fn temporary(path: &Path) -> io::Result<PathBuf> {
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
    fn a_failure_leaves_no_temporary_file() {
        let folder = tempfile::tempdir().unwrap();
        let taken = folder.path().join("taken");
        fs::create_dir(&taken).unwrap();
        fs::write(taken.join("inside"), b"x").unwrap();
        assert!(write_atomically(&taken, b"a file cannot replace a folder").is_err());
        assert_eq!(entries(folder.path()), ["taken"]);
    }
}
