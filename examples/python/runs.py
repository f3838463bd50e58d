"""Opens what `trainer runs` has exported with MLflow and TensorBoard, and compares it with the records.

  trainer runs out --mlflow mlruns --tensorboard events --json runs.json
  python3 runs.py runs.json mlruns events
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
exported = {
    (run.info.run_name, name): run
    for name, number in experiments.items()
    for run in client.search_runs([number])
}
assert len(exported) == len(runs), f"MLflow finds {len(exported)} runs in place of {len(runs)}"

for run in runs:
    kept = exported[run["name"], "eupnea " + run["command"][0]]
    assert kept.info.status == STATUS[run["state"]], kept.info.status
    assert kept.info.start_time == 1000 * run["began_s"]
    assert kept.data.params == run["options"]
    assert "record.json" in [artifact.path for artifact in client.list_artifacts(kept.info.run_id)]

    board = EventAccumulator(os.path.join(events, run["name"]))
    board.Reload()
    assert run["command"][0] in board.Tensors("options")[0].tensor_proto.string_val[0].decode()

    wanted = {name: [(0, value)] for name, value in run["figures"].items()}
    wanted |= {name: list(zip(curve["steps"], curve["values"])) for name, curve in run["curves"].items()}
    assert set(wanted) == set(kept.data.metrics) == set(board.Tags()["scalars"])
    for name, points in wanted.items():
        history = [(metric.step, metric.value) for metric in client.get_metric_history(kept.info.run_id, name)]
        assert sorted(history) == points, name
        scalars = [(scalar.step, scalar.value) for scalar in board.Scalars(name)]
        assert [step for step, _ in scalars] == [step for step, _ in points], name
        # An event holds single precision.
        for (_, seen), (_, exact) in zip(scalars, points):
            assert abs(seen - exact) <= 1e-6 * abs(exact), name
    print(f"{run['name']}: MLflow and TensorBoard have the {len(wanted)} figures and curves of the record")
