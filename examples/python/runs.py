"""Copies the records of runs (made-by.json) into MLflow and TensorBoard, with their own clients. A second call replaces the first.

  pip install mlflow-skinny tensorboard
  python3 runs.py out --tensorboard events && tensorboard --logdir events
  python3 runs.py out --mlflow http://localhost:5000     # a server, or a folder
"""
import argparse, json, os, re
from pathlib import Path

MADE_BY = "made-by.json"
# End of the name of an event file that this script has written.
OURS = ".eupnea"
STATUS = {"running": "RUNNING", "complete": "FINISHED", "stopped": "KILLED", "failed": "FAILED"}


def runs(folder):
    """Name, file and record of each run: `a/made-by.json` and `a.made-by.json` are those of a."""
    for file in sorted(folder.rglob("*" + MADE_BY)):
        name = str(file.relative_to(folder))[: -len(MADE_BY)].rstrip("/\\.")
        yield name or folder.resolve().name, file, json.loads(file.read_text())


def points(record):
    """Name, step and value of each figure and of each point of the curves."""
    for name, value in record["figures"].items():
        yield name, 0, value
    for name, curve in record["curves"].items():
        for step, value in zip(curve["steps"], curve["values"]):
            yield name, step, value


def origin(record):
    return {"command": "trainer " + " ".join(record["command"]), "revision": record["revision"], "machine": record["host"]}


def known_s(record):
    return record["ended_s"] or record["began_s"]


def to_mlflow(client, name, file, record):
    """A run in the experiment of its command, with the options, the numbers, and record and report as artifacts."""
    from mlflow.entities import Metric, Param, RunTag

    title = "eupnea " + record["command"][0]
    experiment = client.get_experiment_by_name(title)
    number = experiment.experiment_id if experiment else client.create_experiment(title)
    for earlier in client.search_runs([number], f"tags.record = '{file.resolve()}'"):
        client.delete_run(earlier.info.run_id)
    run = client.create_run(number, start_time=1000 * record["began_s"], run_name=name).info.run_id
    ending = record["ending"]
    state, error = next(iter(ending.items())) if isinstance(ending, dict) else (ending, "")
    tags = origin(record) | {"record": str(file.resolve()), "error": error}
    time = 1000 * known_s(record)
    logged = [
        [Metric(key(name), value, time, step) for name, step, value in points(record)],
        [Param(key(name), value[:6000]) for name, value in record["options"].items()],
        [RunTag(name, value) for name, value in tags.items() if value],
    ]
    for kind, entries in zip(["metrics", "params", "tags"], logged):
        # The client takes at most so many at once.
        for first in range(0, len(entries), 100):
            client.log_batch(run, **{kind: entries[first : first + 100]})
    client.log_artifact(run, str(file))
    report = file.with_name("report.html")
    if file.name == MADE_BY and report.exists():
        client.log_artifact(run, str(report))
    client.set_terminated(run, STATUS[state], time) if record["ended_s"] else client.update_run(run, STATUS[state])


def key(name):
    """A name that MLflow accepts."""
    return re.sub(r"[^\w\-. ]", "_", name)


def to_tensorboard(folder, record):
    """An event file with the numbers, and the options as a text."""
    from tensorboard.compat.proto.event_pb2 import Event
    from tensorboard.compat.proto.summary_pb2 import Summary
    from tensorboard.compat.proto.tensor_pb2 import TensorProto
    from tensorboard.plugins.text.metadata import create_summary_metadata
    from tensorboard.summary.writer.event_file_writer import EventFileWriter

    # The viewer would show the events of an earlier call as those of this run.
    for earlier in folder.glob("events.out.tfevents.*" + OURS):
        earlier.unlink()
    writer = EventFileWriter(str(folder), filename_suffix=OURS)

    def put(step, **value):
        summary = Summary(value=[Summary.Value(**value)])
        writer.add_event(Event(wall_time=known_s(record), step=step, summary=summary))

    rows = [f"| {name} | {value.replace('|', chr(92) + '|')} |" for name, value in (origin(record) | record["options"]).items()]
    text = "\n".join(["| option | value |", "|---|---|", *rows])
    put(0, tag="options", metadata=create_summary_metadata("options", ""), tensor=TensorProto(dtype="DT_STRING", string_val=[text.encode()]))
    for name, step, value in points(record):
        put(step, tag=name, simple_value=value)
    writer.close()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder with the runs, searched with all folders below")
    parser.add_argument("--mlflow", metavar="URI", help="tracking server, or folder of a file store")
    parser.add_argument("--tensorboard", metavar="DIR", type=Path, help="folder of the event files")
    args = parser.parse_args()
    found = list(runs(args.folder))
    assert found, f"no run in {args.folder}"
    if args.mlflow:
        # Current versions refuse a file store otherwise.
        os.environ.setdefault("MLFLOW_ALLOW_FILE_STORE", "true")
        from mlflow import MlflowClient

        client = MlflowClient(args.mlflow if ":" in args.mlflow else Path(args.mlflow).resolve().as_uri())
    for name, file, record in found:
        if args.mlflow:
            to_mlflow(client, name, file, record)
        if args.tensorboard:
            to_tensorboard(args.tensorboard / name, record)
    print(f"copied {len(found)} run(s)")


if __name__ == "__main__":
    main()
