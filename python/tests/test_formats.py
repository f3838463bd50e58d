"""Files for other programs, opened by those programs' own readers."""

import json

import numpy as np
import pytest

import eupnea
from eupnea.policies import Lesson
from eupnea.policies import onnx as onnx_policy


def test_mcap_has_every_sample(recording, tmp_path):
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "recording.mcap"
    eupnea.export(recording, path)
    with path.open("rb") as file:
        messages = [json.loads(m.data) for _, c, m in reader.make_reader(file).iter_messages() if c.topic == "/pressure"]
    measured = np.array([message["measured"] for message in messages], np.float32)
    np.testing.assert_array_equal(measured, recording["pressure"])


def saved(path, nodes, inputs, outputs, constants=(), metadata=()):
    """Write an ONNX graph; inputs and outputs are pairs of name and shape, or also have a type."""
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    make = onnx.helper

    def described(values):
        return [make.make_tensor_value_info(name, *(kind or [onnx.TensorProto.FLOAT]), shape) for name, shape, *kind in values]

    graph = make.make_graph(
        [make.make_node(*node) for node in nodes],
        "policy",
        described(inputs),
        described(outputs),
        [onnx.numpy_helper.from_array(np.asarray(value), name) for name, value in constants],
    )
    model = make.make_model(graph, opset_imports=[make.make_opsetid("", 17)])
    model.ir_version = 8
    make.set_model_props(model, dict(metadata))
    onnx.save(model, path)
    return path


WEIGHTS = np.array([-2, 2, 0, 0, 0, 0], np.float32)
CLIPPED = [
    ("w", WEIGHTS.reshape(6, 1)),
    ("b", np.array([12], np.float32)),
    ("low", np.float32(0)),
    ("high", np.float32(100)),
]


def test_an_onnx_policy_is_judged_like_the_function_that_it_is(tmp_path):
    nodes = [("Gemm", ["seen", "w", "b"], ["sum"]), ("Clip", ["sum", "low", "high"], ["command"])]
    path = saved(tmp_path / "policy.onnx", nodes, [("seen", [1, 6])], [("command", [1, 1])], CLIPPED)
    short = {"pips": [20], "breaths": 1, "seed": 1}
    judged = eupnea.evaluate(policy=onnx_policy(path), **short)

    def same(seen):
        return float(np.clip(np.float32(12) + seen @ WEIGHTS, 0, 100))

    expected = eupnea.evaluate(policy=same, **short)
    found, wanted = (result["mean"]["learned"]["score"] for result in (judged, expected))
    assert found == pytest.approx(wanted, rel=1e-4)


def test_an_onnx_state_goes_on_until_the_reset(tmp_path):
    nodes = [("Add", ["state", "one"], ["next"]), ("Identity", ["next"], ["command"])]
    path = saved(
        tmp_path / "counter.onnx",
        nodes,
        [("seen", ["batch", 6]), ("state", ["batch", 1])],
        [("command", ["batch", 1]), ("next", ["batch", 1])],
        [("one", np.ones((1, 1), np.float32))],
        [("period_us", "2000")],
    )
    policy, seen = onnx_policy(path), np.zeros(6, np.float32)
    assert [policy(seen) for _ in range(102)] == [*range(1, 101), 100, 100]
    # With six inputs, it does not run for a lesson.
    policy.reset()
    policy.learn(0, 40.0)
    assert policy(seen) == 1.0
    assert policy.period_us == 2000


