//! Tests of recordings and captures.

use super::*;
use data::recording::Recording;
use shared::link::messages::{ControllerChoice, DeviceKind};
use shared::reset::ResetCause;
use shared::ventilator::Mode;
use shared::weights::slots::SlotState;

fn sample(breath: u32, tick: u32, pressure: f32) -> Sample {
    let phase = if tick < 50 { Phase::Inspiration } else { Phase::Expiration };
    Sample {
        breath,
        tick,
        phase,
        target: 20.0,
        pressure,
        u_in: 30.0,
        u_out: tick >= 50,
        explore: 0.0,
        learned: 0.0,
        flow: None,
    }
}

fn recorder(folder: &Path) -> Recorder {
    Recorder::new(folder, 3, "a lung", 10_000)
}

/// Feeds breaths of 100 ticks at a pressure; returns what is told.
fn breathe(recorder: &mut Recorder, breaths: std::ops::Range<u32>, pressure: f32) -> Vec<Told> {
    let settings = Settings::default();
    breaths
        .flat_map(|breath| (0..100).map(move |tick| (breath, tick)))
        .flat_map(|(breath, tick)| recorder.sample(&sample(breath, tick, pressure), Some(&settings), 7))
        .collect()
}

fn files(folder: &Path) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> =
        std::fs::read_dir(folder).unwrap().map(|entry| entry.unwrap().path()).collect();
    files.sort();
    files
}

#[test]
fn a_recording_holds_every_sample_from_its_start_to_its_end_and_the_markers() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    breathe(&mut recorder, 0..2, 20.0);
    let path = recorder.start(5, None, "a page").unwrap();
    assert_eq!(recorder.start(6, None, "another").unwrap(), path, "it goes on");
    breathe(&mut recorder, 2..4, 20.0);
    assert_eq!(recorder.mark("suction", 9), None);
    // Ventilation starts again, from breath 0.
    breathe(&mut recorder, 0..1, 20.0);
    assert_eq!(recorder.info().unwrap().samples, 300);
    assert_eq!(recorder.stop().unwrap().unwrap().samples, 300);
    breathe(&mut recorder, 1..2, 20.0);
    let recording = Recording::load(&path).unwrap();
    assert_eq!((recording.len(), recording.breath[0], recording.breath[299]), (300, 2, 4));
    assert_eq!(recording.provenance.notes, ["marker after breath 3 tick 99: suction"]);
    assert_eq!(recorder.stop().unwrap(), None);
}

#[test]
fn a_capture_has_ten_seconds_before_its_trigger_and_ten_after_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    recorder.arm(Triggers { pressure: Some(30.0), ..Triggers::default() });
    assert_eq!(breathe(&mut recorder, 0..20, 20.0), []);
    assert_eq!(files(folder.path()).len(), 0, "nothing has triggered it");
    breathe(&mut recorder, 20..21, 31.0);
    let told = breathe(&mut recorder, 21..40, 20.0);
    assert!(told.len() == 1 && told[0].0.starts_with("capture written to "), "{told:?}");
    assert_eq!(recorder.triggers(), None, "one shot");
    assert_eq!(breathe(&mut recorder, 40..41, 31.0), []);
    assert_eq!(files(folder.path()).len(), 1);
    let recording = Recording::load(&files(folder.path())[0]).unwrap();
    let above = recording.pressure.iter().position(|pressure| *pressure > 30.0).unwrap();
    assert_eq!((above, recording.len()), (999, 2000));
    assert_eq!(recording.provenance.notes, ["triggered capture: pressure above the threshold"]);
}

#[test]
fn alarms_and_overshoots_trigger_only_if_they_are_armed() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    let overshoot = |overshoot| BreathFigures { overshoot: Some(overshoot), ..BreathFigures::default() };
    breathe(&mut recorder, 0..1, 20.0);
    recorder.alarm("leak", 1);
    recorder.breath(&overshoot(5.0), 1);
    assert!(recorder.running.is_none());
    recorder.arm(Triggers { overshoot: Some(2.0), ..Triggers::default() });
    recorder.breath(&overshoot(1.9), 2);
    assert!(recorder.running.is_none());
    recorder.breath(&overshoot(2.1), 2);
    assert!(recorder.running.take().is_some());
    recorder.arm(Triggers { alarm: true, ..Triggers::default() });
    recorder.alarm("leak", 3);
    assert!(recorder.running.is_some());
}

#[test]
fn a_recording_is_whole_when_the_server_ends() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    let path = recorder.start(5, None, "a page").unwrap();
    breathe(&mut recorder, 0..1, 20.0);
    recorder.sample(&sample(1, 0, f32::NAN), Some(&Settings::default()), 5);
    drop(recorder);
    let recording = Recording::load(path).unwrap();
    assert_eq!(recording.len(), 100, "a reading that is no number is left out");
    assert_eq!(recording.provenance.notes, ["left out: 1 samples with a value that is no number"]);
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error_and_nothing_else() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let mut recorder = recorder(file.path());
    assert!(recorder.start(5, None, "a page").is_err());
    assert_eq!((recorder.info(), breathe(&mut recorder, 0..1, 20.0)), (None, vec![]));
}

#[test]
fn samples_from_before_the_settings_are_left_out_and_no_settings_are_invented() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    let path = recorder.start(5, None, "a page").unwrap();
    (0..5).for_each(|tick| _ = recorder.sample(&sample(0, tick, 20.0), None, 7));
    let settings = Settings { pip: 31.0, peep: 8.0, ..Settings::default() };
    (5..9).for_each(|tick| _ = recorder.sample(&sample(0, tick, 20.0), Some(&settings), 7));
    assert_eq!(recorder.info().unwrap().samples, 4);
    recorder.stop().unwrap();
    let recording = Recording::load(path).unwrap();
    assert_eq!(
        (recording.tick, recording.pip, recording.peep),
        (vec![5, 6, 7, 8], vec![31.0; 4], vec![8.0; 4])
    );
    let notes = recording.provenance.notes;
    assert_eq!(notes, ["left out: 5 samples before the device reported its settings"]);
}

#[test]
fn a_recording_whose_mcap_file_cannot_be_created_does_not_start() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    let identity = DeviceIdentity {
        protocol: shared::link::PROTOCOL,
        firmware: [0, 1, 0],
        device: DeviceKind::Ventilator,
        period_us: 10_000,
        mode: Mode::Standby,
        controller: ControllerChoice::Learned,
        exploration: None,
        slots: [SlotState::Empty, SlotState::Empty],
        running: None,
        reset: ResetCause::PowerOn,
        failure: None,
        weights_key: None,
    };
    // A folder is in its place.
    let mcap = folder.path().join("recording-3-5.mcap");
    std::fs::create_dir(&mcap).unwrap();
    assert!(recorder.start(5, Some(&identity), "a page").is_err());
    assert_eq!((recorder.info(), files(folder.path())), (None, vec![mcap]), "nor is half of it left");
    recorder.start(6, Some(&identity), "a page").unwrap();
    assert!(recorder.has_mcap());
}
