//! What a device's answers, alarms and samples do to a measurement.

use super::*;
use shared::breath::{Breath, DEFAULT_PERIOD_US};
use shared::link::telemetry::{BATCH_SAMPLES, Counters, PackedSample};

/// The newest breath when a measurement is asked for.
const NEWEST: u32 = 7;

fn plan() -> Plan {
    Plan { frequencies: 8, phases: 5, settings: Plan::ramp(&Settings::default()), ..Plan::default() }
}

fn measuring() -> Measuring {
    Measuring::new(plan(), DEFAULT_PERIOD_US, Settings::default(), NEWEST).unwrap()
}

fn answer(request: Request, result: Result<Response, String>) -> News {
    News::Answer { request, result }
}

fn settings(in_force: Settings) -> Response {
    Response::Settings { in_force, pending: None }
}

/// A measurement whose breaths follow.
fn begun() -> Measuring {
    let mut measuring = measuring();
    let Some(Next::Ask(next)) = measuring.take(&answer(measuring.request(), Ok(Response::Done))) else {
        panic!("the settings follow the sweep")
    };
    assert_eq!(next, Request::ApplySettings(plan().settings));
    assert!(matches!(measuring.take(&answer(next, Ok(settings(plan().settings)))), Some(Next::Begun)));
    measuring
}

/// The end that a piece of news brings.
fn over(measuring: &mut Measuring, news: &News) -> Over {
    match measuring.take(news) {
        Some(Next::Over(over)) => over,
        other => panic!("{other:?}"),
    }
}

/// The reason of an end, and whether the device gets its settings back.
fn ended(over: &Over) -> (String, bool) {
    let restore = [Request::SetSweep(None), Request::ApplySettings(Settings::default())];
    assert!(over.undo.is_empty() || over.undo == restore, "{over:?}");
    let why = match over.ended.clone().expect("a reason") {
        Ended::Stopped => "stopped".to_owned(),
        Ended::Alarm(why) | Ended::Failed(why) => why,
    };
    (why, !over.undo.is_empty())
}

/// Samples of a breath as the device commands it, with a constant command and its sine.
fn breath(measuring: &Measuring, number: u32) -> Vec<Sample> {
    let course = Breath::new(&plan().settings, DEFAULT_PERIOD_US).unwrap();
    let sine = measuring.measurement.sweep_from(measuring.first).sine(number, DEFAULT_PERIOD_US);
    let sample = |tick| {
        let (phase, target) = (course.phase(tick), course.target(tick));
        let inspires = tick < course.inspiration_ticks();
        let explore = sine.filter(|_| inspires).map_or(0.0, |sine| sine.at(tick));
        let u_in = if inspires { 40.0 + explore } else { 0.0 };
        let (u_out, learned, flow) = (!inspires, 0.0, None);
        Sample { breath: number, tick, phase, target, pressure: target, u_in, u_out, explore, learned, flow }
    };
    (0..course.total_ticks()).map(sample).collect()
}

/// Feeds samples in batches; the end, if they bring one.
fn feed(measuring: &mut Measuring, samples: &[Sample]) -> Option<Over> {
    for samples in samples.chunks(BATCH_SAMPLES) {
        let samples = samples.iter().map(PackedSample::pack).collect();
        let batch = TelemetryBatch { sequence: 0, first_tick: 0, counters: Counters::default(), samples };
        if let Some(next) = measuring.take(&News::Event(Event::Telemetry(batch))) {
            let Next::Over(over) = next else { panic!("{next:?}") };
            return Some(over);
        }
    }
    None
}

/// Feeds whole breaths.
fn breathe(measuring: &mut Measuring, numbers: std::ops::Range<u32>) -> Option<Over> {
    for number in numbers {
        let samples = breath(measuring, number);
        if let Some(over) = feed(measuring, &samples) {
            return Some(over);
        }
    }
    None
}

#[test]
fn a_device_that_refuses_the_sweep_keeps_its_settings() {
    let mut measuring = measuring();
    let refused = answer(measuring.request(), Err("an alarm is present".into()));
    assert!(matches!(measuring.take(&refused), Some(Next::Refused(_, None))));
}

#[test]
fn a_device_that_refuses_the_settings_loses_the_sweep() {
    let mut measuring = measuring();
    measuring.take(&answer(measuring.request(), Ok(Response::Done)));
    let refused = answer(Request::ApplySettings(plan().settings), Err("another host steers".into()));
    assert!(matches!(measuring.take(&refused), Some(Next::Refused(_, Some(Request::SetSweep(None))))));
}

