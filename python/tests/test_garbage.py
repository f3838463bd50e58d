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
EXPECTED = (TypeError, ValueError, OSError, RuntimeError, OverflowError, KeyError, ImportError, AttributeError)


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
        if getattr(function, "__name__", "") in ("step_async", "step_wait", "has_wrapper_attr"):
            continue
        for given in arguments(function):
            calls += 1
            try:
                function(*given)
            except EXPECTED:
                pass
            except BaseException as error:
                pytest.fail(f"{function}{given!r}: {error!r}")
    assert calls > 10_000


@pytest.mark.parametrize("options", [{"pip": float("nan")}, {"pip": -5}, {"noise": -1}, {"number": 2**40}, {"number": "x"}])
def test_garbage_in_a_reset_is_refused(options):
    with pytest.raises(EXPECTED):
        eupnea.PressureControl().reset(seed=1, options=options)


@pytest.mark.parametrize("settings", [{"peep": float("nan")}, {"rate": 0}, {"nothing": 1}, {"peep": 40}])
def test_garbage_in_settings_is_refused(settings):
    with pytest.raises((TypeError, ValueError)):
        eupnea.PressureControl(settings=settings)
