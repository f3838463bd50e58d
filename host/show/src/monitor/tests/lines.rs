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
