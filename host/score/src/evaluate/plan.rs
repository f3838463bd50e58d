//! The breaths of an evaluation: waveforms, number of breaths and sensor noise.

use serde::{Deserialize, Serialize};
use shared::breath::{DEFAULT_PERIOD_US, PAPER_PIPS};
use shared::control::ControlLaw;
use shared::settings::Settings;

use plant::bench::BenchConfig;
use plant::prescriptions::Prescriptions;
use ventilator::{BenchSource, SourceError, seeds};

/// The breaths of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(from = "WrittenPlan", into = "WrittenPlan")]
pub struct Plan {
    /// Control period, microseconds.
    pub period_us: u32,
    /// Settings of every waveform: see [`at_pips`] and [`Plan::prescribed`].
    pub waveforms: Vec<Settings>,
    /// Number of scored breaths of every waveform.
    pub breaths: usize,
    /// Number of unscored breaths before them; the first one starts from rest, with the valve closed. A controller that learns from
    /// breath to breath learns in these.
    pub warm_up: usize,
    /// Seeds of the sensor noise; every waveform runs once with each.
    pub seeds: Vec<u64>,
    /// Go on, as a device does, after the pressure limit has ended an inspiration. Otherwise that is an error.
    pub goes_on: bool,
}

impl Default for Plan {
    /// The paper's six waveforms at 1 kHz under the evaluation seeds of user seed 0.
    fn default() -> Self {
        Self {
            period_us: DEFAULT_PERIOD_US,
            waveforms: at_pips(&PAPER_PIPS, &Settings::default()),
            breaths: 4,
            warm_up: 1,
            seeds: seeds::evaluation(0),
            goes_on: false,
        }
    }
}

impl Plan {
    /// The default plan under the noise reserved for tuning.
    pub fn tuning(seed: u64) -> Self {
        Self { seeds: vec![seeds::tuning(seed)], ..Self::default() }
    }

    /// The default plan under the noise reserved for reported scores.
    pub fn evaluation(seed: u64) -> Self {
        Self { seeds: seeds::evaluation(seed), ..Self::default() }
    }

    /// The same with waveforms of prescriptions: each of those that are listed, or as many drawn ones as asked for. Drawn pressure
    /// limits may be so close to PIP that an overshoot ends an inspiration, so the ventilation then goes on.
    #[must_use]
    pub fn prescribed(self, prescriptions: &Prescriptions, seed: u64, count: u32) -> Self {
        let listed = prescriptions.are_listed();
        let count = if listed { prescriptions.pips.len().max(1) as u32 } else { count };
        let waveforms = (0..count).map(|number| prescriptions.draw(seed, number)).collect();
        Self { waveforms, goes_on: !listed, ..self }
    }

    /// The ventilator of a waveform on a bench at rest; `seed` is that of the sensor noise.
    ///
    /// # Errors
    /// A bench, settings or a control period that are refused.
    pub fn source<C: ControlLaw>(
        &self,
        bench: &BenchConfig,
        controller: C,
        waveform: &Settings,
        seed: u64,
    ) -> Result<BenchSource<C>, SourceError> {
        let source = BenchSource::new(bench, controller, waveform, self.period_us, seed)?;
        Ok(if self.goes_on { source.going_on() } else { source })
    }

    /// Number of breaths that one evaluation runs.
    pub fn breaths_run(&self) -> usize {
        self.waveforms.len() * self.seeds.len() * (self.warm_up + self.breaths)
    }

    /// Settings by which a waveform of this plan is named beside its PIP; none if the waveforms differ in nothing else.
    pub fn beside_pip(&self, waveform: &Settings) -> Option<Settings> {
        self.only_pips().is_none().then_some(*waveform)
    }

    /// The PIPs, cmH2O, if the waveforms differ in nothing else.
    fn only_pips(&self) -> Option<Vec<f32>> {
        let same = |one: &Settings| self.waveforms[0] == Settings { pip: self.waveforms[0].pip, ..*one };
        self.waveforms.iter().all(same).then(|| self.waveforms.iter().map(|waveform| waveform.pip).collect())
    }
}

/// Waveforms with these PIPs, cmH2O, and otherwise the same settings.
pub fn at_pips(pips: &[f32], settings: &Settings) -> Vec<Settings> {
    pips.iter().map(|pip| Settings { pip: *pip, ..*settings }).collect()
}

/// Name of a waveform in reports: by its PIP, cmH2O, or by the settings of [`Plan::beside_pip`].
pub fn waveform_name(pip: f32, settings: Option<&Settings>) -> String {
    match settings {
        None => format!("PIP {pip}"),
        Some(Settings { peep, rise_time, inspiratory_time, .. }) => {
            let rise = (100.0 * rise_time).round() / 100.0;
            format!("PIP {pip:.0} PEEP {peep:.0} rise {rise} s Ti {inspiratory_time:.1} s")
        }
    }
}

