//! A farm from the user's side: killed at any moment, stopped, and described wrongly.

use std::process::Stdio;
use std::time::{Duration, Instant};

use data::recording::Recording;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_chacha::rand_core::SeedableRng;

use super::support::{Place, text};

/// Moments at which the farm is killed.
const KILLS: usize = 20;
/// Breaths of a session after which it is killed, whatever the speed of the machine.
const SESSION: usize = 2;
/// Breaths of each unit: more than all sessions record. A breath may end while another one is counted.
const BREATHS: usize = 2 * KILLS * SESSION;

/// The recording of a unit.
fn recording(place: &Place, farm: &str, unit: u32) -> Recording {
    Recording::load(place.path(&format!("{farm}/units/{unit}/measurement-0/recording.parquet"))).unwrap()
}

/// PIP of every breath of a recording, each of which must be there once, whole and in order.
fn pips(recording: &Recording) -> Vec<f32> {
    let breaths = recording.breaths();
    assert_eq!(breaths.len(), BREATHS);
    let pip = |(number, rows): (usize, std::ops::Range<usize>)| {
        assert!(recording.tick[rows.clone()].iter().copied().eq(0..3000), "breath {number} is whole");
        recording.pip[rows.start]
    };
    breaths.into_iter().enumerate().map(pip).collect()
}

#[test]
#[cfg(unix)]
fn a_farm_that_is_killed_at_twenty_moments_loses_and_doubles_no_breath() {
    let place = Place::new();
    let line =
        |out: &str| format!("farm --virtual 2 --until collect --breaths {BREATHS} --pace 40 --out {out}");
    let recorded = |unit| {
        let folder = place.path(&format!("killed/units/{unit}/measurement-0/breaths"));
        std::fs::read_dir(folder).map_or(0, Iterator::count)
    };
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for kill in 1..=KILLS {
        let before = [1, 2].map(recorded);
        let mut child =
            place.command(&line("killed")).stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        // The measurement of the zero, 30 s of a device that is forty times as fast as a chip, is not saved in parts.
        let (begun, moment) = (Instant::now(), Duration::from_millis(rng.random_range(100..1_600)));
        let begins = |kill| kill == KILLS && [1, 2].map(recorded).contains(&0);
        // The last kill interrupts recordings, however slow the machine is.
        while (begun.elapsed() < moment || begins(kill))
            && [1, 2].into_iter().zip(before).all(|(unit, before)| recorded(unit) < before + SESSION)
        {
            assert!(begun.elapsed() < Duration::from_mins(2), "no recording has begun");
            std::thread::sleep(Duration::from_millis(5));
        }
        // On Unix, this is SIGKILL.
        child.kill().unwrap();
        child.wait().unwrap();
    }
    place.ok(&line("killed"));
    place.ok(&line("straight"));
    for unit in [1, 2] {
        assert_eq!(
            pips(&recording(&place, "killed", unit)),
            pips(&recording(&place, "straight", unit)),
            "PIPs are those of a farm that was never killed"
        );
    }
}

#[test]
fn a_wrong_description_is_refused_with_its_line_and_leaves_no_folder() {
    let place = Place::new();
    for (text_of_file, wanted) in [
        (
            "[[unit]]\nport = \"/dev/no-such\"\n[[unit]]\nport = \"/dev/no-such\"\n",
            "farm.toml:4: unit 2 has the port of unit 1",
        ),
        ("[[unit]]\nport = \"/dev/no-such\"\nlung = \"R5\"\n", "farm.toml:3: unknown lung \"R5\""),
        ("[[unit]]\n", "farm.toml:1: unit 1 needs a port or a bench"),
    ] {
        std::fs::write(place.path("farm.toml"), text_of_file).unwrap();
        let output = place.run("farm farm.toml --out farm");
        assert!(!output.status.success());
        assert!(text(&output.stderr).contains(wanted), "{}", text(&output.stderr));
        assert!(!place.path("farm").exists());
    }
}

#[test]
fn a_unit_that_is_not_there_is_named_and_the_rest_is_recorded() {
    let place = Place::new();
    let farm = "[[unit]]\nname = \"absent\"\nport = \"/dev/no-such\"\n[[unit]]\nname = \"here\"\nbench = \"R20C20\"\n";
    std::fs::write(place.path("farm.toml"), farm).unwrap();
    let output =
        place.run("farm farm.toml --out farm --until collect --breaths 8 --patience 0 --json farm.json");
    assert!(!output.status.success());
    assert!(
        text(&output.stderr).contains("not all units are done (absent left out)"),
        "{}",
        text(&output.stderr)
    );
    let result: serde_json::Value =
        serde_json::from_str(&std::fs::read_to_string(place.path("farm.json")).unwrap()).unwrap();
    assert_eq!(result["units"][1]["breaths"], 8);
    assert_eq!(result["units"][1]["problem"], serde_json::Value::Null);
    assert!(place.path("farm/units/here/measurement-0/recording.parquet").exists());
}
