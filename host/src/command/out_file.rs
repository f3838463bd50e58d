//! Where a result goes: a file that a command writes. It is checked before the work begins, and never destroys anything.

use std::ffi::OsStr;
use std::fs::{self, File};
use std::io::{self, Write};
use std::ops::Deref;
use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use clap::builder::{OsStringValueParser, TypedValueParser};
use clap::{ArgMatches, Command};
use data::files::{Draft, ROOM, Target, check_room};
use data::kind::Kind;

/// Name of the option that lets a command replace what it would spare.
pub(super) const FORCE: &str = "force";
/// The path that stands for standard output.
const STANDARD_OUTPUT: &str = "-";
/// Bytes that a folder must take.
const PROBE: usize = 4096;

/// Whether a path stands for standard output.
pub(super) fn is_standard_output(path: &Path) -> bool {
    path == Path::new(STANDARD_OUTPUT)
}

/// The option for all commands.
#[derive(Debug, clap::Args)]
pub struct ForceArgs {
    /// Replace earlier recordings, files of another kind and files that may only be read
    #[arg(long = FORCE, global = true)]
    pub force: bool,
}

/// A file that a command writes: the value of an option such as `--out`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct OutFile {
    path: PathBuf,
    kind: Kind,
}

impl OutFile {
    /// A parser of a path to which a command writes content of this kind.
    pub fn of(kind: Kind) -> impl TypedValueParser<Value = Self> {
        OsStringValueParser::new().try_map(move |path| Self::new(path.into(), kind))
    }

    /// A parser of a path whose ending says what a command writes.
    pub fn named() -> impl TypedValueParser<Value = Self> {
        OsStringValueParser::new().try_map(|path| {
            let path = PathBuf::from(path);
            let kind = Kind::of_name(&path);
            Self::new(path, kind)
        })
    }

    fn new(path: PathBuf, kind: Kind) -> Result<Self, &'static str> {
        if path.as_os_str().is_empty() {
            Err("the name of the file is empty")
        } else {
            Ok(Self { path, kind })
        }
    }

    /// Checks that the disk has room for this many bytes.
    ///
    /// # Errors
    /// It has less.
    pub fn check_room(&self, bytes: u64) -> anyhow::Result<()> {
        match Target::of(&self.path)? {
            Target::File(file) => {
                check_room(&file, bytes).with_context(|| format!("cannot write {}", self.path.display()))
            }
            Target::Stream(_) => Ok(()),
        }
    }

    /// Checks that the file can be written and that nothing else is lost.
    fn check(&self, force: bool) -> anyhow::Result<()> {
        let Self { path, kind } = self;
        let shown = path.display();
        if force {
            make_writable(path).with_context(|| format!("cannot write {shown}"))?;
        }
        let target = Target::of(path).with_context(|| format!("cannot write {shown}"))?;
        let Target::File(file) = target else { return Ok(()) };
        try_folder_of(&file).with_context(|| format!("cannot write {shown}"))?;
        let there = Kind::of_file(&file).with_context(|| format!("cannot read {shown}"))?;
        let Some(there) = there.filter(|_| !force) else { return Ok(()) };
        let way = format!("choose another name, or give --{FORCE} to replace it");
        ensure!(there == *kind, "{shown} is {}, not {}: {way}", there.name(), kind.name());
        ensure!(there != Kind::Recording, "{shown} is an earlier recording: {way}");
        Ok(())
    }

    /// The header of a controller in C, which is written beside it; none of another file.
    pub fn header(&self) -> Option<Self> {
        let Self { path, kind } = self;
        let is_code = *kind == Kind::Code && path.extension().is_some_and(|ending| ending == "c");
        is_code.then(|| Self { path: path.with_extension("h"), kind: *kind })
    }
}

impl Deref for OutFile {
    type Target = Path;

    fn deref(&self) -> &Path {
        &self.path
    }
}

impl AsRef<Path> for OutFile {
    fn as_ref(&self) -> &Path {
        &self.path
    }
}

/// Lets a file be replaced that may only be read, if there is one.
fn make_writable(path: &Path) -> io::Result<()> {
    let Ok(there) = fs::metadata(path) else { return Ok(()) };
    let mut permissions = there.permissions();
    if !there.is_file() || !permissions.readonly() {
        return Ok(());
    }
    #[expect(clippy::permissions_set_readonly_false, reason = "the file is about to be replaced")]
    permissions.set_readonly(false);
    fs::set_permissions(path, permissions)
}

/// Checks that a file can be created in its folder, or in the closest one above that exists, and that the disk takes it.
fn try_folder_of(file: &Path) -> io::Result<()> {
    check_room(file, ROOM)?;
    let Some(folder) = file.ancestors().skip(1).find(|folder| folder.exists()) else { return Ok(()) };
    let probe = Draft::of(&folder.join("probe"))?;
    let mut file = File::create(probe.path())?;
    file.write_all(&[0; PROBE])?;
    file.sync_all()
}

/// Checks the files that a command writes, before it begins: none is one that it reads, no two are the same, and each can be written
/// without a loss.
///
/// # Errors
/// The first reason against it, with what to do.
pub(super) fn check(program: &Command, matches: &ArgMatches) -> anyhow::Result<()> {
    let Some((name, matches)) = matches.subcommand() else { return Ok(()) };
    let Some(command) = program.find_subcommand(name) else { return Ok(()) };
    let (mut outputs, mut inputs) = (Vec::<(&str, &OutFile)>::new(), Vec::new());
    for argument in command.get_arguments() {
        let id = argument.get_id().as_str();
        if let Ok(Some(files)) = matches.try_get_many(id) {
            outputs.extend(files.map(|file| (argument.get_long().unwrap_or(id), file)));
        } else if let Ok(Some(values)) = matches.try_get_raw(id) {
            inputs.extend(values.flat_map(names_in).filter(|name| name.is_file()));
        }
    }
    outputs.retain(|(_, file)| !is_standard_output(file));
    for (n, (option, output)) in outputs.iter().enumerate() {
        let shown = output.display();
        if inputs.iter().any(|input| is_same(input, output)) {
            bail!("{shown} is read by this command too: choose another name for --{option}");
        }
        if let Some((other, _)) = outputs[..n].iter().find(|(_, earlier)| is_same(earlier, output)) {
            bail!(
                "--{other} and --{option} are both written to {shown}: choose another name for one of them"
            );
        }
        for file in [Some(*output), output.header().as_ref()].into_iter().flatten() {
            file.check(matches.get_flag(FORCE))?;
        }
    }
    Ok(())
}

/// The names of files that the value of an option may contain: the value, or what follows `=`, `:` or `,`.
fn names_in(value: &OsStr) -> Vec<PathBuf> {
    let parts = value.to_str().into_iter().flat_map(|text| text.split([',', '=', ':']).skip(1));
    std::iter::once(value.into()).chain(parts.map(PathBuf::from)).collect()
}

/// Whether two paths are of the same file, which may not exist yet. A device such as /dev/null takes any number of outputs.
fn is_same(one: &Path, other: &Path) -> bool {
    if matches!(Target::of(other), Ok(Target::Stream(_))) {
        return false;
    }
    same_file::is_same_file(one, other).unwrap_or_else(|_| match (Target::of(one), Target::of(other)) {
        (Ok(Target::File(one)), Ok(Target::File(other))) => one == other,
        _ => false,
    })
}
