//! Compilers, and the programs that they make of exported controllers.

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use learn::c_export::source;
use shared::weights::Image;

/// A compiler, and what runs its programs.
pub struct Toolchain {
    compiler: &'static str,
    options: Vec<String>,
    /// Further sources.
    sources: Vec<PathBuf>,
    /// Program and arguments before the path of the program; none runs it directly.
    runner: &'static [&'static str],
}

/// A compiler of this computer.
pub fn compiler(name: &'static str) -> Toolchain {
    Toolchain { compiler: name, options: Vec::new(), sources: Vec::new(), runner: &[] }
}

/// GCC for a Cortex-M4F, and QEMU.
#[cfg(feature = "board")]
pub fn chip() -> Toolchain {
    let core = ["-mcpu=cortex-m4", "-mthumb", "-mfloat-abi=hard", "-mfpu=fpv4-sp-d16"];
    let mut options: Vec<String> =
        core.into_iter().chain(["--specs=rdimon.specs"]).map(str::to_owned).collect();
    options.push(format!("-Wl,-T,{}", here("mps2.ld").display()));
    Toolchain {
        compiler: "arm-none-eabi-gcc",
        options,
        sources: vec![here("startup.c")],
        runner: &[
            "timeout",
            "120",
            "qemu-system-arm",
            "-M",
            "mps2-an386",
            "-display",
            "none",
            "-monitor",
            "none",
            "-serial",
            "none",
            "-semihosting-config",
            "enable=on,target=native",
            "-kernel",
        ],
    }
}

fn here(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/c_export").join(name)
}

/// A folder with exported controllers.
pub struct Place {
    folder: tempfile::TempDir,
    names: Vec<String>,
}

impl Place {
    /// Exports controllers with their names.
    pub fn new(controllers: &[(String, Image)]) -> Self {
        let folder = tempfile::tempdir().expect("a folder can be made");
        let put = |name: &str, ending: &str, text: &str| {
            fs::write(folder.path().join(name).with_extension(ending), text).expect("a file can be written");
        };
        let (mut headers, mut entries) = (String::new(), String::new());
        for (name, image) in controllers {
            let source = source(image, name).expect("the name is one in C");
            put(name, "c", &source.code);
            put(name, "h", &source.header);
            headers.extend(["#include \"", name, ".h\"\n"]);
            entries.extend([" X(", name, ")"]);
        }
        put("controllers", "h", &format!("{headers}#define CONTROLLERS(X){entries}\n"));
        Self { folder, names: controllers.iter().map(|(name, _)| name.clone()).collect() }
    }

    /// Changes a part of a controller's code, which must be there once.
    pub fn change(&self, name: &str, from: &str, to: &str) {
        let path = self.folder.path().join(name).with_extension("c");
        let code = fs::read_to_string(&path).expect("it is there");
        assert!(from == to || code.matches(from).count() == 1, "{from}");
        fs::write(&path, code.replace(from, to)).expect("it can be written");
    }

    /// Compiles a sketch for Arduino with the controllers.
    #[cfg(feature = "board")]
    #[track_caller]
    pub fn compile_sketch(&self, sketch: &str) {
        let sketch = Path::new(env!("CARGO_MANIFEST_DIR")).join("..").join(sketch);
        let mut compile = Command::new("arm-none-eabi-g++");
        compile.args(["-std=gnu++11", "-Wall", "-Wextra", "-Werror", "-fsyntax-only", "-I.", "-include"]);
        compile.arg(here("arduino.h")).args(["-x", "c++"]).arg(sketch);
        succeed(compile.current_dir(self.folder.path()));
    }

    /// Builds the controllers with the driver and runs them; returns their answers.
    #[track_caller]
    pub fn run(&self, toolchain: &Toolchain, options: &[&str], operations: &[u8]) -> Vec<u8> {
        let folder = self.folder.path();
        let mut build = Command::new(toolchain.compiler);
        build.args(["-Wall", "-Wextra", "-Werror", "-o", "program", "-I."]).args(options);
        build.args(&toolchain.options).arg(here("driver.c"));
        build.args(self.names.iter().map(|name| format!("{name}.c"))).args(&toolchain.sources);
        succeed(build.current_dir(folder));
        fs::write(folder.join("operations.bin"), operations).expect("it can be written");
        let program = folder.join("program");
        let mut run = match toolchain.runner {
            [] => Command::new(program),
            [first, rest @ ..] => {
                let mut run = Command::new(first);
                run.args(rest).arg(program);
                run
            }
        };
        succeed(run.current_dir(folder));
        fs::read(folder.join("answers.bin")).expect("the program writes its answers")
    }
}

#[track_caller]
fn succeed(command: &mut Command) {
    let output = command.output().unwrap_or_else(|error| {
        panic!("{command:?}: {error}; to install compilers and QEMU: cargo xtask setup")
    });
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{command:?} ended with {}:\n{told}", output.status);
}
