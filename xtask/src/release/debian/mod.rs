//! Debian packages: the programs, their manual pages and completions, and a rule that lets users open the boards.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result};
use xshell::{Shell, cmd};

use super::programs::{self, Processor, Target};
use super::{Release, VERSION};

/// Programs with commands for users.
const PROGRAMS: [(&str, &str); 2] = [
    ("trainer", "learned control for mechanical ventilators"),
    ("lab", "experiments on learned control for mechanical ventilators"),
];
const RULE: &str = include_str!("60-eupnea.rules");
const COPYRIGHT: &str = include_str!("copyright");
const CONTROL: &str = include_str!("control");

/// Builds a package for each processor.
pub fn build(release: &Release<'_>) -> Result<()> {
    cmd!(release.shell, "bash .ci/setup/release").quiet().run()?;
    // What a program says of itself is the same on all processors; this machine runs those for its own.
    let native = programs::build(release.shell, Target::Glibc(Processor::X86))?;
    for processor in Processor::ALL {
        package(release, processor, &native)?;
    }
    Ok(())
}

fn package(release: &Release<'_>, processor: Processor, native: &[PathBuf]) -> Result<()> {
    let shell = release.shell;
    let root = release.staging("debian")?;
    let folder = |path: &str| Ok::<_, anyhow::Error>(shell.create_dir(root.join(path))?);
    let library = folder("usr/lib/eupnea")?;
    for file in programs::build(shell, Target::Glibc(processor))? {
        shell.copy_file(file, &library)?;
    }
    shell.write_file(folder("usr/lib/udev/rules.d")?.join("60-eupnea.rules"), RULE)?;
    let documents = folder("usr/share/doc/eupnea")?;
    shell.write_file(documents.join("copyright"), COPYRIGHT)?;
    let changes = documents.join("changelog");
    shell.write_file(&changes, changelog(release)?)?;
    cmd!(shell, "gzip -9n {changes}").quiet().run()?;
    for ((name, about), program) in PROGRAMS.iter().zip(native) {
        let bin = folder("usr/bin")?;
        cmd!(shell, "ln -s ../lib/eupnea/{name} {bin}/{name}").quiet().run()?;
        describe(shell, &root, name, about, program)?;
    }
    let control = control(shell, processor, &root)?;
    shell.write_file(folder("DEBIAN")?.join("control"), control)?;
    cmd!(shell, "chmod -R u=rwX,go=rX {root}").quiet().run()?;
    cmd!(shell, "chmod 644 {library}/libeupnea_fmu.so").quiet().run()?;
    let out = release.folder.join(format!("eupnea_{VERSION}_{}.deb", processor.debian()));
    cmd!(shell, "dpkg-deb --root-owner-group -Zxz --build {root} {out}").quiet().run()?;
    Ok(())
}

/// Writes a program's manual page and completions.
fn describe(shell: &Shell, root: &Path, name: &str, about: &str, program: &Path) -> Result<()> {
    let manual = shell.create_dir(root.join("usr/share/man/man1"))?.join(format!("{name}.1"));
    cmd!(shell, "help2man --no-info --name {about} --version-string {VERSION} --output {manual} {program}")
        .quiet()
        .run()?;
    cmd!(shell, "gzip -9n {manual}").quiet().run()?;
    for (kind, file) in [
        ("bash", format!("bash-completion/completions/{name}")),
        ("zsh", format!("zsh/vendor-completions/_{name}")),
        ("fish", format!("fish/vendor_completions.d/{name}.fish")),
    ] {
        let script = cmd!(shell, "{program} completions {kind}").quiet().read()?;
        shell.write_file(root.join("usr/share").join(file), script + "\n")?;
    }
    Ok(())
}

/// The list of changes in Debian's form: it refers to the project's own.
fn changelog(release: &Release<'_>) -> Result<String> {
    let time = format!("@{}", release.time_s);
    let date = cmd!(release.shell, "date --utc --rfc-email --date {time}").quiet().read()?;
    let maintainer = field("Maintainer")?;
    Ok(format!(
        "eupnea ({VERSION}) unstable; urgency=medium\n\n  * Revision {}; the changes are in the project's CHANGELOG.md.\n\n -- {maintainer}  {date}\n",
        release.revision
    ))
}

/// The value of a field of the package's description.
fn field(name: &str) -> Result<&'static str> {
    let prefix = format!("{name}: ");
    let line = CONTROL.lines().find_map(|line| line.strip_prefix(&prefix));
    line.with_context(|| format!("the package's description has no field {name}"))
}

/// The description with version, processor and size.
fn control(shell: &Shell, processor: Processor, root: &Path) -> Result<String> {
    let size = cmd!(shell, "du --summarize --apparent-size --block-size=1K {root}").quiet().read()?;
    let kilobytes = size.split_whitespace().next().unwrap_or_default();
    Ok(format!(
        "Package: eupnea\nVersion: {VERSION}\nArchitecture: {}\nInstalled-Size: {kilobytes}\n{CONTROL}",
        processor.debian()
    ))
}
