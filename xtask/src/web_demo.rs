//! The demonstration: `cargo xtask web --demo` compiles it to WebAssembly, builds its page into `docs/demo` and tests both;
//! `cargo xtask web` checks that the committed module is what the sources give.

use std::path::Path;

use anyhow::{Context, Result, bail};
use xshell::{Shell, cmd};

use crate::WEB_TARGET;
use crate::firmware::cargo_folder;
use crate::npm::{self, PAGE};

/// Folder of the files, which any web server can serve.
const FOLDER: &str = "docs/demo";
/// File of the module.
const MODULE: &str = "demo.wasm";
/// The test of a module, in the page's folder: its samples are those of the host, bit for bit.
const TEST: &str = "out/demo.test.mjs";

/// Builds and tests the demonstration.
pub fn run(shell: &Shell) -> Result<()> {
    let module = compile(shell)?;
    shell.create_dir(FOLDER)?;
    shell.write_file(format!("{FOLDER}/{MODULE}"), module)?;
    let _page = shell.push_dir(PAGE);
    npm::install(shell)?;
    cmd!(shell, "node build.mjs").quiet().run()?;
    cmd!(shell, "node build.mjs --tests").quiet().run()?;
    cmd!(shell, "node --test {TEST} test/demo.browser.mjs").env("SKIP_NOTHING", "1").quiet().run()?;
    Ok(())
}

/// Fails unless the committed module is what the sources give. With a standard library of other bytes than the released one, the
/// compiled module is tested instead; the page's unit tests must have been built.
pub fn check(shell: &Shell) -> Result<()> {
    let module = compile(shell)?;
    if module == shell.read_binary_file(format!("{FOLDER}/{MODULE}"))? {
        println!("{FOLDER}/{MODULE} is what the sources give");
        return Ok(());
    }
    if released(shell)? {
        bail!("{FOLDER}/{MODULE} is not what the sources give: run cargo xtask web --demo");
    }
    println!("{WEB_TARGET}: not the released standard library, so the compiled module is tested");
    let folder = cargo_folder(shell).join("webdemo");
    shell.write_file(folder.join(MODULE), module)?;
    let _page = shell.push_dir(PAGE);
    cmd!(shell, "node --test {TEST}").env("DEMO", folder).quiet().run()?;
    Ok(())
}

/// Whether the standard library for the module is the one that rustup installs.
fn released(shell: &Shell) -> Result<bool> {
    let root = cmd!(shell, "rustc --print sysroot").quiet().read()?;
    Ok(Path::new(&root).join(format!("lib/rustlib/manifest-rust-std-{WEB_TARGET}")).exists())
}

/// Compiles the module.
fn compile(shell: &Shell) -> Result<Vec<u8>> {
    cmd!(shell, "cargo build --quiet -p webdemo --lib --target {WEB_TARGET} --profile web")
        .env("RUSTFLAGS", remapped(shell)?)
        .quiet()
        .run()
        .with_context(|| {
            format!(
                "cannot build for {WEB_TARGET}; if its standard library is missing, run: cargo xtask setup"
            )
        })?;
    let module = cargo_folder(shell).join(WEB_TARGET).join("web/webdemo.wasm");
    Ok(shell.read_binary_file(module)?)
}

/// Flags with which a program names no folder of this machine: any other machine compiles the same bytes.
pub fn remapped(shell: &Shell) -> Result<String> {
    let home = shell.var("CARGO_HOME").or_else(|_| shell.var("HOME").map(|home| format!("{home}/.cargo")))?;
    let sources = shell.read_dir(format!("{home}/registry/src")).unwrap_or_default();
    let crates = sources.into_iter().map(|folder| (folder, "/crates"));
    // Of several that fit, the last one counts: the folder of builds may be within that of the project.
    let all = crates.chain([(shell.current_dir(), "/eupnea"), (cargo_folder(shell), "/target")]);
    let flags = all.map(|(folder, name)| format!("--remap-path-prefix={}={name}", folder.display()));
    Ok(flags.collect::<Vec<_>>().join(" "))
}
