use shared::breath::Phase;
use shared::recorder::{Activity, Held, RecorderStatus, SLOW_STRIDE, TickEntry};
use shared::reset::ResetCause;
use shared::safety::alarms::Fault;

use super::*;

fn tick(pressure: f32, activity: Activity) -> TickEntry {
    let breathing = activity == Activity::Ventilating;
    TickEntry {
        pressure,
        target: breathing.then_some(20.0),
        u_in: if breathing { 35.5 } else { 0.0 },
        u_out: !breathing,
        phase: breathing.then_some(Phase::Inspiration),
        explored: false,
        activity,
        breath: 3,
    }
}

fn blackbox() -> Blackbox {
    let breathing = |pressure| Some(tick(pressure, Activity::Ventilating));
    let fault = Some(tick(39.0, Activity::Fault));
    let fast = vec![breathing(4.0), None, breathing(f32::NAN), breathing(61.25), fault];
    let held = Held { first: 0, next: 5, origin: 0 };
    let log = [
        (0, Happening::Boot { cause: ResetCause::PowerOn, failed: false }),
        (0, Happening::Weights(0xBEEF)),
        (1200, Happening::Start),
        (1200, Happening::Controller { learned: true }),
        (1200, Happening::Settings { pip: 20.0, peep: 5.0, rate: 20.0 }),
        (1800, Happening::Missed { ticks: 2 }),
        (2345, Happening::Fault(Fault::HighPressure)),
        (9000, Happening::Acknowledged),
    ];
    let log = log.map(|(tick, happening)| LogEntry { tick, boot: 1, happening });
    let again = Happening::Boot { cause: ResetCause::Watchdog, failed: true };
    Blackbox {
        status: RecorderStatus {
            boot: 2,
            recording: RecordingState::Fault(Fault::HighPressure),
            tick: 2345,
            tick_boot: 1,
            fast: held,
            slow: Held::default(),
            log: held,
        },
        from_flash: false,
        period_us: 1000,
        fast: RecordedTicks { step_s: 0.001, entries: fast },
        slow: RecordedTicks { step_s: 0.001 * f64::from(SLOW_STRIDE), entries: Vec::new() },
        log: log.into_iter().chain([LogEntry { tick: 0, boot: 2, happening: again }]).collect(),
        unread: 1,
    }
}

#[test]
fn the_summary_and_the_events() {
    let text = [summary(&blackbox(), "COM3").to_plain(), events(&blackbox(), 40).to_plain()].join("\n");
    insta::assert_snapshot!(text);
}

#[test]
fn old_events_are_left_out_and_counted() {
    let text = events(&blackbox(), 2).to_plain();
    assert!(
        text.contains("7 older ones") && text.contains("acknowledged") && !text.contains("pip"),
        "{text}"
    );
}

#[test]
fn the_csv_has_a_line_for_each_tick_and_shows_gaps_and_missing_readings() {
    insta::assert_snapshot!(csv(&blackbox()));
}

#[test]
fn every_way_in_which_a_recording_ends_is_named() {
    let end = |recording| {
        let mut blackbox = blackbox();
        blackbox.status.recording = recording;
        story(&blackbox)
    };
    assert!(end(RecordingState::Nothing).contains("nothing"));
    assert!(end(RecordingState::Running).contains("ventilates"));
    assert!(end(RecordingState::Stopped).contains("by a stop, at 2.345 s after start 1"));
    assert!(end(RecordingState::Reset).contains("by a reset while ventilating"));
    let restored = Blackbox { from_flash: true, ..blackbox() };
    assert_eq!(
        story(&restored),
        format!("{} (read back from its copy in flash after a loss of power)", story(&blackbox()))
    );
}

#[test]
fn the_page_draws_what_there_is_and_marks_the_fault() {
    let html = report(&blackbox(), "COM3").to_html().unwrap();
    assert_eq!(html.matches("<figure>").count(), 2, "the slow part is empty");
    for text in ["Airway pressure", "Inspiratory valve", "fault", "ventilation started"] {
        assert!(html.contains(text), "{text}");
    }
    let nothing = Blackbox { fast: blackbox().slow, ..blackbox() };
    assert_eq!(report(&nothing, "COM3").to_html().unwrap().matches("<figure>").count(), 0);
}
