//! Archives of the programs, which need no installation: static ones for any Linux, and for Windows.

use std::collections::BTreeMap;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use xshell::cmd;
use zip::write::SimpleFileOptions;
use zip::{DateTime, ZipWriter};

use super::programs::{self, Processor, Target};
use super::{Release, VERSION};

/// What lies beside the programs.
const DOCUMENTS: [&str; 3] = ["LICENSE-APACHE", "LICENSE-MIT", "CHANGELOG.md"];

/// Builds an archive of static programs for each processor. The library inside an FMU is the one for glibc, as simulators load it.
pub fn linux(release: &Release<'_>) -> Result<()> {
    let shell = release.shell;
    for processor in Processor::ALL {
        let name = format!("eupnea-{VERSION}-{}-linux", processor.name());
        let staging = release.staging("archive")?;
        let folder = shell.create_dir(staging.join(&name))?;
        let mut files = programs::build(shell, Target::Static(processor))?;
        files.extend(programs::build(shell, Target::Glibc(processor))?.pop());
        files.extend(DOCUMENTS.map(PathBuf::from));
        for file in files {
            shell.copy_file(file, &folder)?;
        }
        let archive = release.folder.join(format!("{name}.tar.gz"));
        let time = format!("@{}", release.time_s);
        let same = ["--sort=name", "--owner=0", "--group=0", "--numeric-owner", "--mode=u=rwX,go=rX"];
        let packer = "gzip -9n";
        cmd!(
            shell,
            "tar -C {staging} {same...} --mtime {time} --use-compress-program {packer} -cf {archive} {name}"
        )
        .quiet()
        .run()?;
    }
    Ok(())
}

/// Builds the archive for Windows.
pub fn windows(release: &Release<'_>) -> Result<()> {
    let mut files: BTreeMap<String, PathBuf> = BTreeMap::new();
    let programs = programs::build(release.shell, Target::Windows)?;
    for path in programs.into_iter().chain(DOCUMENTS.map(PathBuf::from)) {
        let name = path.file_name().and_then(|name| name.to_str()).context("a file has a name")?;
        files.insert(name.to_owned(), path.clone());
    }
    let archive = release.folder.join(format!("eupnea-{VERSION}-x86_64-windows.zip"));
    zip(&archive, &files, release.time_s)
}

/// Writes files, by their names in the archive, with one time for all.
pub fn zip(archive: &Path, files: &BTreeMap<String, PathBuf>, time_s: u64) -> Result<()> {
    let mut writer = ZipWriter::new(std::fs::File::create(archive)?);
    let options = SimpleFileOptions::default().last_modified_time(day(time_s)?).unix_permissions(0o644);
    for (name, path) in files {
        writer.start_file(name.as_str(), options)?;
        writer.write_all(&std::fs::read(path).with_context(|| path.display().to_string())?)?;
    }
    writer.finish()?;
    Ok(())
}

/// The beginning of a day in the form of a zip file.
fn day(time_s: u64) -> Result<DateTime> {
    let date = crate::papers::results::date(time_s);
    let numbers: Vec<u16> = date.split('-').filter_map(|part| part.parse().ok()).collect();
    let [year, month, day] = numbers[..] else { anyhow::bail!("{date} is no date") };
    Ok(DateTime::from_date_and_time(year, month as u8, day as u8, 0, 0, 0)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_same_files_give_the_same_archive() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("file");
        std::fs::write(&file, "content").unwrap();
        let files = [("a.txt".to_owned(), file)].into();
        let archives = ["one.zip", "two.zip"].map(|name| {
            let path = folder.path().join(name);
            zip(&path, &files, 1_796_000_000).unwrap();
            std::fs::read(path).unwrap()
        });
        assert!(archives[0].starts_with(b"PK"));
        assert_eq!(archives[0], archives[1]);
    }
}
