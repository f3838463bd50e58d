//! The rows of a recording, with numbers of breaths that ascend.

use data::recording::{Row, phase_number};
use shared::settings::Settings;
use shared::ventilator::{Sample, opening};

use super::recorded_file::Gap;

/// Numbers the breaths so that they ascend, also when a ventilation starts again.
#[derive(Debug, Default)]
pub struct Numbers {
    offset: u32,
    last: Option<(u32, u32)>,
}

impl Numbers {
    /// The row of a sample.
    ///
    /// # Errors
    /// [`Gap::NoNumber`].
    pub fn row(&mut self, sample: &Sample, settings: &Settings) -> Result<Row, Gap> {
        let Sample { breath, tick, phase, target, pressure, u_in, u_out, explore, .. } = *sample;
        if ![target, pressure, u_in, explore].iter().all(|value| value.is_finite()) {
            return Err(Gap::NoNumber);
        }
        let number = |offset: u32| breath.saturating_add(offset);
        if self.last.is_some_and(|last| (number(self.offset), tick) <= last) {
            self.offset = self.last.map_or(0, |(last, _)| last + 1).saturating_sub(breath);
        }
        let breath = number(self.offset);
        self.last = Some((breath, tick));
        let phase = phase_number(phase);
        let u_out = opening(u_out);
        let (pip, peep) = (settings.pip, settings.peep);
        Ok(Row { breath, tick, phase, target, pressure, u_in, u_out, explore, pip, peep, ..Row::default() })
    }
}
