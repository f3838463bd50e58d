//! Plants to evaluate controllers on: a bench, or any ventilator whose plant can restart from a seed.

use std::sync::{Mutex, MutexGuard, PoisonError};

use plant::bench::BenchConfig;
use plant::link::PlantError;
use progress::Progress;
use shared::control::{ControlLaw, Controller};
use shared::settings::Settings;
use ventilator::law::AnyLaw;
use ventilator::{Reseed, SourceError};

use super::{Evaluated, Plan, evaluate_law, evaluate_source};

/// A plant to evaluate control laws of the type `C` on.
pub trait Ground<C = Controller>: Sync {
    /// Name of the plant.
    fn name(&self) -> String;

    /// Evaluates a controller by a plan.
    ///
    /// # Errors
    /// The error of the first waveform that could not be run; [`ventilator::SourceError::Stopped`] if stopped.
    fn evaluate(&self, controller: &C, plan: &Plan, progress: &Progress<'_>) -> Evaluated;
}

impl<C: ControlLaw + Clone + Sync> Ground<C> for BenchConfig {
    fn name(&self) -> String {
        self.name.clone()
    }

    fn evaluate(&self, controller: &C, plan: &Plan, progress: &Progress<'_>) -> Evaluated {
        evaluate_law(self, controller, plan, progress)
    }
}

/// A bench with a prescription of its own, which takes the place of the plan's waveforms: so each of many benches has another.
#[derive(Clone, Debug, PartialEq)]
pub struct PrescribedBench {
    /// The bench.
    pub bench: BenchConfig,
    /// Settings of its breaths.
    pub prescription: Settings,
}

impl<C: ControlLaw + Clone + Sync> Ground<C> for PrescribedBench {
    fn name(&self) -> String {
        self.bench.name.clone()
    }

    fn evaluate(&self, controller: &C, plan: &Plan, progress: &Progress<'_>) -> Evaluated {
        let plan = Plan { waveforms: vec![self.prescription], ..plan.clone() };
        evaluate_law(&self.bench, controller, &plan, progress)
    }
}

/// A ventilator to evaluate on; evaluations run one after the other, each from rest.
pub struct SourceGround<C = Controller>(Mutex<Box<dyn Reseed<C> + Send>>);

impl<C> SourceGround<C> {
    /// All evaluations run at the source's control period.
    pub fn new(source: impl Reseed<C> + Send + 'static) -> Self {
        Self(Mutex::new(Box::new(source)))
    }

    fn source(&self) -> MutexGuard<'_, Box<dyn Reseed<C> + Send>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<C: Clone> Ground<C> for SourceGround<C> {
    fn name(&self) -> String {
        self.source().plant()
    }

    fn evaluate(&self, controller: &C, plan: &Plan, progress: &Progress<'_>) -> Evaluated {
        let mut source = self.source();
        let own = source.period_us();
        if own != plan.period_us {
            return Err(PlantError::other_period(plan.period_us, own).into());
        }
        evaluate_source(source.as_mut(), controller, plan, progress)
    }
}

/// A device to evaluate on: it runs its own controllers and refuses all other laws.
pub struct DeviceGround(pub SourceGround);

impl Ground<AnyLaw> for DeviceGround {
    fn name(&self) -> String {
        self.0.name()
    }

    fn evaluate(&self, law: &AnyLaw, plan: &Plan, progress: &Progress<'_>) -> Evaluated {
        match law.chip() {
            Some(controller) => self.0.evaluate(controller, plan, progress),
            None => {
                Err(SourceError::Controller("a device runs PIDs and learned controllers only".to_owned()))
            }
        }
    }
}
