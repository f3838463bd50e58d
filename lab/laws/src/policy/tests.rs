//! Policies over real TCP: one that follows the protocol, and ones that do not.

use std::io::{Read, Write};
use std::net::{TcpListener, TcpStream};
use std::sync::mpsc::{Receiver, channel};
use std::thread;
use std::time::Duration;

use plant::bench::BenchConfig;
use plant::line::Address;
use progress::Progress;
use shared::breath::{DEFAULT_PERIOD_US, paper_settings};
use shared::control::Controller;
use shared::control::pid::{KNOWN_GOOD, PidGains};
use shared::settings::Settings;

use super::frame::{FRAME_BYTES, PolicyFrame, PolicyMessage, VERSION};
use super::link::PolicyError;
use super::*;
use score::evaluate::{Evaluation, Plan, at_pips, evaluate, evaluate_law, evaluate_source};
use ventilator::BenchSource;

/// Timeout for policies that answer, however busy the machine.
const LONG: Duration = Duration::from_mins(2);
/// Timeout for a policy that does not answer.
const SHORT: Duration = Duration::from_millis(300);
/// Highest true pressure that the bench's relief valve allows, cmH2O.
const BOUND: f32 = 75.0;

/// A policy's reaction to a frame.
enum Act {
    Say(PolicyMessage),
    Bytes([u8; FRAME_BYTES]),
    Silence,
    HangUp,
}

/// A reaction that needs the frame.
type Reaction = fn(PolicyMessage, PolicyFrame) -> Act;

/// A policy that reacts to each frame, counted from 0, as `act` returns, and otherwise commands 20 %.
fn scripted(mut act: impl FnMut(u32, PolicyFrame) -> Option<Act> + Send + 'static) -> Address {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = Address::Tcp(listener.local_addr().unwrap().to_string());
    thread::spawn(move || {
        let mut stream: TcpStream = listener.accept().unwrap().0;
        stream.set_nodelay(true).unwrap();
        let mut request = [0; FRAME_BYTES];
        for count in 0.. {
            if stream.read_exact(&mut request).is_err() {
                return;
            }
            let frame = PolicyFrame::decode(&request).unwrap();
            let honest = match frame.message {
                PolicyMessage::Hello { .. } => PolicyMessage::Greeting { version: VERSION, period_us: 0 },
                PolicyMessage::Observe { .. } => PolicyMessage::Command { u_in: 20.0 },
                _ => PolicyMessage::Ready,
            };
            let answer = match act(count, frame).unwrap_or(Act::Say(honest)) {
                Act::Say(message) => PolicyFrame { message, ..frame }.encode(),
                Act::Bytes(bytes) => bytes,
                Act::Silence => continue,
                Act::HangUp => return,
            };
            if stream.write_all(&answer).is_err() {
                return;
            }
        }
    });
    address
}

/// A policy that answers every observation with a command.
fn commanding(command: impl Fn(PolicyMessage) -> f32 + Send + 'static) -> Address {
    scripted(move |_, frame| match frame.message {
        PolicyMessage::Observe { .. } => {
            Some(Act::Say(PolicyMessage::Command { u_in: command(frame.message) }))
        }
        _ => None,
    })
}

/// A policy that passes on all frames.
fn recording() -> (Address, Receiver<PolicyMessage>) {
    let (sender, frames) = channel();
    let address = scripted(move |_, frame| {
        sender.send(frame.message).unwrap();
        None
    });
    (address, frames)
}

fn pid() -> Pid {
    Pid::new(KNOWN_GOOD, DEFAULT_PERIOD_US).unwrap()
}

fn law(address: &Address, patience: Duration) -> PolicyLaw {
    PolicyLaw::new(PolicyLink::open(address, patience).unwrap(), pid(), DEFAULT_PERIOD_US)
}

fn lung() -> BenchConfig {
    BenchConfig::paper(20.0, 20.0)
}

fn on(bench: &BenchConfig, law: PolicyLaw, settings: &Settings) -> BenchSource<PolicyLaw> {
    BenchSource::new(bench, law, settings, DEFAULT_PERIOD_US, 1).unwrap().going_on()
}

/// Runs breaths at PIP 30; returns the highest true pressure.
fn highest(bench: &BenchConfig, law: &PolicyLaw, breaths: usize) -> f32 {
    let settings = paper_settings(30.0);
    let mut source = on(bench, law.clone(), &settings);
    let mut highest = 0.0_f32;
    for _ in 0..breaths {
        let seen = &mut |tick: &ventilator::Tick| {
            highest = highest.max(tick.truth.unwrap().airway_pressure);
        };
        source.breathe(&settings, seen).unwrap();
    }
    highest
}

fn plan() -> Plan {
    Plan { waveforms: at_pips(&[15.0, 30.0], &Settings::default()), breaths: 2, ..Plan::evaluation(3) }
}

fn evaluated(law: &PolicyLaw) -> Evaluation {
    let mut source = on(&lung(), law.clone(), &paper_settings(15.0));
    evaluate_source(&mut source, law, &plan(), &Progress::silent()).unwrap()
}

