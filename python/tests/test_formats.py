"""Files for other programs, opened by those programs' own readers."""

import json

import numpy as np
import pytest

import eupnea


def test_mcap_has_every_sample(recording, tmp_path):
    reader = pytest.importorskip("mcap.reader")
    path = tmp_path / "recording.mcap"
    eupnea.export(recording.path, path)
    with path.open("rb") as file:
        messages = [json.loads(m.data) for _, c, m in reader.make_reader(file).iter_messages() if c.topic == "/pressure"]
    measured = np.array([message["measured"] for message in messages], np.float32)
    np.testing.assert_array_equal(measured, recording["pressure"])


def test_an_onnx_policy_is_judged_like_the_function_that_it_is(tmp_path):
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    weights = np.array([-2, 2, 0, 0, 0, 0], np.float32).reshape(6, 1)
    make = onnx.helper
    graph = make.make_graph(
        [make.make_node("Gemm", ["seen", "w", "b"], ["sum"]), make.make_node("Clip", ["sum", "low", "high"], ["command"])],
        "policy",
        [make.make_tensor_value_info("seen", onnx.TensorProto.FLOAT, [1, 6])],
        [make.make_tensor_value_info("command", onnx.TensorProto.FLOAT, [1, 1])],
        [
            onnx.numpy_helper.from_array(array, name)
            for name, array in [
                ("w", weights),
                ("b", np.array([12], np.float32)),
                ("low", np.float32(0)),
                ("high", np.float32(100)),
            ]
        ],
    )
    path = tmp_path / "policy.onnx"
    model = make.make_model(graph, opset_imports=[make.make_opsetid("", 17)])
    model.ir_version = 8
    onnx.save(model, path)
    short = {"pips": [20], "breaths": 1, "seed": 1}
    judged = eupnea.evaluate(policy=eupnea.policies.onnx(path), **short)

    def same(seen):
        return float(np.clip(np.float32(12) + seen @ weights[:, 0], 0, 100))

    expected = eupnea.evaluate(policy=same, **short)
    found, wanted = (result["mean"]["learned"]["score"] for result in (judged, expected))
    assert found == pytest.approx(wanted, rel=1e-4)


def test_a_controller_of_onnx_computes_the_commands_of_the_chip(tmp_path):
    onnxruntime = pytest.importorskip("onnxruntime")
    path = tmp_path / "adult.onnx"
    assert eupnea.export("adult", path)["kind"] == "controller"
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    assert {"command"} <= {output.name for output in session.get_outputs()}
