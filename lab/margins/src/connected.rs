//! The measurement in breaths, as of a connected unit, beside the exact one.
//!
//! Exact is the loop held where the breaths were measured: at their mean pressure, with the mean flow through the valve drawn out of
//! the circuit. There the lung takes no flow, so its parabolic resistor is replaced by the slope that it has at the flow of the breaths.

use std::ops::Range;

use plant::bench::{BenchConfig, BenchError};
use rayon::prelude::*;
use serde::Serialize;
use shared::breath::{PAPER_PIPS, period_s};
use shared::control::Controller;
use shared::explore::Exploration;
use shared::explore::sines::SineSweep;
use shared::settings::Settings;
use tuning::interval::{Finding, Sure};
use tuning::measure::{MeasureError, measure};
use tuning::measurement::{Measured, Plan, PlanError};
use tuning::stability::Margins;
use ventilator::{BenchSource, Source, SourceError, Tick};

use crate::operating_point::{HELD_AT_S, OperatingPoint};
use crate::response::{Loop, Sweep};
use crate::{OSCILLATES_CMH2O, SETTLE_S};
use progress::{Progress, Stage};

/// Comparing measurements in breaths with exact ones: plants.
pub const CONNECTED: Stage = Stage("measure in breaths, plants");

/// Difference between a measured and an exact margin, as a share, up to which they agree.
pub const AGREES: f64 = 0.1;
/// Ratio of frequencies within which the end of the band may hide a margin.
const NEAR: f64 = 1.2;
/// Lowest PIP that is tried, cmH2O: less moves too little gas for the sine.
const FROM_PIP: f32 = 20.0;

/// A margin measured in breaths, beside the exact one.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Pair {
    /// What the breaths say.
    pub found: Finding,
    /// The exact margin; none if there is none at any frequency.
    pub exact: Option<f64>,
    /// Whether the exact one lies outside the measured frequencies.
    pub outside: bool,
}

/// How a margin measured in breaths compares with the exact one.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Agreement {
    /// Within [`AGREES`], or both lie outside the measured frequencies.
    Agrees,
    /// The coherence does not suffice.
    NotEnoughCoherence,
    /// Neither.
    Differs,
}

impl Pair {
    /// How they compare.
    pub fn agreement(&self) -> Agreement {
        match (self.found, self.exact) {
            (Finding::NotEnoughCoherence(_), _) => Agreement::NotEnoughCoherence,
            (Finding::Found(Sure { value, .. }), Some(exact)) if (value / exact - 1.0).abs() <= AGREES => {
                Agreement::Agrees
            }
            (Finding::OutsideFrequencies, _) if self.outside => Agreement::Agrees,
            _ => Agreement::Differs,
        }
    }
}

/// The margins of a plant in its breaths, beside the exact ones.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Compared {
    /// Name of the plant.
    pub plant: String,
    /// The measurement; none if no PIP leaves room for the sine.
    pub measured: Option<Measured>,
    /// Ms.
    pub ms: Pair,
    /// Gain margin.
    pub gain_margin: Pair,
    /// Delay margin, ms.
    pub delay_margin_ms: Pair,
}

