//! The engines that run the tasks of a job array, and what they tell a task about its place in it.

use crate::Share;

/// An engine.
#[derive(Debug, PartialEq, Eq)]
pub struct Engine {
    /// Its name.
    pub name: &'static str,
    /// Variable with the task's number.
    index: &'static str,
    /// Variables with the number of tasks, or with the lowest and the highest number.
    extent: Extent,
}

/// How an engine tells the number of tasks.
#[derive(Debug, PartialEq, Eq)]
enum Extent {
    /// Not at all.
    Unknown,
    /// In this variable.
    Count(&'static str),
    /// By the lowest and the highest number and the number of tasks.
    Range([&'static str; 3]),
}

/// The known engines.
const ENGINES: [Engine; 4] = [
    Engine {
        name: "Slurm",
        index: "SLURM_ARRAY_TASK_ID",
        extent: Extent::Range(["SLURM_ARRAY_TASK_MIN", "SLURM_ARRAY_TASK_MAX", "SLURM_ARRAY_TASK_COUNT"]),
    },
    Engine { name: "HyperQueue", index: "HQ_TASK_ID", extent: Extent::Unknown },
    Engine { name: "GNU parallel", index: "PARALLEL_SEQ", extent: Extent::Unknown },
    Engine {
        name: "AWS Batch",
        index: "AWS_BATCH_JOB_ARRAY_INDEX",
        extent: Extent::Count("AWS_BATCH_JOB_ARRAY_SIZE"),
    },
];

impl Engine {
    /// The engine that runs this process; none if no engine does.
    pub fn current() -> Option<&'static Self> {
        ENGINES.iter().find(|engine| variable(engine.index).is_some())
    }

    /// Number of the task that runs this process.
    pub fn task(&self) -> Option<u64> {
        variable(self.index)
    }
}

/// Variables that number a task. A task that starts commands with work of their own removes them.
pub fn variables() -> impl Iterator<Item = &'static str> {
    ENGINES.iter().map(|engine| engine.index)
}

/// The share of the task that an engine runs in this process, of `of` shares or, if that is not given, as many as the engine has tasks.
///
/// # Errors
/// No engine, one that does not tell its number of tasks, or a task whose number is larger.
pub fn share(of: Option<u64>) -> Result<Share, String> {
    share_by(of, &variable)
}

fn share_by(of: Option<u64>, variable: &impl Fn(&str) -> Option<u64>) -> Result<Share, String> {
    let numbered = |engine: &'static Engine| Some((engine, variable(engine.index)?));
    let found: Vec<_> = ENGINES.iter().filter_map(numbered).collect();
    let names = |engines: &mut dyn Iterator<Item = &Engine>| {
        engines.map(|engine| engine.index).collect::<Vec<_>>().join(", ")
    };
    let (engine, index) = match found[..] {
        [found] => found,
        [] => {
            let known = names(&mut ENGINES.iter());
            return Err(format!("no engine runs this task (none of {known} is set): give --shard i/n"));
        }
        _ => {
            let set = names(&mut found.iter().map(|(engine, _)| *engine));
            return Err(format!("several engines number this task ({set} are set): give --shard i/n"));
        }
    };
    let counted = match engine.extent {
        Extent::Unknown => None,
        Extent::Count(name) => variable(name),
        // An array of a few tasks with gaps, such as one that repeats failures, does not tell how many there were.
        Extent::Range(names) => match names.map(variable) {
            [Some(low @ 0..=1), Some(high), Some(count)] if high + 1 == low + count => Some(count),
            _ => None,
        },
    };
    let name = engine.name;
    let of = of.or(counted).ok_or_else(|| {
        format!("{name} does not report the number of shards: give it, as in --shard auto/40")
    })?;
    Share::new(index, of)
        .ok_or_else(|| format!("this is task {index} of {name}, but there are only {of} shards"))
}

fn variable(name: &str) -> Option<u64> {
    std::env::var(name).ok()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn share_in(of: Option<u64>, set: &[(&str, u64)]) -> Result<String, String> {
        let variable = |name: &str| set.iter().find(|(set, _)| *set == name).map(|(_, value)| *value);
        share_by(of, &variable).map(|share| share.to_string())
    }

    #[test]
    fn each_engine_tells_a_task_its_share() {
        let slurm = |id, low, high, count| {
            [
                ("SLURM_ARRAY_TASK_ID", id),
                ("SLURM_ARRAY_TASK_MIN", low),
                ("SLURM_ARRAY_TASK_MAX", high),
                ("SLURM_ARRAY_TASK_COUNT", count),
            ]
        };
        assert_eq!(share_in(None, &slurm(3, 0, 39, 40)).unwrap(), "3/40");
        assert_eq!(share_in(None, &slurm(40, 1, 40, 40)).unwrap(), "0/40");
        assert_eq!(share_in(Some(40), &slurm(17, 3, 17, 2)).unwrap(), "17/40");
        let batch = [("AWS_BATCH_JOB_ARRAY_INDEX", 2), ("AWS_BATCH_JOB_ARRAY_SIZE", 7)];
        assert_eq!(share_in(None, &batch).unwrap(), "2/7");
        assert_eq!(share_in(Some(7), &[("PARALLEL_SEQ", 7)]).unwrap(), "0/7");
        assert_eq!(share_in(Some(7), &[("HQ_TASK_ID", 6)]).unwrap(), "6/7");
    }

    #[test]
    fn a_task_that_cannot_know_its_share_says_what_to_give() {
        for (of, set, wanted) in [
            (None, vec![], "give --shard i/n"),
            (None, vec![("PARALLEL_SEQ", 1)], "--shard auto/40"),
            (None, vec![("SLURM_ARRAY_TASK_ID", 17)], "--shard auto/40"),
            (Some(5), vec![("HQ_TASK_ID", 6)], "only 5 shards"),
            (Some(5), vec![("PARALLEL_SEQ", 1), ("SLURM_ARRAY_TASK_ID", 2)], "several engines"),
        ] {
            let refused = share_in(of, &set).unwrap_err();
            assert!(refused.contains(wanted), "{refused}");
        }
    }
}
