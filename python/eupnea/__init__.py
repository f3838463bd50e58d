"""Learned pressure control for mechanical ventilation.

The package contains the virtual bench, the ventilator that runs on the chip, learned simulators and controllers, the commands of
the `trainer`, and environments for Gymnasium. All of it is the code of the command line: the same seed gives the same bits.

Pressures are in cmH2O, flows in L/s, resistances in cmH2O/(L/s), compliances in mL/cmH2O, commands in percent of the valve.

Research software: never connect it to a patient.
"""

from __future__ import annotations

from importlib.metadata import version

try:
    from eupnea import _native as _native
except ImportError as error:
    raise ImportError(
        f"{error}: a wheel needs the processor in its name, and glibc 2.28 or newer. On other machines use the static "
        "programs of the release, or build the package there, with Rust: pip install ./python"
    ) from error

from eupnea import policies
from eupnea._native import Bench, Controller, Family, Simulator, Ventilator
from eupnea.commands import (
    bound,
    collect,
    evaluate,
    export,
    fit,
    judge,
    robust,
    test_table,
    train,
    tune_pid,
)
from eupnea.environments import PressureControl, VectorPressureControl, register, score, vector
from eupnea.recordings import Recording
from eupnea.reference import normalized_score

__version__ = version("eupnea")

__all__ = [
    "Bench",
    "Controller",
    "Family",
    "PressureControl",
    "Recording",
    "Simulator",
    "VectorPressureControl",
    "Ventilator",
    "bound",
    "collect",
    "evaluate",
    "export",
    "fit",
    "judge",
    "normalized_score",
    "policies",
    "register",
    "robust",
    "score",
    "test_table",
    "train",
    "tune_pid",
    "vector",
]

register()
