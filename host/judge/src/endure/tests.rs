use super::course::{Event, Scene};
use super::deserved::Verdict;
use super::*;
use plant::bench::Failure;
use shared::safety::alarms::Fault;

/// Two minutes.
const HOURS: f64 = 1.0 / 30.0;

fn controller() -> Controller {
    sound_controller().unwrap().0
}

fn endured(patients: u64) -> Endurance {
    let mut test = Endurance::new(3, HOURS, "PID");
    test.advance(patients, &controller(), None, &Progress::silent()).unwrap();
    test
}

/// A passive patient at a sound machine, of which a part may fail after some milliseconds.
fn patient(failure: Option<(u32, Failure)>) -> Patient {
    let mut patient = Patient::draw(1, 0, HOURS);
    patient.bench = plant::bench::BenchConfig::paper(20.0, 20.0);
    patient.settings = shared::breath::paper_settings(25.0);
    (patient.changes, patient.failure) = (Vec::new(), failure);
    patient
}

/// Collects the alarms of a stay.
#[derive(Default)]
struct Alarms(Vec<(Fault, Verdict)>);

impl Observer for Alarms {
    fn event(&mut self, event: &Event, _: &Scene<'_>) {
        if let Event::Alarm(fault, verdict) = event {
            self.0.push((*fault, *verdict));
        }
    }
}

fn stay(failure: Option<Failure>) -> (PatientResult, Vec<(Fault, Verdict)>) {
    let mut alarms = Alarms::default();
    let patient = patient(failure.map(|failure| (30_300, failure)));
    let result = course::run(&patient, &controller(), HOURS, &mut alarms).unwrap().unwrap();
    (result, alarms.0)
}

#[test]
fn a_sound_machine_ventilates_a_passive_patient_without_an_alarm() {
    let (result, alarms) = stay(None);
    assert_eq!((result.interruptions, result.missed(), alarms.as_slice()), (0, 0, [].as_slice()));
    assert_eq!(result.breaths, 40, "20 a minute");
    assert!((result.minute_volume_share - 1.0).abs() < 0.03, "{}", result.minute_volume_share);
    assert!((24.0..40.0).contains(&result.peak_true) && result.longest_gap_s < 3.0, "{result:?}");
}

#[test]
fn a_sabotaged_machine_interrupts_ventilation_and_its_alarms_are_deserved() {
    let (result, alarms) = stay(Some(Failure::ExpiratoryValveClosed));
    assert!(result.interruptions > 0, "{result:?}");
    assert!(alarms.iter().any(|(_, verdict)| *verdict == Verdict::Deserved), "{alarms:?}");
    let (result, alarms) = stay(Some(Failure::Disconnected));
    assert!(alarms.contains(&(Fault::Disconnection, Verdict::Deserved)), "{alarms:?}");
    assert!(result.interruptions > 0 && result.longest_gap_s > 80.0, "{result:?}");
    let (_, alarms) = stay(Some(Failure::TubeOccluded));
    assert!(alarms.contains(&(Fault::Occlusion, Verdict::Deserved)), "{alarms:?}");
    assert!(alarms.contains(&(Fault::Apnoea, Verdict::Deserved)), "{alarms:?}");
    let (_, alarms) = stay(Some(Failure::PeepValveStuck(12.0)));
    assert!(alarms.contains(&(Fault::BaselineHigh, Verdict::Deserved)), "{alarms:?}");
    let (_, alarms) = stay(Some(Failure::Leak(0.45)));
    assert!(alarms.contains(&(Fault::Leak, Verdict::Deserved)), "{alarms:?}");
}

#[test]
fn alarms_about_volumes_are_deserved_if_the_lung_takes_that_much() {
    let with = |low: f32, high: f32| {
        let mut patient = patient(None);
        // 400 mL and 8 L/min.
        let (limits, minute) = (400.0 * low, 8.0 * low);
        (patient.settings.tidal_volume_low, patient.settings.minute_volume_low) = (limits, minute);
        (patient.settings.tidal_volume_high, patient.settings.minute_volume_high) =
            (400.0 * high, 8.0 * high);
        let mut alarms = Alarms::default();
        let result = course::run(&patient, &controller(), HOURS, &mut alarms).unwrap().unwrap();
        assert_eq!(result.missed(), 0);
        alarms.0.sort_unstable_by_key(|(fault, _)| *fault);
        alarms.0
    };
    assert_eq!(with(0.8, 1.2), []);
    let deserved = |faults: [Fault; 2]| faults.map(|fault| (fault, Verdict::Deserved));
    assert_eq!(with(1.3, 0.0), deserved([Fault::TidalVolumeLow, Fault::MinuteVolumeLow]));
    assert_eq!(with(0.0, 0.7), deserved([Fault::TidalVolumeHigh, Fault::MinuteVolumeHigh]));
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| endured(6))
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn a_test_in_two_parts_finds_what_one_in_a_single_part_finds() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("endure.json");
    for patients in [3, 7] {
        let mut part = Endurance::new(3, HOURS, "PID").resumed(&file).unwrap();
        part.advance(patients, &controller(), Some(&file), &Progress::silent()).unwrap();
    }
    let kept = Endurance::new(3, HOURS, "PID").resumed(&file).unwrap();
    let whole = endured(7);
    assert_eq!(kept, whole);
    assert_eq!(kept.summary(3), endured(3).summary(3), "fewer patients than the file has");
    for other in
        [Endurance::new(4, HOURS, "PID"), Endurance::new(3, 1.0, "PID"), Endurance::new(3, HOURS, "other")]
    {
        let refused = other.resumed(&file).unwrap_err().to_string();
        assert!(refused.contains("belongs to seed 3"), "{refused}");
    }
}

#[test]
fn a_stopped_test_keeps_whole_stays_only() {
    let stop = std::sync::atomic::AtomicBool::new(false);
    let asked = |_: &progress::Event<'_>| stop.store(true, std::sync::atomic::Ordering::Relaxed);
    let mut test = Endurance::new(3, HOURS, "PID");
    test.advance(3, &controller(), None, &Progress::new(&asked, &stop)).unwrap();
    assert_eq!(test.results, []);
    test.advance(3, &controller(), None, &Progress::silent()).unwrap();
    assert_eq!(test, endured(3));
}
