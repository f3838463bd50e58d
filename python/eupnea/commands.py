"""The commands of `trainer` and `lab`: the same options, the same defaults and, for the same seed, the same bits.

Every function takes the options of its command as keywords, with underscores in place of dashes: `breaths_of_learning=20` is
`--breaths-of-learning 20`; `help(eupnea.evaluate)` lists them. It returns what `--json` writes, as a dictionary. Ctrl-C stops a
command, which keeps its results so far as on the command line, and raises `KeyboardInterrupt`. Commands can run at the same time, each
in a thread of its own; an exception of its function for the progress stops one of them.

All functions raise `ValueError` for wrong options, `OSError` for files that cannot be read or written, and `RuntimeError` if the
command fails otherwise.
"""

from __future__ import annotations

import json
import os
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from eupnea import _native
from eupnea._native import Bench
from eupnea.policies import Policy, served
from eupnea.recordings import Recording

#: Called with the stage of the work, the number of steps done, and their total.
Progress = Callable[[str, int, int], None]
PathLike = str | os.PathLike[str]
Result = dict[str, Any]


def run(command: str, *files: PathLike, progress: Progress | bool = True, **options: Any) -> Result:
    """Run any command of `lab` or `trainer` that writes JSON.

    Args:
        command: Name of the command, such as `"margins"`.
        files: Arguments without a name.
        progress: Whether to show the progress on standard error if that is a terminal, or a function to call with it.
        options: Options of the command. `True` sets a flag; `None` and `False` leave an option out; a `Bench` stands for its
            description; a mapping is names with values, as in `settings={"peep": 8, "rate": 15}`; a sequence is a list of values,
            or the gains of a PID.

    Returns:
        The content of `--json`.
    """
    known = {name.replace("-", "_"): repeated for name, repeated in _native.command_options(command).items()}
    unknown = sorted(options.keys() - known.keys())
    if unknown:
        raise ValueError(f"{command} has no option {unknown[0]!r}: choose from {', '.join(sorted(known))}")
    with tempfile.TemporaryDirectory() as folder:
        named = _arguments(options, known, Path(folder))
        arguments = [command, *named, "--", *(os.fspath(file) for file in files)]
        observer = Line() if progress is True and sys.stderr.isatty() else progress
        text = _native.call(arguments, observer if callable(observer) else None)
    result: Result = json.loads(text)
    return result


def _arguments(options: dict[str, Any], repeated: dict[str, bool], folder: Path) -> Iterator[str]:
    for name, value in options.items():
        flag = "--" + name.replace("_", "-")
        if value is None or (isinstance(value, (bool, np.bool_)) and not value):
            continue
        if isinstance(value, (bool, np.bool_)):
            yield flag
        elif isinstance(value, Bench):
            description = folder / f"{name}.toml"
            description.write_text(value.to_toml(), encoding="utf-8")
            yield f"{flag}={description}"
        elif isinstance(value, Mapping):
            yield f"{flag}={','.join(f'{key}={each}' for key, each in value.items())}"
        elif isinstance(value, Iterable) and not isinstance(value, (str, bytes, os.PathLike)):
            words = [os.fspath(word) if isinstance(word, os.PathLike) else str(word) for word in value]
            yield from (f"{flag}={word}" for word in (words if repeated[name] else [",".join(words)]))
        else:
            yield f"{flag}={os.fspath(value) if isinstance(value, os.PathLike) else value}"


class Line:
    """Shows the progress on one line of standard error."""

    def __call__(self, stage: str, done: int, total: int) -> None:
        """Show the stage, the number of steps done, and their total."""
        print(f"\r{stage} {done}/{total}\x1b[K", end="\n" if done >= total else "", file=sys.stderr, flush=True)


def collect(*, out: PathLike | None = None, **options: Any) -> Recording:
    """Record breaths under a PID or another controller, with random perturbations.

    Args:
        out: File to write; without one, the recording is in memory only.
        options: Those of `trainer collect`, such as `bench="R20C20"`, `breaths=200`, `gains=(3, 30)`, `seed=1`.

    Returns:
        The recording.
    """
    with _place(out, "recording.parquet") as path:
        run("collect", out=path, **options)
        return Recording(path)


def fit(data: PathLike | Recording | Sequence[PathLike | Recording], **options: Any) -> Result:
    """Learn a differentiable simulator from recordings.

    Args:
        data: Recordings of one ventilator, or their files.
        options: Those of `trainer fit`, such as `out="simulator.safetensors"`, `epochs=200`, `seed=1`.

    Returns:
        Errors on held-out breaths, in cmH2O: `open_loop`, `one_step` and more.
    """
    several = [data] if isinstance(data, (str, os.PathLike, Recording)) else list(data)
    with _files(several) as files:
        return run("fit", *files, **options)


