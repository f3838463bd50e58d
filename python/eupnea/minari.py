"""A data set of recorded breaths for offline learning, in the format of Minari: `pip install './python[minari]'`.

    python -m eupnea minari --out datasets --episodes 1000

The episodes are those of a registered environment, by their numbers, so that any of them can be repeated. A PID with known-good gains
commands the valve, with the random perturbations of `eupnea.collect`.
"""

from __future__ import annotations

import os
import shutil
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.metadata import metadata
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np

from eupnea import reference
from eupnea._native import KNOWN_GOOD, Controller
from eupnea.commands import Progress
from eupnea.environments import HOLD, PressureControl, protocol_episodes
from eupnea.policies import Known

try:
    import minari
    from minari.data_collector.episode_buffer import EpisodeBuffer
except ImportError:
    raise ImportError("the data set needs Minari: pip install './python[minari]'") from None

#: Name of the data set.
DATA_SET = "eupnea/adult-family/pid-exploration-v0"
#: Environment of its episodes, and their prescriptions: drawn over the whole range that a ventilator must hold for.
ENVIRONMENT, PRESCRIPTIONS = "eupnea/AdultFamily-v0", "bedside"
#: Control period of the PID: it acts when an action is due, microseconds.
PERIOD_US = 1000 * HOLD
#: Variable with Minari's folder.
FOLDER = "MINARI_DATASETS_PATH"
#: Episodes that are written together.
TOGETHER = 50
DESCRIPTION = """Breaths of adults on ventilators that differ as machines do, each with a lung and settings of its own. A PID commands \
the inspiratory valve every 10 ms, with one random perturbation per breath. Rewards are minus the mean absolute error of the airway \
pressure, cmH2O. ref_min_score is the mean return of a random policy, ref_max_score that of the best controller of the package."""


class Explorer:
    """A PID with known-good gains, and one random perturbation per breath: a step that fades out, or a triangle.

    Args:
        seed: Seed of the perturbations.
        options: Options of the environment.
    """

    def __init__(self, seed: int, **options: Any) -> None:
        self._seed = seed
        self._pid = Known(Controller.pid(KNOWN_GOOD, period_us=PERIOD_US))
        # A twin of the environment, which shows the PID what it needs.
        self._twin = PressureControl(**{**options, "observation": "plain"})

    def start(self, **reset: Any) -> None:
        """Begin an episode, with the arguments of `reset`."""
        self._pid.reset()
        self._seen, _ = self._twin.reset(**reset)
        self._perturbation = iter(self._twin.exploration(self._seed)[::HOLD])

    def act(self) -> np.ndarray[Any, np.dtype[np.float32]]:
        """Return the action of the next step."""
        percent = self._pid(self._seen) + next(self._perturbation)
        action = np.array([np.clip(percent / 50.0 - 1.0, -1.0, 1.0)], np.float32)
        self._seen, *_, self._end = self._twin.step(action)
        return action

    def about(self) -> dict[str, Any]:
        """Describe the episode that has ended: plant and settings, and the fault with which the ventilator aborted it."""
        return {"plant": self._end["plant"], "settings": self._twin.settings, "fault": self._end["fault"]}


def record(
    out: os.PathLike[str] | str | None = None,
    *,
    episodes: int = 1000,
    seed: int = 1,
    progress: Progress | None = None,
) -> minari.MinariDataset:
    """Record the data set `eupnea/adult-family/pid-exploration-v0`. The same seed gives the same data.

    Args:
        out: Folder for data sets, in which it becomes complete or not at all; default: that of Minari.
        episodes: Number of episodes, of one breath each.
        seed: Seed of plants, settings, sensor noise and perturbations.
        progress: Called with the stage, the number of episodes done, and their total.

    Returns:
        The data set. Load it with `minari.load_dataset`, which looks in the folder that the variable `MINARI_DATASETS_PATH` names.

    Raises:
        ValueError: There are no episodes.
        FileExistsError: The folder has the data set already.
    """
    if episodes < 1:
        raise ValueError(f"{episodes} episodes: give at least one")
    folder = (Path(out) if out is not None else minari.storage.get_dataset_path()).absolute()
    place = folder / DATA_SET
    if place.exists():
        raise FileExistsError(f"{place} exists already: remove it, or choose another folder")
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=folder, prefix=".eupnea-") as unfinished:
        with _folder(unfinished):
            _write(episodes, seed, progress or (lambda *_: None))
        _move(Path(unfinished), folder)
    return minari.MinariDataset(place / "data")


