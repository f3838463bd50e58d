//! A handmade simulator with a known response, to test code that runs on simulators.

use super::Timing;
use super::model::{Architecture, Simulator};
use super::state_space::StateSpaceConfig;

/// The pressure follows the command with a lag of 50 ms, from 5 cmH2O at 0 % to 5 + 30 `gain` cmH2O at 50 %.
pub fn first_order(gain: f32) -> Simulator {
    let timing = Timing::for_period(1000, 1);
    let config = StateSpaceConfig { timing, states: 1, hidden: 1, history: 1, lungs: false };
    let (hidden, start) = ([0.0; 4], [0.0; 3]);
    // The state moves to the mean of the two scaled commands; it keeps five sixths of its value in 10 ms.
    let (drive, decay) = ([0.0, 0.5, 0.5, 0.0], [5.0_f32.ln()]);
    let readout = [3.0 * gain, 0.0, 3.0 * gain, 0.0, -1.5, -1.5];
    let parameters = [&hidden[..], &drive, &readout, &start, &decay].concat();
    let architecture = Architecture::StateSpace(config);
    Simulator { architecture, parameters, noise: 0.1, start_pressure: 5.0, plant: "test".into() }
}
