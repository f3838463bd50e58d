//! One simulator for several units: the same model with the parameters of each, fitted to all recordings at once.

use super::{Checked, CommissionRun, Figures};
use crate::pipeline::PipelineError;
use crate::simulator::episode::Episode;
use crate::simulator::fit::{FIT, Fit};
use crate::simulator::model::{Architecture, Simulator};
use crate::simulator::open_loop::open_loop;
use crate::simulator::unit::{PER_UNIT, UnitNumbers, spread};
use data::recording::Recording;
use progress::{Progress, Task};

impl CommissionRun {
    /// Fits one simulator to the recordings of several units and checks it, for each unit, on breaths left out of the fit. Returns it
    /// with the part of each unit, in the order of the recordings.
    ///
    /// # Errors
    /// No recording, a breath that the safe state ended, too few complete breaths, or a stopped fit.
    pub fn check_jointly(
        &self,
        recordings: &[Recording],
        progress: &Progress<'_>,
    ) -> Result<(Simulator, Vec<Checked>), PipelineError> {
        let Some(first) = recordings.first() else { return Err(PipelineError::NoSimulator) };
        let period_us = first.provenance.period_us;
        let mut breaths = Vec::new();
        for (unit, recording) in (0..).zip(recordings) {
            let own = self.complete_breaths(recording)?;
            breaths.extend(own.into_iter().map(|breath| Episode {
                ventilator: Some(unit),
                group: Some(unit),
                ..breath
            }));
        }
        let task = progress.task(FIT, 2 * self.fit.epochs);
        let numbered: Vec<(usize, &Episode)> = breaths.iter().enumerate().collect();
        let (left_out, fitted): (Vec<_>, Vec<_>) = numbered.iter().partition(|(n, _)| n % self.parts == 0);
        let [left_out, fitted]: [Vec<&Episode>; 2] =
            [left_out, fitted].map(|part| part.into_iter().map(|(_, breath)| breath).collect());
        let checked = self.fitted_jointly(recordings, period_us, &fitted, &task)?;
        let whole = self.fitted_jointly(recordings, period_us, &breaths.iter().collect::<Vec<_>>(), &task)?;
        let part = |(unit, recording): (u32, &Recording)| {
            let own = |breath: &&Episode| breath.ventilator == Some(unit);
            let left_out: Vec<&Episode> = left_out.iter().copied().filter(own).collect();
            let parameters = whole.parameters[unit as usize * PER_UNIT..][..PER_UNIT].to_vec();
            let figures = Figures {
                breaths: breaths.iter().filter(|breath| own(breath)).count(),
                open_loop: open_loop(&checked, &left_out).measured,
                noise: whole.noise,
                unit: UnitNumbers::of(&parameters),
            };
            let simulator = Simulator {
                architecture: Architecture::Unit(self.shape(period_us, 1)),
                parameters,
                plant: recording.provenance.plant.clone(),
                ..whole.clone()
            };
            Checked { simulator, figures }
        };
        let parts = (0..).zip(recordings).map(part).collect();
        Ok((whole, parts))
    }

    /// Fits a simulator of all units to these breaths.
    fn fitted_jointly(
        &self,
        recordings: &[Recording],
        period_us: u32,
        breaths: &[&Episode],
        task: &Task<'_>,
    ) -> Result<Simulator, PipelineError> {
        let shape = self.shape(period_us, recordings.len());
        let mut fit = Fit::new(Architecture::Unit(shape), breaths, self.fit, None);
        while fit.epoch().is_some() {
            if task.stopped() {
                return Err(PipelineError::Stopped);
            }
            task.advance(1);
        }
        let names: Vec<&str> =
            recordings.iter().map(|recording| recording.provenance.plant.as_str()).collect();
        let mut simulator = fit.simulator(&names.join(", "));
        spread::normalise(&mut simulator.parameters);
        Ok(simulator)
    }
}
