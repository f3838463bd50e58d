//! Plants over real TCP: a bench that follows the protocol, and plants that do not.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::{Arc, Mutex};
use std::thread;
use std::time::{Duration, Instant};

use shared::breath::paper_settings;
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::link::plant_link::{FRAME_BYTES, PlantFrame, PlantMessage, VERSION};
use shared::settings::Settings;

use crate::collect::{CollectConfig, CollectError, Collected, collect};
use crate::{BenchSource, PlantSource, Source, SourceError};
use emulator::{LockstepPlant, PlantEnd};
use plant::Plant;
use plant::bench::{BenchConfig, BenchPlant};
use plant::link::{Greeting, PlantAddress, PlantError, PlantLink};
use progress::Progress;

/// Timeout for plants that answer, however busy the machine.
const LONG: Duration = Duration::from_mins(2);
/// Timeout for plants that do not answer: long enough for the steps before on a busy machine, else short.
const SHORT: Duration = Duration::from_secs(1);
const PERIOD_US: u32 = 30_000;

/// Listens, and serves the first connection.
fn served(serve: impl FnOnce(TcpStream) + Send + 'static) -> PlantAddress {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = PlantAddress::Tcp(listener.local_addr().unwrap().to_string());
    thread::spawn(move || serve(listener.accept().unwrap().0));
    address
}

/// A bench that follows the protocol.
fn bench_plant() -> PlantAddress {
    let mut plant = LockstepPlant::new(BenchPlant::new(&BenchConfig::paper(20.0, 20.0)).unwrap());
    served(move |mut stream| {
        stream.set_nodelay(true).unwrap();
        let mut request = [0; FRAME_BYTES];
        while stream.read_exact(&mut request).is_ok() {
            stream.write_all(&plant.answer(&request)).unwrap();
        }
    })
}

/// A scripted plant's reaction to a request.
enum Act {
    Say(PlantMessage),
    Bytes(Vec<u8>),
    Silence,
    HangUp,
}

/// A lung that holds 5 cmH2O and reacts to each request, counted from 0, as `act` returns.
fn scripted(mut act: impl FnMut(usize, PlantFrame) -> Option<Act> + Send + 'static) -> PlantAddress {
    served(move |mut stream| {
        let mut request = [0; FRAME_BYTES];
        for number in 0.. {
            if stream.read_exact(&mut request).is_err() {
                return;
            }
            let frame = PlantFrame::decode(&request).unwrap();
            let honest = match frame.message {
                PlantMessage::Hello { .. } => greeting(VERSION, 100),
                PlantMessage::Step { .. } => PlantMessage::Pressure { pressure: 5.0 },
                _ => PlantMessage::Ready { pressure: 5.0 },
            };
            let answer = match act(number, frame).unwrap_or(Act::Say(honest)) {
                Act::Say(message) => PlantFrame { tick: frame.tick, message }.encode().to_vec(),
                Act::Bytes(bytes) => bytes,
                Act::Silence => continue,
                Act::HangUp => return,
            };
            if stream.write_all(&answer).is_err() {
                return;
            }
        }
    })
}

fn greeting(version: u16, highest: u16) -> PlantMessage {
    PlantMessage::Greeting { version, highest, period_us: PERIOD_US }
}

fn open(address: &PlantAddress) -> Result<PlantLink, PlantError> {
    PlantLink::open(address, LONG)
}

/// Opens, resets and makes a few steps until an error occurs.
fn error(act: impl FnMut(usize, PlantFrame) -> Option<Act> + Send + 'static) -> PlantError {
    error_within(LONG, act)
}

fn error_within(
    patience: Duration,
    act: impl FnMut(usize, PlantFrame) -> Option<Act> + Send + 'static,
) -> PlantError {
    let mut link = match PlantLink::open(&scripted(act), patience) {
        Ok(link) => link,
        Err(error) => return error,
    };
    let outcome = link
        .reset(PERIOD_US, 1, 5.0)
        .and_then(|_| (0..10).try_for_each(|_| link.step(20.0, false).map(|_| ())));
    let error = outcome.unwrap_err();
    assert_eq!(link.step(0.0, true), Err(error.clone()), "and again");
    error
}

