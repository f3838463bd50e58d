//! The authors' balloon as a source: the ventilator core of `shared` at a control period of 30 ms.

use shared::control::Controller;
use shared::explore::Exploration;
use shared::settings::Settings;
use shared::ventilator::{Ventilator, VentilatorState};

use super::{Source, SourceError, Tick, TickTruth, broken_off, on_any_plant};
use plant::balloon::{Balloon, PERIOD_US, settings};

/// A ventilator on the balloon. Expiration is no part of that plant: once the expiratory valve opens, the balloon is
/// back at the volume at which a breath starts.
#[derive(Clone, Debug)]
pub struct BalloonSource {
    balloon: Balloon,
    ventilator: Ventilator,
    state: VentilatorState,
}

impl BalloonSource {
    /// A ventilator at rest.
    ///
    /// # Errors
    /// Settings that are refused.
    pub fn new(controller: Controller) -> Result<Self, SourceError> {
        let ventilator = on_any_plant(PERIOD_US, controller, None);
        let mut state = ventilator.standby(&settings(Settings::default().pip))?;
        state.start();
        Ok(Self { balloon: Balloon::default(), ventilator, state })
    }

    fn tick(&mut self) -> Result<Tick, SourceError> {
        let (pressure, lung_volume) = (self.balloon.pressure() as f32, self.balloon.volume() as f32);
        let output = self.ventilator.step(&mut self.state, pressure);
        if output.command.u_out() {
            self.balloon = Balloon::default();
        } else {
            self.balloon.step(f64::from(output.command.u_in()), false);
        }
        let truth = Some(TickTruth { airway_pressure: pressure, sensor_pressure: pressure, lung_volume });
        if let Some(error) = broken_off(&self.state, &output) {
            return Err(error);
        }
        let Some(sample) = output.sample else {
            self.state.start();
            return self.tick();
        };
        Ok(Tick { sample, truth })
    }
}

impl Source for BalloonSource {
    fn period_us(&self) -> u32 {
        PERIOD_US
    }

    fn plant(&self) -> String {
        "balloon".to_owned()
    }

    fn plant_parameters(&self) -> String {
        String::new()
    }

    fn configure(
        &mut self,
        controller: Controller,
        exploration: Option<Exploration>,
    ) -> Result<(), SourceError> {
        self.ventilator = on_any_plant(PERIOD_US, controller, exploration);
        Ok(())
    }

    fn breath(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError> {
        self.ventilator.apply(&mut self.state, settings)?;
        loop {
            let tick = self.tick()?;
            sink(&tick);
            if self.state.tick() == 0 {
                return Ok(());
            }
        }
    }

    fn acknowledge(&mut self) -> Result<(), SourceError> {
        self.balloon = Balloon::default();
        self.state.stop();
        self.state.acknowledge();
        self.state.start();
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::balloon::SAMPLES;
    use shared::breath::Phase;
    use shared::control::pid::{Pid, PidGains};

    fn source() -> BalloonSource {
        let pid = Pid::new(PidGains { p: 3.0, i: 8.0, d: 0.0 }, PERIOD_US).unwrap();
        BalloonSource::new(Controller::Pid(pid)).unwrap()
    }

    #[test]
    fn every_breath_starts_at_no_pressure_and_has_29_samples() {
        let mut source = source();
        for pip in [35.0, 10.0, 35.0] {
            let mut pressure = Vec::new();
            source
                .breath(&settings(pip), &mut |tick| {
                    if tick.sample.phase == Phase::Inspiration {
                        pressure.push(tick.sample.pressure);
                    }
                })
                .unwrap();
            assert_eq!(pressure.len(), SAMPLES);
            assert!(pressure[0].abs() < 1e-6 && pressure[SAMPLES - 1] > 0.9 * pip, "{pressure:?}");
        }
    }

    #[test]
    fn a_high_pressure_ends_the_breath_and_can_be_acknowledged() {
        let mut source = source();
        let limited = Settings { pressure_limit: 20.0, ..settings(15.0) };
        let exploration = Exploration {
            boundary_probability: 1.0,
            boundary_height: (100.0, 100.0),
            boundary_duration: (0.5, 0.5),
            ..Exploration::default()
        };
        source.configure(source.ventilator.controller().clone(), Some(exploration)).unwrap();
        assert!(matches!(source.breath(&limited, &mut |_| ()), Err(SourceError::Fault { .. })));
        source.acknowledge().unwrap();
        source.configure(source.ventilator.controller().clone(), None).unwrap();
        source.breath(&settings(15.0), &mut |_| ()).unwrap();
    }
}