def train(out: PathLike, **options: Any) -> Result:
    """Train a residual through learned simulators.

    Args:
        out: Folder for the controller (`controller.safetensors`) and for the state from which training continues after Ctrl-C.
        options: Those of `trainer train`, such as `bench="R20C20"`, `gains=(6.5, 265, 0.13)`, `simulator=["a.safetensors"]`.

    Returns:
        Scores on the held-out simulator, and the path of the controller.
    """
    return run("train", out=out, **options)


def evaluate(controller: PathLike | None = None, *, policy: Policy | str | None = None, **options: Any) -> Result:
    """Score a controller, and compare a learned one with its PID, under the same sensor noise.

    Args:
        controller: A shipped controller such as `"adult"`, a file of `train`, or a rival; default: the PID with `gains`.
        policy: Your own controller, which runs behind the safety envelope: a function of six numbers (`eupnea.policies`), or the
            address of a policy on the policy link (`tcp:HOST:PORT` or `pipe:COMMAND`).
        options: Those of `trainer evaluate`, such as `bench="R20C20"` (a name or a `Bench`), `gains=(3, 30)`, `seed=1`.

    Returns:
        Scores by waveform and their mean, in cmH2O.
    """
    with served(policy) as address:
        return run("evaluate", controller=controller, policy=address, **options)


def robust(controller: PathLike | None = None, *, policy: Policy | str | None = None, **options: Any) -> Result:
    """Run a controller on many random plants of a family, beside the best PID of that family.

    Args:
        controller: As in `evaluate`.
        policy: As in `evaluate`.
        options: Those of `lab robust`, such as `family="adult"`, `plants=1000`, `subset=0`, `seed=1`.

    Returns:
        Distribution of the scores over the plants, in cmH2O.
    """
    with served(policy) as address:
        return run("robust", controller=controller, policy=address, **options)


def bound(**options: Any) -> Result:
    """Compute a reference bound: the error of commands optimised on a fully known lung.

    Args:
        options: Those of `lab bound`, such as `bench="R20C20"`, `pips=(15, 35)`, `effort=2`.

    Returns:
        Scores by lung and waveform, in cmH2O.
    """
    return run("bound", **options)


def judge(*files: PathLike | Recording, **options: Any) -> Result:
    """Judge recordings of any ventilator, breath by breath, against declared limits.

    Args:
        files: Recordings or their files.
        options: Those of `trainer judge`, such as `accuracy="2,4"`, `overshoot=5`.

    Returns:
        Figures of every breath, and whether all keep the limits (`pass`).
    """
    with _files(files) as paths:
        return run("judge", *paths, **options)


def tune_pid(**options: Any) -> Result:
    """Search for the best P, I, PI and PID controllers.

    Args:
        options: Those of `trainer tune-pid`, such as `bench="R20C20"`, `grid="coarse"`.

    Returns:
        Gains and scores, in cmH2O.
    """
    return run("tune-pid", **options)


def test_table(**options: Any) -> Result:
    """Run the 21 pressure-control rows of ISO 80601-2-12.

    Args:
        options: Those of `lab test-table`, such as `seed=1`.

    Returns:
        Scores by row, in cmH2O.
    """
    return run("test-table", **options)


def export(file: PathLike | Recording, out: PathLike, **options: Any) -> Result:
    """Convert a recording, a controller or a simulator for other programs.

    Args:
        file: A recording or its file, a shipped controller such as `"adult"`, or the file of a controller or simulator.
        out: File to write; its extension selects the format, such as `.mcap` or `.onnx`.
        options: Those of `trainer export`.

    Returns:
        A summary of the written file, such as its number of rows, or its kind and size.
    """
    with _files([file]) as paths:
        return run("export", *paths, out=out, **options)


@contextmanager
def _files(several: Iterable[PathLike | Recording]) -> Iterator[list[Path]]:
    """Give every recording a file for as long as the context lasts."""
    with tempfile.TemporaryDirectory() as folder:
        yield [
            one.file(Path(folder) / f"{number}.parquet") if isinstance(one, Recording) else Path(one)
            for number, one in enumerate(several)
        ]


@contextmanager
def _place(out: PathLike | None, name: str) -> Iterator[Path]:
    if out is not None:
        yield Path(out)
        return
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder) / name


def _document() -> None:
    """Append the help of the command line to the documentation."""
    for function in (collect, fit, train, evaluate, robust, bound, judge, tune_pid, test_table, export):
        command = function.__name__.replace("_", "-")
        function.__doc__ = f"{function.__doc__}\n\nHelp of `{command}` on the command line:\n\n{_native.command_help(command)}"


_document()
