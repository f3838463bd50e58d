"""Trains PPO or SAC of Stable-Baselines3 on an environment of eupnea, and judges the agent on the bench of the trainer.

The figures of RESULTS.md ("Reinforcement learning") are those of this script.
"""

from __future__ import annotations

import argparse
import csv
import json
import sys
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

import eupnea
from eupnea.environments import REGISTERED
from eupnea.policies import Agent
from eupnea.sb3 import VecPressureControl

EXAMPLES = """examples:
  python3 sb3.py --ticks 2e6 --out out/ppo            # a minute or two: better than the best PID
  python3 sb3.py --algorithm sac --ticks 2e7 --out out/sac
  python3 sb3.py --id eupnea/NineLungs-v0 --out out/nine
  python3 sb3.py --out out/ppo --score-only           # judge again what is in the folder

The folder gets model.zip, curve.csv (score against ticks) and score.json. Ctrl-C ends the training;
the model so far is kept and judged. The packages: pip install ./python stable-baselines3"""

#: Control ticks for which an action is held. The valve answers after 12 ms of dead time and 25 ms of lag: shorter
#: actions are harder to tell apart.
HOLD = 10
#: Breaths of an episode. The first starts from rest, the later ones from the command between breaths.
BREATHS = 4
#: Episodes in a mean of the curve.
MEAN_OVER = 48
WIDTH = 30
LEARNERS: dict[str, type[PPO] | type[SAC]] = {"ppo": PPO, "sac": SAC}


def falling(rate: float) -> Callable[[float], float]:
    """Return a learning rate that falls linearly to a fiftieth."""
    return lambda left: rate * (0.02 + 0.98 * left)


def learner(algorithm: str, environments: VecPressureControl, seed: int) -> BaseAlgorithm:
    """Make a learner with the settings that worked best in a few short runs on R20C20."""
    if algorithm == "ppo":
        return PPO(
            "MlpPolicy",
            environments,
            learning_rate=falling(1e-3),
            n_steps=400,
            batch_size=400,
            gamma=0.95,
            gae_lambda=0.9,
            max_grad_norm=5.0,
            policy_kwargs={"net_arch": [64, 64], "log_std_init": -1.0},
            seed=seed,
            device="cpu",
        )
    return SAC(
        "MlpPolicy",
        environments,
        learning_rate=falling(1e-3),
        gamma=0.98,
        train_freq=2,
        buffer_size=300_000,
        policy_kwargs={"net_arch": [64, 64]},
        seed=seed,
        device="cpu",
    )


class Course(BaseCallback):
    """Shows the progress and notes the scores of the episodes."""

    def __init__(self, ticks: int) -> None:
        super().__init__()
        self.points: list[tuple[int, float, float]] = []
        self._ticks = ticks
        self._recent: deque[float] = deque(maxlen=MEAN_OVER)
        self._episodes = 0
        self._begun = time.perf_counter()

    def _on_step(self) -> bool:
        ended = [info["episode"] for info in self.locals["infos"] if "episode" in info]
        # The rewards also count the ticks that an aborted episode misses; its score does not.
        self._recent.extend(-episode["r"] / episode["l"] for episode in ended)
        for _ in ended:
            self._episodes += 1
            if self._episodes % MEAN_OVER == 0:
                self._note()
        return True

    def _note(self) -> None:
        ticks = self.num_timesteps * HOLD
        score, seconds = float(np.mean(self._recent)), time.perf_counter() - self._begun
        self.points.append((ticks, score, seconds))
        share = min(ticks / self._ticks, 1.0)
        bar = "#" * int(WIDTH * share)
        sys.stderr.write(f"\r[{bar:<{WIDTH}}] {ticks / 1e6:6.2f} million ticks, error {score:6.3f} cmH2O, {seconds:5.0f} s ")
        sys.stderr.flush()

    def write(self, path: Path) -> None:
        """Write the curve: ticks, error of the exploring agent in cmH2O, seconds."""
        with path.open("w", newline="", encoding="utf-8") as file:
            rows = csv.writer(file)
            rows.writerow(["ticks", "error_cmh2o", "seconds"])
            rows.writerows((ticks, round(score, 4), round(seconds, 1)) for ticks, score, seconds in self.points)


def judge(model: BaseAlgorithm, id: str) -> dict[str, Any]:
    """Score the agent without exploration, in the environment and, for one lung, as `trainer evaluate` does."""

    def act(observation: np.ndarray) -> np.ndarray:
        return np.asarray(model.predict(observation, deterministic=True)[0])

    scores: dict[str, Any] = {"environment": eupnea.score(act, id, hold=HOLD)}
    lung = REGISTERED[id].get("lungs")
    if lung not in (None, "paper"):
        scores["evaluate"] = eupnea.evaluate(policy=Agent(act, hold=HOLD), bench=lung, seed=1)
    return scores


def main() -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--algorithm", choices=list(LEARNERS), default="ppo", help="[default: ppo]")
    parser.add_argument("--id", choices=list(REGISTERED), default="eupnea/OneLung-v0", metavar="ID",
                        help="environment [default: eupnea/OneLung-v0]")  # fmt: skip
    parser.add_argument("--envs", type=int, default=8, metavar="N", help="environments [default: 8]")
    parser.add_argument("--ticks", type=float, default=2e7, metavar="N",
                        help="ticks of 1 ms over all inspirations [default: 2e7]")  # fmt: skip
    parser.add_argument("--seed", type=int, default=1, metavar="N", help="[default: 1]")
    parser.add_argument("--out", type=Path, required=True, metavar="FOLDER", help="folder for the results")
    parser.add_argument("--score-only", action="store_true", help="judge the model in the folder again")
    given = parser.parse_args()
    torch.set_num_threads(1)  # the networks are too small for several
    given.out.mkdir(parents=True, exist_ok=True)
    file, scores = given.out / "model.zip", given.out / "score.json"
    record: dict[str, Any] = {}
    if given.score_only:
        record = json.loads(scores.read_text(encoding="utf-8"))
        model: BaseAlgorithm = LEARNERS[record["algorithm"]].load(file, device="cpu")
    else:
        environments = VecPressureControl(given.id, given.envs, hold=HOLD, breaths=BREATHS)
        model = learner(given.algorithm, environments, given.seed)
        course, begun = Course(int(given.ticks)), time.perf_counter()
        try:
            model.learn(int(given.ticks) // HOLD, callback=course)
        except KeyboardInterrupt:
            sys.stderr.write("\nstopped: the model so far is kept")
        sys.stderr.write("\n")
        model.save(file)
        course.write(given.out / "curve.csv")
        record = {"algorithm": given.algorithm, "id": given.id, "seed": given.seed, "envs": given.envs}
        record |= {"ticks": model.num_timesteps * HOLD, "seconds": round(time.perf_counter() - begun, 1)}
        scores.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    record |= judge(model, record["id"])
    scores.write_text(json.dumps(record, indent=2) + "\n", encoding="utf-8")
    print(f"score in the environment: {record['environment']['score']:.3f} cmH2O")
    if "evaluate" in record:
        mean = record["evaluate"]["mean"]["learned"]
        print(f"score of trainer evaluate: {mean['score']:.3f} cmH2O, overshoot {mean['overshoot']:.2f} cmH2O")
    return 0


if __name__ == "__main__":
    sys.exit(main())
