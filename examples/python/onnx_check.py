"""Checks ONNX files of `trainer export` with onnxruntime against what the trainer computes (docs/FILES.md); needs onnx and onnxruntime.

    trainer export adult --out adult.onnx --check adult.json
    python3 onnx_check.py adult.onnx adult.json"""
import json, sys

import numpy, onnx, onnxruntime

FULL_SCALE = 100.0  # percent of a command, cmH2O of a pressure
TOLERANCE = 1e-6 * FULL_SCALE
ROWS = 3  # side by side: all rows must agree


class Stepper:
    """A graph with its state, run step by step."""

    def __init__(self, model):
        self.session = onnxruntime.InferenceSession(model.SerializeToString(), providers=["CPUExecutionProvider"])
        self.outputs = [output.name for output in self.session.get_outputs()]
        state = next(given for given in self.session.get_inputs() if given.name == "state")
        self.state = numpy.zeros((ROWS, state.shape[1]), numpy.float32)

    def step(self, **inputs):
        rows = {name: numpy.tile(numpy.float32(values), (ROWS, 1)) for name, values in inputs.items()}
        results = dict(zip(self.outputs, self.session.run(None, {**rows, "state": self.state})))
        self.state = results.pop("next_state")
        assert all((values == values[0]).all() for values in results.values()), "rows with equal inputs differ"
        return {name: values[0] for name, values in results.items()}


def controller_error(model, steps):
    """Largest difference of a command, percent; both in closed loop, so the state's error counts."""
    stepper, worst = Stepper(model), 0.0
    for step in steps:
        found = stepper.step(observation=step["observation"])
        if step["commands"]:
            pair = [found["command"][0], found["base"][0]]
            worst = max(worst, numpy.abs(numpy.subtract(pair, step["commands"])).max())
    return worst


def simulator_error(model, breath):
    """Largest difference of a pressure, cmH2O."""
    stepper, worst, ticks = Stepper(model), 0.0, breath["block_ticks"]
    for block in range(len(breath["commands"]) // ticks):
        part = slice(block * ticks, (block + 1) * ticks)
        found = stepper.step(commands=breath["commands"][part], start=breath["start"], block=[block])
        worst = max(worst, numpy.abs(found["pressures"] - breath["pressures"][part]).max())
    return worst


def changed(model, number):
    """The model with its largest weight in one of its constants 1 % larger."""
    copy = onnx.ModelProto.FromString(model.SerializeToString())
    weights = copy.graph.initializer[number].float_data
    weights[numpy.abs(weights).argmax()] *= 1.01
    return copy


def notices(model, expected, error):
    """Whether a changed weight shows: in one of the five largest constants, since inputs of a few networks are zero."""
    size = {number: len(one.float_data) for number, one in enumerate(model.graph.initializer)}
    largest = sorted(size, key=size.get, reverse=True)[:5]
    return any(error(changed(model, number), expected) > TOLERANCE for number in largest)


for network, check in zip(sys.argv[1::2], sys.argv[2::2]):
    model, expected = onnx.load(network), json.load(open(check))
    onnx.checker.check_model(model, full_check=True)
    error = controller_error if isinstance(expected, list) else simulator_error
    worst = error(model, expected)
    print(f"{network}: {len(model.graph.node)} operators, largest difference {worst:.2e} of {FULL_SCALE:g}")
    assert worst <= TOLERANCE, f"{network} differs from the trainer's result by {worst}, more than {TOLERANCE}"
    assert notices(model, expected, error), f"{network}: a changed weight goes unnoticed"
