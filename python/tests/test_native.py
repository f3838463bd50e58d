"""The bench, the ventilator, controllers and simulators from Python."""

import json
import shutil
import struct
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import eupnea


def test_a_wheel_of_another_machine_says_what_to_do(tmp_path):
    shutil.copytree(Path(eupnea.__file__).parent, tmp_path / "eupnea", ignore=shutil.ignore_patterns("_native*", "__pycache__"))
    (tmp_path / "eupnea" / "_native.abi3.so").write_bytes(b"code of another machine")
    result = subprocess.run([sys.executable, "-c", "import eupnea"], cwd=tmp_path, capture_output=True, text=True)
    assert result.returncode != 0
    assert all(word in result.stderr for word in ("ImportError", "glibc 2.28", "static", "pip install ./python")), result.stderr


def test_a_bench_with_the_same_seed_gives_the_same_readings():
    one, other = eupnea.Bench("R5C50", seed=4), eupnea.Bench("R5C50", seed=4)
    readings = one.run(np.full(300, 30, np.float32), False)
    assert [other.step(30, False) for _ in range(300)] == list(readings)
    truth = one.truth()
    assert truth["airway_pressure"] > 7 and truth["flow_lung"] > 0
    one.reset(5)
    assert not np.array_equal(one.run(np.full(300, 30, np.float32), False), readings)
    assert eupnea.Bench.from_toml(one.to_toml()).to_toml() == one.to_toml()
    assert eupnea.Bench.preset("paper")[0].name == "R5C10"


def test_a_family_draws_the_same_plants_for_a_seed():
    family = eupnea.Family("adult")
    assert family.draw(1, 2).to_toml() == family.draw(1, 2).to_toml() != family.draw(1, 3).to_toml()
    assert family.pid is not None


@pytest.mark.parametrize("monitors", [True, False])
def test_the_ventilator_holds_the_pressure_of_a_bench(monitors):
    ventilator = eupnea.Ventilator(eupnea.Controller.load("adult"), monitors=monitors, pip=25, peep=5)
    bench = eupnea.Bench("R20C20", seed=1)
    pressure = 5.0
    plateau, alarms = [], []
    for _ in range(9000):
        u_in, u_out, _, tick, phase, target, _, alarm = ventilator.step(pressure, bench.outlet_reading(), bench.flow_reading())
        pressure = bench.step(u_in, u_out)
        if phase == "inspiration" and tick > 700:
            plateau.append(pressure - target)
        alarms.append(alarm)
    assert abs(np.mean(plateau)) < 0.3 and set(alarms) == {None} and ventilator.mode == "ventilating"
    assert ventilator.settings["pip"] == 25
    ventilator.stop()
    assert ventilator.mode == "standby" and ventilator.step(pressure)[0] == 0


def test_settings_that_wait_for_their_breath_are_changed_one_after_the_other():
    ventilator = eupnea.Ventilator(eupnea.Controller.pid((3, 30)), pip=20, peep=5)
    for _ in range(10):
        ventilator.step(5.0)
    ventilator.apply(pip=25)
    ventilator.apply(peep=8)
    for _ in range(3000):
        ventilator.step(8.0)
    assert (ventilator.settings["pip"], ventilator.settings["peep"]) == (25, 8)


def test_monitors_find_a_sensor_that_gives_no_number():
    ventilator = eupnea.Ventilator(eupnea.Controller.pid((3, 30)), pip=20)
    alarms = {ventilator.step(float("nan"))[-1] for _ in range(300)}
    assert "ReadingNotANumber" in alarms


def test_a_controller_computes_what_it_computed_before_a_reset():
    controller = eupnea.Controller.load("adult")
    pressures = np.linspace(5, 20, 200, dtype=np.float32)
    targets = np.full(200, 20, np.float32)
    controller.start_breath()
    first = controller(pressures, targets)
    controller.reset()
    controller.start_breath()
    np.testing.assert_array_equal(controller(pressures, targets), first)
    assert (first >= 0).all() and (first <= 100).all() and controller.period_us == 1000


def test_a_gradient_agrees_with_finite_differences(simulator):
    learned = eupnea.Simulator.load(simulator)
    assert learned.period_us == 1000 and learned.plant == "R20C20" and learned.architecture == "state_space"
    rng = np.random.default_rng(1)
    commands = rng.uniform(10, 30, (3, 200)).astype(np.float32)
    weights = rng.normal(size=(3, 200)).astype(np.float32)
    loss = lambda u: float((learned.roll_out(u).astype(np.float64) * weights).sum())  # noqa: E731
    gradient = learned.gradient(commands, weights)
    assert gradient.shape == commands.shape
    direction = rng.normal(size=commands.shape).astype(np.float32)
    step = 0.05
    difference = (loss(commands + step * direction) - loss(commands - step * direction)) / (2 * step)
    assert difference == pytest.approx(float((gradient * direction).sum()), rel=0.02)


