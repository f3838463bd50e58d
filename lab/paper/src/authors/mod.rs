//! The balloon of the paper's authors: the analytic plant on which their published controllers were trained.
//!
//! It allows a comparison with the authors' figures under their conditions: a control period of 30 ms, 29 samples of an
//! inspiration, each read before the command that follows it, and a breath that starts at 0 cmH2O. It has no dead time,
//! no noise and no expiration. Its valve is almost closed below 15 % and fully open at 29 %, and a rise takes a few
//! periods at full flow. [`Balloon`](plant::balloon::Balloon) is the plant, [`score()`] the score of any [`Controller`],
//! [`baseline`] has reference scores, and [`ventilator::BalloonSource`] runs breaths on it.

pub mod baseline;

use plant::balloon::{PERIOD_US, SAMPLES, settings};

use shared::breath::{PAPER_PIPS, Phase};
use shared::control::Controller;
use shared::control::pid::PidGains;
use shared::settings::Settings;

use learn::pipeline::PipelineConfig;
use ventilator::{BalloonSource, Source, SourceError};

/// Gains of the PI that collects and that lies under the residual: cautious because of the valve's steep middle range.
const GAINS: PidGains = PidGains { p: 1.0, i: 5.0, d: 0.0 };

/// The authors' score of a controller with a period of [`PERIOD_US`]: the mean of |pressure - PIP| over the samples,
/// and over the PIPs 10 to 35, cmH2O.
///
/// # Errors
/// A fault of the ventilator.
pub fn score(controller: &Controller) -> Result<f64, SourceError> {
    let mut source = BalloonSource::new(controller.clone());
    let mut sum = 0.0;
    for pip in PAPER_PIPS {
        let mut pressure = Vec::with_capacity(SAMPLES);
        source.breath(&settings(pip), &mut |tick| {
            if tick.sample.phase == Phase::Inspiration {
                pressure.push(f64::from(tick.sample.pressure));
            }
        })?;
        sum += mean_error(&pressure, f64::from(pip));
    }
    Ok(sum / PAPER_PIPS.len() as f64)
}

/// The pipeline for the balloon: its period and breaths, and a training without noise, because the balloon has none.
/// Inspirations of 29 ticks are cheap, so fit and training can be longer than at 1 kHz.
pub fn pipeline(seed: u64) -> PipelineConfig {
    let breath = settings(Settings::default().pip);
    let mut config = PipelineConfig { seed, gains: GAINS, ..PipelineConfig::for_period(PERIOD_US) };
    config.collect.settings = breath;
    config.train.peep = breath.peep;
    config.train.rest = breath.expiratory_bias;
    config.train.inspiratory_time = breath.inspiratory_time;
    config.fit.epochs = 5000;
    config.train.iterations = 3000;
    config.train.adam.rate = 2e-3;
    config.train.start_spread = 0.0;
    config.train.sensor_noise = Some(0.0);
    config
}

/// Mean of |pressure - PIP|, cmH2O.
fn mean_error(pressure: &[f64], pip: f64) -> f64 {
    pressure.iter().map(|p| (p - pip).abs()).sum::<f64>() / pressure.len().max(1) as f64
}
