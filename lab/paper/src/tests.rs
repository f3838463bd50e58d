//! A small study of two lungs: its files, and that a stopped study continues.

use std::fs;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use super::shards::Shards;
use super::*;
use ::study::StudyError;
use campaign::Share;
use campaign::record::Options;
use campaign::shards::RunFolder;
use clap::ValueEnum;
use data::workspace::WorkspaceError;
use laws::rl::compare::RlConfig;
use learn::pipeline::PipelineConfig;
use plant::bench::BenchConfig;
use score::baselines::{Grid, Search};

fn small(out: &Path, only: &[Experiment]) -> Reproduction {
    let grid = Grid { p: vec![1.0, 4.0], i: vec![15.0, 80.0], d: vec![0.0] };
    let mut lung = PipelineConfig { rounds: 1, ensemble: 1, ..PipelineConfig::default() };
    lung.collect.breaths = 24;
    lung.fit.epochs = 60;
    lung.train.iterations = 40;
    lung.train.batch = 32;
    lung.train.validate_every = 20;
    let search = Search { grid, refinements: 0, exhaustive: true };
    Reproduction {
        seed: 1,
        budget: Budget {
            repeats: 1,
            search,
            lung: lung.clone(),
            generalist: lung.clone(),
            ablation: lung,
            learners: RlConfig::default(),
            breaths_of_learning: 2,
        },
        lungs: vec![BenchConfig::paper(20.0, 20.0), BenchConfig::paper(50.0, 10.0)],
        out: out.to_owned(),
        only: only.to_vec(),
    }
}

fn run_small(out: &Path, only: &[Experiment]) -> Results {
    run(&small(out, only), &Progress::silent()).unwrap()
}

#[test]
fn an_experiment_brings_those_it_needs_and_all_end_in_one_report() {
    let out = tempfile::tempdir().unwrap();
    let tracked = run_small(out.path(), &[Experiment::Tracking, Experiment::Iso]);
    let mean = tracked.mean.clone().unwrap();
    assert!(mean.learned < mean.pid && mean.generalist.unwrap() < mean.single_pid, "{mean:?}");
    assert!(tracked.worst_cell_ratio.unwrap() > mean.generalist.unwrap() / mean.single_pid);
    assert_eq!((tracked.iso_rows.len(), tracked.unseen.len(), tracked.breaths_to_reconverge), (21, 0, None));
    let changed = run_small(out.path(), &[Experiment::Changes]);
    assert_eq!(changed.lungs, tracked.lungs, "what was there stays");
    assert!((1..=5).contains(&changed.breaths_to_reconverge.unwrap()));
    let html = fs::read_to_string(out.path().join("report.html")).unwrap();
    for heading in
        ["Tracking", "Performance and robustness", "Changes of the lung", "Pressure-control test table"]
    {
        assert!(html.contains(&format!(">{heading}<")), "{heading}");
    }
    let json = fs::read_to_string(out.path().join("results.json")).unwrap();
    assert_eq!(serde_json::from_str::<Results>(&json).unwrap(), changed);
}

#[test]
fn a_folder_of_another_study_is_refused() {
    let out = tempfile::tempdir().unwrap();
    run_small(out.path(), &[]);
    let other = Reproduction { seed: 2, ..small(out.path(), &[]) };
    let refused = run(&other, &Progress::silent());
    assert!(matches!(refused, Err(StudyError::Workspace(WorkspaceError::OtherRun { .. }))));
}

#[test]
fn a_wish_to_stop_is_told_and_the_study_goes_on_later() {
    let out = tempfile::tempdir().unwrap();
    let only = [Experiment::Generalist];
    let stop = AtomicBool::new(true);
    let stopped = run(&small(out.path(), &only), &Progress::quiet(&stop));
    let error = stopped.unwrap_err().to_string();
    assert!(error.contains("the same command again"), "{error}");
    run_small(out.path(), &only);
}

