//! Where the demo's breaths run: on the bench in this process, or on the virtual board with that bench as its lung.

use shared::breath::paper_settings;
use shared::control::Controller;
use shared::settings::Settings;

use super::{TRACED_BREATHS, TRACED_PIPS};
#[cfg(unix)]
use emulator::EmulatorConfig;
use plant::bench::BenchConfig;
use progress::Progress;
#[cfg(unix)]
use score::evaluate::evaluate_source;
use score::evaluate::{BreathTrace, Evaluation, Ground, Plan, trace_source};
#[cfg(unix)]
use ventilator::PortSource;
use ventilator::{BenchSource, Source, SourceError};

/// A place to collect and compare breaths. All places give the same results, bit for bit.
#[derive(Clone, Debug, Default)]
pub enum Venue {
    /// The ventilator's core in this process.
    #[default]
    InProcess,
    /// The real firmware image in QEMU.
    #[cfg(unix)]
    Board(EmulatorConfig),
}

impl Venue {
    /// A ventilator with a bench, under the sensor noise of `seed`.
    pub(super) fn source(
        &self,
        bench: &BenchConfig,
        controller: Controller,
        settings: &Settings,
        period_us: u32,
        seed: u64,
    ) -> Result<Box<dyn Source>, SourceError> {
        Ok(match self {
            Self::InProcess => Box::new(BenchSource::new(bench, controller, settings, period_us, seed)?),
            #[cfg(unix)]
            Self::Board(config) => {
                let mut board = PortSource::virtual_board(config.clone(), bench, seed)?;
                board.configure(controller, None)?;
                Box::new(board)
            }
        })
    }

    /// Scores a controller.
    pub(super) fn evaluate(
        &self,
        bench: &BenchConfig,
        controller: &Controller,
        plan: &Plan,
        progress: &Progress<'_>,
    ) -> Result<Evaluation, SourceError> {
        match self {
            Self::InProcess => bench.evaluate(controller, plan, progress),
            #[cfg(unix)]
            Self::Board(config) => {
                let mut board = PortSource::virtual_board(config.clone(), bench, 0)?;
                evaluate_source(&mut board, controller, plan, progress)
            }
        }
    }

    /// The traced breaths at each of [`TRACED_PIPS`].
    pub(super) fn traces(
        &self,
        bench: &BenchConfig,
        controller: &Controller,
        plan: &Plan,
    ) -> Result<Vec<BreathTrace>, SourceError> {
        let one = |pip: &f32| {
            let settings = paper_settings(*pip);
            let mut source =
                self.source(bench, controller.clone(), &settings, plan.period_us, plan.seeds[0])?;
            trace_source(source.as_mut(), &settings, TRACED_BREATHS)
        };
        TRACED_PIPS.iter().map(one).collect()
    }
}
