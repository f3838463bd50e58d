"""The bench, the ventilator, controllers and simulators from Python."""

import numpy as np
import pytest

import eupnea


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


def test_commands_in_another_memory_order_are_refused_and_not_transposed(simulator):
    learned = eupnea.Simulator.load(simulator)
    with pytest.raises(ValueError, match="ascontiguousarray"):
        learned.roll_out(np.asfortranarray(np.ones((3, 200), np.float32)))
