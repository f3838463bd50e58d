//! The monitor's pictures, the effect of keys, and the whole against a device at a pseudo-terminal.

use proptest::prelude::*;
use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyEventKind, KeyModifiers};
use ratatui::style::Color;
use shared::breath::Phase;
use shared::control::memory::Lesson;
use shared::control::pid::PidGains;
use shared::device::KNOWN_GOOD;
use shared::device::annunciator::AudioStatus;
use shared::link::PROTOCOL;
use shared::link::host_name::HostName;
use shared::link::messages::{
    AlarmStatus, ControllerChoice, DeviceIdentity, DeviceKind, Event, LeaseStatus, Request, Response,
};
use shared::link::refusal::Refusal;
use shared::link::telemetry::{BreathSummary, Counters, PackedSample, TelemetryBatch};
use shared::reset::ResetCause;
use shared::safety::alarms::{Fault, Priority};
use shared::safety::indications::FaultSet;
use shared::safety::ladder::Level;
use shared::settings::Settings;
use shared::timing::{BINS, CycleStats, TickTimes};
use shared::ventilator::{Mode, Sample};
use shared::weights::slots::{Slot, SlotState};
use shared::weights::trust::KeyId;

use super::News;
use super::draw::draw;
use super::terminal::{Pressed, meaning};
use super::view::{Key, Notice, PIP_STEP, RATE_STEP, View};
use super::window::TelemetryWindow;
use super::words;
use device::LineCounters;

mod capture;
mod connected;
mod lines;

const PERIOD_US: u32 = 1000;

/// A ventilator with weights, restarted by its watchdog.
fn identity(mode: Mode) -> DeviceIdentity {
    DeviceIdentity {
        protocol: PROTOCOL,
        firmware: [0, 1, 0],
        device: DeviceKind::Ventilator,
        period_us: PERIOD_US,
        mode,
        controller: ControllerChoice::Pid(KNOWN_GOOD),
        exploration: None,
        slots: [SlotState::Valid { generation: 3, id: 0xBEEF }, SlotState::Empty],
        running: Some(Slot::A),
        reset: ResetCause::Watchdog,
        failure: None,
        weights_key: Some(KeyId([0xAB; 8])),
    }
}

fn answer(request: Request, response: Response) -> News {
    News::Answer { request, result: Ok(response) }
}

fn greeting(mode: Mode) -> News {
    answer(Request::Identify, Response::Identity(identity(mode)))
}

fn in_force(settings: Settings) -> News {
    answer(Request::GetSettings, Response::Settings { in_force: settings, pending: None })
}

fn times(ticks: u32) -> TickTimes {
    let span = |shortest, mean, longest| CycleStats { shortest, mean, longest };
    TickTimes {
        core_hz: 168_000_000,
        ticks,
        missed: 0,
        latency: span(50, 84.0, 336),
        work: span(2100, 2520.0, 3360),
        period: span(167_900, 168_000.0, 168_100),
        histogram: [0; BINS],
    }
}

fn timing(ticks: u32) -> News {
    answer(Request::GetTiming { clear: false }, Response::Timing(times(ticks)))
}

/// A batch starting at this tick of a 3000-tick breath, with a pressure that follows the target.
fn batch(first_tick: u64, pressures: &[f32]) -> TelemetryBatch {
    let sample = |(tick, pressure): (u64, &f32)| {
        let tick = (tick % 3000) as u32;
        let (phase, target, u_in) = match tick {
            0..1000 => (Phase::Inspiration, 20.0, 34.0),
            1000..1500 => (Phase::Fall, 20.0 - 0.03 * (tick - 1000) as f32, 0.0),
            _ => (Phase::Expiration, 5.0, 5.0),
        };
        let u_out = phase != Phase::Inspiration;
        PackedSample::pack(&Sample {
            breath: 0,
            tick,
            phase,
            target,
            pressure: *pressure,
            u_in,
            u_out,
            explore: 0.0,
            learned: 0.0,
            flow: None,
        })
    };
    let samples = (first_tick..).zip(pressures).map(sample).collect();
    TelemetryBatch { sequence: 0, first_tick, counters: Counters::default(), samples }
}

