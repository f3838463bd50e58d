//! Which host keeps the exploration on, and whose silence is reported, when two hosts ask in any rhythm and order. Verifies: host-silent.

use super::*;
use crate::safety::host::SILENCE_MAX;

/// Another host, and the one that steers ([`HOST`]).
const OTHER: Option<u32> = Some(8);
/// A long control period, so that seconds take few ticks, us.
const PERIOD_US: u32 = 10_000;
const TICKS_PER_S: usize = 100;
/// Ticks of silence after which the alarm is raised.
const SILENCE: usize = SILENCE_MAX as usize * TICKS_PER_S;

/// A device in standby that watches its host.
fn watched() -> Rig {
    let mut rig = Rig::new(None);
    let others = Fault::all().filter(|fault| *fault != Fault::HostSilent && !Monitors::ANY_PLANT.has(*fault));
    let control = Control::new(DeviceKind::HardwareInTheLoop, PERIOD_US, CORE_HZ).unwrap();
    rig.control = control.with_monitors(others.fold(Monitors::ALL, Monitors::without));
    let memory: &'static RecorderMemory = Box::leak(Box::new(RecorderMemory::new()));
    let facts = DeviceFacts { period_us: PERIOD_US, ..DeviceFacts::blank(DeviceKind::HardwareInTheLoop) };
    rig.server = Server::new(facts, memory);
    rig
}

/// The same, ventilating; the host that steers explores.
fn exploring() -> Rig {
    let mut rig = watched();
    rig.start();
    rig.ask(Request::SetExploration(Some(Exploration::default())));
    rig
}

fn acquire(take_over: bool) -> Request {
    Request::AcquireLease { name: HostName::new("other"), take_over }
}

fn explores(rig: &mut Rig) -> bool {
    matches!(rig.ask_by(None, Request::Identify), Response::Identity(identity) if identity.exploration.is_some())
}

/// Number of alarms about a silent host.
fn silences(rig: &Rig) -> usize {
    let alarm =
        |event: &&ToHost| matches!(event, ToHost::Event(Event::Alarm { fault: Fault::HostSilent, .. }));
    rig.events.iter().filter(alarm).count()
}

/// Polls in the name of a host once a second for some time.
fn poll(rig: &mut Rig, host: Option<u32>, seconds: usize) {
    for _ in 0..seconds {
        rig.run(TICKS_PER_S);
        rig.ask_by(host, Request::GetAlarms);
    }
}

#[test]
fn a_page_that_polls_keeps_no_exploration_of_a_dead_host_on() {
    for page in [OTHER, None] {
        let mut rig = exploring();
        poll(&mut rig, page, SILENCE_MAX as usize);
        assert_eq!((explores(&mut rig), silences(&rig)), (true, 0), "10 s have not passed");
        poll(&mut rig, page, 1);
        assert_eq!((explores(&mut rig), silences(&rig)), (false, 1));
        assert_eq!(rig.control.mode(), Mode::Ventilating);
        poll(&mut rig, page, 30);
        assert_eq!(silences(&rig), 1, "once");
    }
}

#[test]
fn a_host_whose_lease_has_lapsed_is_not_silent_while_it_polls() {
    let mut rig = exploring();
    rig.run(SILENCE - TICKS_PER_S);
    poll(&mut rig, HOST, 30);
    assert_eq!((explores(&mut rig), silences(&rig)), (true, 0));
}

#[test]
fn who_takes_the_lease_over_supervises_and_so_does_who_has_started_the_exploration() {
    for supervisor in [OTHER, HOST] {
        let mut rig = exploring();
        assert!(matches!(rig.ask_by(OTHER, acquire(true)), Response::Lease(status) if status.yours));
        poll(&mut rig, supervisor, 30);
        assert_eq!((explores(&mut rig), silences(&rig)), (true, 0), "{supervisor:?}");
        poll(&mut rig, None, 11);
        assert_eq!((explores(&mut rig), silences(&rig)), (false, 1), "{supervisor:?} is gone");
    }
}