/// The PID in the place of a policy: the same arithmetic, so the same bits.
fn pid_as_policy() -> Address {
    let gains = PidGains { p: 4.0, i: 80.0, d: 0.0 };
    let (law, mut state) = (Pid::new(gains, DEFAULT_PERIOD_US).unwrap(), PidState::new());
    scripted(move |_, frame| match frame.message {
        PolicyMessage::Start { .. } => {
            state = PidState::new();
            None
        }
        PolicyMessage::Observe { pressure, target, pip, peep, tick, .. } => {
            let seen = Observation { pressure, target, pip, peep, tick, rise_ticks: 0 };
            Some(Act::Say(PolicyMessage::Command { u_in: law.step(&mut state, &seen, 0.0).command }))
        }
        _ => None,
    })
}

#[test]
fn a_pid_behind_the_link_scores_as_the_pid_in_the_ventilator() {
    let law = law(&pid_as_policy(), LONG);
    let alone = Controller::Pid(Pid::new(PidGains { p: 4.0, i: 80.0, d: 0.0 }, DEFAULT_PERIOD_US).unwrap());
    let (linked, alone) = (evaluated(&law), evaluate(&lung(), &alone, &plan()).unwrap());
    for (linked, alone) in linked.waveforms.iter().zip(&alone.waveforms) {
        // Only the first ticks differ: the supervisor lets the part that the PID underneath does not command grow at its slew.
        let difference = (linked.score.score - alone.score.score).abs();
        assert!(difference < 0.02, "{linked:?} {alone:?}");
    }
    let account = law.account();
    assert!(account.percent(account.commanded) > 99.0, "{account:?}");
    assert_eq!((account.ticks, account.refused, account.failure), (account.breaths * 1000, 0, None));
}

#[test]
fn the_same_seed_gives_the_same_scores() {
    let run = || evaluated(&law(&pid_as_policy(), LONG));
    assert_eq!(run(), run());
}

#[test]
fn a_policy_whose_commands_are_no_numbers_changes_no_bit_of_the_pids_breaths() {
    let law = law(&commanding(|_| f32::NAN), LONG);
    let alone = Controller::Pid(Pid::new(KNOWN_GOOD, DEFAULT_PERIOD_US).unwrap());
    assert_eq!(evaluated(&law), evaluate(&lung(), &alone, &plan()).unwrap());
    let account = law.account();
    assert_eq!((account.pid, account.refused), (account.ticks, account.ticks));
    assert!(account.first_refused.unwrap().what.contains("NaN"));
}

#[test]
fn commands_out_of_range_are_not_used() {
    for wrong in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, 1e30, 100.01, -0.01] {
        let law = law(&commanding(move |_| wrong), LONG);
        highest(&lung(), &law, 1);
        let account = law.account();
        assert_eq!((account.commanded, account.refused, account.ticks), (0, 1000, 1000), "{wrong}");
        assert_eq!(account.failure, None);
    }
    let law = law(&commanding(|_| 100.0), LONG);
    highest(&lung(), &law, 1);
    assert_eq!(law.account().refused, 0);
}

#[test]
fn a_policy_that_always_opens_the_valve_stays_within_the_bound_and_the_pid_takes_over() {
    for (r, c) in [(5.0, 50.0), (20.0, 20.0), (50.0, 10.0), (5.0, 10.0)] {
        let law = law(&commanding(|_| 100.0), LONG);
        let highest = highest(&BenchConfig::paper(r, c), &law, 6);
        assert!(highest < BOUND, "R {r}, C {c}: {highest}");
        let account = law.account();
        assert_eq!((account.breaths, account.failure.clone()), (6, None));
        if c < 50.0 {
            assert!(account.percent(account.pid) > 50.0, "R {r}, C {c}: {account:?}");
        }
    }
}

#[test]
fn every_failure_of_the_link_leaves_the_pid_and_is_named_with_its_place() {
    let greeting = PolicyMessage::Greeting { version: VERSION, period_us: 0 };
    let acts: [(Reaction, &str); 5] = [
        (|_, _| Act::Silence, "0 of 32 bytes arrived"),
        (|_, _| Act::HangUp, "has closed the line"),
        (|_, _| Act::Bytes([0x5A; FRAME_BYTES]), "not a frame (5A 5A"),
        (|greeting, _| Act::Say(greeting), "answered Observe with Greeting"),
        (
            |_, frame| {
                Act::Bytes(PolicyFrame { number: frame.number + 1, message: PolicyMessage::Ready }.encode())
            },
            "with number",
        ),
    ];
    for (act, told) in acts {
        // Hello, Reset, then Start, 1000 observations and Learn for each breath.
        let law = law(
            &scripted(move |count, frame| (count >= 2 + 1002 + 1 + 210).then(|| act(greeting, frame))),
            SHORT,
        );
        assert!(highest(&lung(), &law, 4) < BOUND);
        let account = law.account();
        let failure = account.failure.unwrap();
        assert_eq!((failure.run, failure.breath, failure.tick), (1, 1, 210), "{failure:?}");
        assert!(failure.what.contains(told), "{}", failure.what);
        // More time helps only a policy that is still there.
        let waits = failure.what.contains("--policy-timeout");
        assert_eq!(waits, failure.what.contains("bytes arrived"), "{}", failure.what);
        assert_eq!((account.breaths, account.ticks), (4, 4000));
        assert!(account.commanded > 1100 && account.commanded <= 1210, "{}", account.commanded);
        assert!(account.pid > 2700, "{}", account.pid);
    }
}