impl Compared {
    /// The margins by name.
    pub fn pairs(&self) -> [(&'static str, Pair); 3] {
        [("Ms", self.ms), ("gain margin", self.gain_margin), ("delay margin", self.delay_margin_ms)]
    }
}

/// Measures a controller on plants in their breaths, and exactly, on all threads. Plants that are not done when it is stopped are left out.
///
/// # Errors
/// A plant or a plan that is refused.
pub fn compare(
    plants: &[BenchConfig],
    controller: &Controller,
    period_us: u32,
    plan: &Plan,
    progress: &Progress<'_>,
) -> Result<Vec<Compared>, MeasureError> {
    let task = progress.task(CONNECTED, plants.len());
    let compared: Result<Vec<_>, MeasureError> = plants
        .par_iter()
        .map(|plant| {
            if task.stopped() {
                return Ok(None);
            }
            let compared = compare_one(plant, controller, period_us, plan)?;
            task.advance(1);
            Ok(Some(compared))
        })
        .collect();
    Ok(compared?.into_iter().flatten().collect())
}

/// Tries higher PIPs, whose flow leaves more room for the sine, until the margins are sure.
fn compare_one(
    plant: &BenchConfig,
    controller: &Controller,
    period_us: u32,
    plan: &Plan,
) -> Result<Compared, MeasureError> {
    let none = Pair { found: Finding::NotEnoughCoherence(None), exact: None, outside: false };
    let mut compared = Compared {
        plant: plant.name.clone(),
        measured: None,
        ms: none,
        gain_margin: none,
        delay_margin_ms: none,
    };
    for pip in PAPER_PIPS.into_iter().filter(|pip| *pip >= FROM_PIP) {
        let plan = Plan { settings: Settings { pip, ..plan.settings }, ..*plan };
        let source = BenchSource::new(plant, controller.clone(), &plan.settings, period_us, plan.seed)?;
        let mut watched = Watched { source, window: plan.window(period_us), flow: Flow::default() };
        let measured = match measure(&mut watched, &plan, &Progress::silent()) {
            Err(MeasureError::Plan(PlanError::NoRoom { .. })) => continue,
            other => other?,
        };
        let exact =
            exact(plant, controller, period_us, &measured, &watched.flow).map_err(SourceError::from)?;
        let lowest = f64::from(plan.band_hz.0) * NEAR;
        let highest = f64::from(plan.band_hz.1) / NEAR;
        let pair = |found: Finding, of: fn(&Margins) -> Option<f64>, at: fn(&Margins) -> Option<f64>| {
            let exact = exact.as_ref().map(|(all, _)| all);
            // Without a frequency, the margin has none in any measured loop.
            let outside = exact.is_some_and(|exact| at(exact).is_none_or(|hz| hz < lowest || hz > highest));
            Pair { found, exact: exact.and_then(of), outside }
        };
        let ms = pair(measured.margins.ms, |margins| Some(margins.ms), |margins| Some(margins.ms_hz));
        // That within the measured frequencies, if one was found there.
        let inside =
            exact.as_ref().map(|(_, inside)| *inside).filter(|_| measured.margins.ms.sure().is_some());
        compared.ms = Pair { exact: inside.or(ms.exact), ..ms };
        compared.gain_margin =
            pair(measured.margins.gain_margin, |margins| margins.gain_margin, |margins| margins.opposite_hz);
        compared.delay_margin_ms = pair(
            measured.margins.delay_margin_ms,
            |margins| margins.delay_margin_ms,
            |margins| margins.crossover_hz,
        );
        let suffices = measured.margins.suffices();
        compared.measured = Some(measured);
        if suffices {
            break;
        }
    }
    Ok(compared)
}

/// The margins of the loop held where it was measured in breaths, and its Ms within the frequencies of the breaths; none if it
/// oscillates by itself.
fn exact(
    plant: &BenchConfig,
    controller: &Controller,
    period_us: u32,
    measured: &Measured,
    flow: &Flow,
) -> Result<Option<(Margins, f64)>, BenchError> {
    if measured.estimates.is_empty() {
        return Ok(None);
    }
    let lung_l_s = 1e-3 * flow.lung_ml / flow.time_s;
    let circuit_l_s = 1e-3 * plant.circuit.compliance_ml_per_cmh2o * flow.risen_cmh2o / flow.time_s;
    let mut held = plant.clone();
    let first = &mut held.lung.first;
    first.resistance_cmh2o_per_l_s *= 1.0 + 2.0 * first.turbulence_s_per_l * lung_l_s;
    first.turbulence_s_per_l = 0.0;
    let settings = measured.plan.settings;
    let point = OperatingPoint {
        pip: measured.point.pressure as f32,
        peep: settings.peep,
        flow_l_s: lung_l_s + circuit_l_s,
    };
    let held_tick = (HELD_AT_S / f64::from(period_s(period_us))) as u32;
    let control = Loop { law: controller, seen: point.observation(), period_us, held_tick };
    let (rest, sd) = control.settle(point.bench(&held, period_us, measured.plan.seed)?, SETTLE_S);
    let sweep = Sweep::default().with_amplitude(measured.plan.amplitude.into());
    let (response, _) = control.response(&rest, &sweep);
    let inside: Vec<_> =
        response.iter().filter(|at| at.hz >= f64::from(measured.plan.band_hz.0)).copied().collect();
    let both = Margins::of(&response).zip(Margins::of(&inside).map(|inside| inside.ms));
    Ok(both.filter(|_| sd <= OSCILLATES_CMH2O))
}

/// Gas and pressure over the inspirations, while the sine is added.
#[derive(Clone, Copy, Debug, Default)]
struct Flow {
    lung_ml: f64,
    risen_cmh2o: f64,
    time_s: f64,
}

/// A bench that notes the flow during the sines.
struct Watched {
    source: BenchSource,
    window: Range<u32>,
    flow: Flow,
}

impl Source for Watched {
    fn period_us(&self) -> u32 {
        self.source.period_us()
    }

    fn plant(&self) -> String {
        self.source.plant()
    }

    fn plant_parameters(&self) -> String {
        self.source.plant_parameters()
    }

    fn configure(
        &mut self,
        controller: Controller,
        exploration: Option<Exploration>,
    ) -> Result<(), SourceError> {
        self.source.configure(controller, exploration)
    }

    fn sweep(&mut self, sweep: Option<SineSweep>) -> Result<(), SourceError> {
        self.source.sweep(sweep)
    }

    fn breath(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError> {
        let period = f64::from(period_s(self.source.period_us()));
        let mut before: Option<(f64, f64)> = None;
        let Self { window, flow, .. } = self;
        self.source.breath(settings, &mut |tick| {
            let explores = window.contains(&tick.sample.tick) && tick.sample.explore != 0.0;
            let truth = tick.truth.filter(|_| explores);
            let now = truth.map(|truth| (f64::from(truth.lung_volume), f64::from(truth.airway_pressure)));
            if let (Some(before), Some(now)) = (before, now) {
                flow.lung_ml += now.0 - before.0;
                flow.risen_cmh2o += now.1 - before.1;
                flow.time_s += period;
            }
            before = now;
            sink(tick);
        })
    }

    fn acknowledge(&mut self) -> Result<(), SourceError> {
        self.source.acknowledge()
    }
}
