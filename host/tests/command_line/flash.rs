//! `trainer flash --firmware`: the file of a release, through a debug probe. A program that notes its arguments stands in for probe-rs.

use std::collections::BTreeMap;
use std::fs;

use firmware_file::{Content, Firmware, KeyPair, Part, ReleaseKey, Seed, write};

use super::support::{Place, text};

fn pair() -> KeyPair {
    KeyPair::from_seed(Seed::new([42; 32]))
}

/// Writes `release.zip` for the Nucleo, and returns the key that signed it.
fn release(place: &Place, usb_dfu: bool) -> ReleaseKey {
    let files: BTreeMap<_, _> = [("p.bin", vec![1; 300]), ("w.bin", vec![2; 200])]
        .map(|(name, bytes)| (name.to_owned(), bytes))
        .into();
    let part = |content, file: &str, address, bytes| Part { content, file: file.into(), address, bytes };
    let firmware = Firmware {
        version: "0.1.0".into(),
        revision: "abc".into(),
        board: "stm32f446".into(),
        chip: "STM32F446RETx".into(),
        image: "The second board".into(),
        usb_dfu,
        parts: vec![
            part(Content::Program, "p.bin", 0x0800_0000, 300),
            part(Content::Weights, "w.bin", 0x0804_0000, 200),
        ],
    };
    fs::write(place.path("release.zip"), write(&firmware, &files, &pair()).unwrap()).unwrap();
    ReleaseKey::of(&pair())
}

/// Runs a command with this program as the only probe-rs.
#[cfg(unix)]
fn with_probe(place: &Place, program: &str, line: &str) -> (bool, String) {
    use std::os::unix::fs::PermissionsExt as _;

    fs::create_dir_all(place.path("bin")).unwrap();
    let file = place.path("bin/probe-rs");
    fs::write(&file, program).unwrap();
    fs::set_permissions(&file, fs::Permissions::from_mode(0o755)).unwrap();
    let output = place.command(line).env("PATH", place.path("bin")).output().unwrap();
    (output.status.success(), text(&output.stdout) + &text(&output.stderr))
}

#[cfg(unix)]
#[test]
fn a_verified_release_is_loaded_part_by_part_through_the_probe() {
    let place = Place::new();
    let key = release(&place, true);
    let line = format!("flash --firmware release.zip --for stm32f446 --trust {key}");
    let note =
        "#!/bin/sh\nfor last; do :; done\necho \"$@\" >> calls\necho $(($(/bin/wc -c < $last))) >> sizes\n";
    let (ok, told) = with_probe(&place, note, &line);
    assert!(ok, "{told}");
    for word in ["The second board 0.1.0 (revision abc) for stm32f446", "verified", "reset button"] {
        assert!(told.contains(word), "{told}");
    }
    let calls = fs::read_to_string(place.path("calls")).unwrap();
    let calls: Vec<&str> = calls.lines().map(|call| call.rsplit_once(' ').unwrap().0).collect();
    let call = |address| {
        format!("download --verify --chip STM32F446RETx --binary-format bin --base-address {address}")
    };
    assert_eq!(calls, [call("0x8000000"), call("0x8040000")]);
    assert_eq!(fs::read_to_string(place.path("sizes")).unwrap(), "300\n200\n");
    let (ok, told) = with_probe(&place, "#!/bin/sh\nexit 1\n", &line);
    assert!(!ok && told.contains("check that the probe is plugged in"), "{told}");
    let output = place.command(&line).env("PATH", place.path("nowhere")).output().unwrap();
    assert!(text(&output.stderr).contains("take it from https://probe.rs"), "{}", text(&output.stderr));
}

#[test]
fn the_firmware_of_another_board_is_refused() {
    let place = Place::new();
    let key = release(&place, false);
    let refused = place.refused(&format!("flash --firmware release.zip --for stm32f405 --trust {key}"));
    assert!(refused.contains("for the board stm32f446 (The second board), not for stm32f405"), "{refused}");
    fs::write(place.path("own.elf"), "").unwrap();
    let refused = place.refused("flash own.elf --for esp32");
    assert!(refused.contains("no board is named esp32"), "{refused}");
}

#[test]
fn a_damaged_unsigned_or_otherwise_signed_file_is_refused_with_what_to_do() {
    let place = Place::new();
    let key = release(&place, true);
    let line = |file: &str, key| format!("flash --firmware {file} --for stm32f446 --trust {key}");
    let other = ReleaseKey::of(&KeyPair::from_seed(Seed::new([43; 32])));
    let refused = place.refused(&line("release.zip", other));
    assert!(refused.contains(&format!("signed by the key {key}")), "{refused}");
    let mut bytes = fs::read(place.path("release.zip")).unwrap();
    bytes.truncate(bytes.len() / 2);
    fs::write(place.path("half.zip"), bytes).unwrap();
    let refused = place.refused(&line("half.zip", key));
    assert!(refused.contains("half.zip") && refused.contains("download the release file again"), "{refused}");
    assert!(place.refused(&line("none.zip", key)).contains("cannot read none.zip"));
}

#[test]
fn a_program_without_a_built_in_key_says_how_to_name_one() {
    if option_env!("EUPNEA_RELEASE_KEY").is_some_and(|key| !key.is_empty()) {
        return;
    }
    let place = Place::new();
    release(&place, true);
    let refused = place.refused("flash --firmware release.zip --for stm32f446");
    assert!(refused.contains("without a release key") && refused.contains("--trust"), "{refused}");
}

#[test]
fn arguments_that_do_not_fit_a_release_are_refused() {
    let place = Place::new();
    assert!(place.wrong("flash --firmware release.zip").contains("--for"));
    assert!(place.wrong("flash --firmware a.zip --for b --trust 12").contains("64 hexadecimal digits"));
    place.wrong("flash --firmware a.zip --for b --port c");
    place.wrong("flash weights.bin --dfu");
    assert!(place.refused("flash eupnea.zip").contains("--firmware"));
}

#[test]
fn a_board_without_usb_is_told_before_a_device_is_looked_for() {
    let place = Place::new();
    let key = release(&place, false);
    let refused = place.refused(&format!("flash --firmware release.zip --for stm32f446 --trust {key} --dfu"));
    assert!(refused.contains("has no USB"), "{refused}");
}