/// The name with its unit, where a PIP alone would have none.
pub fn waveform_title(pip: f32, settings: Option<&Settings>) -> String {
    let unit = if settings.is_none() { " cmH2O" } else { "" };
    waveform_name(pip, settings) + unit
}

/// A plan as it is written: waveforms that differ in their PIPs alone are PIPs and settings.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
struct WrittenPlan {
    period_us: u32,
    #[serde(skip_serializing_if = "Option::is_none")]
    pips: Option<Vec<f32>>,
    breaths: usize,
    warm_up: usize,
    seeds: Vec<u64>,
    #[serde(skip_serializing_if = "Option::is_none")]
    settings: Option<Settings>,
    #[serde(skip_serializing_if = "Option::is_none")]
    waveforms: Option<Vec<Settings>>,
    #[serde(skip_serializing_if = "is_off")]
    goes_on: bool,
}

/// Whether a flag is off.
#[expect(clippy::trivially_copy_pass_by_ref, reason = "serde calls it so")]
fn is_off(flag: &bool) -> bool {
    !flag
}

impl Default for WrittenPlan {
    fn default() -> Self {
        Plan::default().into()
    }
}

impl From<WrittenPlan> for Plan {
    fn from(written: WrittenPlan) -> Self {
        let WrittenPlan { period_us, pips, breaths, warm_up, seeds, settings, waveforms, goes_on } = written;
        let settings = settings.unwrap_or_default();
        let listed = || at_pips(&pips.unwrap_or_default(), &settings);
        Self { period_us, waveforms: waveforms.unwrap_or_else(listed), breaths, warm_up, seeds, goes_on }
    }
}

impl From<Plan> for WrittenPlan {
    fn from(plan: Plan) -> Self {
        let pips = plan.only_pips();
        let common = plan.waveforms.first().copied().unwrap_or_default();
        let settings = pips.is_some().then_some(Settings { pip: Settings::default().pip, ..common });
        let Plan { period_us, waveforms, breaths, warm_up, seeds, goes_on } = plan;
        let waveforms = pips.is_none().then_some(waveforms);
        Self { period_us, pips, breaths, warm_up, seeds, settings, waveforms, goes_on }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_of_pips_is_written_as_pips_and_settings() {
        let settings = Settings { peep: 8.0, ..Settings::default() };
        let plan = Plan { waveforms: at_pips(&[15.0, 30.0], &settings), ..Plan::default() };
        let json = serde_json::to_value(&plan).unwrap();
        assert_eq!(
            (&json["pips"], &json["settings"]["peep"]),
            (&serde_json::json!([15.0, 30.0]), &8.0.into())
        );
        assert!(json.get("waveforms").is_none());
        assert_eq!(serde_json::from_value::<Plan>(json).unwrap(), plan);
        assert_eq!(plan.beside_pip(&plan.waveforms[0]), None);
    }

    #[test]
    fn drawn_waveforms_are_written_in_full() {
        let bedside = Prescriptions::find("bedside").unwrap();
        let plan = Plan::default().prescribed(&bedside, 3, 5);
        let text = toml::to_string(&plan).unwrap();
        assert!(!text.contains("pips") && text.matches("[[waveforms]]").count() == 5, "{text}");
        assert_eq!(toml::from_str::<Plan>(&text).unwrap(), plan);
        assert_eq!(plan.beside_pip(&plan.waveforms[2]), Some(plan.waveforms[2]));
        assert_eq!(toml::from_str::<Plan>("").unwrap(), Plan::default());
    }

    #[test]
    fn prescriptions_give_their_list_or_as_many_draws_as_asked_for() {
        let paper = Prescriptions::default();
        assert_eq!(Plan::tuning(1).prescribed(&paper, 9, 24), Plan::tuning(1));
        let bedside = Prescriptions::find("bedside").unwrap();
        let drawn = Plan::default().prescribed(&bedside, 9, 24);
        assert!(drawn.goes_on && drawn.waveforms.len() == 24);
        assert_eq!(drawn.waveforms[23], bedside.draw(9, 23));
    }

    #[test]
    fn a_waveform_has_a_short_name() {
        assert_eq!(waveform_name(12.5, None), "PIP 12.5");
        assert_eq!(waveform_title(12.5, None), "PIP 12.5 cmH2O");
        let settings =
            Settings { pip: 27.3, peep: 12.1, rise_time: 0.2, inspiratory_time: 1.41, ..Settings::default() };
        assert_eq!(waveform_name(27.3, Some(&settings)), "PIP 27 PEEP 12 rise 0.2 s Ti 1.4 s");
        assert_eq!(waveform_title(27.3, Some(&settings)), waveform_name(27.3, Some(&settings)));
    }
}
