//! Quality of a fitted simulator: errors on held-out breaths, beside classical identification.

use serde::Serialize;

use crate::identify;
use data::identity::TestRun;
use data::recording::Recording;
use learn::recipe::{Fitted, Parts};
use learn::simulator::episode::Episode;
use learn::simulator::model::{Architecture, Simulator};
use learn::simulator::open_loop::{ByWaveform, OpenLoop, by_waveform, open_loop, response};
use shared::breath::period_s;

/// Times after the start of the inspiration at which the response to a higher command is reported, s.
pub const RESPONSE_S: [f32; 3] = [0.1, 0.3, 0.8];

/// Results of a fit.
#[derive(Debug, Serialize)]
pub struct FitSummary {
    /// Seed of the fit.
    pub seed: u64,
    /// Plant of the recording.
    pub plant: String,
    /// Architecture, including its shape.
    #[serde(flatten)]
    pub architecture: Architecture,
    /// Number of parameters.
    pub parameters: usize,
    /// Number of training breaths.
    pub training_breaths: usize,
    /// Number of held-out breaths.
    pub held_out_breaths: usize,
    /// Number of breaths of lungs that were held out altogether.
    pub held_out_lung_breaths: usize,
    /// Passes over the training breaths.
    pub epochs: usize,
    /// Whether the fit was stopped early.
    pub stopped: bool,
    /// Loss of the last epoch, cmH2O; `None` if stopped before its end.
    pub training_loss: Option<f64>,
    /// Standard deviation of the sensor noise, cmH2O.
    pub noise: f32,
    /// Mean absolute error of the predicted change over one step on the held-out breaths, cmH2O.
    pub one_step: f64,
    /// Mean absolute error open loop on the held-out breaths, cmH2O.
    pub open_loop: f64,
    /// Like `open_loop`, against the true airway pressure if the recording contains it.
    pub open_loop_true: Option<f64>,
    /// Like `open_loop`, on the lungs that were held out altogether.
    pub open_loop_held_out_lung: Option<f64>,
    /// Classical identification on the same held-out breaths, from measured flows.
    pub classical_open_loop: Option<f64>,
    /// Rise of the predicted pressure when every command is 5 percentage points higher, cmH2O, at [`RESPONSE_S`].
    pub response: Vec<f64>,
    /// Errors by waveform.
    pub waveforms: Vec<ByWaveform>,
    /// Errors by PEEP, rise and inspiratory time, of those that vary, and at a PIP above the paper's.
    pub settings: Vec<ByGroup>,
    /// Errors by lung or test run.
    pub groups: Vec<ByGroup>,
    /// Errors on the lungs that were held out altogether.
    pub held_out_lungs: Vec<ByGroup>,
}

/// Errors on the held-out breaths of one lung, one test run, or one range of a setting.
#[derive(Clone, Debug, Serialize)]
pub struct ByGroup {
    /// Name of the lung, the test run or the range.
    pub group: String,
    /// Number of breaths.
    pub episodes: usize,
    /// Open-loop errors.
    #[serde(flatten)]
    pub open_loop: OpenLoop,
}

impl FitSummary {
    /// Scores a simulator on the parts of a recording.
    pub fn new(seed: u64, fitted: &Fitted, parts: &Parts<'_>, recording: &Recording) -> Self {
        let Fitted { simulator, curve, stopped } = fitted;
        let names = &recording.provenance.groups;
        let errors = open_loop(simulator, &parts.held_out);
        let rows = |episodes: &[&Episode]| -> Vec<_> { episodes.iter().map(|e| e.rows.clone()).collect() };
        Self {
            seed,
            plant: simulator.plant.clone(),
            architecture: simulator.architecture,
            parameters: simulator.parameters.len(),
            training_breaths: parts.training.len(),
            held_out_breaths: parts.held_out.len(),
            held_out_lung_breaths: parts.other_lungs.len(),
            epochs: curve.len(),
            stopped: *stopped,
            training_loss: curve.last().copied(),
            noise: simulator.noise,
            one_step: errors.one_step,
            open_loop: errors.measured,
            open_loop_true: errors.truth,
            open_loop_held_out_lung: (!parts.other_lungs.is_empty())
                .then(|| open_loop(simulator, &parts.other_lungs).measured),
            classical_open_loop: identify::open_loop::open_loop(
                recording,
                &rows(&parts.training),
                &rows(&parts.held_out),
            ),
            response: response(simulator, &parts.held_out, &RESPONSE_S),
            waveforms: by_waveform(simulator, &repeated(&parts.held_out)),
            settings: by_setting(simulator, &parts.held_out, recording),
            groups: by_group(simulator, &parts.held_out, names),
            held_out_lungs: by_group(simulator, &parts.other_lungs, names),
        }
    }
}

