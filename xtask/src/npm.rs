//! The packages of the bedside page, which npm installs.

use anyhow::{Context, Result};
use xshell::{Shell, cmd};

/// Folder of the page.
pub const PAGE: &str = "host/bedside/web";
/// The lock file, and a copy of it beside the packages that were installed by it.
const LOCK: [&str; 2] = ["package-lock.json", "node_modules/.installed.json"];

/// Installs the packages of the lock file, unless they are the ones that are installed.
pub fn install(shell: &Shell) -> Result<()> {
    let [wanted, installed] = LOCK.map(|path| shell.read_file(path).ok());
    if wanted.is_some() && wanted == installed {
        return Ok(());
    }
    println!("npm packages: installing them into {PAGE}/node_modules");
    cmd!(shell, "npm ci --no-audit --no-fund --loglevel=error").quiet().run().context(
        "cannot install the page's packages: check the connection and npm's configuration, then repeat this",
    )?;
    shell.copy_file(LOCK[0], LOCK[1])?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn packages_of_the_same_lock_file_are_not_installed_again() {
        let shell = Shell::new().unwrap();
        let folder = tempfile::tempdir().unwrap();
        shell.change_dir(folder.path());
        for path in LOCK {
            shell.write_file(path, "{}").unwrap();
        }
        install(&shell).unwrap();
        assert!(!shell.path_exists("node_modules/.package-lock.json"), "npm was not called");
    }
}
