"""`python -m eupnea`: measures the speed of the environments."""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from eupnea.environments import PressureControl, VectorPressureControl

BATCHES = (1, 8, 64, 256, 1024)
#: Steps that are timed together, over all environments of a batch.
SLICE = 20_000
#: What the authors' network observes, an action every millisecond.
OPTIONS: dict[str, Any] = {"observation": "authors", "hold": 1}

EXAMPLES = """examples:
  python -m eupnea bench
  python -m eupnea bench --threads 2 --repeats 20 --json speed.json

A step is 1 ms of the virtual bench under the ventilator of the chip, with the observation of the paper's
authors. The figures are medians over the repeats."""


def main(arguments: list[str] | None = None) -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(prog="python -m eupnea", description="Tools of the package eupnea.")
    commands = parser.add_subparsers(dest="command", required=True)
    bench = commands.add_parser(
        "bench",
        help="measure steps per second by batch size",
        epilog=EXAMPLES,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    bench.add_argument("--json", type=Path, metavar="FILE", help="write the results as JSON; '-' for standard output")
    bench.add_argument("--threads", type=int, default=1, metavar="N", help="threads of a batch [default: 1]")
    bench.add_argument("--repeats", type=int, default=9, metavar="N", help="measurements of each figure [default: 9]")
    given = parser.parse_args(arguments)
    if given.threads < 1 or given.repeats < 1:
        parser.error("--threads and --repeats must be at least 1")
    results = speed(given.threads, given.repeats)
    quiet = given.json == Path("-")
    if not quiet:
        for size, rate in results["steps_per_second"].items():
            print(f"batch {size:>5}: {rate / 1e6:6.2f} million steps/s")
        print(f"single step from Python: {results['scalar_step_us']:.2f} us")
    text = json.dumps(results, indent=2) + "\n"
    if quiet:
        sys.stdout.write(text)
    elif given.json:
        given.json.write_text(text, encoding="utf-8")
    return 0


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
