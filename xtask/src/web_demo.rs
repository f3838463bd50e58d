//! `cargo xtask web --demo`: compiles the demonstration to WebAssembly, builds its page into `docs/demo` and tests both.

use anyhow::{Context, Result};
use xshell::{Shell, cmd};

use crate::firmware::cargo_folder;
use crate::web;

/// Folder of the files, which any web server can serve.
const FOLDER: &str = "docs/demo";
/// What the module is compiled for.
const TARGET: &str = "wasm32-unknown-unknown";
/// Folder of the page's sources.
const PAGE: &str = "host/bedside/web";

/// Builds and tests the demonstration.
pub fn run(shell: &Shell) -> Result<()> {
    compile(shell)?;
    let _page = shell.push_dir(PAGE);
    web::install(shell)?;
    cmd!(shell, "node build.mjs").quiet().run()?;
    cmd!(shell, "node build.mjs --tests").quiet().run()?;
    cmd!(shell, "node --test out/demo.test.mjs test/demo.browser.mjs")
        .env("SKIP_NOTHING", "1")
        .quiet()
        .run()?;
    Ok(())
}

/// Compiles the module into the folder.
fn compile(shell: &Shell) -> Result<()> {
    cmd!(shell, "rustup target add {TARGET}")
        .quiet()
        .run()
        .with_context(|| format!("cannot install the standard library for {TARGET}: check the connection"))?;
    cmd!(shell, "cargo build --quiet -p webdemo --lib --target {TARGET} --profile web")
        .env("RUSTFLAGS", remapped(shell)?)
        .quiet()
        .run()?;
    let module = cargo_folder(shell).join(TARGET).join("web/webdemo.wasm");
    shell.create_dir(FOLDER)?;
    // Its contents alone: cargo makes it executable.
    shell.write_file(format!("{FOLDER}/demo.wasm"), shell.read_binary_file(module)?)?;
    Ok(())
}

/// Flags with which the module names no folder of this machine.
fn remapped(shell: &Shell) -> Result<String> {
    let home = shell.var("CARGO_HOME").or_else(|_| shell.var("HOME").map(|home| format!("{home}/.cargo")))?;
    let sources = shell.read_dir(format!("{home}/registry/src")).unwrap_or_default();
    let folders = sources.into_iter().map(|folder| (folder, "/crates"));
    let all = folders.chain([(shell.current_dir(), "/eupnea")]);
    let flags = all.map(|(folder, name)| format!("--remap-path-prefix={}={name}", folder.display()));
    Ok(flags.collect::<Vec<_>>().join(" "))
}
