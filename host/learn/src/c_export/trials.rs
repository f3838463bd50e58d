//! The trials of a self-check: breaths on a simple lung, in which the controller learns, is disturbed, surprised and forgets.
//!
//! The lung consists of a few operations that IEEE 754 defines to the last bit. Command and pressure form a loop, so that a wrong bit
//! in any tick spreads to later ones.

use shared::checksum::CRC_32;
use shared::settings::Settings;

use super::standalone::Standalone;

/// Fraction of the way to its end that the lung's pressure moves in a tick.
pub const LUNG_STEP: f32 = 0.02;
/// Smallest step of the reading's ripple, cmH2O; the steps by which it moves in a tick, and after how many it begins again.
pub const RIPPLE: (f32, u32, u32) = (0.05, 7, 16);

/// A breath of the self-check.
#[derive(Clone, Copy, Debug)]
pub struct Trial {
    /// Settings.
    pub settings: Settings,
    /// Pressure above PEEP at which the lung ends, cmH2O per percent of the inspiratory valve.
    pub gain: f32,
    /// Reading in the tick after a third of the inspiration, if it is not that of the lung, cmH2O.
    pub fault: Option<f32>,
}

impl Trial {
    /// Tick in which the reading is not that of the lung, for a control period in microseconds; none without a fault.
    pub fn fault_tick(&self, period_us: u32) -> Option<u32> {
        let time = self.settings.inspiratory_time / 3.0;
        self.fault.map(|_| shared::math::ticks(time, period_us))
    }
}

/// The breaths in order.
pub fn trials() -> Vec<Trial> {
    let first = Settings { rate: 40.0, inspiratory_time: 0.6, fall_time: 0.2, ..Settings::default() };
    let higher = Settings { pip: first.pip + 2.0, ..first };
    let other = Settings { pip: 30.0, peep: 8.0, rise_time: 0.15, expiratory_bias: 3.0, ..first };
    let soft = |settings| Trial { settings, gain: 0.9, fault: None };
    let stiff = |settings| Trial { gain: 0.4, ..soft(settings) };
    vec![
        soft(first),
        soft(first),
        Trial { fault: Some(f32::NAN), ..soft(first) },
        soft(first),
        soft(first),
        soft(higher),
        // A surprise.
        stiff(higher),
        stiff(higher),
        stiff(other),
        Trial { fault: Some(other.pressure_limit + 10.0), ..stiff(other) },
        stiff(other),
    ]
}

/// CRC-32 of each breath's commands: bits of `u_in`, little endian, and a byte for `u_out`, tick by tick.
pub fn checksums(controller: &Standalone, period_us: u32) -> Vec<u32> {
    let (mut state, mut pressure) = (controller.initial_state(), 0.0_f32);
    let mut breathe = |trial: &Trial| {
        let started = controller.start_breath(&mut state, &trial.settings);
        debug_assert_eq!(started, Ok(()));
        let (fault_tick, mut crc) = (trial.fault_tick(period_us), CRC_32.digest());
        while !state.is_due() {
            let tick = state.tick();
            let ripple = RIPPLE.0 * (RIPPLE.1 * tick % RIPPLE.2) as f32;
            let reading = trial.fault.filter(|_| fault_tick == Some(tick)).unwrap_or(pressure + ripple);
            let command = controller.step(&mut state, reading);
            let peep = trial.settings.peep;
            let end = if command.u_out { peep } else { peep + trial.gain * command.u_in };
            pressure += LUNG_STEP * (end - pressure);
            crc.update(&command.u_in.to_le_bytes());
            crc.update(&[u8::from(command.u_out)]);
        }
        crc.finalize()
    };
    trials().iter().map(&mut breathe).collect()
}
