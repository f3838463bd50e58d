//! Golden traces: 100 breaths in closed loop must give the committed commands, bit for bit, with any optimisation, on
//! every machine. Verifies: same-bits.
//!
//! After an intended change of commands, update them with `EUPNEA_BLESS=1 cargo test -p tests golden`.

use std::fmt::Write as _;
use std::path::PathBuf;
use std::{fs, iter};

use shared::control::Controller;
use tests::trace::{self, Entry};

#[test]
fn golden_pid_commands_keep_every_bit() {
    compare("pid", trace::pid());
}

#[test]
fn golden_residual_commands_keep_every_bit() {
    compare("residual", trace::residual(1));
}

#[test]
fn golden_learned_commands_keep_every_bit() {
    compare("learned", trace::learned());
}

fn compare(name: &str, controller: Controller) {
    let trace = trace::run(controller).expect("the ventilator must not leave ventilation");
    // Exploration alone causes an error of 1.5 cmH2O.
    assert!(
        trace.plateau_error < 2.0,
        "the loop misses its target by {} cmH2O, so its trace would prove little",
        trace.plateau_error
    );
    let path = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("golden").join(name).with_extension("txt");
    let now = text(&trace.entries);
    if tests::blesses() {
        fs::write(&path, now).expect("the golden file can be written");
        return;
    }
    let golden = fs::read_to_string(&path).unwrap_or_default();
    let committed = golden.lines().chain(iter::repeat("nothing"));
    let parted = now.lines().zip(committed).find(|(now, golden)| now != golden);
    assert!(
        now == golden,
        "commands of the {name} trace changed; first difference (now, committed): {parted:?}. If that is meant, \
         say why in the commit and renew them: EUPNEA_BLESS=1 cargo test -p tests golden"
    );
}

fn text(entries: &[Entry]) -> String {
    entries.iter().fold(String::new(), |mut text, entry| {
        let _ = writeln!(text, "breaths {:>3}  fnv1a64 {:016x}", entry.breaths, entry.hash);
        text
    })
}
