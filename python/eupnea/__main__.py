"""`python -m eupnea`: speed of the environments, data set for Minari, reference scores."""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from eupnea import reference
from eupnea.commands import Line, Progress
from eupnea.environments import PressureControl, VectorPressureControl

BATCHES = (1, 8, 64, 256, 1024)
#: Steps that are timed together, over all environments of a batch.
SLICE = 20_000
#: What the authors' network observes, an action every millisecond.
OPTIONS: dict[str, Any] = {"observation": "authors", "hold": 1}

BENCH = """examples:
  python -m eupnea bench
  python -m eupnea bench --threads 2 --repeats 20 --json speed.json

A step is 1 ms of the virtual bench under the ventilator of the chip, with the observation of the paper's
authors. The figures are medians over the repeats."""

MINARI = """examples:
  python -m eupnea minari
  python -m eupnea minari --out datasets --episodes 200 --seed 2

The data set is eupnea/adult-family/pid-exploration-v0; the same seed gives the same data. To load it:
  MINARI_DATASETS_PATH=datasets python -c "import minari; print(minari.load_dataset('eupnea/adult-family/pid-exploration-v0'))"
Ctrl-C saves nothing."""

REFERENCE = """examples:
  python -m eupnea reference
  python -m eupnea reference --json scores.json
  python -m eupnea reference --measure --bounds --json python/eupnea/reference_scores.json

Scores are mean absolute errors of the airway pressure over the episodes of eupnea.score, cmH2O."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m eupnea", description="Tools of the package eupnea.")
    commands = parser.add_subparsers(dest="command", required=True)
    bench = _command(commands, "bench", "measure steps per second by batch size", BENCH, _bench)
    bench.add_argument("--json", type=Path, metavar="FILE", help="write the results as JSON; '-' for standard output")
    bench.add_argument("--threads", type=_some, default=1, metavar="N", help="threads of a batch [default: 1]")
    bench.add_argument("--repeats", type=_some, default=9, metavar="N", help="measurements of each figure [default: 9]")
    data = _command(commands, "minari", "record a data set of breaths for Minari", MINARI, _minari)
    data.add_argument("--out", type=Path, metavar="FOLDER", help="folder for data sets [default: that of Minari]")
    data.add_argument("--episodes", type=_some, default=1000, metavar="N", help="episodes, of one breath each [default: 1000]")
    data.add_argument("--seed", type=int, default=1, metavar="N", help="seed of the episodes and perturbations [default: 1]")
    scores = _command(commands, "reference", "print the reference scores of the environments", REFERENCE, _reference)
    scores.add_argument("--json", type=Path, metavar="FILE", help="write the scores as JSON; '-' for standard output")
    scores.add_argument("--measure", action="store_true", help="measure them again, which takes minutes")
    scores.add_argument("--bounds", action="store_true", help="with --measure: the reference bounds too, which take an hour")
    given = parser.parse_args(arguments)
    try:
        given.run(given)
    except (OSError, ValueError, ImportError) as error:
        parser.exit(1, f"error: {error}\n")
    except KeyboardInterrupt:
        parser.exit(130, "\nstopped: nothing was saved\n")
    return 0


def _command(
    commands: Any, name: str, purpose: str, examples: str, run: Callable[[argparse.Namespace], None]
) -> argparse.ArgumentParser:
    parser: argparse.ArgumentParser = commands.add_parser(
        name, help=purpose, epilog=examples, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.set_defaults(run=run)
    return parser


def _some(text: str) -> int:
    """Return a whole number of at least 1."""
    number = int(text)
    if number < 1:
        raise argparse.ArgumentTypeError(f"{number} is too few: give at least 1")
    return number


def _bench(given: argparse.Namespace) -> None:
    results = speed(given.threads, given.repeats)
    lines = [f"batch {size:>5}: {rate / 1e6:6.2f} million steps/s" for size, rate in results["steps_per_second"].items()]
    _report(results, [*lines, f"single step from Python: {results['scalar_step_us']:.2f} us"], given.json)


def _minari(given: argparse.Namespace) -> None:
    from eupnea import minari

    data_set = minari.record(given.out, episodes=given.episodes, seed=given.seed, progress=_progress())
    size = data_set.storage.metadata["dataset_size"]
    print(f"{data_set.id}: {data_set.total_episodes} episodes, {data_set.total_steps} steps, {size} MB in {data_set.storage.data_path}")


def _reference(given: argparse.Namespace) -> None:
    scores = _measured(given.bounds) if given.measure else reference.SCORES
    _report(scores, [reference.table(scores)], given.json)


def _measured(bounds: bool) -> reference.Scores:
    """Measure all rows; without `bounds`, these stay as they are."""
    scores: reference.Scores = {}
    progress = _progress()
    steps = [(*row, policy) for row in reference.rows() for policy in (*reference.POLICIES, reference.BOUND)]
    for done, (id, prescriptions, policy) in enumerate(steps):
        progress("measuring", done, len(steps))
        row: reference.Row | None
        if policy != reference.BOUND:
            row = reference.measure(id, prescriptions, policy)
        elif bounds:
            row = reference.measure_bound(id, prescriptions)
        else:
            row = reference.SCORES.get(id, {}).get(prescriptions, {}).get(policy)
        if row is not None:
            scores.setdefault(id, {}).setdefault(prescriptions, {})[policy] = row
    progress("measuring", len(steps), len(steps))
    return scores


def _progress() -> Progress:
    """Return what shows the progress, on a terminal only."""
    return Line() if sys.stderr.isatty() else lambda *_: None


def _report(results: Any, lines: list[str], file: Path | None) -> None:
    """Print lines, and write the results as JSON; to standard output in place of the lines for '-'."""
    text = json.dumps(results, indent=2) + "\n"
    if file == Path("-"):
        sys.stdout.write(text)
        return
    print(*lines, sep="\n")
    if file:
        file.write_text(text, encoding="utf-8")


def speed(threads: int = 1, repeats: int = 9) -> dict[str, Any]:
    """Measure the environments.

    Args:
        threads: Threads of a batch.
        repeats: Measurements of each figure, of which the median counts.

    Returns:
        `steps_per_second` by batch size, `scalar_step_us`, and the conditions.
    """
    rates = {str(size): statistics.median(_batch(size, threads, repeats)) for size in BATCHES}
    return {
        "steps_per_second": rates,
        "scalar_step_us": statistics.median(_scalar(repeats)),
        "step_ms": 1,
        "threads": threads,
        "repeats": repeats,
        "machine": platform.processor() or platform.machine(),
    }


def _batch(size: int, threads: int, repeats: int) -> list[float]:
    environments = VectorPressureControl(size, seed=1, threads=threads, copy=False, **OPTIONS)
    environments.reset()
    actions = np.full((size, 1), -0.7, np.float32)
    steps = max(SLICE // size, 20)
    rates = []
    for _ in range(repeats):
        begun = time.perf_counter()
        for _ in range(steps):
            environments.step(actions)
        rates.append(size * steps / (time.perf_counter() - begun))
    return rates


def _scalar(repeats: int) -> list[float]:
    environment = PressureControl(**OPTIONS)
    action = np.full(1, -0.7, np.float32)
    times = []
    for repeat in range(repeats):
        environment.reset(seed=repeat)
        steps = environment.steps - 1
        begun = time.perf_counter()
        for _ in range(steps):
            environment.step(action)
        times.append(1e6 * (time.perf_counter() - begun) / steps)
    return times


if __name__ == "__main__":
    sys.exit(main())
