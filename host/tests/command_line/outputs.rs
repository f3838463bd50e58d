//! An output never destroys: it is no input, replaces nothing of another kind and no recording, and follows links, pipes and devices.

use std::fs;
use std::io::Read;
use std::process::Stdio;

use data::recording::Recording;

use super::support::{Place, text};

#[test]
fn an_output_that_is_an_input_is_refused_by_any_name() {
    let place = Place::new();
    let recording = place.collected();
    fs::create_dir(place.path("folder")).unwrap();
    fs::hard_link(place.path(recording), place.path("twin.parquet")).unwrap();
    let whole = fs::read(place.path(recording)).unwrap();
    for output in ["first.parquet", "./first.parquet", "folder/../first.parquet", "twin.parquet"] {
        for line in
            ["fit first.parquet --out", "identify first.parquet --write-plant", "judge first.parquet --json"]
        {
            let refused = place.wrong(&format!("{line} {output}"));
            let option = line.rsplit(' ').next().unwrap();
            assert!(refused.contains("read by this command too") && refused.contains(option), "{refused}");
        }
    }
    assert_eq!(fs::read(place.path(recording)).unwrap(), whole);
}

#[test]
fn two_outputs_in_one_file_are_refused() {
    let place = Place::new();
    let refused = place.wrong("collect --breaths 2 --out a.parquet --json ./a.parquet");
    assert!(refused.contains("--out") && refused.contains("--json"), "{refused}");
    assert!(!place.path("a.parquet").exists());
}

#[test]
fn a_file_of_another_kind_stays_unless_forced() {
    let place = Place::new();
    let recording = place.collected();
    let table = "time,pressure\n0,5\n";
    for (line, file) in [
        ("collect --breaths 2 --out", "lab.csv"),
        ("evaluate --pips 20 --breaths 1 --json", recording),
        ("evaluate --pips 20 --breaths 1 --report", "lab.csv"),
    ] {
        fs::write(place.path("lab.csv"), table).unwrap();
        let before = fs::read(place.path(file)).unwrap();
        let refused = place.wrong(&format!("{line} {file}"));
        assert!(refused.contains(" is a ") && refused.contains("--force"), "{refused}");
        assert_eq!(fs::read(place.path(file)).unwrap(), before, "{line}");
        place.ok(&format!("{line} {file} --force"));
        assert_ne!(fs::read(place.path(file)).unwrap(), before, "{line}");
    }
}

#[test]
fn an_earlier_recording_stays_unless_forced_and_json_is_replaced() {
    let place = Place::new();
    let recording = place.path(place.collected());
    let before = fs::read(&recording).unwrap();
    let refused = place.wrong("collect --breaths 2 --out first.parquet");
    assert!(refused.contains("earlier recording") && refused.contains("--force"), "{refused}");
    assert_eq!(fs::read(&recording).unwrap(), before);
    place.ok("collect --breaths 2 --out first.parquet --force --json a.json");
    place.ok("judge first.parquet --json a.json");
    assert_ne!(fs::read(&recording).unwrap(), before);
}

#[test]
fn a_file_that_may_only_be_read_stays_unless_forced() {
    let place = Place::new();
    let recording = place.path(place.collected());
    let protect = || {
        let mut permissions = fs::metadata(&recording).unwrap().permissions();
        permissions.set_readonly(true);
        fs::set_permissions(&recording, permissions).unwrap();
    };
    protect();
    let refused = place.wrong("collect --breaths 2 --out first.parquet");
    assert!(refused.contains("may only be read"), "{refused}");
    let refused = place.wrong("judge first.parquet --json first.parquet --force");
    assert!(refused.contains("read by this command too"), "{refused}");
    place.ok("collect --breaths 2 --out first.parquet --force");
}

#[test]
fn a_folder_that_cannot_be_written_is_found_before_the_work() {
    let place = Place::new();
    fs::write(place.path("file"), "x").unwrap();
    fs::create_dir(place.path("folder")).unwrap();
    for output in ["file/a.parquet", "file/deep/a.parquet", "folder"] {
        // So many breaths would take hours.
        let refused = place.wrong(&format!("collect --breaths 10000000 --out {output}"));
        assert!(refused.contains("cannot write"), "{refused}");
    }
}

#[cfg(unix)]
#[test]
fn links_pipes_and_devices_stay_what_they_are() {
    use std::os::unix::fs::FileTypeExt;
    let place = Place::new();
    place.collected();
    fs::write(place.path("target.json"), "{}").unwrap();
    std::os::unix::fs::symlink("target.json", place.path("link.json")).unwrap();
    place.ok("judge first.parquet --json link.json");
    assert!(place.path("link.json").is_symlink());
    let json = fs::read_to_string(place.path("target.json")).unwrap();
    assert!(json.len() > 100);

    assert!(place.program("mkfifo").arg("pipe").status().unwrap().success());
    let reader = place.program("cat").arg("pipe").stdout(Stdio::piped()).spawn().unwrap();
    place.ok("judge first.parquet --json pipe");
    assert_eq!(text(&reader.wait_with_output().unwrap().stdout), json);
    assert!(fs::metadata(place.path("pipe")).unwrap().file_type().is_fifo());
    place.ok("evaluate --pips 20 --breaths 1 --json /dev/null --report /dev/null");
    assert!(!fs::metadata("/dev/null").unwrap().is_file());
}

#[cfg(target_os = "linux")]
#[test]
fn a_full_disk_is_an_error_and_a_closed_pipe_is_none() {
    let place = Place::new();
    place.collected();
    let full = || fs::File::options().write(true).open("/dev/full").unwrap();
    for line in ["judge first.parquet", "judge first.parquet --json -", "inspect first.parquet"] {
        let output = place.command(line).stdout(full()).output().unwrap();
        assert_eq!(output.status.code(), Some(1), "{line}");
        assert!(text(&output.stderr).contains("No space left"), "{line}: {}", text(&output.stderr));

        let mut child = place.command(line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
        drop(child.stdout.take());
        let mut stderr = String::new();
        child.stderr.take().unwrap().read_to_string(&mut stderr).unwrap();
        assert!(child.wait().unwrap().success() && stderr.is_empty(), "{line}: {stderr}");
    }
}

#[cfg(target_os = "linux")]
#[test]
fn breaths_for_which_the_disk_has_become_too_full_are_saved_elsewhere() {
    let place = Place::new();
    let elsewhere = place.path("elsewhere");
    fs::create_dir(&elsewhere).unwrap();
    let mut command = place.command("collect --breaths 2 --out /dev/full");
    let output = command.env("TMPDIR", &elsewhere).output().unwrap();
    let stderr = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{stderr}");
    let [saved] = &fs::read_dir(&elsewhere).unwrap().map(|file| file.unwrap().path()).collect::<Vec<_>>()[..]
    else {
        panic!("{stderr}");
    };
    assert!(stderr.contains("No space left") && stderr.contains(&*saved.to_string_lossy()), "{stderr}");
    assert_eq!(Recording::load(saved).unwrap().breaths().len(), 2);
}

/// The largest number of breaths takes terabytes.
#[test]
fn a_disk_without_room_is_noticed_before_the_work_begins() {
    let place = Place::new();
    let full = place.refused("collect --breaths 100000000 --out big.parquet");
    assert!(full.contains("MB free") && full.contains("are needed"), "{full}");
    assert!(!place.path("big.parquet").exists());
}