/// Breaths whose PIP occurs more than once: those of the waveforms, without random PIPs.
fn repeated<'a>(episodes: &[&'a Episode]) -> Vec<&'a Episode> {
    let count = |pip: f32| episodes.iter().filter(|e| e.pip.total_cmp(&pip).is_eq()).count();
    episodes.iter().copied().filter(|episode| count(episode.pip) > 1).collect()
}

/// Ranges of what can be set: name, setting, and its lowest and highest value; the highest belongs to the next range.
const RANGES: [(&str, Set, f32, f32); 11] = [
    ("PEEP below 4", |set| set.peep, f32::MIN, 4.0),
    ("PEEP 4 to 8", |set| set.peep, 4.0, 8.0),
    ("PEEP 8 to 14", |set| set.peep, 8.0, 14.0),
    ("PEEP from 14", |set| set.peep, 14.0, f32::MAX),
    ("PIP above 37", |set| set.pip, 37.1, f32::MAX),
    ("square rise", |set| set.rise, f32::MIN, 0.02),
    ("rise to 0.2 s", |set| set.rise, 0.02, 0.2),
    ("rise from 0.2 s", |set| set.rise, 0.2, f32::MAX),
    ("inspiration below 0.8 s", |set| set.inspiration, f32::MIN, 0.8),
    ("inspiration 0.8 to 1.5 s", |set| set.inspiration, 0.8, 1.5),
    ("inspiration from 1.5 s", |set| set.inspiration, 1.5, f32::MAX),
];
/// A setting of a breath.
type Set = fn(&Prescribed) -> f32;

/// What was set for a breath, as far as its recording tells: pressures in cmH2O, times in s.
struct Prescribed {
    pip: f32,
    peep: f32,
    rise: f32,
    inspiration: f32,
}

impl Prescribed {
    fn of(episode: &Episode, recording: &Recording) -> Self {
        let target = &recording.target[episode.rows.clone()];
        let highest = target.iter().copied().fold(f32::MIN, f32::max);
        let rising = target.iter().take_while(|target| **target < highest).count();
        let seconds = |ticks: usize| ticks as f32 * period_s(recording.provenance.period_us);
        Self {
            pip: episode.pip,
            peep: episode.peep,
            rise: seconds(rising),
            inspiration: seconds(episode.rows.len()),
        }
    }
}

/// Errors by the ranges of the settings that hold some of the breaths, but not all.
fn by_setting(simulator: &Simulator, episodes: &[&Episode], recording: &Recording) -> Vec<ByGroup> {
    let set: Vec<Prescribed> = episodes.iter().map(|e| Prescribed::of(e, recording)).collect();
    let within = |of: Set, low: f32, high: f32| -> Vec<&Episode> {
        let both = episodes.iter().zip(&set);
        both.filter(|(_, set)| (low..high).contains(&of(set))).map(|(episode, _)| *episode).collect()
    };
    let judged = RANGES.iter().filter_map(|(name, of, low, high)| {
        let own = within(*of, *low, *high);
        let some = !own.is_empty() && own.len() < episodes.len();
        some.then(|| ByGroup {
            group: (*name).to_owned(),
            episodes: own.len(),
            open_loop: open_loop(simulator, &own),
        })
    });
    judged.collect()
}

