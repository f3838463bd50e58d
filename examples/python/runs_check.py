"""Opens what runs.py has written with MLflow and TensorBoard, and compares it with the records.

  lab runs out --json runs.json
  python3 runs.py out --mlflow mlruns --tensorboard events
  python3 runs_check.py runs.json mlruns events
"""
import json, os, sys

os.environ["MLFLOW_ALLOW_FILE_STORE"] = "true"
from mlflow import MlflowClient
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

STATUS = {"complete": "FINISHED", "failed": "FAILED", "stopped": "KILLED", "killed": "KILLED"}

file, store, events = sys.argv[1:]
runs = json.load(open(file))["runs"]
assert runs, "no run was exported"
client = MlflowClient(tracking_uri="file:" + os.path.abspath(store))
experiments = {experiment.name: experiment.experiment_id for experiment in client.search_experiments()}
exported = [(run, name) for name, number in experiments.items() for run in client.search_runs([number])]
assert len(exported) == len(runs), f"MLflow finds {len(exported)} runs in place of {len(runs)}"
exported = {(run.info.run_name, name): run for run, name in exported}

for run in runs:
    kept = exported[run["name"], "eupnea " + run["command"][0]]
    assert kept.info.status == STATUS[run["state"]], kept.info.status
    assert (kept.info.start_time, kept.info.end_time) == (1000 * run["began_s"], 1000 * run["ended_s"])
    assert kept.data.params == run["options"]
    artifacts = [artifact.path for artifact in client.list_artifacts(kept.info.run_id)]
    assert any(path.endswith("made-by.json") for path in artifacts), artifacts

    board = EventAccumulator(os.path.join(events, run["name"]))
    board.Reload()
    assert run["command"][0] in board.Tensors("options")[0].tensor_proto.string_val[0].decode()

    expected = {name: [(0, value)] for name, value in run["figures"].items()}
    expected |= {name: list(zip(curve["steps"], curve["values"])) for name, curve in run["curves"].items()}
    assert set(expected) == set(kept.data.metrics) == set(board.Tags()["scalars"])
    for name, points in expected.items():
        history = [(metric.step, metric.value) for metric in client.get_metric_history(kept.info.run_id, name)]
        assert sorted(history) == points, name
        scalars = [(scalar.step, scalar.value) for scalar in board.Scalars(name)]
        assert [step for step, _ in scalars] == [step for step, _ in points], name
        # An event holds single precision.
        for (_, seen), (_, exact) in zip(scalars, points):
            assert abs(seen - exact) <= 1e-6 * abs(exact), name
    print(f"{run['name']}: MLflow and TensorBoard have the {len(expected)} figures and curves of the record")
