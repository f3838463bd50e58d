"""Runs the shards of a command as tasks of a HyperQueue server and a worker, both in this process.

Arguments: folder of the server, number of shards, program, its arguments.
"""

import sys

from hyperqueue import Job, LocalCluster
from hyperqueue.cluster import WorkerConfig

server, shards, *command = sys.argv[1:]
with LocalCluster(server_dir=server) as cluster:
    cluster.start_worker(WorkerConfig(cores=2))
    client = cluster.client()
    job = Job(max_fails=None)
    for number in range(int(shards)):
        # The number of a task reaches it in HQ_TASK_ID, as with `hq submit --array`.
        job.program([*command, "--shard", f"auto/{shards}"], stdout=f"{number}.txt", stderr=f"{number}-error.txt")
    client.wait_for_jobs([client.submit(job)])