/// Reacts to the sixth step, after Hello, Seed, Peep and Reset.
fn on_step(act: impl Fn(PlantFrame) -> Act + Send + 'static) -> PlantError {
    error(move |number, frame| (number == 9).then(|| act(frame)))
}

fn controller() -> Controller {
    controller_for(PERIOD_US)
}

fn controller_for(period_us: u32) -> Controller {
    Controller::Pid(Pid::new(PidGains { p: 1.0, i: 10.0, d: 0.0 }, period_us).unwrap())
}

fn source(address: &PlantAddress) -> PlantSource {
    PlantSource::new(Arc::new(Mutex::new(open(address).unwrap())), controller(), PERIOD_US, 7)
}

fn config(breaths: usize) -> CollectConfig {
    CollectConfig { breaths, seed: 7, ..CollectConfig::default() }
}

#[test]
fn a_bench_behind_the_link_gives_the_recording_of_the_bench_bit_for_bit() {
    for period_us in [PERIOD_US, 7_000] {
        let lung = BenchConfig::paper(20.0, 20.0);
        let (controller, config) = (controller_for(period_us), config(8));
        let mut bench =
            BenchSource::new(&lung, controller.clone(), &config.settings, period_us, config.seed).unwrap();
        let here = collect(&mut bench, &controller, &config, &Progress::silent()).unwrap().recording;
        let link = Arc::new(Mutex::new(open(&bench_plant()).unwrap()));
        let mut plant = PlantSource::new(link, controller.clone(), period_us, config.seed);
        let there = collect(&mut plant, &controller, &config, &Progress::silent()).unwrap().recording;
        let bits = |values: &[f32]| values.iter().map(|value| value.to_bits()).collect::<Vec<_>>();
        assert_eq!(bits(&here.pressure), bits(&there.pressure));
        assert_eq!(bits(&here.u_in), bits(&there.u_in));
        assert_eq!((&here.breath, &here.tick), (&there.breath, &there.tick));
        assert!(there.pressure_true.is_none() && there.pressure_sensor_true.is_none(), "nobody told");
        there.validate().unwrap();
    }
}

#[test]
fn a_new_peep_is_told_before_the_breath_that_has_it() {
    let told = Arc::new(Mutex::new(Vec::new()));
    let log = Arc::clone(&told);
    let address = scripted(move |_, frame| {
        match frame.message {
            PlantMessage::Peep { pressure } => log.lock().unwrap().push((pressure, 0)),
            PlantMessage::Step { .. } => log.lock().unwrap().last_mut().unwrap().1 += 1,
            _ => {}
        }
        None
    });
    let mut source = source(&address);
    for peep in [5.0, 5.0, 8.0] {
        source.breath(&Settings { peep, ..paper_settings(20.0) }, &mut |_| ()).unwrap();
    }
    assert_eq!(*told.lock().unwrap(), [(5.0, 200), (8.0, 100)], "PEEP and steps since");
}

#[test]
fn the_true_pressure_is_recorded_where_a_plant_tells_it() {
    let address = scripted(|_, frame| match frame.message {
        PlantMessage::Reset { .. } | PlantMessage::Step { .. } => {
            Some(Act::Say(PlantMessage::Truth { pressure: 5.5, airway: 5.25 }))
        }
        _ => None,
    });
    let recording =
        collect(&mut source(&address), &controller(), &config(2), &Progress::silent()).unwrap().recording;
    assert!(recording.pressure.iter().all(|p| p.to_bits() == 5.5_f32.to_bits()));
    assert!(recording.pressure_true.as_ref().unwrap().iter().all(|p| p.to_bits() == 5.25_f32.to_bits()));
    assert!(recording.pressure_sensor_true.is_none());
    recording.validate().unwrap();
}

