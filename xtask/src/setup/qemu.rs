//! QEMU, in which the tests run the real image.
//!
//! Debian has a recent one in its backports, and only there may it differ from what the release brings: the release's own
//! package does not fit beside newer parts of QEMU that may be installed already.

use anyhow::{Context, Result, bail, ensure};
use xshell::{Shell, cmd};

use super::debian::{KEYRING, configured_mirror};

const PROGRAM: &str = "qemu-system-arm";
/// Older ones lack the core-coupled memory and the serial port's interrupts.
const LEAST_VERSION: u32 = 10;
/// Our addition to apt's sources.
const SOURCES: &str = "/etc/apt/sources.list.d/eupnea-backports.list";

/// How to install QEMU where this program does not do it.
const INSTRUCTIONS: &str =
    "install QEMU 10 or newer for Arm, then repeat this; without it (no tests of the real image): \
    cargo xtask setup --target-only
    macOS          brew install qemu
    Fedora         sudo dnf install qemu-system-arm
    Arch           sudo pacman -S qemu-system-arm
    Ubuntu 25.10+  sudo apt-get install qemu-system-arm
    others         https://www.qemu.org/download";

/// Installs QEMU unless it is there and new enough.
pub fn run(shell: &Shell) -> Result<()> {
    if let Some(version) = installed(shell) {
        println!("{PROGRAM}: version {version} present");
        return Ok(());
    }
    let release = shell.read_file("/etc/os-release").unwrap_or_default();
    ensure!(field(&release, "ID") == Some("debian"), "{PROGRAM} is missing or too old; {INSTRUCTIONS}");
    let codename =
        field(&release, "VERSION_CODENAME").context("/etc/os-release names no release of Debian")?;
    ensure!(
        cmd!(shell, "id -u").quiet().read()? == "0",
        "{PROGRAM} is missing or too old and only root can install it; run as root: cargo xtask setup"
    );
    let suite = offering_suite(shell, codename)?;
    println!("{PROGRAM}: installing it from {suite}");
    cmd!(shell, "apt-get install -y -qq --no-install-recommends -t {suite} {PROGRAM}")
        .env("DEBIAN_FRONTEND", "noninteractive")
        .quiet()
        .run()?;
    let version = installed(shell).context("QEMU was installed but is still too old")?;
    println!("{PROGRAM}: version {version} installed");
    Ok(())
}

/// The major version that is installed, if it will do.
fn installed(shell: &Shell) -> Option<u32> {
    let output = cmd!(shell, "{PROGRAM} --version").quiet().ignore_stderr().read().ok()?;
    let (_, after) = output.split_once("version ")?;
    sufficient(after)
}

/// The first number of a version, without a Debian epoch, if it will do.
fn sufficient(version: &str) -> Option<u32> {
    let version = version.split_once(':').map_or(version, |(_, upstream)| upstream);
    version.split('.').next()?.parse().ok().filter(|&major| major >= LEAST_VERSION)
}

/// The suite that offers a recent QEMU; backports are added to apt's sources if none does.
fn offering_suite(shell: &Shell, codename: &str) -> Result<String> {
    let offered = |shell: &Shell| -> Result<Option<String>> {
        let versions = cmd!(shell, "apt-cache madison {PROGRAM}").quiet().read()?;
        Ok(suite(&versions).map(str::to_owned))
    };
    if let Some(suite) = offered(shell)? {
        return Ok(suite);
    }
    // What apt knows may be old, or nothing.
    update(shell)?;
    if let Some(suite) = offered(shell)? {
        return Ok(suite);
    }
    let mirror = configured_mirror(shell)?;
    println!("{PROGRAM}: adding {codename}-backports to apt's sources in {SOURCES}");
    shell.write_file(SOURCES, source_line(&mirror, codename))?;
    update(shell)?;
    match offered(shell)? {
        Some(suite) => Ok(suite),
        None => bail!("Debian {codename} offers no recent QEMU; {INSTRUCTIONS}"),
    }
}

fn update(shell: &Shell) -> Result<()> {
    Ok(cmd!(shell, "apt-get update -qq").quiet().run()?)
}

fn source_line(mirror: &str, codename: &str) -> String {
    format!("deb [signed-by={KEYRING}] {mirror} {codename}-backports main\n")
}

/// The suite of the first version that will do, from apt-cache's list of all versions.
fn suite(versions: &str) -> Option<&str> {
    versions.lines().find_map(|line| {
        let mut columns = line.split('|').map(str::trim);
        let (version, source) = (columns.nth(1)?, columns.next()?);
        sufficient(version)?;
        source.split_whitespace().nth(1)?.split('/').next()
    })
}

/// A value of /etc/os-release.
fn field<'a>(release: &'a str, name: &str) -> Option<&'a str> {
    let value = release.lines().find_map(|line| line.strip_prefix(name)?.strip_prefix('='))?;
    Some(value.trim_matches('"'))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn versions_from_ten_on_will_do() {
        for (version, major) in
            [("10.0.2 (Debian", Some(10)), ("1:11.1.0+ds-1", Some(11)), ("7.2.17", None), ("", None)]
        {
            assert_eq!(sufficient(version), major, "{version}");
        }
        assert_eq!(sufficient("1:7.2+dfsg-7"), None, "the epoch is no version");
    }

    #[test]
    fn the_suite_of_a_recent_version_is_taken() {
        let versions = "\
qemu-system-arm | 1:7.2+dfsg-7 | http://mirror.example/debian bookworm/main amd64 Packages
qemu-system-arm | 1:10.0.2+ds-2~bpo12+1 | http://mirror.example/debian bookworm-backports/main amd64 Packages\n";
        assert_eq!(suite(versions), Some("bookworm-backports"));
        assert_eq!(suite(versions.lines().next().unwrap()), None);
        assert_eq!(suite(""), None);
    }

    #[test]
    fn the_release_is_read_with_and_without_quotes() {
        let release =
            "PRETTY_NAME=\"Debian GNU/Linux\"\nVERSION_ID=\"12\"\nVERSION_CODENAME=bookworm\nID=debian\n";
        assert_eq!(field(release, "ID"), Some("debian"));
        assert_eq!(field(release, "VERSION_ID"), Some("12"));
        assert_eq!(field(release, "VERSION"), None);
    }

    #[test]
    fn backports_come_from_the_mirror_in_use_under_debians_key() {
        let line = source_line("http://mirror.example/debian", "bookworm");
        assert_eq!(
            line,
            format!("deb [signed-by={KEYRING}] http://mirror.example/debian bookworm-backports main\n")
        );
    }
}