fn telemetry(first_tick: u64, pressures: &[f32]) -> News {
    News::Event(Event::Telemetry(batch(first_tick, pressures)))
}

fn alarm(fault: Fault) -> News {
    News::Event(Event::Alarm { fault, tick: 4321 })
}

/// The answer with these alarms; `gone` are only not yet acknowledged.
fn alarms(present: &[Fault], gone: &[Fault], level: Level) -> News {
    let bits = |faults: &[Fault]| faults.iter().fold(0, |bits, fault| bits | 1 << *fault as u32);
    let [present, gone] = [present, gone].map(bits);
    let [present, indicated] = [present, present | gone].map(FaultSet::from_bits);
    answer(Request::GetAlarms, Response::Alarms(AlarmStatus { present, indicated, level }))
}

/// The answer of a sounder that sounds for an alarm of high priority, and is paused for so many seconds more.
fn sounder(pause_left: u16) -> News {
    let audio = AudioStatus { priority: Some(Priority::High), pause_left };
    answer(Request::GetAudio, Response::Audio(audio))
}

/// The answer of a device that the host of this name steers.
fn steered(holder: Option<&str>, yours: bool) -> News {
    let status = LeaseStatus { holder: holder.map(HostName::new), yours };
    answer(Request::GetLease, Response::Lease(status))
}

fn breath(number: u32) -> News {
    News::Event(Event::Breath(BreathSummary {
        breath: number,
        mean_absolute_error: 1.25,
        peak_pressure: 21.5,
        end_pressure: 5.1,
        leak: Some(0.01),
        lesson: Lesson::Adopt,
        adopted: 2,
    }))
}

fn view_after(news: impl IntoIterator<Item = News>) -> View {
    let mut view = View::new("/dev/ttyACM0", KNOWN_GOOD);
    news.into_iter().for_each(|news| view.take(&news));
    view
}

/// A device that ventilates with the default settings.
fn ventilating() -> View {
    view_after([greeting(Mode::Ventilating), in_force(Settings::default()), timing(9000)])
}

fn applied(request: Option<Request>) -> Settings {
    match request {
        Some(Request::ApplySettings(settings)) => settings,
        other => panic!("{other:?} in place of settings"),
    }
}

fn warning(view: &View) -> &str {
    match &view.message {
        Some(Notice::Warning(text)) => text,
        other => panic!("{other:?} in place of a warning"),
    }
}

mod keys {
    use super::*;

    #[test]
    fn before_the_device_has_told_its_state_no_key_sends_anything() {
        let keys = [Key::StartStop, Key::Acknowledge, Key::PipUp, Key::RateDown, Key::Controller];
        let keys = keys.into_iter().chain([Key::PauseAudio, Key::Confirm, Key::TakeOver]);
        for key in keys {
            let mut view = view_after([]);
            assert_eq!(view.press(key), None, "{key:?}");
            assert!(warning(&view).contains("nothing was sent"));
        }
    }

    #[test]
    fn space_stops_what_ventilates_and_starts_what_stands_by() {
        assert_eq!(ventilating().press(Key::StartStop), Some(Request::Stop));
        assert_eq!(view_after([greeting(Mode::Standby)]).press(Key::StartStop), Some(Request::Start));
    }

    #[test]
    fn after_an_alarm_space_never_stops_or_acknowledges_by_itself() {
        let mut view = ventilating();
        view.take(&alarm(Fault::HardLimit));
        assert_eq!(view.known().mode, Some(Mode::Fault(Fault::HardLimit)));
        assert_eq!(
            view.press(Key::StartStop),
            Some(Request::Start),
            "which the device refuses, and says why"
        );
        assert_eq!(view.press(Key::Acknowledge), Some(Request::Acknowledge));
    }

    #[test]
    fn alarms_are_acknowledged_while_it_ventilates() {
        let mut view = ventilating();
        view.take(&alarms(&[], &[Fault::Restarted], Level::Pid));
        assert_eq!(
            (view.press(Key::Acknowledge), view.known().mode),
            (Some(Request::Acknowledge), Some(Mode::Ventilating))
        );
    }