def _write(episodes: int, seed: int, progress: Progress) -> None:
    environment = gymnasium.make(ENVIRONMENT, prescriptions=PRESCRIPTIONS)
    assert environment.spec is not None
    explorer = Explorer(seed, **environment.spec.kwargs)
    data_set: minari.MinariDataset | None = None
    for first in range(0, episodes, TOGETHER):
        several, about = [], []
        for number in range(first, min(first + TOGETHER, episodes)):
            progress("recording", number, episodes)
            several.append(_episode(environment.unwrapped, explorer, seed, number))
            about.append(explorer.about())
        if data_set is None:
            data_set = _create(several, environment)
        else:
            data_set.update_dataset_from_buffer(several)
        data_set.storage.update_episode_metadata(about, range(first, first + len(about)))
    progress("recording", episodes, episodes)


def _episode(environment: gymnasium.Env[Any, Any], explorer: Explorer, seed: int, number: int) -> EpisodeBuffer:
    reset: dict[str, Any] = {"seed": seed, "options": {"number": number}}
    observation, _ = environment.reset(**reset)
    explorer.start(**reset)
    observations, actions, rewards, ended = [observation], [], [], False
    while not ended:
        actions.append(explorer.act())
        observation, reward, ended, _, _ = environment.step(actions[-1])
        observations.append(observation)
        rewards.append(reward)
    terminations = [False] * (len(rewards) - 1) + [True]
    return EpisodeBuffer(
        **reset,
        observations=observations,
        actions=actions,
        rewards=rewards,
        terminations=terminations,
        truncations=[False] * len(rewards),
    )


def _create(episodes: list[EpisodeBuffer], environment: gymnasium.Env[Any, Any]) -> minari.MinariDataset:
    least, most = reference.returns(ENVIRONMENT, PRESCRIPTIONS)
    assert environment.spec is not None
    package = metadata("eupnea")
    with warnings.catch_warnings():
        # The project has no address for mail.
        warnings.filterwarnings("ignore", message="`author_email`")
        return minari.create_dataset_from_buffers(
            DATA_SET,
            episodes,
            env=environment,
            eval_env=environment,
            algorithm_name="PID with boundary and triangular exploration",
            author=package["Author"],
            code_permalink=package["Project-URL"].split(", ")[-1],
            ref_min_score=least,
            ref_max_score=most,
            num_episodes_average_score=protocol_episodes(**environment.spec.kwargs),
            description=DESCRIPTION,
            requirements=[f"eupnea=={package['Version']}"],
            data_format="arrow",
        )


@contextmanager
def _folder(path: str) -> Iterator[None]:
    """Let Minari write to a folder for as long as the context lasts."""
    before = os.environ.get(FOLDER)
    os.environ[FOLDER] = path
    try:
        yield
    finally:
        if before is None:
            del os.environ[FOLDER]
        else:
            os.environ[FOLDER] = before


def _move(unfinished: Path, folder: Path) -> None:
    """Move the complete data set to its place, and the descriptions of its namespaces where there are none."""
    place = folder / DATA_SET
    place.parent.mkdir(parents=True, exist_ok=True)
    for description in unfinished.rglob("namespace_metadata.json"):
        target = folder / description.relative_to(unfinished)
        if not target.exists():
            shutil.move(description, target)
    os.replace(unfinished / DATA_SET, place)
