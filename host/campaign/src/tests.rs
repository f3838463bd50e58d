//! Tests of campaigns as a whole, with the work of adding up sines.

use std::fs;
use std::sync::Barrier;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use thiserror::Error;

use super::record::{Ending, Options};
use super::shards::RunFolder;
use super::*;

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Sines {
    sum: ExactSum,
    /// The unit with the highest value; of equal ones the first.
    highest: Option<(u64, f64)>,
}

impl Sums for Sines {
    type Unit = f64;

    fn add(&mut self, number: u64, result: f64) {
        self.sum.add(result);
        self.absorb(Self { sum: ExactSum::default(), highest: Some((number, result)) });
    }

    fn absorb(&mut self, other: Self) {
        self.sum.absorb(other.sum);
        let both = self.highest.into_iter().chain(other.highest);
        self.highest = both.reduce(|one, other| {
            let order = other.1.total_cmp(&one.1).then(one.0.cmp(&other.0));
            if order.is_gt() { other } else { one }
        });
    }
}

/// Sines of the units' numbers, scaled by a seed.
#[derive(Default)]
struct Waves {
    seed: u64,
    /// First unit that fails, as do all later ones.
    fails: Option<u64>,
    /// Units computed.
    computed: AtomicU64,
}

#[derive(Debug, Error)]
enum WavesError {
    #[error(transparent)]
    Workspace(#[from] WorkspaceError),
    #[error("unit {0} broke")]
    Broken(u64),
}

impl Work for Waves {
    type Question = u64;
    type Sums = Sines;
    type Error = WavesError;

    fn question(&self) -> u64 {
        self.seed
    }

    fn nothing(&self) -> Sines {
        Sines::default()
    }

    fn stage(&self) -> (Stage, f64) {
        (Stage("waves"), 1.0)
    }

    fn unit(&self, number: u64, task: &Task<'_>) -> Result<Option<f64>, WavesError> {
        if self.fails.is_some_and(|first| number >= first) {
            return Err(WavesError::Broken(number));
        }
        self.computed.fetch_add(1, Ordering::Relaxed);
        task.advance(1);
        Ok(Some((number as f64 * 0.7 + self.seed as f64).sin() * 10_f64.powi((number % 9) as i32 - 4)))
    }
}

fn waves(seed: u64) -> Waves {
    Waves { seed, ..Waves::default() }
}

fn whole(units: u64) -> CampaignOf<Waves> {
    let mut campaign = Campaign::new(&waves(1));
    campaign.advance(&waves(1), units, None, &Progress::silent()).unwrap();
    campaign
}

fn shard(folder: &RunFolder, text: &str, units: u64) -> Result<bool, WavesError> {
    folder.run(&waves(1), units, text.parse().unwrap(), &Options::default(), &Progress::silent())
}

#[test]
fn the_result_does_not_depend_on_the_number_of_threads() {
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| whole(500))
    };
    assert_eq!(with(1), with(4));
    assert_eq!(with(1).units(), 500);
}

#[test]
fn a_campaign_in_parts_equals_one_in_a_single_part_and_computes_no_unit_twice() {
    let folder = tempfile::tempdir().unwrap();
    let (file, work) = (folder.path().join("kept.json"), waves(1));
    for units in [3, 100, 60] {
        let mut part = Campaign::new(&work).resumed(&file).unwrap();
        part.advance(&work, units, Some(&file), &Progress::silent()).unwrap();
    }
    assert_eq!(Campaign::new(&work).resumed(&file).unwrap(), whole(100));
    assert_eq!(work.computed.into_inner(), 100);
}

#[test]
fn a_file_of_another_question_is_refused_with_the_difference() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("kept.json");
    whole(3).save(Some(&file)).unwrap();
    let refused = Campaign::new(&waves(2)).resumed(&file).unwrap_err().to_string();
    assert!(refused.contains("1 there and 2 here"), "{refused}");
}

#[test]
fn a_stopped_campaign_has_whole_units_only() {
    let stop = AtomicBool::new(false);
    let observer = |event: &progress::Event<'_>| stop.store(event.done >= 10, Ordering::Relaxed);
    let (mut campaign, work) = (Campaign::new(&waves(1)), waves(1));
    campaign.advance(&work, 1000, None, &Progress::new(&observer, &stop)).unwrap();
    assert!((10..500).contains(&campaign.units()), "{}", campaign.units());
    campaign.advance(&work, 1000, None, &Progress::silent()).unwrap();
    assert_eq!(campaign, whole(1000));
}