#[test]
fn who_explored_once_supervises_no_later_exploration() {
    for ended_by_silence in [false, true] {
        let mut rig = exploring();
        if ended_by_silence {
            rig.run(SILENCE + 1);
        } else {
            rig.ask(Request::SetExploration(None));
        }
        let before = silences(&rig);
        rig.ask_by(OTHER, acquire(true));
        rig.ask_by(OTHER, Request::SetController(ControllerChoice::Pid(KNOWN_GOOD)));
        poll(&mut rig, HOST, 11);
        assert_eq!(silences(&rig), before + 1, "the other host is silent; by silence: {ended_by_silence}");
    }
}

#[test]
fn a_refused_exploration_leaves_the_running_one_to_its_host() {
    let mut rig = exploring();
    rig.ask_by(OTHER, acquire(true));
    let nonsense = Exploration { boundary_probability: 2.0, ..Exploration::default() };
    assert!(matches!(rig.ask_by(OTHER, Request::SetExploration(Some(nonsense))), Response::Refused(_)));
    rig.ask_by(HOST, acquire(true));
    poll(&mut rig, OTHER, 11);
    assert_eq!((explores(&mut rig), silences(&rig)), (false, 1));
}

/// A program that starts ventilation, gives the lease back and ends: ventilation goes on, and nobody is missing.
#[test]
fn a_host_that_has_given_the_lease_back_is_not_missed_by_one_that_watches() {
    let without_exploration = || {
        let mut rig = watched();
        rig.start();
        rig
    };
    let mut rig = without_exploration();
    rig.ask(Request::ReleaseLease);
    poll(&mut rig, None, 30);
    assert_eq!(silences(&rig), 0);
    rig.run(SILENCE + 1);
    assert_eq!(silences(&rig), 1, "until that one is silent");
    let mut rig = without_exploration();
    rig.run(SILENCE - TICKS_PER_S);
    rig.ask(Request::ReleaseLease);
    poll(&mut rig, OTHER, 30);
    assert_eq!(silences(&rig), 0, "its lease had lapsed before");
    let mut rig = without_exploration();
    poll(&mut rig, OTHER, 11);
    assert_eq!(silences(&rig), 1, "one that has not given it back is missed");
    let mut rig = without_exploration();
    rig.ask(Request::ReleaseLease);
    rig.ask(Request::ApplySettings(Settings::default()));
    poll(&mut rig, OTHER, 11);
    assert_eq!(silences(&rig), 1, "nor one that has acquired it again");
    let mut rig = exploring();
    rig.ask(Request::ReleaseLease);
    poll(&mut rig, OTHER, 11);
    assert_eq!((explores(&mut rig), silences(&rig)), (false, 1), "nobody supervises what it explored");
}

#[test]
fn a_device_that_no_host_has_steered_reports_the_silence_of_one_that_watched() {
    let mut rig = watched();
    rig.control.resume(&Settings::default()).unwrap();
    poll(&mut rig, None, 30);
    assert_eq!(silences(&rig), 0);
    rig.run(SILENCE + 1);
    assert_eq!(silences(&rig), 1);
}

/// A request that reaches the control half and only reads.
fn read() -> impl Strategy<Value = Request> {
    prop_oneof![
        Just(Request::Identify),
        Just(Request::GetSettings),
        Just(Request::GetAlarms),
        Just(Request::GetAudio),
        Just(Request::GetSelfTest),
        Just(Request::GetTiming { clear: false }),
    ]
}

/// Settings, most of them valid.
fn prescribed() -> impl Strategy<Value = Settings> {
    (6.0f32..45.0, 8.0f32..40.0, 0.4f32..1.0).prop_map(|(pip, rate, inspiratory_time)| Settings {
        rate,
        inspiratory_time,
        ..paper_settings(pip)
    })
}

/// A request that changes something, other than the exploration and the lease.
fn change() -> impl Strategy<Value = Request> {
    prop_oneof![
        4 => prescribed().prop_map(Request::ApplySettings),
        4 => prescribed().prop_map(Request::QueueSettings),
        1 => Just(Request::SetController(ControllerChoice::Pid(KNOWN_GOOD))),
        1 => Just(Request::Acknowledge),
        1 => Just(Request::Telemetry { on: false }),
    ]
}