    #[test]
    fn m_pauses_the_sounder_for_the_longest_time_and_ends_the_pause() {
        let mut view = ventilating();
        view.take(&sounder(0));
        assert_eq!(view.press(Key::PauseAudio), Some(Request::PauseAudio { seconds: 120 }));
        view.take(&sounder(87));
        assert_eq!(view.press(Key::PauseAudio), Some(Request::PauseAudio { seconds: 0 }));
        let refused = Refusal::NothingSounds.to_string();
        view.take(&News::Answer { request: Request::PauseAudio { seconds: 120 }, result: Err(refused) });
        assert_eq!(warning(&view), "no alarm sounds: there is nothing to pause");
    }

    #[test]
    fn arrows_change_one_setting_of_those_that_the_device_named() {
        let named =
            Settings { pip: 24.0, peep: 7.0, rate: 15.0, pressure_limit: 50.0, ..Settings::default() };
        let changed = |key| {
            let mut view = view_after([greeting(Mode::Ventilating), in_force(named)]);
            applied(view.press(key))
        };
        assert_eq!(changed(Key::PipUp), Settings { pip: 24.0 + PIP_STEP, ..named });
        assert_eq!(changed(Key::PipDown), Settings { pip: 24.0 - PIP_STEP, ..named });
        assert_eq!(changed(Key::RateUp), Settings { rate: 15.0 + RATE_STEP, ..named });
        assert_eq!(changed(Key::RateDown), Settings { rate: 15.0 - RATE_STEP, ..named });
    }

    #[test]
    fn c_sends_the_settings_that_are_shown() {
        let named = Settings { pip: 24.0, ..Settings::default() };
        let mut view = view_after([greeting(Mode::Standby), in_force(named)]);
        assert_eq!(applied(view.press(Key::Confirm)), named);
    }

    #[test]
    fn t_takes_over_from_the_host_that_steers_and_only_that_key_does() {
        let mut view = ventilating();
        let pressed = view.press(Key::TakeOver);
        assert!(matches!(pressed, Some(Request::AcquireLease { take_over: true, .. })), "{pressed:?}");
    }

    #[test]
    fn settings_that_wait_are_the_ones_that_are_changed() {
        let pending = Settings { pip: 30.0, ..Settings::default() };
        let told = Response::Settings { in_force: Settings::default(), pending: Some(pending) };
        let mut view = view_after([greeting(Mode::Ventilating), answer(Request::GetSettings, told)]);
        assert_eq!(applied(view.press(Key::RateUp)), Settings { rate: 21.0, ..pending });
    }

    #[test]
    fn keys_pressed_faster_than_the_device_answers_add_up() {
        let mut view = ventilating();
        for pip in [21.0, 22.0, 23.0] {
            assert!((applied(view.press(Key::PipUp)).pip - pip).abs() < 1e-6);
        }
    }

    #[test]
    fn a_refused_change_is_said_and_the_next_key_starts_from_what_is_in_force() {
        let mut view = ventilating();
        let settings = applied(view.press(Key::PipUp));
        let refused = News::Answer {
            request: Request::ApplySettings(settings),
            result: Err(Refusal::QueueFull.to_string()),
        };
        view.take(&refused);
        assert_eq!(warning(&view), Refusal::QueueFull.to_string());
        assert!((applied(view.press(Key::PipUp)).pip - 21.0).abs() < 1e-6);
    }

    #[test]
    fn p_changes_between_learned_weights_and_the_pid_that_ran() {
        let gains = PidGains { p: 1.0, i: 2.0, d: 0.5 };
        let mut view = ventilating();
        let chosen = |choice| answer(Request::SetController(choice), Response::Controller(choice));
        view.take(&chosen(ControllerChoice::Pid(gains)));
        assert_eq!(view.press(Key::Controller), Some(Request::SetController(ControllerChoice::Learned)));
        view.take(&chosen(ControllerChoice::Learned));
        let back = Request::SetController(ControllerChoice::Pid(gains));
        assert_eq!(view.press(Key::Controller), Some(back));
    }

