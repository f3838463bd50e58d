//! QEMU for the virtual board: on Debian from the backports of its release, elsewhere by the reader's own hands.

use anyhow::{Context, Result, bail, ensure};
use xshell::{Shell, cmd};

/// The emulator of the chip's instruction set.
const PROGRAM: &str = "qemu-system-arm";
/// Older versions do not model the serial ports' interrupts.
const LEAST_VERSION: u32 = 10;
/// Where our line in apt's configuration goes.
const SOURCE_LIST: &str = "/etc/apt/sources.list.d/eupnea-backports.list";
const KEYRING: &str = "/usr/share/keyrings/debian-archive-keyring.gpg";

/// Installs QEMU unless it is there.
pub fn install(shell: &Shell) -> Result<()> {
    if let Some(version) = version(shell) {
        if version >= LEAST_VERSION {
            println!("{PROGRAM}: present, version {version}");
            return Ok(());
        }
        println!("{PROGRAM}: version {version} is too old");
    }
    let release = shell.read_file("/etc/os-release").unwrap_or_default();
    let Some(codename) = debian_codename(&release) else {
        bail!(
            "install QEMU {LEAST_VERSION} or newer by hand, so that {PROGRAM} is in the path: on Fedora `dnf install \
             qemu-system-arm`, on Arch `pacman -S qemu-system-arm`, on macOS `brew install qemu`, on Ubuntu 25.10 or \
             newer `apt-get install qemu-system-arm`"
        );
    };
    from_backports(shell, &codename)?;
    let installed =
        version(shell).with_context(|| format!("{PROGRAM} is not in the path after its installation"))?;
    ensure!(
        installed >= LEAST_VERSION,
        "apt installed version {installed}; version {LEAST_VERSION} is needed"
    );
    println!("{PROGRAM}: installed, version {installed}");
    Ok(())
}

/// Major version, if the program is there.
fn version(shell: &Shell) -> Option<u32> {
    let said = cmd!(shell, "{PROGRAM} --version").quiet().ignore_stderr().read().ok()?;
    major(&said)
}

/// `QEMU emulator version 10.0.2 (Debian ...)` is 10.
fn major(said: &str) -> Option<u32> {
    let (_, after) = said.split_once("version ")?;
    after.split('.').next()?.parse().ok()
}

/// The release's name, if the system is Debian itself.
fn debian_codename(os_release: &str) -> Option<String> {
    let value = |key: &str| {
        let line = os_release.lines().find_map(|line| line.strip_prefix(key)?.strip_prefix('='));
        line.map(|value| value.trim_matches('"').to_owned())
    };
    value("VERSION_CODENAME").filter(|_| value("ID").as_deref() == Some("debian"))
}

fn from_backports(shell: &Shell, codename: &str) -> Result<()> {
    let root = cmd!(shell, "id -u").quiet().read()?.trim() == "0";
    let suite = format!("{codename}-backports");
    ensure!(
        root,
        "installing packages needs root; run as root: cargo xtask setup (or install {PROGRAM} from {suite})"
    );
    let known = cmd!(shell, "apt-cache policy").quiet().read()?;
    if !known.contains(&format!("n={suite}")) {
        let mirror = mirror(shell).context("apt's configuration names no Debian mirror")?;
        shell.write_file(SOURCE_LIST, format!("deb [signed-by={KEYRING}] {mirror} {suite} main\n"))?;
    }
    cmd!(shell, "apt-get update -q").quiet().run()?;
    // The release's own package would conflict with tools of QEMU that come from backports.
    cmd!(shell, "apt-get install -q -y --no-install-recommends -t {suite} {PROGRAM}")
        .env("DEBIAN_FRONTEND", "noninteractive")
        .quiet()
        .run()?;
    Ok(())
}

/// The Debian mirror that apt uses.
fn mirror(shell: &Shell) -> Option<String> {
    let folder = shell.read_dir("/etc/apt/sources.list.d").unwrap_or_default();
    let files = folder.into_iter().chain([std::path::PathBuf::from("/etc/apt/sources.list")]);
    let texts: Vec<String> = files.filter_map(|file| shell.read_file(file).ok()).collect();
    texts.iter().find_map(|text| debian_mirror(text))
}

/// The first address in a source list, of either format, whose path is that of the main archive.
fn debian_mirror(text: &str) -> Option<String> {
    let lines = text.lines().filter(|line| !line.trim_start().starts_with('#'));
    let mut words = lines.flat_map(str::split_whitespace);
    let archive = |word: &&str| word.contains("://") && word.trim_end_matches('/').ends_with("/debian");
    words.find(archive).map(ToOwned::to_owned)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_major_version_is_read() {
        assert_eq!(major("QEMU emulator version 10.0.2 (Debian 1:10.0.2+ds-2)\nCopyright"), Some(10));
        assert_eq!(major("no such thing"), None);
    }

    #[test]
    fn only_debian_itself_has_its_backports() {
        let debian = "ID=debian\nVERSION_CODENAME=bookworm\n";
        assert_eq!(debian_codename(debian).as_deref(), Some("bookworm"));
        assert_eq!(debian_codename("ID=ubuntu\nID_LIKE=debian\nVERSION_CODENAME=noble\n"), None);
        assert_eq!(debian_codename("ID=debian\nPRETTY_NAME=\"Debian sid\"\n"), None);
    }

    #[test]
    fn the_mirror_is_found_in_both_formats() {
        let one_line =
            "# a comment http://old.example/debian\ndeb http://mirror.example/debian bookworm main\n";
        assert_eq!(debian_mirror(one_line).as_deref(), Some("http://mirror.example/debian"));
        let stanza = "Types: deb\nURIs: https://mirror.example/debian/\nSuites: bookworm\n";
        assert_eq!(debian_mirror(stanza).as_deref(), Some("https://mirror.example/debian/"));
        assert_eq!(debian_mirror("deb https://other.example/apt stable main"), None);
        assert_eq!(debian_mirror("deb http://mirror.example/debian-security bookworm-security main"), None);
    }
}
