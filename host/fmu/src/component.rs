//! A running FMU.

use plant::Reading;
use shared::breath::Phase;
use shared::control::Controller;
use shared::safety::filter::ValveCommand;
use shared::settings::Settings;
use shared::ventilator::Sample;
use thiserror::Error;
use ventilator::{BenchSource, SourceError, Tick, seeds};

use crate::resources::{ResourceError, Resources};
use crate::variables::{DEFAULT_SEED, OUTPUTS, Real, SEED};

/// Why a call of a simulator fails.
#[derive(Debug, Error)]
pub enum FmuError {
    /// The resources are unusable.
    #[error(transparent)]
    Resources(#[from] ResourceError),
    /// The library and the description belong to different FMUs.
    #[error("the description has the guid {description}, the resources {resources}: unpack the FMU again")]
    Guid {
        /// In the description.
        description: String,
        /// Of the resources.
        resources: String,
    },
    /// There is no such variable, or it cannot be set.
    #[error("there is no variable {0} of this kind that can be {1}")]
    Variable(u32, &'static str),
    /// The seed cannot change once the bench runs.
    #[error("the seed is set before the start")]
    Started,
    /// A step before the start, or back in time.
    #[error("a step to {0} s: steps follow the initialization, and time does not run backwards")]
    Time(f64),
    /// The ventilator or the bench failed.
    #[error(transparent)]
    Source(#[from] SourceError),
}

/// A ventilator on a bench, with the variables of an FMU.
#[derive(Clone, Debug)]
pub struct Component {
    resources: Resources,
    settings: Settings,
    seed: i32,
    /// None before the start.
    source: Option<BenchSource>,
    /// Time of the start, s, and control ticks since then.
    begun: f64,
    ticks: u64,
    outputs: [f32; OUTPUTS.len()],
}

impl Component {
    /// An FMU before its start.
    pub fn new(resources: Resources) -> Self {
        let outputs = [f32::NAN; OUTPUTS.len()];
        Self {
            resources,
            settings: Settings::default(),
            seed: DEFAULT_SEED,
            source: None,
            begun: 0.0,
            ticks: 0,
            outputs,
        }
    }

    /// The FMU whose resources are at a `file:` address and whose description has this `guid`.
    ///
    /// # Errors
    /// Resources that cannot be used, or another FMU's.
    pub fn at(address: &str, guid: &str) -> Result<Self, FmuError> {
        let resources = Resources::at(address)?;
        if resources.guid() != guid {
            return Err(FmuError::Guid { description: guid.to_owned(), resources: resources.guid() });
        }
        Ok(Self::new(resources))
    }

    /// The FMU as it was before its start.
    pub fn reset(&mut self) {
        *self = Self::new(self.resources.clone());
    }

    fn period_us(&self) -> u32 {
        self.resources.image.residual.spec().period_us
    }

    /// A real variable.
    ///
    /// # Errors
    /// There is none with this reference.
    pub fn real(&self, reference: u32) -> Result<f64, FmuError> {
        match Real::of(reference).ok_or(FmuError::Variable(reference, "read"))? {
            Real::Setting(index) => Ok(self.settings.values()[index].into()),
            Real::Output(index) => Ok(self.outputs[index].into()),
        }
    }

    /// Sets a setting, which takes effect at the start of the next breath.
    ///
    /// # Errors
    /// There is none with this reference.
    pub fn set_real(&mut self, reference: u32, value: f64) -> Result<(), FmuError> {
        let Some(Real::Setting(index)) = Real::of(reference) else {
            return Err(FmuError::Variable(reference, "set"));
        };
        let mut values = self.settings.values();
        values[index] = value as f32;
        self.settings = Settings::from_values(values);
        Ok(())
    }

    /// An integer variable.
    ///
    /// # Errors
    /// There is none with this reference.
    pub fn integer(&self, reference: u32) -> Result<i32, FmuError> {
        if reference == SEED { Ok(self.seed) } else { Err(FmuError::Variable(reference, "read")) }
    }

    /// Sets the seed.
    ///
    /// # Errors
    /// Another reference, or a bench that runs.
    pub fn set_integer(&mut self, reference: u32, value: i32) -> Result<(), FmuError> {
        match (reference, &self.source) {
            (SEED, None) => self.seed = value,
            (SEED, Some(_)) => return Err(FmuError::Started),
            _ => return Err(FmuError::Variable(reference, "set")),
        }
        Ok(())
    }

    /// Sets the time of the start, s.
    ///
    /// # Errors
    /// A time that is not a number.
    pub fn begin_at(&mut self, time: f64) -> Result<(), FmuError> {
        self.begun = if time.is_finite() { time } else { return Err(FmuError::Time(time)) };
        Ok(())
    }

    /// Starts the bench at rest.
    ///
    /// # Errors
    /// Settings that are refused, or a bench that cannot run at the controller's period.
    pub fn start(&mut self) -> Result<(), FmuError> {
        let law = Controller::Residual(self.resources.image.residual.clone());
        // As `trainer collect` does with this seed.
        let noise = seeds::collection(u64::from(self.seed.cast_unsigned()), 0);
        let source = BenchSource::new(&self.resources.bench, law, &self.settings, self.period_us(), noise)?;
        let source = self.source.insert(source.going_on());
        self.ticks = 0;
        if let Some(breath) = source.breathing() {
            let rest = at_rest(breath.reading(), self.settings.peep);
            self.outputs = OUTPUTS.map(|output| (output.of)(&rest));
        }
        Ok(())
    }

    /// Runs all control ticks up to a time, s.
    ///
    /// # Errors
    /// A time that has passed, settings that are refused at the start of a breath, or a fault that ends ventilation.
    pub fn advance(&mut self, until: f64) -> Result<(), FmuError> {
        let due = ((until - self.begun) * 1.0e6 / f64::from(self.period_us())).round();
        let Some(source) = self.source.as_mut().filter(|_| due >= self.ticks as f64) else {
            return Err(FmuError::Time(until));
        };
        while (self.ticks as f64) < due {
            if source.breathing().is_none_or(|breath| breath.is_at_start()) {
                source.begin(&self.settings)?;
            }
            if let Some(mut breath) = source.breathing() {
                breath.tick(&mut |tick| self.outputs = OUTPUTS.map(|output| (output.of)(tick)))?;
            }
            self.ticks += 1;
        }
        Ok(())
    }
}

/// What there is before the first tick: safe valves, and the bench's reading at a PEEP, cmH2O.
fn at_rest(reading: &Reading, peep: f32) -> Tick {
    let sample = Sample {
        breath: 0,
        tick: 0,
        phase: Phase::Expiration,
        target: peep,
        pressure: reading.pressure,
        u_in: ValveCommand::SAFE.u_in(),
        u_out: ValveCommand::SAFE.u_out(),
        explore: 0.0,
        learned: 0.0,
        flow: Some(reading.flow),
    };
    Tick { sample, truth: reading.truth }
}

#[cfg(test)]
mod tests {
    use plant::bench::BenchConfig;
    use shared::control::features::FeatureSpec;
    use shared::control::network::Network;
    use shared::control::pid::KNOWN_GOOD;
    use shared::control::residual::{Residual, ResidualSpec};
    use shared::weights::{IMAGE_BYTES, Identity, encode};

    use super::*;
    use crate::variables::SETTINGS;

    fn component(period_us: u32) -> Component {
        let features = FeatureSpec::default();
        let spec = ResidualSpec { period_us, gains: KNOWN_GOOD, lambda: 1.0, authority: 40.0, features };
        let residual = Residual::new(spec, Network::zero()).unwrap();
        let mut image = [0; IMAGE_BYTES];
        encode(&residual, &Identity::default(), &mut image).unwrap();
        let bench = BenchConfig::find("R20C20").unwrap().remove(0);
        Component::new(Resources::new(&bench, &image).unwrap())
    }

    fn output(component: &Component, name: &str) -> f64 {
        let index = OUTPUTS.iter().position(|output| output.name == name).unwrap();
        component.real((SETTINGS + index) as u32).unwrap()
    }

    #[test]
    fn steps_of_any_length_give_the_same_ticks() {
        let (mut fine, mut coarse) = (component(1000), component(1000));
        for component in [&mut fine, &mut coarse] {
            component.start().unwrap();
        }
        for tick in 1..=900 {
            fine.advance(f64::from(tick) * 0.001).unwrap();
        }
        assert!((output(&coarse, "pressure") - 5.0).abs() < 1.0, "at PEEP before the first tick");
        coarse.advance(0.3).unwrap();
        coarse.advance(0.9).unwrap();
        for index in 0..OUTPUTS.len() {
            assert_eq!(fine.outputs[index].to_bits(), coarse.outputs[index].to_bits(), "{index}");
        }
        assert!((output(&fine, "pressure") - 20.0).abs() < 3.0 && output(&fine, "u_in") > 1.0);
    }

    #[test]
    fn a_setting_takes_effect_at_the_next_breath_and_a_bad_one_is_refused_there() {
        let mut component = component(1000);
        component.start().unwrap();
        component.advance(0.5).unwrap();
        component.set_real(0, 30.0).unwrap();
        component.advance(0.9).unwrap();
        assert!((output(&component, "target") - 20.0).abs() < 1e-6);
        component.advance(3.5).unwrap();
        assert!((output(&component, "target") - 30.0).abs() < 1e-6);
        component.set_real(0, f64::NAN).unwrap();
        component.advance(5.9).unwrap();
        let refused = component.advance(6.1).unwrap_err().to_string();
        assert!(refused.starts_with("pip is NaN cmH2O"), "{refused}");
    }

    #[test]
    fn calls_that_make_no_sense_are_refused() {
        let mut component = component(1000);
        assert!(matches!(component.advance(1.0), Err(FmuError::Time(_))), "before the start");
        component.start().unwrap();
        component.advance(1.0).unwrap();
        assert!(matches!(component.advance(0.5), Err(FmuError::Time(_))));
        assert!(matches!(component.advance(f64::NAN), Err(FmuError::Time(_))));
        assert!(matches!(component.set_integer(SEED, 4), Err(FmuError::Started)));
        assert!(component.set_real(SETTINGS as u32, 1.0).is_err(), "an output");
        assert!(component.real((SETTINGS + OUTPUTS.len()) as u32).is_err());
        component.reset();
        component.set_integer(SEED, 4).unwrap();
        assert_eq!(component.integer(SEED).unwrap(), 4);
    }
}