/// Requests with the ticks before each.
fn rhythm(
    request: impl Strategy<Value = Request>,
    longest: usize,
) -> impl Strategy<Value = Vec<(usize, Request)>> {
    prop::collection::vec((0..longest, request), 1..40)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    /// Whatever another host reads or tries in vain, in any rhythm.
    #[test]
    fn a_dead_hosts_exploration_ends_after_ten_seconds(
        alive in rhythm(prop_oneof![read(), change()], SILENCE),
        others in prop::collection::vec((1usize..300, prop_oneof![read(), change()]), 1..40),
    ) {
        let mut rig = exploring();
        for (ticks, request) in alive {
            rig.run(ticks);
            // A lapsed lease is acquired again, as programs do.
            rig.ask(request);
        }
        let exploring = rig.control.execute(&ControlRequest::Status);
        prop_assert!(matches!(exploring, ControlReply::Status(status) if status.exploration.is_some()));
        let mut silent = 0;
        for (ticks, request) in others.into_iter().cycle() {
            let ticks = ticks.min(SILENCE + 1 - silent);
            rig.run(ticks);
            silent += ticks;
            prop_assert_eq!(explores(&mut rig), silent <= SILENCE);
            if silent > SILENCE {
                break;
            }
            rig.ask_by(OTHER, request);
        }
        prop_assert_eq!((silences(&rig), rig.control.mode()), (1, Mode::Ventilating));
    }

    /// Whatever another host does, steering included where the lease is free.
    #[test]
    fn a_host_that_polls_keeps_its_exploration_whatever_another_one_does(
        requests in prop::collection::vec(
            (0..SILENCE, any::<bool>(), read(), prop_oneof![read(), change(), Just(acquire(false)), Just(acquire(true))]),
            1..40,
        ),
    ) {
        let mut rig = exploring();
        let mut unheard = 0;
        for (ticks, other_asks, poll, request) in requests {
            let ticks = ticks.min(SILENCE - unheard);
            rig.run(ticks);
            unheard += ticks;
            if other_asks && unheard < SILENCE {
                rig.ask_by(OTHER, request);
            } else {
                rig.ask_by(HOST, poll);
                unheard = 0;
            }
        }
        prop_assert!(explores(&mut rig));
        prop_assert_eq!(silences(&rig), 0);
    }

    /// Only what the holder of the lease has sent comes into force, from the next breath on, and nothing stops the breaths.
    #[test]
    fn settings_of_two_hosts_in_any_order_come_from_the_one_that_steers(
        requests in prop::collection::vec(
            (0usize..400, any::<bool>(), prop_oneof![
                6 => prescribed().prop_map(Request::ApplySettings),
                6 => prescribed().prop_map(Request::QueueSettings),
                2 => read(),
                2 => Just(acquire(false)),
                1 => Just(acquire(true)),
                1 => Just(Request::ReleaseLease),
            ]),
            1..60,
        ),
    ) {
        let mut rig = watched();
        rig.start();
        let mut accepted = std::vec![Settings::default()];
        for (ticks, by_other, request) in requests {
            for _ in 0..ticks {
                rig.run(1);
                prop_assert!(accepted.contains(rig.control.state().breath().settings()));
            }
            let host = if by_other { OTHER } else { HOST };
            let steers = matches!(rig.ask_by(host, Request::GetLease), Response::Lease(status) if status.yours);
            let answer = rig.ask_by(host, request.clone());
            if let Request::ApplySettings(settings) | Request::QueueSettings(settings) = request {
                let refused = matches!(answer, Response::Refused(Refusal::Lease { .. } | Refusal::NoLease));
                prop_assert_eq!(refused, !steers, "{:?}", answer);
                if steers {
                    accepted.push(settings);
                }
            }
            prop_assert_eq!(rig.control.mode(), Mode::Ventilating);
        }
    }
}