    #[test]
    fn without_a_connection_nothing_is_sent_and_nothing_is_kept_for_later() {
        let mut view = ventilating();
        view.press(Key::PipUp);
        view.take(&News::Lost("cable".into()));
        assert_eq!(view.press(Key::StartStop), None);
        assert_eq!(view.press(Key::PipUp), None);
        view.take(&greeting(Mode::Ventilating));
        assert_eq!(view.press(Key::PipUp), None, "the device may have other settings now");
        view.take(&in_force(Settings { pip: 30.0, ..Settings::default() }));
        assert!(
            (applied(view.press(Key::PipUp)).pip - 31.0).abs() < 1e-6,
            "the key and the settings from before are forgotten"
        );
    }

    #[test]
    fn every_key_has_its_meaning_and_held_keys_do_not_start_and_stop_in_turns() {
        let press = |code, modifiers, kind| meaning(&KeyEvent::new_with_kind(code, modifiers, kind));
        let plain = |code| press(code, KeyModifiers::NONE, KeyEventKind::Press);
        let held = |code| press(code, KeyModifiers::NONE, KeyEventKind::Repeat);
        assert_eq!(plain(KeyCode::Char(' ')), Some(Pressed::Key(Key::StartStop)));
        assert_eq!(plain(KeyCode::Char('a')), Some(Pressed::Key(Key::Acknowledge)));
        assert_eq!(plain(KeyCode::Char('p')), Some(Pressed::Key(Key::Controller)));
        assert_eq!(plain(KeyCode::Char('m')), Some(Pressed::Key(Key::PauseAudio)));
        assert_eq!(held(KeyCode::Char('m')), None);
        assert_eq!(plain(KeyCode::Char('c')), Some(Pressed::Key(Key::Confirm)));
        assert_eq!(plain(KeyCode::Char('t')), Some(Pressed::Key(Key::TakeOver)));
        assert_eq!(held(KeyCode::Char('t')), None);
        assert_eq!(plain(KeyCode::Up), Some(Pressed::Key(Key::PipUp)));
        assert_eq!(plain(KeyCode::Down), Some(Pressed::Key(Key::PipDown)));
        assert_eq!(plain(KeyCode::Right), Some(Pressed::Key(Key::RateUp)));
        assert_eq!(plain(KeyCode::Left), Some(Pressed::Key(Key::RateDown)));
        assert_eq!(plain(KeyCode::Char('q')), Some(Pressed::Leave));
        assert_eq!(held(KeyCode::Char(' ')), None);
        assert_eq!(held(KeyCode::Up), Some(Pressed::Key(Key::PipUp)));
        assert_eq!(press(KeyCode::Up, KeyModifiers::NONE, KeyEventKind::Release), None);
        let control = |code| press(code, KeyModifiers::CONTROL, KeyEventKind::Press);
        assert_eq!(
            (control(KeyCode::Char('c')), control(KeyCode::Char('p'))),
            (Some(Pressed::Interrupt), None)
        );
    }
}

mod state {
    use super::*;

    #[test]
    fn a_development_build_is_called_so() {
        let development = DeviceIdentity { weights_key: None, ..identity(Mode::Standby) };
        assert!(words::identity(&development).ends_with(", development build"));
        assert!(!words::identity(&identity(Mode::Standby)).contains("development"));
        assert_eq!(words::weights_key(&identity(Mode::Standby)), "abababababababab");
    }

    #[test]
    fn a_device_that_restarted_between_two_looks_is_reported_with_its_cause() {
        let mut view = ventilating();
        view.take(&telemetry(100, &[5.0; 16]));
        view.take(&breath(0));
        view.take(&timing(9900));
        assert_eq!(view.message, None);
        view.take(&greeting(Mode::Standby));
        view.take(&timing(12));
        assert_eq!(warning(&view), "the device restarted: watchdog");
        assert!(view.window.last().is_none() && view.breaths.is_empty());
    }

    #[test]
    fn whoever_leaves_learns_whether_ventilation_goes_on() {
        let mut view = ventilating();
        assert!(view.farewell().contains("continues to ventilate"));
        view.take(&News::Lost("cable".into()));
        assert!(view.farewell().contains("when the connection broke"));
        assert!(view_after([greeting(Mode::Standby)]).farewell().ends_with("standby"));
        assert!(view_after([]).farewell().contains("never reported"));
    }

    #[test]
    fn breaths_of_an_earlier_start_go_when_it_starts_again() {
        let view = view_after([breath(0), breath(1), breath(2), breath(0)]);
        assert_eq!(view.breaths.iter().map(|breath| breath.breath).collect::<Vec<_>>(), [0]);
    }