def test_a_simulator_predicts_each_breath_of_a_batch_alone(simulator):
    learned = eupnea.Simulator.load(simulator)
    commands = np.random.default_rng(2).uniform(0, 40, (19, 300)).astype(np.float32)
    together = learned.roll_out(commands)
    for row in (0, 15, 16, 18):
        np.testing.assert_array_equal(learned.roll_out(commands[row : row + 1])[0], together[row])


TIMING = {"period_us": 1000, "block_ticks": 10, "parts": 2, "points": 2, "channels": 1}


def write_simulator(path, shape, parameters):
    """Write the file of a simulator with random parameters."""
    about = json.dumps({**shape, "noise": 0.1, "start_pressure": 5.0, "plant": "random"})
    content = np.random.default_rng(1).normal(0.0, 0.1, parameters).astype("<f4").tobytes()
    tensor = {"dtype": "F32", "shape": [parameters], "data_offsets": [0, len(content)]}
    head = json.dumps({"__metadata__": {"eupnea-simulator": about}, "parameters": tensor}).encode()
    path.write_bytes(struct.pack("<Q", len(head)) + head + content)


@pytest.mark.parametrize(
    "damage",
    [{"block_ticks": 0}, {"parts": 0}, {"parts": 11}, {"points": 3}, {"channels": 0}, {"period_us": 0}],
)
def test_a_file_with_an_impossible_shape_is_a_value_error(folder, damage):
    path = folder / "damaged.safetensors"
    shape = {"architecture": "state_space", "timing": {**TIMING, **damage}, "states": 4, "hidden": 6, "history": 4}
    write_simulator(path, shape, 1)
    with pytest.raises(ValueError, match=next(iter(damage))):
        eupnea.Simulator.load(path)
    with pytest.raises((RuntimeError, ValueError)):
        eupnea.export(path, out=folder / "damaged.onnx")


#: Number of parameters of the hybrid below.
HYBRID_PARAMETERS = 2454


@pytest.fixture(scope="session")
def hybrid(folder):
    """A simulator of a ventilator with any lung, with random parameters, and its exported network."""
    path, network = folder / "hybrid.safetensors", folder / "hybrid.onnx"
    shape = {"architecture": "hybrid", "timing": TIMING, "states": 4, "hidden": 6, "history": 4}
    write_simulator(path, shape, HYBRID_PARAMETERS)
    eupnea.export(path, out=network)
    return path, network


@pytest.mark.parametrize(
    "changed",
    [{}, {"rest": 12.0}, {"plateau_command": 60.0}, {"pip": 35.0}, {"start_pressure": 8.0}, {"resistance": 50.0}, {"compliance": 50.0}],
)
def test_the_state_before_a_breath_counts_as_in_the_exported_network(hybrid, changed):
    onnxruntime = pytest.importorskip("onnxruntime")
    learned = eupnea.Simulator.load(hybrid[0])
    state = {
        "start_pressure": 5.5,
        "pip": 20.0,
        "rest": 5.0,
        "plateau_command": 25.0,
        "resistance": 20.0,
        "compliance": 20.0,
        **changed,
    }
    commands = (40.0 + 30.0 * np.sin(np.arange(300, dtype=np.float32) / 40.0))[None]
    ours = learned.roll_out(commands, **state)[0]
    session = onnxruntime.InferenceSession(str(hybrid[1]), providers=["CPUExecutionProvider"])
    theirs = network_pressures(session, commands[0], [state["start_pressure"], 5.0, *list(state.values())[1:]])
    assert np.abs(ours[1:] - theirs[:-1]).max() < 1e-3
    # Each part of the state has an effect, so that none was left out on both sides.
    usual = learned.roll_out(commands, **{**state, **dict.fromkeys(changed)})[0]
    assert not changed or np.abs(ours - usual).max() > 1e-3


def network_pressures(session, commands, start):
    """Run an exported simulator block by block; returns the pressure after each tick."""
    shapes = {one.name: [1, one.shape[1]] for one in session.get_inputs()}
    state, ticks = np.zeros(shapes["state"], np.float32), shapes["commands"][1]
    pressures = []
    for number, block in enumerate(commands.reshape(-1, 1, ticks)):
        given = {"commands": block, "block": np.float32([[number]]), "start": np.float32([start]), "state": state}
        after, state = session.run(["pressures", "next_state"], given)
        pressures.extend(after[0])
    return np.array(pressures)


@pytest.mark.parametrize("start", [{"rest": float("nan")}, {"pip": float("inf")}])
def test_a_start_that_is_not_finite_is_refused(simulator, start):
    with pytest.raises(ValueError, match="finite"):
        eupnea.Simulator.load(simulator).roll_out(np.ones((1, 10), np.float32), **start)


def test_commands_in_another_memory_order_are_refused_and_not_transposed(simulator):
    learned = eupnea.Simulator.load(simulator)
    with pytest.raises(ValueError, match="ascontiguousarray"):
        learned.roll_out(np.asfortranarray(np.ones((3, 200), np.float32)))
