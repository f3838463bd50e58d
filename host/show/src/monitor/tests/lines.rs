//! The lines of `--plain`.

use super::*;
use crate::monitor::plain::Lines;

fn written(news: impl IntoIterator<Item = News>) -> Vec<String> {
    let mut lines = Lines::default();
    news.into_iter().flat_map(|news| lines.take(&news)).collect()
}

#[test]
fn a_night_in_lines() {
    let device = Counters { missed_ticks: 1, ..Counters::default() };
    let losses = LineCounters { frames: 900, corrupt: 2, lost_batches: 3, device };
    let text = written(vec![
        greeting(Mode::Standby),
        in_force(Settings::default()),
        answer(Request::Start, Response::Mode(Mode::Ventilating)),
        telemetry(0, &[5.0; 16]),
        alarms(&[], &[], Level::Learned),
        breath(0),
        News::Traffic(losses),
        alarm(Fault::Leak),
        News::Event(Event::Unacknowledged { fault: Fault::Leak, tick: 4321 }),
        News::Event(Event::Unacknowledged { fault: Fault::Restarted, tick: 12 }),
        sounder(0),
        sounder(120),
        sounder(119),
        sounder(0),
        steered(None, false),
        steered(Some("anna@icu"), false),
        steered(Some("anna@icu"), false),
        steered(Some("here"), true),
        alarms(&[Fault::Leak, Fault::HostSilent], &[Fault::Restarted], Level::Pid),
        alarms(&[Fault::HostSilent], &[], Level::Pid),
        alarms(&[], &[], Level::Learned),
        alarm(Fault::HardLimit),
        greeting(Mode::Fault(Fault::HardLimit)),
        News::Lost("cable".into()),
        greeting(Mode::Standby),
    ]);
    insta::assert_snapshot!(text.join("\n"));
}

#[test]
fn what_did_not_change_is_not_written_again() {
    let look = || {
        let traffic = LineCounters { frames: 7, ..LineCounters::default() };
        let silent = alarms(&[Fault::HostSilent], &[], Level::Pid);
        let state =
            [greeting(Mode::Standby), in_force(Settings::default()), silent, timing(1), steered(None, false)];
        state.into_iter().chain([News::Traffic(traffic)])
    };
    assert_eq!(written(look().chain(look()).chain(look())), written(look()));
}

#[test]
fn a_breath_of_the_learned_controller_says_how_many_it_remembers() {
    let learned = answer(Request::Identify, Response::Controller(ControllerChoice::Learned));
    let lines = written([learned, breath(7)]);
    assert_eq!(
        lines.last().unwrap(),
        "breath 7: mean error 1.25, peak 21.5, end 5.1 cmH2O, leak 0.010 L/s at 1 cmH2O, 2 of 4 breaths remembered"
    );
}

#[test]
fn a_device_that_does_not_know_polled_requests_is_told_once_of_each() {
    let unknown = |request| News::Answer { request, result: Err("the device does not know it".to_owned()) };
    let poll = || [unknown(Request::GetLease), unknown(Request::GetAudio)];
    let lines = written(poll().into_iter().chain(poll()).chain(poll()));
    assert_eq!(lines, ["lease: the device does not know it", "sounder: the device does not know it"]);
    // An answer in between makes the next failure new; another reason is new anyway.
    let lost = News::Answer { request: Request::GetLease, result: Err("no answer".to_owned()) };
    let again = [unknown(Request::GetLease), steered(None, false), unknown(Request::GetLease), lost];
    let lines = written(again);
    assert_eq!(lines.iter().filter(|line| line.starts_with("lease: ")).count(), 3, "{lines:?}");
}

#[test]
fn the_same_reason_for_a_lost_connection_is_written_once_until_it_is_back() {
    let lost = || News::Lost("the device uses protocol 5".to_owned());
    let lines = written([lost(), lost(), lost(), greeting(Mode::Standby), lost()]);
    assert_eq!(lines.iter().filter(|line| line.starts_with("no connection")).count(), 2, "{lines:?}");
}
