//! Slurm with a node on this machine: started for each test with a configuration of its own, without munge, and stopped by process
//! id.

use std::fs;
use std::net::TcpListener;
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use super::{COMMAND, merged, record, submitted, whole};
use crate::support::{Place, text};

/// When to give up: longer than anything takes on a busy machine. Slurm itself holds back a task that is requeued.
const PATIENCE: Duration = Duration::from_mins(10);

struct Cluster {
    place: Place,
    daemons: Vec<Child>,
}

impl Cluster {
    fn start() -> Self {
        let place = Place::new().with("SLURM_CONF", "slurm.conf");
        fs::write(place.path("slurm.conf"), configuration(&place)).unwrap();
        let daemon = |program: &str| {
            let log = fs::File::create(place.path(&format!("{program}.txt"))).unwrap();
            // Debian has the daemons where only root looks for programs.
            let daemon = format!("/usr/sbin/{program}");
            let mut command = place.program(if Path::new(&daemon).exists() { &daemon } else { program });
            command.arg("-D").stdin(Stdio::null()).stdout(log.try_clone().unwrap()).stderr(log);
            command.spawn().unwrap_or_else(|error| panic!("{program}: {error}; run .ci/setup/engines"))
        };
        let daemons = vec![daemon("slurmctld"), daemon("slurmd")];
        let cluster = Self { place, daemons };
        cluster.wait("an idle node", || cluster.ask(&["sinfo", "--noheader", "--format=%T"]) == "idle");
        cluster
    }

    /// What a program of Slurm answers; empty if it fails.
    fn ask(&self, words: &[&str]) -> String {
        let output = self.place.program(words[0]).args(&words[1..]).output().unwrap();
        text(&output.stdout).trim().to_owned()
    }