    #[test]
    fn a_repeated_alarm_is_told_only_to_a_monitor_that_missed_it() {
        let again = |tick| News::Event(Event::Unacknowledged { fault: Fault::Leak, tick });
        let view = view_after([alarm(Fault::Leak), again(4321), again(4321), again(9000), again(4321)]);
        assert_eq!(view.alarms.iter().map(|alarm| alarm.tick).collect::<Vec<_>>(), [9000, 4321]);
        let missed = view_after([News::Event(Event::Unacknowledged { fault: Fault::HardLimit, tick: 1 })]);
        assert_eq!(missed.known().mode, Some(Mode::Fault(Fault::HardLimit)));
    }

    #[test]
    fn looks_at_the_device_leave_the_message_alone() {
        let mut view = ventilating();
        view.take(&News::Answer { request: Request::Start, result: Err("refused".into()) });
        for news in [greeting(Mode::Standby), in_force(Settings::default()), timing(9100)] {
            view.take(&news);
        }
        assert_eq!(warning(&view), "refused");
        view.take(&answer(Request::Start, Response::Mode(Mode::Ventilating)));
        assert_eq!(view.message, None);
    }
}

mod traces {
    use super::*;

    fn traced(batches: &[TelemetryBatch]) -> TelemetryWindow {
        let mut trace = TelemetryWindow::new(9.0, PERIOD_US);
        for batch in batches {
            trace.take(batch);
        }
        trace
    }

    #[test]
    fn a_lost_batch_leaves_a_gap() {
        let trace = traced(&[batch(0, &[5.0; 16]), batch(16, &[5.0; 16]), batch(48, &[5.0; 16])]);
        assert_eq!(trace.pieces(9000, |sample| sample.pressure).iter().map(Vec::len).sum::<usize>(), 48);
        assert_eq!(trace.pieces(9000, |sample| sample.pressure).len(), 2);
    }

    #[test]
    fn a_spike_of_one_tick_is_seen_however_few_columns_there_are() {
        let mut pressures = [5.0; 16];
        pressures[7] = 41.0;
        let quiet = (0..500).map(|index| batch(16 * index, &[5.0; 16]));
        let batches: Vec<_> = quiet.chain([batch(8000, &pressures), batch(8016, &[5.0; 16])]).collect();
        for columns in [1, 10, 160] {
            let pieces = traced(&batches).pieces(columns, |sample| sample.pressure);
            assert!(pieces.concat().iter().any(|(_, value)| (*value - 41.0).abs() < 1e-9), "{columns}");
            assert!(pieces.concat().len() <= 2 * (columns + 1), "{columns}");
        }
    }

    #[test]
    fn only_the_last_seconds_are_kept_and_time_runs_up_to_now() {
        let batches: Vec<_> = (0..1000).map(|index| batch(16 * index, &[5.0; 16])).collect();
        let points = traced(&batches).pieces(1_000_000, |sample| sample.pressure).concat();
        assert_eq!(points.len(), 9000);
        assert!((points[0].0 + 8.999).abs() < 1e-9 && points[8999].0.abs() < 1e-9);
    }

    #[test]
    fn ticks_that_go_back_forget_what_was_before() {
        let trace = traced(&[batch(1600, &[5.0; 16]), batch(0, &[6.0; 16])]);
        assert_eq!(trace.pieces(9000, |sample| sample.pressure).concat().len(), 16);
    }

    #[test]
    fn values_that_are_no_numbers_are_not_drawn() {
        let trace = traced(&[batch(0, &[f32::NAN; 16]), batch(16, &[f32::INFINITY, 5.0])]);
        assert_eq!(trace.pieces(9000, |sample| sample.pressure).concat().len(), 1);
    }

