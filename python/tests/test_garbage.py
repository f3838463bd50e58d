"""Every public function with garbage: an exception of Python, never a panic."""

import inspect
import itertools

import numpy as np
import pytest

import eupnea
from eupnea import _native, policies

GARBAGE = [
    None,
    "",
    "nonsense",
    b"\xff",
    -1,
    0,
    2**70,
    float("nan"),
    float("inf"),
    -1e38,
    True,
    [],
    [float("nan")],
    {},
    {"pip": "high"},
    np.zeros(0, np.float32),
    np.full((2, 3), np.nan, np.float32),
    np.zeros((2, 3), np.int64),
    np.zeros((2, 6), np.float32)[:, ::2],
    object(),
]

#: What garbage may cause. A panic is a BaseException of its own, and fails the test.
EXPECTED = (TypeError, ValueError, OSError, RuntimeError, ImportError)


def subjects(simulator):
    """Functions and methods of living objects."""
    bench, pid = eupnea.Bench(), eupnea.Controller.pid((3, 30))
    task = _native.Task()
    living = [
        bench,
        pid,
        eupnea.Family("adult"),
        eupnea.Simulator.load(simulator),
        eupnea.Ventilator(pid),
        _native.Environment(task, 1),
        _native.Batch(task, 1, 2, 1),
        _native.Observer(),
        eupnea.PressureControl(render_mode="rgb_array"),
        eupnea.vector("eupnea/OneLung-v0", 2),
    ]
    classes = [type(one) for one in living] + [_native.Task, eupnea.Recording, policies.Agent]
    # Commands that wait for a device or run for long are tested with wrong options only.
    calls = [eupnea.vector, eupnea.score, eupnea.judge, eupnea.fit, eupnea.export, policies.onnx]
    calls += [_native.call, _native.command_help, _native.command_options, _native.noise_seeds]
    for one in [*living, *classes]:
        # A closed environment would only say that it is closed.
        names = [name for name in dir(one) if name != "close" and (not name.startswith("_") or name == "__call__")]
        if isinstance(one, type):  # its other functions need an object
            names = [name for name in names if isinstance(inspect.getattr_static(one, name), staticmethod)]
        calls += [getattr(one, name) for name in names if callable(getattr(one, name, None))]
    return [*classes, *calls]


def arguments(function):
    """Garbage for the positional arguments that a function may have."""
    try:
        most = len(inspect.signature(function).parameters)
    except (TypeError, ValueError):
        most = 3
    for count in range(min(most, 5) + 1):
        if count <= 2:
            yield from itertools.product(GARBAGE, repeat=count)
        else:
            yield from ((one,) * count for one in GARBAGE)


def test_garbage_never_panics(simulator):
    calls = 0
    for function in subjects(simulator):
        if (getattr(function, "__module__", None) or "").startswith("gymnasium"):
            continue  # inherited, and not ours to mend
        for given in arguments(function):
            calls += 1
            try:
                function(*given)
            except EXPECTED:
                pass
            except BaseException as error:
                pytest.fail(f"{function}{given!r}: {error!r}")
    assert calls > 10_000


@pytest.mark.parametrize("options", [{"pip": float("nan")}, {"pip": -5}, {"noise": -1}, {"number": 2**40}, {"other": 1}])
def test_a_wrong_option_of_a_reset_is_a_value_error(options):
    with pytest.raises(ValueError):
        eupnea.PressureControl().reset(seed=1, options=options)


@pytest.mark.parametrize("settings", [{"peep": float("nan")}, {"rate": 0}, {"nothing": 1}, {"peep": 40}, {"pip": 20}])
def test_a_wrong_setting_is_a_value_error(settings):
    with pytest.raises(ValueError):
        eupnea.PressureControl(settings=settings)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        ({"hold": -1}, "-1 is out of range"),
        ({"hold": 0}, "hold is 0"),
        ({"breaths": 2**70}, "out of range"),
        ({"period_us": 0}, "period"),
        ({"period_us": 500}, "1000"),
        ({"period_us": 1500}, "1000"),
        ({"period_us": 51_000}, "50000"),
        ({"effort": float("nan")}, "weight"),
        ({"overshoot": -1.0}, "weight"),
        ({"gains": (3, 30)}, 'action="residual"'),
        ({"authority": 50.0}, 'action="residual"'),
        ({"action": "residual", "authority": 101.0}, "authority is 101"),
        ({"settings": {"pip": 20}}, "pips="),
        ({"observation": "nothing"}, "ours, authors or plain"),
        ({"lungs": "R20C20", "family": "adult"}, "choose one"),
        ({"lungs": "nothing"}, "nothing"),
    ],
)
@pytest.mark.parametrize("environment", [eupnea.PressureControl, eupnea.VectorPressureControl])
def test_a_wrong_value_of_an_option_is_a_value_error_that_names_it(environment, options, text):
    with pytest.raises(ValueError, match=text):
        environment(**options)


def test_an_unknown_option_is_named_beside_the_known_ones():
    with pytest.raises(TypeError, match="'holding' of the environment: choose from lungs, family"):
        eupnea.PressureControl(holding=3)
    with pytest.raises(TypeError, match="holding"):
        eupnea.vector("eupnea/OneLung-v0", 2, holding=3)


@pytest.mark.parametrize("numbers", [{"num_envs": -2}, {"num_envs": 0}, {"seed": -1}, {"threads": 0}, {"threads": 2**64}])
def test_a_number_out_of_range_is_a_value_error(numbers):
    with pytest.raises(ValueError):
        eupnea.VectorPressureControl(**{"num_envs": 2, **numbers})
    with pytest.raises(ValueError):
        eupnea.PressureControl().reset(seed=-1)
    with pytest.raises(ValueError):
        eupnea.Bench(seed=-1)
    with pytest.raises(ValueError):
        eupnea.Family("adult").draw(1, -1)
    with pytest.raises(ValueError):
        eupnea.Controller.pid((3, 30), period_us=0)


@pytest.mark.parametrize("action", [None, "0.5", 1j, [0.1, 0.2], np.array([None]), np.array(["0.5"]), [[1], [2, 3]], float("nan")])
def test_an_action_that_is_not_one_number_is_a_value_error_and_moves_nothing(action):
    environment, same = eupnea.PressureControl(), eupnea.PressureControl()
    environment.reset(seed=1), same.reset(seed=1)
    with pytest.raises(ValueError, match="action"):
        environment.step(action)
    np.testing.assert_array_equal(environment.step(0.1)[0], same.step(0.1)[0])
    batch = eupnea.vector("eupnea/OneLung-v0", 2)
    batch.reset()
    with pytest.raises(ValueError, match="action"):
        batch.step([action, 0.1])
