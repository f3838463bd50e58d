use super::course::{Event, Scene};
use super::deserved::Verdict;
use super::*;
use campaign::Campaign;
use plant::bench::Failure;
use progress::Progress;
use shared::safety::alarms::Fault;

/// Two minutes.
const HOURS: f64 = 1.0 / 30.0;

fn controller() -> Controller {
    sound_controller().unwrap().0
}

fn test(controller: &Controller) -> Endurance<'_> {
    Endurance { question: Question { seed: 3, hours: HOURS, controller: "PID".to_owned() }, controller }
}

fn endured(patients: u64) -> Summary {
    let controller = controller();
    let mut campaign = Campaign::new(&test(&controller));
    campaign.advance(&test(&controller), patients, None, &Progress::silent()).unwrap();
    campaign.sums().summary(patients)
}

/// A passive patient at a sound machine, of which a part may fail after some milliseconds.
fn patient(failure: Option<(u32, Failure)>) -> Patient {
    let mut patient = Patient::draw(1, 0, HOURS);
    patient.bench = plant::bench::BenchConfig::paper(20.0, 20.0);
    patient.settings = shared::breath::paper_settings(25.0);
    (patient.newborn, patient.changes, patient.failure) = (false, Vec::new(), failure);
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
fn the_result_does_not_depend_on_the_order_of_the_patients() {
    let found = |numbers: [u64; 3]| {
        let mut stays = Stays::default();
        for patient in numbers {
            stays.add(patient, PatientResult { patient, ..PatientResult::default() });
        }
        stays
    };
    let mut parts = found([5, 3, 4]);
    parts.absorb(found([2, 0, 1]));
    assert_eq!(parts.0.iter().map(|result| result.patient).collect::<Vec<_>>(), [0, 1, 2, 3, 4, 5]);
    assert_eq!((parts.summary(4).patients, found([0, 1, 2])), (4, found([2, 1, 0])));
}

#[test]
fn a_stopped_test_keeps_whole_stays_only() {
    let stop = std::sync::atomic::AtomicBool::new(false);
    let asked = |_: &progress::Event<'_>| stop.store(true, std::sync::atomic::Ordering::Relaxed);
    let controller = controller();
    let test = test(&controller);
    let mut campaign = Campaign::new(&test);
    campaign.advance(&test, 3, None, &Progress::new(&asked, &stop)).unwrap();
    assert_eq!(*campaign.sums(), Stays::default());
    campaign.advance(&test, 3, None, &Progress::silent()).unwrap();
    assert_eq!(campaign.sums().summary(3), endured(3));
}
