//! Tests of recordings and captures.

use std::time::{Duration, Instant};

use super::*;
use data::recording::Recording;
use shared::breath::Phase;
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

/// Longest time that the writer may take.
const LONG: Duration = Duration::from_mins(1);

/// Feeds samples with these settings.
fn feed(recorder: &mut Recorder, samples: impl IntoIterator<Item = Sample>, settings: Option<&Settings>) {
    let room = recorder.writer.has_room();
    recorder.samples(samples, settings, room, 7);
}

/// Feeds breaths of 100 ticks at a pressure.
fn breathe(recorder: &mut Recorder, breaths: std::ops::Range<u32>, pressure: f32) {
    for breath in breaths {
        feed(recorder, (0..100).map(|tick| sample(breath, tick, pressure)), Some(&Settings::default()));
    }
}

/// The next notice of the recorder.
fn notice(recorder: &mut Recorder) -> Notice {
    let deadline = Instant::now() + LONG;
    loop {
        let mut notices = recorder.notices();
        if !notices.is_empty() {
            // What else has come is for the next call.
            recorder.notices.extend(notices.drain(1..));
            return notices.remove(0);
        }
        assert!(Instant::now() < deadline, "no notice comes");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A device of which an MCAP file can be written.
fn identity() -> DeviceIdentity {
    DeviceIdentity {
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
    }
}

/// Starts a recording; returns its file.
fn start(recorder: &mut Recorder) -> PathBuf {
    recorder.start(5, None, "a page").unwrap();
    assert!(matches!(notice(recorder), Notice::Started(Ok(_))));
    recorder.info().unwrap().file.into()
}

/// Ends the recording; returns the answer.
fn stop(recorder: &mut Recorder) -> String {
    assert!(recorder.stop());
    match notice(recorder) {
        Notice::Stopped(Ok(text)) => text,
        other => panic!("{other:?}"),
    }
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
    let path = start(&mut recorder);
    recorder.start(6, None, "another").unwrap();
    let goes_on = format!("recording to {}, without MCAP: the device is not known", path.display());
    assert_eq!(notice(&mut recorder), Notice::Started(Ok(goes_on)));
    breathe(&mut recorder, 2..4, 20.0);
    assert!(recorder.mark("suction", 9));
    // Ventilation starts again, from breath 0.
    breathe(&mut recorder, 0..1, 20.0);
    assert_eq!(recorder.info().unwrap().samples, 300);
    assert_eq!(stop(&mut recorder), format!("300 samples written to {}", path.display()));
    breathe(&mut recorder, 1..2, 20.0);
    let recording = Recording::load(&path).unwrap();
    assert_eq!((recording.len(), recording.breath[0], recording.breath[299]), (300, 2, 4));
    assert_eq!(recording.provenance.notes, ["marker after breath 3 tick 99: suction"]);
    assert!(!recorder.stop(), "nothing is being recorded");
}

#[test]
fn a_capture_has_ten_seconds_before_its_trigger_and_ten_after_it() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    recorder.arm(Triggers { pressure: Some(30.0), ..Triggers::default() });
    breathe(&mut recorder, 0..20, 20.0);
    assert_eq!(files(folder.path()).len(), 0, "nothing has triggered it");
    breathe(&mut recorder, 20..21, 31.0);
    breathe(&mut recorder, 21..40, 20.0);
    let Notice::Event(text) = notice(&mut recorder) else { panic!() };
    assert!(text.starts_with("capture: 2000 samples written to "), "{text}");
    assert_eq!(recorder.triggers(), None, "one shot");
    breathe(&mut recorder, 40..41, 31.0);
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
    assert!(recorder.capture.is_none());
    recorder.arm(Triggers { overshoot: Some(2.0), ..Triggers::default() });
    recorder.breath(&overshoot(1.9), 2);
    assert!(recorder.capture.is_none());
    recorder.breath(&overshoot(2.1), 2);
    assert!(recorder.capture.take().is_some());
    recorder.arm(Triggers { alarm: true, ..Triggers::default() });
    recorder.alarm("leak", 3);
    assert!(recorder.capture.is_some());
}

#[test]
fn a_recording_is_whole_when_the_server_ends() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    let path = start(&mut recorder);
    breathe(&mut recorder, 0..1, 20.0);
    feed(&mut recorder, [sample(1, 0, f32::NAN)], Some(&Settings::default()));
    drop(recorder);
    let recording = Recording::load(path).unwrap();
    assert_eq!(recording.len(), 100, "a reading that is no number is left out");
    assert_eq!(recording.provenance.notes, ["left out: 1 samples with a value that is no number"]);
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error_and_nothing_else() {
    let file = tempfile::NamedTempFile::new().unwrap();
    let mut recorder = recorder(file.path());
    recorder.start(5, None, "a page").unwrap();
    assert!(matches!(notice(&mut recorder), Notice::Started(Err(_))));
    breathe(&mut recorder, 0..1, 20.0);
    assert_eq!((recorder.info(), recorder.notices()), (None, vec![]));
}

#[test]
fn samples_from_before_the_settings_are_left_out_and_no_settings_are_invented() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    let path = start(&mut recorder);
    feed(&mut recorder, (0..5).map(|tick| sample(0, tick, 20.0)), None);
    let settings = Settings { pip: 31.0, peep: 8.0, ..Settings::default() };
    feed(&mut recorder, (5..9).map(|tick| sample(0, tick, 20.0)), Some(&settings));
    assert_eq!(recorder.info().unwrap().samples, 4);
    let gap = "left out: 5 samples before the device reported its settings";
    assert_eq!(stop(&mut recorder), format!("4 samples written to {}; {gap}", path.display()));
    let recording = Recording::load(path).unwrap();
    assert_eq!(
        (recording.tick, recording.pip, recording.peep),
        (vec![5, 6, 7, 8], vec![31.0; 4], vec![8.0; 4])
    );
    let notes = recording.provenance.notes;
    assert_eq!(notes, [gap]);
}