#[test]
fn a_plant_that_is_not_there_is_told_with_what_to_do() {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = PlantAddress::Tcp(listener.local_addr().unwrap().to_string());
    drop(listener);
    let text = open(&address).err().unwrap().to_string();
    assert!(text.contains("start it first"), "{text}");
    let missing = PlantAddress::Pipe(vec!["no-such-program-here".into()]);
    assert!(matches!(open(&missing), Err(PlantError::Start { .. })));
}

#[test]
fn a_silent_plant_is_given_up_after_the_time_it_has() {
    let begun = Instant::now();
    let silent = error_within(SHORT, |_, _| Some(Act::Silence));
    assert!(matches!(silent, PlantError::Late { question: "Hello", bytes: 0, .. }), "{silent}");
    assert!(begun.elapsed() >= SHORT);
    let later = error_within(SHORT, |number, _| (number == 9).then_some(Act::Silence));
    assert!(matches!(later, PlantError::Late { question: "Step", bytes: 0, .. }), "{later}");
    assert!(later.to_string().contains("--plant-timeout"), "{later}");
}

#[test]
fn a_slow_plant_is_waited_for_and_one_that_sends_half_an_answer_is_not() {
    let slow = scripted(|_, _| {
        thread::sleep(SHORT / 5);
        None
    });
    let mut link = open(&slow).unwrap();
    link.reset(PERIOD_US, 1, 5.0).unwrap();
    link.step(0.0, true).unwrap();
    let half =
        error_within(SHORT, |number, frame| (number == 9).then(|| Act::Bytes(frame.encode()[..7].to_vec())));
    assert!(matches!(half, PlantError::Late { bytes: 7, .. }), "{half}");
}

#[test]
fn a_vanished_plant_is_gone_at_once() {
    // Waiting for its answer would take minutes.
    let begun = Instant::now();
    let gone = on_step(|_| Act::HangUp);
    assert!(matches!(gone, PlantError::Gone { question: "Step", .. }), "{gone}");
    assert!(begun.elapsed() < LONG, "nothing to wait for");
}

#[test]
fn lies_are_told_from_pressures() {
    for pressure in [f32::NAN, f32::INFINITY, 100.5, -101.0] {
        let lie = on_step(move |_| Act::Say(PlantMessage::Pressure { pressure }));
        assert!(matches!(lie, PlantError::Pressure { what: "a pressure", highest: 100, .. }), "{lie}");
        let text = lie.to_string();
        assert!(text.contains(&pressure.to_string()), "{text}");
    }
    let untrue = error(|_, frame| match frame.message {
        PlantMessage::Reset { .. } => Some(Act::Say(PlantMessage::Truth { pressure: 5.0, airway: 5.0 })),
        PlantMessage::Step { .. } => Some(Act::Say(PlantMessage::Truth { pressure: 5.0, airway: f32::NAN })),
        _ => None,
    });
    assert!(matches!(untrue, PlantError::Pressure { what: "a true pressure", .. }), "{untrue}");
}

#[test]
fn the_truth_is_told_always_or_never() {
    let now_and_then = on_step(|_| Act::Say(PlantMessage::Truth { pressure: 5.0, airway: 5.0 }));
    assert_eq!(now_and_then, PlantError::Truth);
}

#[test]
fn an_answer_to_another_tick_or_of_another_kind_is_no_answer() {
    let message = PlantMessage::Pressure { pressure: 5.0 };
    let early =
        on_step(move |frame| Act::Bytes(PlantFrame { tick: frame.tick + 1, message }.encode().to_vec()));
    assert_eq!(early, PlantError::Tick { asked: 10, told: 11 });
    let twice =
        on_step(move |frame| Act::Bytes([PlantFrame { tick: frame.tick, message }.encode(); 2].concat()));
    assert_eq!(twice, PlantError::Tick { asked: 11, told: 10 });
    let ready = on_step(|_| Act::Say(PlantMessage::Ready { pressure: 5.0 }));
    assert_eq!(ready, PlantError::Kind { question: "Step", answer: "Ready" });
}

