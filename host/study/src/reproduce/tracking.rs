//! Curves of P-only, I-only, PID and learned controller on one lung (the paper's tracking figure).

use serde::{Deserialize, Serialize};
use shared::control::Controller;

use super::study::Study;
use super::{generalist, lungs};
use crate::StudyError;
use judge::evaluate::{BreathTrace, trace};
use learn::controller::learned::Learned;

/// The waveform shown, cmH2O.
const PIP: f32 = 20.0;
/// Breaths shown.
const BREATHS: usize = 3;

/// The curves.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Tracking {
    /// Name of the lung.
    pub(super) lung: String,
    /// Name and curves of each controller.
    pub(super) controllers: Vec<(String, BreathTrace)>,
}

/// Draws the curves on the lung in the middle of the list.
pub(super) fn tracking(study: &Study<'_>) -> Result<Tracking, StudyError> {
    study.keep("tracking", || {
        let index = study.lungs().len() / 2;
        let bench = &study.lungs()[index];
        let best = lungs::tuned(study)?.lungs[index];
        lungs::lungs(study)?;
        let file = study.path(&format!("lungs/{}-0/controller.safetensors", bench.name));
        let controllers = vec![
            ("P only", study.pid(best.p_only.gains)?),
            ("I only", study.pid(best.i_only.gains)?),
            ("PID", study.pid(best.pid.gains)?),
            ("learned", Controller::Residual(Learned::load(&file)?.controller)),
            ("learned, all lungs", generalist::controller(study)?),
        ];
        let plan = study.plan();
        let settings = plan.waveform(PIP);
        let curves = |(name, controller): (&str, Controller)| {
            let trace = trace(bench, &controller, &settings, plan.period_us, plan.seeds[0], BREATHS)?;
            Ok((name.to_owned(), trace))
        };
        let controllers = controllers.into_iter().map(curves).collect::<Result<_, StudyError>>()?;
        Ok(Tracking { lung: bench.name.clone(), controllers })
    })
}

/// What the folder holds.
pub(super) fn kept(study: &Study<'_>) -> Result<Option<Tracking>, StudyError> {
    study.kept("tracking")
}
