"""Prints the reference scores of the environments (docs/ENVIRONMENTS.md): PID, learned controller and reference bound.

pip install ./python
python examples/python/reference_scores.py            # without the bounds, which take half an hour
python examples/python/reference_scores.py --bounds
"""

import argparse

import eupnea
from eupnea.environments import EPISODES, SEED
from eupnea.policies import Known

#: Gains of the best PID that `trainer tune-pid` found for the lung, and for nine lungs together; those of a family are its own.
ONE_LUNG, NINE_LUNGS = (6.5, 265, 0.13), (6.1, 290, 0.2)


def rivals(name: str) -> tuple[eupnea.Controller, eupnea.Controller]:
    """Return the PID and the learned controller for an environment."""
    family = {"eupnea/AdultFamily-v0": "adult", "eupnea/NeonatalFamily-v0": "neonate"}.get(name)
    gains = ONE_LUNG if name == "eupnea/OneLung-v0" else NINE_LUNGS
    if family:
        gains = eupnea.Family(family).pid or gains
    return eupnea.Controller.pid(gains), eupnea.Controller.load(family or "adult")


def bound(name: str) -> float | None:
    """Return the reference bound of an environment, cmH2O; None where there is none."""
    lungs = {"eupnea/OneLung-v0": "R20C20", "eupnea/NineLungs-v0": "paper"}.get(name)
    if lungs:
        results = eupnea.bound(bench=lungs)["lungs"]
        return sum(lung["mean"]["score"] for lung in results) / len(results)
    family = {"eupnea/AdultFamily-v0": "adult", "eupnea/NeonatalFamily-v0": "neonate"}.get(name)
    if family:
        return eupnea.robust(family, family=family, plants=EPISODES, subset=EPISODES, breaths=1, seed=SEED)["bound"][0]
    return None


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bounds", action="store_true", help="compute the reference bounds too")
    given = parser.parse_args()
    print("| id | PID | learned | bound | overshoot PID | overshoot learned |")
    print("|---|---:|---:|---:|---:|---:|")
    for name in list(eupnea.environments.REGISTERED)[1:]:
        plain = {"observation": "plain", "hold": 1}
        pid, learned = (eupnea.score(Known(rival, as_action=True), name, **plain) for rival in rivals(name))
        best = bound(name) if given.bounds else None
        cells = [f"{pid['score']:.3f}", f"{learned['score']:.3f}", "-" if best is None else f"{best:.3f}"]
        cells += [f"{pid['overshoot']:.2f}", f"{learned['overshoot']:.2f}"]
        print(f"| `{name}` | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
