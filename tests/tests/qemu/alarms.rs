//! Alarm outputs of the image.

use super::*;

/// Pins of port B: silence line, red and yellow lamp.
const SILENCE: u32 = 12;
const RED: u32 = 13;
const YELLOW: u32 = 14;
const OUTPUT: u32 = 1;

/// Function of the image that runs in every tick, and the one in it that runs when the signals change.
const APPLY: &str = "alarm_outputs::AlarmOutputs::apply";
const SHOW: &str = "alarm_outputs::AlarmOutputs::show";

/// The outputs after a change of the signals.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Outputs {
    /// Whether the silence line does not change from one tick to the next.
    sounds: bool,
    red: bool,
    yellow: bool,
}

/// The outputs after each of so many changes.
fn outputs(board: &Emulator, changes: usize) -> Vec<Outputs> {
    let [apply, show] = [APPLY, SHOW].map(|name| symbol(&image("board"), name).unwrap());
    let mut debugger = debugger(board);
    let mut seen = Vec::new();
    for _ in 0..changes {
        debugger.run_to(show).unwrap();
        let levels = [(); 2].map(|()| {
            debugger.run_to(apply).unwrap();
            let port = debugger.record().unwrap().ports[1];
            assert_eq!([SILENCE, RED, YELLOW].map(|pin| port.mode(pin)), [OUTPUT; 3]);
            // A breakpoint at the present place would be met at once.
            let caller = debugger.registers().unwrap()[14] & !1;
            debugger.run_to(caller).unwrap();
            [SILENCE, RED, YELLOW].map(|pin| port.level(pin))
        });
        let [[before, ..], [after, red, yellow]] = levels;
        seen.push(Outputs { sounds: before == after, red, yellow });
    }
    debugger.detach().unwrap();
    seen
}

/// Verifies: lamps-and-sounder.
#[test]
fn an_urgent_alarm_sounds_and_flashes_until_it_is_acknowledged() {
    let board = Emulator::start(EmulatorConfig { debugger: true, ..config("board") }, Silence).unwrap();
    let mut device = connect(&board);
    assert!(device.alarms().unwrap().indicated.has(Fault::ReadingNotANumber));
    // The changes of a whole burst and of the lamp meanwhile.
    let seen = outputs(&board, 60);
    for wanted in [true, false] {
        assert!(seen.iter().any(|outputs| outputs.sounds == wanted), "pulses and gaps: {seen:?}");
        assert!(seen.iter().any(|outputs| outputs.red == wanted), "flashes: {seen:?}");
    }
    assert!(seen.iter().all(|outputs| !outputs.yellow));
    device.acknowledge().unwrap();
    let acknowledged = outputs(&board, 10);
    assert!(acknowledged[1..].iter().all(|outputs| !outputs.sounds), "the line changes in every tick");
    assert!(acknowledged.iter().any(|outputs| outputs.red), "its condition holds");
}

#[test]
fn the_sounder_is_paused_over_the_link() {
    let board = Emulator::start(config("board"), Silence).unwrap();
    let mut device = connect(&board);
    assert!(device.pause_audio(121).unwrap_err().to_string().contains("at most 120 s"));
    assert_eq!(device.pause_audio(60).unwrap().pause_left, 60);
    assert!((1..=60).contains(&device.audio().unwrap().pause_left));
    assert_eq!(device.pause_audio(0).unwrap().pause_left, 0);
    device.acknowledge().unwrap();
    assert!(device.pause_audio(60).unwrap_err().to_string().contains("nothing to pause"));
}
