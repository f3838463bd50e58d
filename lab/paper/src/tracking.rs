//! Curves of P-only, I-only, PID and learned controller on one lung (the paper's tracking figure).

use serde::{Deserialize, Serialize};
use shared::breath::paper_settings;
use shared::control::Controller;

use super::study::Study;
use super::{generalist, lungs};
use score::evaluate::{BreathTrace, trace};
use study::Result;

/// The waveform shown, cmH2O.
const PIP: f32 = 20.0;
/// Breaths shown.
const BREATHS: usize = 3;

/// The curves.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub(super) struct Tracking {
    pub(super) lung: String,
    /// Name and curves of each controller.
    pub(super) controllers: Vec<(String, BreathTrace)>,
}

/// Draws the curves on the lung in the middle of the list.
pub(super) fn tracking(study: &Study<'_>) -> Result<Tracking> {
    study.keep("tracking", || {
        let index = study.middle();
        let bench = &study.lungs()[index];
        let best = lungs::tuned(study)?.lungs[index];
        let controllers = vec![
            ("P only", study.pid(best.p_only.gains)?),
            ("I only", study.pid(best.i_only.gains)?),
            ("PID", study.pid(best.pid.gains)?),
            ("learned", study.learned(&lungs::first_folder(bench))?),
            ("learned, all lungs", generalist::controller(study)?),
        ];
        let plan = study.plan();
        let settings = paper_settings(PIP);
        let curves = |(name, controller): (&str, Controller)| {
            let trace = trace(bench, &controller, &settings, plan.period_us, plan.seeds[0], BREATHS)?;
            Ok((name.to_owned(), trace))
        };
        let controllers = controllers.into_iter().map(curves).collect::<Result<_>>()?;
        Ok(Tracking { lung: bench.name.clone(), controllers })
    })
}