fn by_group(simulator: &Simulator, episodes: &[&Episode], names: &[TestRun]) -> Vec<ByGroup> {
    let of_group = |index: usize| -> Vec<&Episode> {
        episodes.iter().copied().filter(|e| e.group == Some(index as u32)).collect()
    };
    let judged = names.iter().enumerate().map(|(index, name)| {
        let own = of_group(index);
        ByGroup { group: name.to_string(), episodes: own.len(), open_loop: open_loop(simulator, &own) }
    });
    judged.filter(|group| group.episodes > 0).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use data::identity::LungParameters;
    use data::import::format::Format;
    use data::import::{import_as, measured, measured_recording, recorded_files};
    use learn::recipe::{HeldOut, Recipe};
    use learn::simulator::episode::episodes;
    use learn::simulator::fit::{Fit, FitConfig};
    use learn::simulator::unit::UnitConfig;
    use plant::bench::BenchConfig;
    use plant::prescriptions::Prescriptions;
    use progress::Progress;
    use shared::breath::DEFAULT_PERIOD_US;
    use shared::control::Controller;
    use shared::control::pid::Pid;
    use shared::device::KNOWN_GOOD;
    use ventilator::BenchSource;
    use ventilator::collect::{CollectConfig, collect};

    fn episode(pip: f32) -> Episode {
        Episode {
            pressure: vec![5.0; 10],
            truth: None,
            commands: vec![0.1; 2],
            rest: vec![0.1; 2],
            start: 5.0,
            plateau: 5.0,
            phases: [1.0, 2.0],
            plateau_command: 0.1,
            pip,
            peep: 5.0,
            group: None,
            ventilator: None,
            lung: None,
            rows: 0..10,
        }
    }

    #[test]
    fn random_pips_are_no_waveforms() {
        let all = [episode(10.0), episode(13.7), episode(10.0)];
        let found = repeated(&all.iter().collect::<Vec<_>>());
        assert_eq!(found.len(), 2);
        assert!(found.iter().all(|e| e.pip.total_cmp(&10.0).is_eq()));
    }

    #[test]
    fn errors_are_told_by_what_was_set_unless_only_the_pip_varies() {
        let recorded = |prescriptions: Option<Prescriptions>| {
            let pid = Controller::Pid(Pid::new(KNOWN_GOOD, DEFAULT_PERIOD_US).unwrap());
            let config = CollectConfig { breaths: 40, prescriptions, ..CollectConfig::default() };
            let bench = BenchConfig::default();
            let mut source =
                BenchSource::new(&bench, pid.clone(), &config.settings, DEFAULT_PERIOD_US, 1).unwrap();
            collect(&mut source, &pid, &config, &Progress::silent()).unwrap().recording
        };
        let shape = UnitConfig::for_period(DEFAULT_PERIOD_US, 1);
        let fit = |recording: &Recording| {
            let all = episodes(recording, &shape.timing);
            let config = FitConfig { epochs: 1, ..FitConfig::default() };
            let episodes: Vec<&Episode> = all.iter().collect();
            let simulator = Fit::new(Architecture::Unit(shape), &episodes, config, None).simulator("bench");
            by_setting(&simulator, &episodes, recording)
        };
        assert!(fit(&recorded(None)).is_empty());
        let found = fit(&recorded(Some(Prescriptions::find("bedside").unwrap())));
        let number = |name: &str| found.iter().find(|range| range.group == name).map_or(0, |r| r.episodes);
        let settings: [usize; 4] = ["PEEP", "square", "rise", "inspiration"].map(|setting| {
            found.iter().filter(|range| range.group.starts_with(setting)).map(|range| range.episodes).sum()
        });
        assert_eq!([settings[0], settings[1] + settings[2], settings[3]], [40, 40, 40], "{found:?}");
        assert!(number("square rise") >= 20 && number("PEEP 4 to 8") >= 20, "{found:?}");
        assert!(found.iter().all(|range| range.open_loop.measured > 0.0));
    }

    /// Uses a quarter of the default's training; `docs/RECORDINGS.md` gives the command for the full training.
    #[test]
    fn one_simulator_of_measured_lungs_beats_classical_identification_and_holds_on_lungs_it_never_saw() {
        let Some(paths) = measured() else { return };
        let folder = tempfile::tempdir().unwrap();
        let recording = measured_recording(&[paths[0].clone(), paths[2].clone()], folder.path());
        let lung = |resistance| LungParameters { resistance, compliance: 20.0 };
        let hold_out_lungs = [5.0, 50.0].map(|resistance| HeldOut::Lung(lung(resistance))).to_vec();
        let recipe = Recipe { epochs: Some(400), hold_out_lungs, ..Recipe::default() };
        let architecture = recipe.architecture(&recording).unwrap();
        assert_eq!(architecture.timing().channels, 1, "the exhale valve follows the inhale valve");
        let all = episodes(&recording, architecture.timing());
        let parts = recipe.parts(&all, &recording.provenance.groups).unwrap();
        let fitted = recipe.fit(architecture, &recording, &parts.training, &Progress::silent()).unwrap();
        let summary = FitSummary::new(recipe.seed, &fitted, &parts, &recording);
        let lung = summary.open_loop_held_out_lung.unwrap();
        let classical = summary.classical_open_loop.unwrap();
        println!(
            "held out {} lung {lung} classical {classical} rise {:?}",
            summary.open_loop, summary.response
        );
        assert!(
            summary.open_loop < 0.33 && summary.open_loop < 0.5 * classical,
            "{} {classical}",
            summary.open_loop
        );
        assert!(lung < 0.8, "{lung}");
        assert!(
            summary.response.iter().all(|rise| *rise > 0.3),
            "a plant, no controller: {:?}",
            summary.response
        );
    }

    /// Uses a fraction of the default's training.
    #[test]
    fn simulators_of_blower_ventilators_have_half_of_the_classical_error() {
        let Some(paths) = recorded_files("makair", &["v2-a.record", "v2-b.record", "v2-c.record"]) else {
            return;
        };
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("records.parquet");
        import_as(&Format::Makair, &paths, &out, &Progress::silent()).unwrap();
        let recording = Recording::load(&out).unwrap();
        let recipe = Recipe { epochs: Some(2000), ..Recipe::default() };
        let architecture = recipe.architecture(&recording).unwrap();
        let all = episodes(&recording, architecture.timing());
        let parts = recipe.parts(&all, &recording.provenance.groups).unwrap();
        let fitted = recipe.fit(architecture, &recording, &parts.training, &Progress::silent()).unwrap();
        let summary = FitSummary::new(recipe.seed, &fitted, &parts, &recording);
        let classical = summary.classical_open_loop.unwrap();
        assert!(summary.open_loop < 0.5 * classical, "{} {classical}", summary.open_loop);
    }
}
