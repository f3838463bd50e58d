"""Reference scores: how a random policy, the best PID and the shipped learned controller do in every environment.

The scores are those of `eupnea.score` with its default episodes, for every environment and its `prescriptions`. `SCORES` has them as
they were measured by `python -m eupnea reference --measure`.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.resources import files
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eupnea._native import PRESCRIPTIONS, Bench, Controller, Family
from eupnea.commands import bound, robust
from eupnea.environments import EPISODES, HOLD, REGISTERED, SEED, score
from eupnea.policies import Known

#: Name of the file with the scores in this package.
FILE = "reference_scores.json"
#: Policies, from the worst to the best.
POLICIES = ("random", "pid", "learned")
#: A reference bound, computed on a fully known lung: no policy.
BOUND = "bound"
#: Decimals of the figures.
DECIMALS = 6
#: Gains of the best PID that `trainer tune-pid` found for the lung, and for nine lungs together; those of a family are its own.
ONE_LUNG, NINE_LUNGS = (6.5, 265.0, 0.13), (6.1, 290.0, 0.2)

Row = dict[str, float]
"""Figures of one policy, as `eupnea.score` names them."""

Scores = dict[str, dict[str, dict[str, Row]]]
"""Rows by environment, prescriptions and policy."""

SCORES: Scores = json.loads(files("eupnea").joinpath(FILE).read_text(encoding="utf-8"))


class Random:
    """Draws every action uniformly, the same ones for the same seed."""

    def __init__(self, seed: int = SEED) -> None:
        self._generator = np.random.default_rng(seed)

    def __call__(self, observation: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return an action, whatever the observation."""
        return self._generator.uniform(-1.0, 1.0, 1).astype(np.float32)


def controller(policy: str, id: str, prescriptions: str) -> Controller:
    """Return the best PID (`"pid"`) or the shipped learned controller (`"learned"`) for an environment.

    Raises:
        ValueError: There is no such policy.
    """
    name = REGISTERED[id].get("family")
    if policy == "learned":
        return Controller.load(name or "adult")
    if policy != "pid":
        raise ValueError(f"there is no controller {policy!r}: choose pid or learned")
    if name is None:
        return Controller.pid(NINE_LUNGS if REGISTERED[id].get("lungs") == "paper" else ONE_LUNG)
    family = Family(name)
    gains = family.pid if prescriptions == PRESCRIPTIONS[0] else family.bedside_pid
    if gains is None:
        raise ValueError(f"the family {name} names no PID for {prescriptions}")
    return Controller.pid(gains)


def measure(id: str, prescriptions: str, policy: str) -> Row:
    """Measure a row of the scores.

    Args:
        id: Name of the environment.
        prescriptions: `"paper"` or `"bedside"`.
        policy: `"random"`, `"pid"` or `"learned"`; the random one holds its actions as registered, the others act every tick.

    Returns:
        `score`, `overshoot`, `aborted` as `eupnea.score` has them, and `return`, that of actions which are held as registered.
    """
    if policy == "random":
        result = score(Random(), id, prescriptions=prescriptions)
    else:
        known = Known(controller(policy, id, prescriptions), as_action=True)
        result = score(known, id, prescriptions=prescriptions, observation="plain", hold=1)
        # The reward of a step is the mean over its ticks.
        result["return"] /= HOLD
    return {name: round(result[name], DECIMALS) for name in ("score", "return", "overshoot", "aborted")}


def measure_bound(id: str, prescriptions: str) -> Row | None:
    """Compute the reference bound of an environment, which takes minutes; None where there is none."""
    options = REGISTERED[id]
    # Where prescriptions are drawn or patients breathe, the episodes are too many.
    if prescriptions != PRESCRIPTIONS[0] or options.get("breathing"):
        return None
    if family := options.get("family"):
        found = robust(family, family=family, plants=EPISODES, subset=EPISODES, breaths=1, seed=SEED)["bound"][0]
    else:
        lungs = bound(bench=options.get("lungs", Bench().name))["lungs"]
        found = sum(lung["mean"]["score"] for lung in lungs) / len(lungs)
    return {"score": round(found, DECIMALS)}


def rows() -> Iterator[tuple[str, str]]:
    """Yield every environment with every name of its prescriptions."""
    for id in REGISTERED:
        for prescriptions in PRESCRIPTIONS:
            yield id, prescriptions


def returns(id: str, prescriptions: str = PRESCRIPTIONS[0]) -> tuple[float, float]:
    """Return the mean returns of the random policy and of the best shipped controller, at the registered `hold`.

    Raises:
        ValueError: There is no such environment, or there are no scores for these prescriptions.
    """
    known = [row["return"] for row in _policies(id, prescriptions).values()]
    return min(known), max(known)


def normalized_score(score: float, id: str = "eupnea/OneLung-v0", prescriptions: str = PRESCRIPTIONS[0]) -> float:
    """Normalise a score as D4RL and Minari do: 0 is the random policy, 1 the best shipped controller.

    Args:
        score: `score` of `eupnea.score`, cmH2O.
        id: Name of the environment.
        prescriptions: Those of the environment, `"paper"` or `"bedside"`.

    Returns:
        The normalised score; above 1 is better than any shipped controller.

    Raises:
        ValueError: There is no such environment, or there are no scores for these prescriptions.
    """
    known = [row["score"] for row in _policies(id, prescriptions).values()]
    return (max(known) - score) / (max(known) - min(known))


def _policies(id: str, prescriptions: str) -> dict[str, Row]:
    if id not in SCORES:
        raise ValueError(f"there is no environment {id!r}: choose from {', '.join(SCORES)}")
    if prescriptions not in SCORES[id]:
        raise ValueError(f"there are no reference scores for {prescriptions!r}: choose from {', '.join(SCORES[id])}")
    return {policy: SCORES[id][prescriptions][policy] for policy in POLICIES}


def table(scores: Scores) -> str:
    """Return the scores as a table in Markdown, cmH2O."""
    lines = ["| id | prescriptions | random | PID | learned controller | reference bound |", "|---|---|---:|---:|---:|---:|"]
    for id, of_environment in scores.items():
        for prescriptions, of_policies in of_environment.items():
            found: list[Any] = [of_policies.get(policy) for policy in (*POLICIES, BOUND)]
            cells = " | ".join("-" if row is None else f"{row['score']:.3f}" for row in found)
            lines.append(f"| `{id}` | {prescriptions} | {cells} |")
    return "\n".join(lines)