@pytest.mark.parametrize(
    ("inputs", "outputs", "metadata", "reason"),
    [
        ([("x", [1, 5])], [("x", "y", [1, 5])], {}, "must be \\(1, 6\\), or \\(1, 7\\)"),
        ([("x", [6])], [("x", "y", [6])], {}, "must be \\(1, 6\\)"),
        ([("x", [4, 6])], [("one", "y", [1, 1])], {}, "must be \\(1, 6\\)"),
        ([("x", ["batch", "columns"])], [("one", "y", [1, 1])], {}, "must be \\(1, 6\\)"),
        ([], [("one", "y", [1, 1])], {}, "first input is missing"),
        ([("x", [1, 6])], [("x", "y", [1, 6])], {}, "must have one element"),
        ([("x", [1, 7]), ("s", [1, 2])], [("one", "y", [1, 1])], {}, "2 inputs but 1 outputs"),
        ([("x", [1, 7]), ("s", [1, 2])], [("one", "y", [1, 1]), ("one", "z", [1, 1])], {}, "they must be the same"),
        ([("x", [1, 6], 11)], [("one", "y", [1, 1])], {}, "not a policy.*double"),
        ([("x", [1, 6])], [("one", "y", [1, 1])], {"period_us": "fast"}, "whole number of microseconds"),
    ],
)
def test_an_onnx_graph_that_is_not_a_policy_is_refused_with_the_reason(tmp_path, inputs, outputs, metadata, reason):
    nodes = [("Identity", [source], [name]) for source, name, _ in outputs]
    named = [(name, shape) for _, name, shape in outputs]
    path = saved(tmp_path / "wrong.onnx", nodes, inputs, named, [("one", np.ones((1, 1), np.float32))], metadata)
    with pytest.raises(ValueError, match=reason):
        onnx_policy(path)


@pytest.fixture(scope="module")
def adult(tmp_path_factory):
    """The shipped controller as an ONNX file."""
    pytest.importorskip("onnxruntime")
    path = tmp_path_factory.mktemp("onnx") / "adult.onnx"
    assert eupnea.export("adult", path)["kind"] == "controller"
    return path


def breath(command, bench, last, ticks=200, pip=25.0, peep=5.0):
    """Run an inspiration whose applied commands differ from the computed ones; returns the last applied one."""
    pressure = peep
    for tick in range(ticks):
        seen = np.array([pressure, pip, pip, peep, last, tick * 1e-3], np.float32)
        last = float(np.float32(np.clip(command(seen) + 3 * np.sin(0.1 * tick), 0, 100)))
        pressure = bench.step(last, False)
    return last


def test_an_exported_controller_has_the_commands_of_the_controller(adult):
    graph, controller = onnx_policy(adult), eupnea.policies.Known(eupnea.Controller.load("adult"))
    assert graph.period_us == controller.period_us == 1000

    def both(seen):
        commands.append((graph(seen), controller(seen)))
        return commands[-1][1]

    lessons = [Lesson.ADOPT, Lesson.DISCARD, Lesson.ADOPT, Lesson.FORGET, Lesson.ADOPT]
    breaths = []
    for _ in range(2):
        for policy in (graph, controller):
            policy.reset()
        last = 5.0
        for number, lesson in enumerate(lessons):
            commands = []
            for policy in (graph, controller):
                policy.start(0.05 * number)
            last = breath(both, eupnea.Bench("R20C20", seed=number), last)
            breaths.append(np.array(commands))
            for policy in (graph, controller):
                policy.learn(lesson, last)
    found, wanted = np.array(breaths)[..., 0], np.array(breaths)[..., 1]
    assert found.shape == (2 * len(lessons), 200) and np.ptp(wanted) > 10
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-4)
    # After a reset, all is as it was.
    np.testing.assert_array_equal(found[: len(lessons)], found[len(lessons) :])


def test_an_exported_controller_is_judged_like_the_controller(adult):
    gains = eupnea.Controller.load("adult").gains
    # The PID under a policy does not know where its command reaches the fully open valve: here it never does.
    options = {"settings": {"rise_time": 0.3}, "pips": [15], "breaths": 2, "breaths_of_learning": 2, "seed": 1}
    judged = eupnea.evaluate(policy=onnx_policy(adult), gains=gains, **options)
    alone = eupnea.evaluate("adult", **options)
    assert judged["mean"]["learned"]["score"] == pytest.approx(alone["mean"]["learned"]["score"], rel=1e-4)
    assert judged["policy"]["pid"] == 0
    with pytest.raises((RuntimeError, ValueError), match="1000 us, not 2000"):
        eupnea.evaluate(policy=onnx_policy(adult), period_us=2000)