#[test]
fn a_failed_unit_ends_the_campaign_and_the_others_are_kept() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("kept.json");
    let broken = Waves { fails: Some(40), ..waves(1) };
    let mut campaign = Campaign::new(&broken);
    let error = campaign.advance(&broken, 100, Some(&file), &Progress::silent()).unwrap_err();
    assert_eq!(error.to_string(), "unit 40 broke");
    let mut mended = Campaign::new(&waves(1)).resumed(&file).unwrap();
    assert!((39..100).contains(&mended.units()));
    mended.advance(&waves(1), 100, None, &Progress::silent()).unwrap();
    assert_eq!(mended, whole(100));
}

#[test]
fn merged_shards_equal_the_whole_run_byte_for_byte_in_any_order() {
    let text = |campaign: &CampaignOf<Waves>| serde_json::to_string(campaign).unwrap();
    for of in [1_u64, 2, 7, 40, 100] {
        let folder = tempfile::tempdir().unwrap();
        let run = RunFolder::new(folder.path());
        for index in (1..=of).map(|n| n * 11 % of) {
            assert!(shard(&run, &format!("{index}/{of}"), 95).unwrap());
        }
        assert_eq!(text(&run.merged(&waves(1), 95).unwrap()), text(&whole(95)), "{of} shards");
    }
}

#[test]
fn a_shard_that_was_stopped_continues_and_two_tasks_with_one_shard_do_no_harm() {
    let folder = tempfile::tempdir().unwrap();
    let run = RunFolder::new(folder.path());
    let stop = AtomicBool::new(false);
    let observer = |event: &progress::Event<'_>| stop.store(event.done >= 10, Ordering::Relaxed);
    let share = "0/2".parse().unwrap();
    assert!(!run.run(&waves(1), 1000, share, &Options::default(), &Progress::new(&observer, &stop)).unwrap());
    let refused = run.merged(&waves(1), 1000).unwrap_err().to_string();
    assert!(refused.contains("shards 0, 1 of 2 are not complete"), "{refused}");
    std::thread::scope(|scope| {
        for text in ["0/2", "0/2", "1/2", "1/2"] {
            let run = &run;
            scope.spawn(move || assert!(shard(run, text, 1000).unwrap()));
        }
    });
    assert_eq!(run.merged(&waves(1), 1000).unwrap(), whole(1000));
    let complete = fs::read(run.shard_file(share)).unwrap();
    assert!(shard(&run, "0/2", 1000).unwrap(), "a complete shard is run again");
    assert_eq!(fs::read(run.shard_file(share)).unwrap(), complete);
}

#[test]
fn shards_that_are_missing_copied_or_of_another_run_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let run = RunFolder::new(folder.path());
    let merged = || run.merged(&waves(1), 20).map_err(|error| error.to_string());
    assert!(merged().unwrap_err().contains("contains no sharded run"));
    for text in ["0/5", "2/5", "4/5"] {
        shard(&run, text, 20).unwrap();
    }
    let file = |index: u64| run.shard_file(Share::new(index, 5).unwrap());
    assert!(merged().unwrap_err().contains("shards 1, 3 of 5 are not complete"));
    fs::copy(file(2), file(1)).unwrap();
    let refused = merged().unwrap_err();
    assert!(
        refused.contains("shard 3 of 5 is not complete") && refused.contains("is a copy of shard 2/5"),
        "{refused}"
    );
    for (index, text) in [(1, "1/5"), (3, "3/5")] {
        let _ = fs::remove_file(file(index));
        shard(&run, text, 20).unwrap();
    }
    assert_eq!(merged().unwrap(), whole(20));
    let sound = fs::read_to_string(file(3)).unwrap();
    let build = data::provenance::build_id();
    fs::write(file(3), sound.replace(&build, "0123456789abcdef")).unwrap();
    assert!(
        merged().unwrap_err().contains("shard 3/5 belongs to another run: `build` is \"0123456789abcdef\"")
    );
    fs::write(file(3), "{").unwrap();
    assert!(merged().unwrap_err().contains("3-of-5.json"));
}