#[test]
fn a_recording_whose_mcap_file_cannot_be_created_does_not_start() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    let identity = identity();
    // A folder is in its place.
    let mcap = folder.path().join("recording-3-5.mcap");
    std::fs::create_dir(&mcap).unwrap();
    recorder.start(5, Some(&identity), "a page").unwrap();
    assert!(matches!(notice(&mut recorder), Notice::Started(Err(_))));
    assert_eq!((recorder.info(), files(folder.path())), (None, vec![mcap]), "nor is half of it left");
    recorder.start(6, Some(&identity), "a page").unwrap();
    let Notice::Started(Ok(text)) = notice(&mut recorder) else { panic!() };
    assert!(text.ends_with("recording-3-6.parquet"), "with MCAP: {text}");
}

#[test]
fn a_disk_that_hangs_delays_nothing_and_what_it_loses_is_counted_and_reported() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    let path = start(&mut recorder);
    breathe(&mut recorder, 0..1, 20.0);
    let goes_on = recorder.hang();
    let breaths = 1 + WAITING_MAX as u32 / 100;
    breathe(&mut recorder, 1..breaths + 7, 20.0);
    assert!(!recorder.mark("suction", 9), "there is no room");
    let RecordingInfo { samples, lost, .. } = recorder.info().unwrap();
    assert_eq!(samples + lost, u64::from(breaths + 7) * 100);
    assert!((600..=800).contains(&lost), "{lost}");
    let event = Notice::Event("the disk is too slow: the recording loses samples".to_owned());
    assert_eq!(recorder.notices(), [event], "once");
    drop(goes_on);
    let deadline = Instant::now() + LONG;
    while !recorder.writer.has_room() {
        assert!(Instant::now() < deadline, "it does not go on");
    }
    breathe(&mut recorder, breaths + 7..breaths + 8, 20.0);
    let gap = format!("lost: {lost} samples for which the disk was too slow");
    assert_eq!(
        stop(&mut recorder),
        format!("{} samples written to {}; {gap}", samples + 100, path.display())
    );
    let recording = Recording::load(path).unwrap();
    assert_eq!((recording.len() as u64, recording.breath.last()), (samples + 100, Some(&(breaths + 7))));
    assert!(recording.breath.is_sorted(), "in order");
    let notes = recording.provenance.notes;
    assert!(notes.len() == 2 && notes[0].ends_with("samples are lost from here on"), "{notes:?}");
    assert_eq!(notes[1], gap);
}

#[test]
fn a_recorder_that_ends_while_its_disk_hangs_writes_everything_that_waits() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    let path = start(&mut recorder);
    recorder.arm(Triggers { alarm: true, ..Triggers::default() });
    let goes_on = recorder.hang();
    breathe(&mut recorder, 0..5, 20.0);
    recorder.alarm("leak", 8);
    breathe(&mut recorder, 5..6, 20.0);
    let ending = std::thread::spawn(move || drop(recorder));
    drop(goes_on);
    ending.join().unwrap();
    assert_eq!(Recording::load(path).unwrap().len(), 600);
    assert_eq!(Recording::load(folder.path().join("capture-3-8.parquet")).unwrap().len(), 600);
}

#[test]
fn a_folder_that_is_gone_is_reported_when_the_recording_ends() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    start(&mut recorder);
    breathe(&mut recorder, 0..1, 20.0);
    folder.close().unwrap();
    assert!(recorder.stop());
    assert!(recorder.start(9, None, "another").is_err(), "the last one is not finished");
    let Notice::Stopped(Err(why)) = notice(&mut recorder) else { panic!() };
    assert!(why.contains("cannot write"), "{why}");
    assert_eq!((recorder.info(), recorder.stop()), (None, false));
}

#[test]
fn a_write_that_fails_ends_the_recording_and_is_reported() {
    let folder = tempfile::tempdir().unwrap();
    let mut recorder = recorder(folder.path());
    recorder.start(5, Some(&identity()), "a page").unwrap();
    assert!(matches!(notice(&mut recorder), Notice::Started(Ok(_))));
    // Rows that are not in order are found as late as a full disk is: when a whole group of them is written.
    for _ in 0..2 {
        let rows = vec![Row::default(); 1 << 17];
        recorder.writer.give(Job::Rows { which: Which::Recording, rows });
    }
    let Notice::Event(text) = notice(&mut recorder) else { panic!() };
    assert!(text.starts_with("the recording ends here: "), "{text}");
    let mcap = std::fs::read(folder.path().join("recording-3-5.mcap")).unwrap();
    assert!(mcap.ends_with(b"\x89MCAP0\r\n"), "the MCAP file is finished, too");
    assert!(!recorder.stop());
    start(&mut recorder);
}