#[test]
fn every_breath_is_measured_and_then_the_settings_come_back() {
    let mut measuring = begun();
    let (first, breaths) = (measuring.first, plan().breaths());
    assert!(first > NEWEST + 1, "by then the settings are in force");
    assert!(breathe(&mut measuring, NEWEST..first + breaths).is_none());
    let over = breathe(&mut measuring, first + breaths..first + breaths + 1).unwrap();
    assert_eq!((over.ended.as_ref(), over.undo.len(), measuring.breaths()), (None, 2, (breaths, breaths)));
    assert_eq!(over.nothing(&measuring.measurement), None);
}

#[test]
fn any_alarm_but_a_leak_ends_it_and_after_one_that_vents_the_settings_stay() {
    let alarm = |fault| News::Event(Event::Alarm { tick: 0, fault });
    assert!(begun().take(&alarm(Fault::Leak)).is_none());
    let (why, restored) = ended(&over(&mut begun(), &alarm(Fault::Disconnection)));
    assert!(why.contains(words::fault(Fault::Disconnection)) && restored);
    let vents = Fault::all().find(|fault| fault.alarm().action == Action::Vent).unwrap();
    assert!(!ended(&over(&mut begun(), &alarm(vents))).1);
}

#[test]
fn a_sine_that_the_device_has_ended_ends_it() {
    let mut measuring = begun();
    let sines = measuring.measurement.sweep_from(measuring.first).first_breath;
    assert!(breathe(&mut measuring, NEWEST..sines).is_none());
    let mut without = breath(&measuring, sines);
    for sample in &mut without {
        sample.explore = 0.0;
    }
    assert!(feed(&mut measuring, &without).is_none());
    let (why, restored) = ended(&breathe(&mut measuring, sines + 1..sines + 2).unwrap());
    assert!(why.contains("ended the sine") && restored, "{why}");
}

#[test]
fn a_device_that_stops_is_lost_or_gets_other_settings_does_not_get_those_of_before() {
    let stop = answer(Request::Stop, Ok(Response::Mode(Mode::Standby)));
    assert_eq!(ended(&over(&mut begun(), &stop)), ("the ventilation was stopped".into(), false));
    assert_eq!(ended(&over(&mut begun(), &News::Lost("unplugged".into()))), ("unplugged".into(), false));
    let others = answer(Request::GetSettings, Ok(settings(Settings { pip: 30.0, ..Settings::default() })));
    let mut measuring = begun();
    assert!(measuring.take(&others).is_none(), "those of before may still be in force");
    let first = measuring.first;
    breathe(&mut measuring, first..first + 2);
    let (why, restored) = ended(&over(&mut measuring, &others));
    assert!(why.contains("changed the settings") && !restored, "{why}");
    assert!(measuring.take(&answer(Request::GetSettings, Ok(settings(plan().settings)))).is_none());
}

#[test]
fn lost_samples_and_a_restart_are_told_apart() {
    let mut measuring = begun();
    let first = measuring.first;
    assert!(breathe(&mut measuring, NEWEST..first + 1).is_none());
    let next = breath(&measuring, first + 1);
    let lost = feed(&mut measuring, &[&next[..100], &next[120..]].concat()).unwrap();
    assert_eq!(ended(&lost), ("samples were lost on the line".into(), true));
    let mut measuring = begun();
    breathe(&mut measuring, NEWEST..first + 2);
    let again = breathe(&mut measuring, 0..1).unwrap();
    assert_eq!(ended(&again), ("the device has started again".into(), false));
}

#[test]
fn a_breath_without_room_for_the_sine_shows_nothing_but_the_reason() {
    let mut measuring = begun();
    let (first, sines) = (measuring.first, measuring.measurement.sweep_from(measuring.first).first_breath);
    let numbers = first..sines;
    let over = numbers.into_iter().find_map(|number| {
        let mut samples = breath(&measuring, number);
        for sample in &mut samples {
            sample.u_in = 3.0;
        }
        feed(&mut measuring, &samples)
    });
    let over = over.unwrap();
    let why = over.nothing(&measuring.measurement).unwrap();
    assert!(why.contains("would reach the valve's limits") && over.undo.len() == 2, "{why}");
}