#[test]
fn a_folder_belongs_to_one_run() {
    let folder = tempfile::tempdir().unwrap();
    let run = RunFolder::new(folder.path());
    shard(&run, "0/5", 20).unwrap();
    let refused = |error: WavesError| error.to_string();
    assert!(refused(shard(&run, "0/4", 20).unwrap_err()).contains("`shards` is 5 there and 4 here"));
    assert!(refused(shard(&run, "1/5", 21).unwrap_err()).contains("`units` is 20 there and 21 here"));
    let other = run.run(&waves(2), 20, Share::new(1, 5).unwrap(), &Options::default(), &Progress::silent());
    assert!(refused(other.unwrap_err()).contains("`question` is 1 there and 2 here"));
    assert!(run.merged(&waves(2), 20).unwrap_err().to_string().contains("`question`"));
}

#[test]
fn of_tasks_with_different_questions_that_begin_together_one_gets_the_folder() {
    for _ in 0..20 {
        let folder = tempfile::tempdir().unwrap();
        let (run, together) = (RunFolder::new(folder.path()), Barrier::new(4));
        let task = |seed: u64| {
            together.wait();
            run.run(&waves(seed), 4, Share::new(seed, 4).unwrap(), &Options::default(), &Progress::silent())
                .is_ok()
        };
        let successes = std::thread::scope(|scope| {
            let tasks: Vec<_> = (0..4).map(|seed| scope.spawn(move || task(seed))).collect();
            tasks.into_iter().map(|task| usize::from(task.join().unwrap())).sum::<usize>()
        });
        assert_eq!(successes, 1);
    }
}

#[test]
fn what_every_task_needs_is_computed_once_and_only_for_its_question() {
    let folder = tempfile::tempdir().unwrap();
    let (run, together, computed) = (RunFolder::new(folder.path()), Barrier::new(4), AtomicU64::new(0));
    let once = |question: u64, progress: &Progress<'_>| {
        run.once("value", &question, progress, || -> Result<u64, WorkspaceError> {
            std::thread::sleep(Duration::from_millis(100));
            Ok(computed.fetch_add(1, Ordering::Relaxed))
        })
    };
    let stop = AtomicBool::new(true);
    assert_eq!(once(1, &Progress::quiet(&stop)).unwrap(), None, "a task that was stopped keeps nothing");
    std::thread::scope(|scope| {
        for _ in 0..4 {
            scope.spawn(|| {
                together.wait();
                assert_eq!(once(1, &Progress::silent()).unwrap(), Some(0));
            });
        }
    });
    assert_eq!(computed.load(Ordering::Relaxed), 1);
    let refused = once(2, &Progress::silent()).unwrap_err().to_string();
    assert!(refused.contains("`question` is 1 there and 2 here"), "{refused}");
}

#[test]
fn a_folder_tells_how_far_each_shard_is_and_what_ended_it() {
    let folder = tempfile::tempdir().unwrap();
    let run = RunFolder::new(folder.path());
    assert_eq!(run.states().unwrap(), []);
    shard(&run, "0/3", 10).unwrap();
    let broken = Waves { fails: Some(1), ..waves(1) };
    run.run(&broken, 10, Share::new(1, 3).unwrap(), &Options::default(), &Progress::silent()).unwrap_err();
    let states = run.states().unwrap();
    let ending = |index: usize| states[index].record.as_ref().map(|record| record.ending.clone());
    assert!(states[0].complete && states[0].units == 4 && ending(0) == Some(Ending::Complete));
    assert_eq!(ending(1), Some(Ending::Failed("unit 1 broke".to_owned())));
    assert_eq!((states[1].units, states[2].done, ending(2)), (3, 0, None));
    assert!(shard(&run, "1/3", 10).unwrap());
    let record = run.states().unwrap().remove(1).record.unwrap();
    assert_eq!((record.attempts, record.ending), (2, Ending::Complete));
    assert!(!record.host.is_empty() && record.ended_s.is_some());
}

#[test]
fn a_folder_that_cannot_be_written_is_named() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("shards"), "a file in place of a folder").unwrap();
    let refused = shard(&RunFolder::new(folder.path()), "0/1", 5).unwrap_err().to_string();
    assert!(refused.starts_with("cannot use") && refused.contains("shards"), "{refused}");
}