#[test]
fn every_experiment_is_in_one_group_and_needs_only_earlier_groups() {
    let group = |experiment: &Experiment| {
        let of = |group: &&[Experiment]| group.contains(experiment);
        assert_eq!(Experiment::GROUPS.iter().filter(|group| of(group)).count(), 1, "{experiment:?}");
        Experiment::GROUPS.iter().position(of).unwrap()
    };
    for experiment in Experiment::value_variants() {
        for needed in experiment.needs() {
            assert!(group(needed) < group(experiment), "{experiment:?} needs {needed:?}");
            let further = needed.needs();
            assert!(further.iter().all(|further| experiment.needs().contains(further)), "{experiment:?}");
        }
    }
}

#[test]
fn rivals_meet_on_the_lungs_and_on_the_unseen_plants() {
    let out = tempfile::tempdir().unwrap();
    let results = run_small(out.path(), &[Experiment::Rivals]);
    assert_eq!(results.rivals.len(), 2 + unseen::plants().len());
    let names = |contest: &Contest| {
        contest.contenders.iter().map(|contender| contender.controller.clone()).collect::<Vec<_>>()
    };
    let first = &results.rivals[0];
    assert_eq!((first.plant.as_str(), names(first).first().unwrap().as_str()), ("R20C20", "family's PID"));
    assert!(results.rivals.iter().all(|contest| names(contest) == names(first)));
    let [pid, .., adult] = &first.contenders[..] else { panic!("{first:?}") };
    assert!(adult.later.score < adult.first.score, "it learns from breath to breath: {adult:?}");
    assert!(adult.later.score < pid.later.score && adult.later.effort.total_variation > 0.0, "{first:?}");
    assert!(results.lungs.is_empty(), "it needs no other experiment");
}

#[test]
fn two_tasks_that_share_a_folder_run_each_piece_once_and_find_what_one_task_finds() {
    let [out, alone] = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let only = [Experiment::Tracking, Experiment::Lungs, Experiment::Changes];
    let reproduction = small(out.path(), &only);
    let (work, folder) = (Shards(&reproduction), RunFolder::new(out.path()));
    let pieces = work.pieces();
    assert_eq!(pieces, 6, "tuning, two lungs, the generalist, tracking and changes");
    std::thread::scope(|scope| {
        for index in 0..2 {
            let (work, folder) = (&work, &folder);
            let share = Share::new(index, 2).unwrap();
            scope.spawn(move || {
                assert!(folder.run(work, pieces, share, &Options::default(), &Progress::silent()).unwrap());
            });
        }
    });
    assert_eq!(folder.merged(&work, pieces).unwrap().units(), pieces);
    let marks: Vec<_> =
        fs::read_dir(folder.claims_folder()).unwrap().map(|mark| mark.unwrap().path()).collect();
    assert!(marks.iter().all(|mark| mark.extension().is_some_and(|end| end == "done")), "{marks:?}");
    let runs = marks.iter().map(|mark| fs::read_to_string(mark).unwrap().lines().count());
    assert_eq!(runs.collect::<Vec<_>>(), vec![1; pieces as usize], "each piece runs once");
    let results = |out: &Path| {
        run_small(out, &only);
        fs::read(out.join("results.json")).unwrap()
    };
    assert!(results(out.path()) == results(alone.path()), "the results differ");
}

#[test]
fn the_number_of_an_experiment_s_pieces_is_known_before_it_can_run() {
    let out = tempfile::tempdir().unwrap();
    run_small(out.path(), &[Experiment::Generalist, Experiment::Lungs]);
    let reproduction = small(out.path(), &[]);
    let study = Study::new(&reproduction, &Progress::silent()).unwrap();
    for experiment in Experiment::value_variants() {
        assert_eq!(experiment.count(&study), experiment.pieces(&study).unwrap().len(), "{experiment:?}");
    }
}