#[test]
fn bytes_that_are_no_frame_are_shown() {
    let chatty = on_step(|_| Act::Bytes(b"step done, p=5.0\n".to_vec()));
    let text = chatty.to_string();
    assert!(matches!(chatty, PlantError::NoFrame { .. }) && text.contains("73 74 65 70"), "{text}");
    let damaged = on_step(|frame| {
        let mut bytes =
            PlantFrame { tick: frame.tick, message: PlantMessage::Pressure { pressure: 5.0 } }.encode();
        bytes[6] ^= 1;
        Act::Bytes(bytes.to_vec())
    });
    assert!(matches!(damaged, PlantError::NoFrame { .. }), "a wrong checksum: {damaged}");
}

#[test]
fn a_greeting_must_be_of_this_version_and_have_a_sound_limit() {
    let greets = |message| error(move |number, _| (number == 0).then_some(Act::Say(message)));
    assert_eq!(greets(greeting(VERSION + 1, 100)), PlantError::Version(VERSION + 1));
    for highest in [0, 1001] {
        assert_eq!(greets(greeting(VERSION, highest)), PlantError::Limit(highest));
    }
}

#[test]
fn a_period_that_the_plant_does_not_run_is_refused() {
    let mut link = open(&scripted(|_, _| None)).unwrap();
    assert_eq!(link.greeting(), Greeting { highest: 100, period_us: Some(PERIOD_US) });
    let refused = link.reset(1000, 1, 5.0).unwrap_err().to_string();
    assert!(refused.contains("30000 us") && refused.contains("--period-us"), "{refused}");
    let mut any = open(&bench_plant()).unwrap();
    assert_eq!(any.greeting().period_us, None);
    assert!(matches!(any.reset(1500, 1, 5.0), Err(PlantError::Period { asked: 1500, .. })), "it reads NaN");
}

#[test]
fn what_was_recorded_before_a_plant_vanished_is_kept() {
    // Hello, Seed, Peep, Reset, two whole breaths of 100 steps, and 40 steps of the third.
    let address = scripted(|number, _| (number == 4 + 240).then_some(Act::HangUp));
    let outcome = collect(&mut source(&address), &controller(), &config(10), &Progress::silent());
    let Err(CollectError::Interrupted { reason, collected }) = outcome else { panic!("{outcome:?}") };
    assert!(matches!(reason, SourceError::Plant(PlantError::Gone { .. })), "{reason}");
    let Collected { recording, breaths, .. } = *collected;
    assert_eq!((breaths, recording.len()), (2, 241), "the tick of the step that was not answered is known");
    assert_eq!(recording.inspirations().len(), 3);
    recording.validate().unwrap();
    assert!(recording.provenance.notes[0].contains("breath 2"), "{:?}", recording.provenance.notes);
}

#[test]
fn a_plant_that_fails_before_the_first_tick_leaves_no_recording() {
    let address = scripted(|number, _| (number == 3).then_some(Act::HangUp));
    let outcome = collect(&mut source(&address), &controller(), &config(10), &Progress::silent());
    assert!(matches!(outcome, Err(CollectError::Source(SourceError::Plant(PlantError::Gone { .. })))));
}

#[test]
fn a_high_pressure_on_a_plant_ends_the_breath_and_can_be_acknowledged() {
    let address = scripted(|number, frame| match frame.message {
        PlantMessage::Step { .. } if number == 20 => {
            Some(Act::Say(PlantMessage::Pressure { pressure: 90.0 }))
        }
        _ => None,
    });
    let mut source = source(&address);
    let fault = source.breath(&paper_settings(20.0), &mut |_| ()).unwrap_err();
    assert!(matches!(fault, SourceError::Fault { .. }), "{fault}");
    source.acknowledge().unwrap();
    let mut ticks = 0;
    source.breath(&paper_settings(20.0), &mut |_| ticks += 1).unwrap();
    assert_eq!(ticks, 100);
}