#[test]
fn a_policy_sees_reset_then_the_breaths_with_their_ticks_commands_and_lessons() {
    let (address, frames) = recording();
    let law = law(&address, LONG);
    let mut source = on(&lung(), law.clone(), &paper_settings(20.0));
    for (pip, rise_time) in [(20.0, 0.0), (25.0, 0.2)] {
        source.breathe(&Settings { rise_time, ..paper_settings(pip) }, &mut |_| ()).unwrap();
    }
    let frames: Vec<PolicyMessage> = frames.try_iter().collect();
    assert_eq!(frames[0], PolicyMessage::Hello { version: VERSION });
    assert_eq!(frames[1], PolicyMessage::Reset { period_us: DEFAULT_PERIOD_US });
    let first = PolicyMessage::Start { breath: 0, pip: 20.0, peep: 5.0, applied: 0.0, rise_ticks: 0 };
    assert_eq!(frames[2], first);
    for (tick, frame) in frames[3..1003].iter().enumerate() {
        let PolicyMessage::Observe { target, pip, peep, applied, tick: told, .. } = *frame else {
            panic!("{frame:?}")
        };
        assert_eq!((told as usize, target, pip, peep), (tick, 20.0, 20.0, 5.0));
        if tick > 100 {
            assert_eq!(applied.to_bits(), 20.0_f32.to_bits());
        }
    }
    let lessons = |frames: &[PolicyMessage]| -> Vec<Lesson> {
        let of = |frame: &PolicyMessage| match frame {
            PolicyMessage::Learn { lesson, .. } => Some(*lesson),
            _ => None,
        };
        frames.iter().filter_map(of).collect()
    };
    // Adopted, then forgotten with the settings.
    assert_eq!(lessons(&frames[1003..1005]), [Lesson::Adopt, Lesson::Forget]);
    assert!(matches!(frames[1005], PolicyMessage::Start { breath: 1, pip: 25.0, rise_ticks: 200, .. }));
    assert_eq!(frames.len(), 1005 + 1 + 1000 + 1);
}

#[test]
fn every_ventilation_begins_with_a_reset_and_an_earlier_one_cannot_go_on() {
    let (address, frames) = recording();
    let law = law(&address, LONG);
    let settings = paper_settings(20.0);
    let mut first = on(&lung(), law.clone(), &settings);
    first.breathe(&settings, &mut |_| ()).unwrap();
    on(&lung(), law.clone(), &settings).breathe(&settings, &mut |_| ()).unwrap();
    let resets = frames.try_iter().filter(|frame| matches!(frame, PolicyMessage::Reset { .. })).count();
    assert_eq!((resets, law.account().failure), (2, None));
    first.breathe(&settings, &mut |_| ()).unwrap();
    let failure = law.account().failure.unwrap();
    assert!(failure.what.contains("take turns"), "{}", failure.what);
}

#[test]
fn ventilations_in_turns_are_one_after_the_other() {
    let law = law(&pid_as_policy(), LONG);
    let scores = in_turns(|| evaluate_law(&lung(), &law, &plan(), &Progress::silent())).unwrap();
    assert_eq!(scores.unwrap(), evaluated(&law));
    assert_eq!(law.account().failure, None);
}

#[test]
fn a_policy_of_another_version_or_without_a_greeting_is_refused() {
    let of = |message| scripted(move |_, _| Some(Act::Say(message)));
    let other = of(PolicyMessage::Greeting { version: 9, period_us: 0 });
    assert_eq!(PolicyLink::open(&other, LONG).err(), Some(PolicyError::Version(9)));
    let rude = PolicyLink::open(&of(PolicyMessage::Ready), LONG).err().unwrap();
    assert_eq!(rude, PolicyError::Kind { question: "Hello", answer: "Ready" });
    let own = of(PolicyMessage::Greeting { version: VERSION, period_us: 5000 });
    assert_eq!(PolicyLink::open(&own, LONG).unwrap().period_us(), Some(5000));
}

#[test]
fn a_policy_that_cannot_be_reached_is_refused() {
    let address = {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        Address::Tcp(listener.local_addr().unwrap().to_string())
    };
    let told = PolicyLink::open(&address, LONG).err().unwrap().to_string();
    assert!(told.contains("start the program"), "{told}");
    let missing = Address::Pipe(vec!["no-such-program-here".into()]);
    let told = PolicyLink::open(&missing, LONG).err().unwrap().to_string();
    assert!(told.contains("cannot start `no-such-program-here`"), "{told}");
}