    #[track_caller]
    fn wait(&self, what: &str, mut there: impl FnMut() -> bool) {
        let begun = Instant::now();
        while !there() {
            if begun.elapsed() > PATIENCE {
                let logs =
                    ["slurmctld.txt", "slurmd.txt"].map(|log| fs::read_to_string(self.place.path(log)));
                panic!("no {what}: {logs:?}");
            }
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    /// Waits until a task of shard 0 has begun for this many times, and holds it, so that it cannot end before it is disturbed.
    fn hold_attempt(&self, attempts: u64) {
        let record = self.place.path("run/shards/0-of-3.task.json");
        let process = || -> Option<u64> {
            let record: serde_json::Value = serde_json::from_str(&fs::read_to_string(&record).ok()?).ok()?;
            (record["attempts"] == attempts).then(|| record["process"].as_u64())?
        };
        self.wait("task of shard 0", || process().is_some());
        let process = process().unwrap().to_string();
        assert!(Command::new("kill").args(["-STOP", &process]).status().unwrap().success());
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        for daemon in &mut self.daemons {
            let _ = daemon.kill();
            let _ = daemon.wait();
        }
    }
}

/// A free port.
fn port() -> u16 {
    TcpListener::bind("127.0.0.1:0").unwrap().local_addr().unwrap().port()
}

/// What a program prints.
fn printed(program: &str, argument: &str) -> String {
    text(&Command::new(program).arg(argument).output().unwrap().stdout).trim().to_owned()
}

/// A cluster of one node with two cores, which starts tasks at once and repeats a task that is put back into the queue
/// after a few seconds.
fn configuration(place: &Place) -> String {
    let (host, user) = (printed("uname", "-n"), printed("id", "-un"));
    let file = |name: &str| place.path(name).display().to_string();
    let (state, spool) = (file("state"), file("spool"));
    let (controller, daemon) = (file("slurmctld.pid"), file("slurmd.pid"));
    let (controller_port, daemon_port) = (port(), port());
    format!(
        "ClusterName=test\nSlurmctldHost={host}(127.0.0.1)\nSlurmUser={user}\nSlurmdUser={user}\n\
         AuthType=auth/none\nCredType=cred/none\nAuthInfo=cred_expire=5\n\
         SlurmctldPort={controller_port}\nSlurmdPort={daemon_port}\n\
         StateSaveLocation={state}\nSlurmdSpoolDir={spool}\n\
         SlurmctldPidFile={controller}\nSlurmdPidFile={daemon}\n\
         ProctrackType=proctrack/pgid\nTaskPlugin=task/none\nSwitchType=switch/none\n\
         JobAcctGatherType=jobacct_gather/none\nAccountingStorageType=accounting_storage/none\n\
         SelectType=select/cons_tres\nSelectTypeParameters=CR_CPU\nSchedulerType=sched/builtin\n\
         SchedulerParameters=batch_sched_delay=0\nKillWait=1\nReturnToService=2\n\
         NodeName={host} NodeAddr=127.0.0.1 CPUs=2 State=UNKNOWN\n\
         PartitionName=all Nodes=ALL Default=YES MaxTime=INFINITE State=UP\n"
    )
}

#[test]
fn an_array_job_and_its_merge_equal_the_whole_run() {
    let cluster = Cluster::start();
    let place = &cluster.place;
    let submitted = submitted(place);
    let shown = place.ok(&format!("submit slurm --shards 7 {submitted}"));
    assert!(shown.contains("array job ") && shown.contains("highest true airway pressure"), "{shown}");
    assert_eq!(fs::read_to_string(merged(place)).unwrap(), whole(place));
    let again = place.ok(&format!("submit slurm --shards 7 {submitted}"));
    assert!(again.contains("all shards are complete"), "{again}");
    assert_eq!(record(place, "3-of-7")["threads"], 1, "a task has one of the node's two cores");
}

#[test]
fn tasks_that_slurm_requeues_or_someone_kills_are_run_again_and_change_nothing() {
    let cluster = Cluster::start();
    let place = &cluster.place;
    let long = COMMAND.replace("1200", "3600");
    let line = format!("submit slurm --shards 3 -- {long} --out run --json {}", merged(place).display());
    let submitted = place.command(&line).stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    cluster.hold_attempt(1);
    let jobs = cluster.ask(&["squeue", "--noheader", "--states=R", "--format=%A %F_%K"]);
    let first =
        jobs.lines().find_map(|line| line.split(' ').nth(1)?.ends_with("_0").then_some(line)).unwrap();
    let task = first.split(' ').nth(1).unwrap();
    cluster.ask(&["scontrol", "requeue", task]);
    cluster.hold_attempt(2);
    cluster.ask(&["scancel", "--full", "--signal=KILL", task]);
    let output = submitted.wait_with_output().unwrap();
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert_eq!(text(&output.stdout).matches("array job ").count(), 2, "the killed task was submitted again");
    let whole = place.ok(&format!("{long} --json -"));
    assert_eq!(fs::read_to_string(merged(place)).unwrap(), whole);
}

#[test]
fn a_shard_that_cannot_succeed_is_named_and_nothing_is_merged() {
    let cluster = Cluster::start();
    let place = &cluster.place;
    place.ok("torture --breaths 60 --seed 6 --shard 0/2 --out run");
    let output = place.run(&format!("submit slurm --shards 2 --retries 1 {}", submitted(place)));
    let refused = text(&output.stderr);
    assert!(
        !output.status.success() && refused.contains("1 of 2 shards are not complete: shard 1"),
        "{refused}"
    );
    assert_eq!(text(&output.stdout).matches("array job ").count(), 2, "it was tried again");
    let log = fs::read_to_string(place.path("run/log/1.txt")).unwrap();
    assert!(log.contains("there and"), "{log}");
    assert!(!merged(place).exists() && cluster.ask(&["squeue", "--noheader"]).is_empty());
    let other = place.run(&format!("submit slurm --shards 3 {}", submitted(place)));
    assert!(text(&other.stderr).contains("is divided into 2 shards, not 3"), "{}", text(&other.stderr));
}

#[test]
fn the_same_command_watches_jobs_that_are_still_in_the_queue() {
    let cluster = Cluster::start();
    let place = &cluster.place;
    let line = format!("submit slurm --shards 2 --detach {}", submitted(place));
    let [first, second] = [place.ok(&line), place.ok(&line)];
    assert_eq!(first, second);
    place.ok(&line.replace("--detach ", ""));
    assert_eq!(fs::read_to_string(merged(place)).unwrap(), whole(place));
}
