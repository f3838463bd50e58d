//! Runs a program in a folder of its own. Which one a command line is for, the test program says (`program_of`).

use std::ffi::OsStr;
use std::io::{BufRead, BufReader, Read};
use std::path::PathBuf;
use std::process::{Command, Output, Stdio};

use learn::controller::learned::{Learned, Origin};
use shared::control::features::FeatureSpec;
use shared::control::network::Network;
use shared::control::pid::PidGains;
use shared::control::residual::{Residual, ResidualSpec};
use tempfile::TempDir;

/// A folder to run the program in.
pub struct Place {
    folder: TempDir,
    /// A variable that all programs see, with the path of a file.
    variable: Option<(&'static str, PathBuf)>,
}

impl Place {
    pub fn new() -> Self {
        Self { folder: tempfile::tempdir().unwrap(), variable: None }
    }

    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// The same folder, in which programs see a variable with the path of a file.
    pub fn with(self, name: &'static str, file: &str) -> Self {
        Self { variable: Some((name, self.path(file))), ..self }
    }

    /// Any program.
    pub fn program(&self, program: impl AsRef<OsStr>) -> Command {
        let mut command = Command::new(program);
        command.current_dir(self.folder.path()).envs(self.variable.clone());
        command
    }

    /// The program of a command with arguments separated by blanks.
    pub fn command(&self, line: &str) -> Command {
        let mut command = self.program(crate::program_of(line));
        command.args(line.split_whitespace()).env_remove("EUPNEA_LOG").env("COLUMNS", "100");
        command
    }

    /// Starts a command that would take hours, presses Ctrl-C at its first logged progress, and waits for the end.
    pub fn interrupt(&self, line: &str) -> Output {
        let mut command = self.command(line);
        command.env("EUPNEA_LOG", "debug");
        let mut child =
            command.stdin(Stdio::null()).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        let mut log = BufReader::new(child.stderr.take().unwrap());
        let mut stderr = Vec::new();
        log.read_until(b'\n', &mut stderr).unwrap();
        let id = child.id().to_string();
        assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
        // Read in parallel with standard output: a full pipe without a reader would block the program.
        let log = std::thread::spawn(move || {
            log.read_to_end(&mut stderr).unwrap();
            stderr
        });
        let output = child.wait_with_output().unwrap();
        Output { stderr: log.join().unwrap(), ..output }
    }

    pub fn run(&self, line: &str) -> Output {
        self.command(line).output().unwrap()
    }

    /// Runs a command that must succeed; returns standard output.
    pub fn ok(&self, line: &str) -> String {
        let output = self.run(line);
        assert!(output.status.success(), "{line}: {}", text(&output.stderr));
        assert!(output.stderr.is_empty(), "{line}: {}", text(&output.stderr));
        text(&output.stdout)
    }

    /// Runs a command that must succeed with `--json -`; returns the JSON, which must be all of standard output.
    pub fn json(&self, line: &str) -> serde_json::Value {
        serde_json::from_str(&self.ok(&format!("{line} --json -"))).unwrap()
    }

    /// Runs a command that must be refused; returns the one-line reason.
    pub fn refused(&self, line: &str) -> String {
        let output = self.run(line);
        let stderr = text(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{line}: {stderr}");
        assert!(stderr.starts_with("error: ") && stderr.trim_end().lines().count() == 1, "{line}: {stderr}");
        stderr
    }

    /// Runs a command whose arguments must be refused; returns the reason.
    pub fn wrong(&self, line: &str) -> String {
        let output = self.run(line);
        let stderr = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{line}: {stderr}");
        assert!(stderr.starts_with("error: "), "{line}: {stderr}");
        stderr
    }

    /// Writes `short.toml`: a family with short breaths, so that the searches for a plant of its subset are short, and with a
    /// PID, so that none is searched.
    pub fn write_short_family(&self) {
        let family = "name = \"short\"\npips = [15]\npid = { p = 3, i = 100, d = 0.1 }\n\
                      [settings]\nrate = 80\ninspiratory_time = 0.2\nfall_time = 0.1\n\
                      [family.lung.first]\ncompliance_ml_per_cmh2o = { uniform = [10, 60] }\n";
        std::fs::write(self.path("short.toml"), family).unwrap();
    }

    /// A recording of a few breaths.
    pub fn collected(&self) -> &'static str {
        self.ok("collect --out first.parquet --breaths 12 --seed 3");
        "first.parquet"
    }

    /// A learned controller that adds a constant to a PI.
    pub fn controller(&self) -> &'static str {
        let mut network = Network::zero();
        network.output.bias[0] = 0.02;
        let spec = ResidualSpec {
            period_us: 1000,
            gains: PidGains { p: 3.0, i: 30.0, d: 0.0 },
            lambda: 0.5,
            authority: 40.0,
            features: FeatureSpec::default(),
        };
        let origin = Origin { plant: "R20C20".into(), seed: 9, ..Origin::default() };
        let learned = Learned { controller: Residual::new(spec, network).unwrap(), origin };
        learned.save(&self.path("controller.safetensors")).unwrap();
        "controller.safetensors"
    }
}

/// Exit code of a command that Ctrl-C ended.
pub const INTERRUPTED: Option<i32> = Some(130);

/// Output as text.
pub fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}