    proptest! {
        #[test]
        fn points_run_forward_in_time_and_stay_within_the_chart(
            steps in prop::collection::vec((0u64..5000, 1usize..16), 1..40), columns in 1usize..400,
        ) {
            let mut trace = TelemetryWindow::new(9.0, PERIOD_US);
            let mut tick = 0;
            for (gap, length) in steps {
                trace.take(&batch(tick + gap, &[5.0; 16][..length]));
                tick += gap + length as u64;
            }
            let points = trace.pieces(columns, |sample| sample.pressure).concat();
            prop_assert!(points.windows(2).all(|two| two[0].0 < two[1].0));
            prop_assert!(points.iter().all(|(time, _)| (-9.0..=0.0).contains(time)));
        }
    }
}

mod pictures {
    use super::*;

    fn picture(view: &View, width: u16, height: u16) -> Terminal<TestBackend> {
        let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
        terminal.draw(|frame| draw(frame, view)).unwrap();
        terminal
    }

    /// Three breaths of 3 s whose pressure lags behind its target.
    fn breathing() -> View {
        let mut view = ventilating();
        let mut pressure = 5.0_f32;
        for first in (0..8992).step_by(16) {
            let targets = batch(first, &[0.0; 16]);
            let pressures: Vec<f32> = targets
                .samples
                .iter()
                .map(|sample| {
                    pressure += 0.01 * (sample.unpack().target - pressure);
                    pressure
                })
                .collect();
            view.take(&telemetry(first, &pressures));
        }
        for news in [breath(0), breath(1)] {
            view.take(&news);
        }
        view.take(&News::Traffic(LineCounters { frames: 812, ..LineCounters::default() }));
        view
    }

    #[test]
    fn a_ventilating_device() {
        insta::assert_snapshot!(picture(&breathing(), 120, 36).backend());
    }

    #[test]
    fn alarms_by_priority_while_it_ventilates() {
        let mut view = breathing();
        let present = [Fault::Leak, Fault::LearnedDistrusted, Fault::BackupVentilation];
        let gone = [Fault::Restarted, Fault::CommandCapped];
        view.take(&alarms(&present, &gone, Level::Backup));
        view.take(&sounder(87));
        insta::assert_snapshot!(picture(&view, 120, 36).backend());
    }

    #[test]
    fn a_fault_with_losses_and_a_refusal() {
        let mut view = breathing();
        view.take(&alarm(Fault::HardLimit));
        let device = Counters { dropped: 4, corrupt_frames: 1, ..Counters::default() };
        view.take(&News::Traffic(LineCounters { frames: 900, corrupt: 2, lost_batches: 3, device }));
        let refused = Err(Refusal::FaultLatched.to_string());
        view.take(&News::Answer { request: Request::Start, result: refused });
        view.take(&steered(Some("anna@icu"), false));
        insta::assert_snapshot!(picture(&view, 120, 36).backend());
    }

    #[test]
    fn a_small_terminal_keeps_charts_mode_and_keys() {
        insta::assert_snapshot!(picture(&breathing(), 72, 20).backend());
    }

    #[test]
    fn a_device_that_is_not_there_yet() {
        insta::assert_snapshot!(picture(&view_after([]), 80, 12).backend());
    }

    /// Whether any cell of the first line has the loud background.
    fn loud(view: &View) -> bool {
        let terminal = picture(view, 120, 30);
        (0..120).any(|column| terminal.backend().buffer()[(column, 0)].bg == Color::Red)
    }

    #[test]
    fn faults_urgent_alarms_and_a_lost_connection_are_loud_and_nothing_else_is() {
        let mut view = ventilating();
        assert!(!loud(&view));
        view.take(&alarm(Fault::HardLimit));
        assert!(loud(&view));
        view.take(&greeting(Mode::Ventilating));
        view.take(&alarms(&[Fault::Leak], &[Fault::HostSilent], Level::Pid));
        assert!(!loud(&view));
        view.take(&alarms(&[Fault::Leak], &[Fault::Restarted], Level::Pid));
        assert!(loud(&view), "not yet acknowledged");
        view.take(&alarms(&[], &[], Level::Learned));
        assert!(!loud(&view));
        view.take(&News::Lost("cable".into()));
        assert!(loud(&view));
    }

    #[test]
    fn no_size_is_too_small_to_draw_on() {
        let view = breathing();
        for (width, height) in [(0, 0), (1, 1), (2, 40), (200, 2), (29, 9), (75, 3), (76, 5), (300, 90)] {
            picture(&view, width, height);
        }
    }
}
