"""The environments for Stable-Baselines3: `pip install './python[sb3]'`.

    from stable_baselines3 import PPO
    from eupnea.sb3 import VecPressureControl

    model = PPO("MlpPolicy", VecPressureControl("eupnea/OneLung-v0", 8))

Stable-Baselines3 expects that the step which ends an episode also starts the next one. `VectorPressureControl` starts it one step
later and ignores the action of that step, from which a learner must not learn. This class therefore steps single environments; they
take about a tenth of the time of a training with PPO.
"""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

try:
    from stable_baselines3.common.vec_env import VecEnv
except ImportError:
    raise ImportError("this module needs Stable-Baselines3: pip install './python[sb3]'") from None

from eupnea.environments import REGISTERED, Observation, PressureControl

#: Default factor of the rewards: errors of some cmH2O become values near 1.
REWARD_SCALE = 0.1

Indices = None | int | Iterable[int]


class VecPressureControl(VecEnv):
    """Environments that step together and start their next episodes at once.

    Environment `i` of `n` runs the episodes `i`, `i + n`, `i + 2 n`, ... of the seed, as in `VectorPressureControl`. The `info` of a
    step that ends an episode has the episode's scores, its last observation (`terminal_observation`), and its unscaled sum of rewards
    and number of steps (`episode`), from which Stable-Baselines3 computes its running means.

    Args:
        id: Name of the environment, such as `"eupnea/OneLung-v0"`.
        num_envs: Number of environments.
        seed: Seed of the episodes: of their plants, their PIPs and the sensor noise. The actions do not depend on it. An algorithm that
            is given a seed of its own, as in `PPO(..., seed=1)`, calls `seed` and so replaces this one.
        reward_scale: Factor of the rewards, as algorithms expect rewards near 1.
        options: Options of the environment in place of the registered ones; `render_mode="rgb_array"` allows `get_images`.

    Raises:
        ValueError: There is no such environment, or an option is wrong.
    """

    def __init__(
        self,
        id: str = "eupnea/OneLung-v0",
        num_envs: int = 8,
        *,
        seed: int = 0,
        reward_scale: float = REWARD_SCALE,
        **options: Any,
    ) -> None:
        if id not in REGISTERED:
            raise ValueError(f"there is no environment {id!r}: choose from {', '.join(REGISTERED)}")
        if num_envs < 1:
            raise ValueError(f"num_envs is {num_envs}: it must be at least 1")
        self.envs = [PressureControl(**{**REGISTERED[id], **options}) for _ in range(num_envs)]
        super().__init__(num_envs, self.envs[0].observation_space, self.envs[0].action_space)
        self._scale = reward_scale
        self._begun = time.perf_counter()
        self._actions = np.zeros((num_envs, 1), np.float32)
        self._rewards = np.zeros(num_envs)
        self._steps = np.zeros(num_envs, np.int64)
        self.seed(seed)

    def seed(self, seed: int | None = None) -> Sequence[int | None]:
        """Choose the seed of the episodes; the next `reset` starts with the first episodes of this seed.

        Args:
            seed: The seed; None changes nothing, so that the next `reset` starts the next episodes.

        Returns:
            The seed in force for each environment. They share it: environment `i` runs the episodes `i`, `i + n`, `i + 2 n`, ...
        """
        if seed is not None:
            self._seed = int(seed)
            self._numbers = list(range(self.num_envs))
        return [self._seed] * self.num_envs

    def _start(self, index: int) -> Observation:
        """Start the next episode of one environment."""
        number = self._numbers[index]
        self._numbers[index] += self.num_envs
        self._rewards[index] = 0.0
        self._steps[index] = 0
        return self.envs[index].reset(seed=self._seed, options={"number": number})[0]

    def reset(self) -> Observation:
        """Start the next episode in every environment; returns observations of shape (num_envs, length)."""
        return np.stack([self._start(index) for index in range(self.num_envs)])

    def step_async(self, actions: NDArray[np.float32]) -> None:
        """Keep the actions for `step_wait`.

        Args:
            actions: Numbers from -1 to 1 of shape (num_envs, 1).

        Raises:
            ValueError: The shape is wrong, or an action is not a finite number; then nothing moves.
        """
        shape = (self.num_envs, 1)
        try:
            kept = np.array(actions, dtype=np.float32)
        except (TypeError, ValueError):
            raise ValueError(f"the actions are not numbers: give an array of shape {shape}") from None
        if kept.shape != shape:
            raise ValueError(f"the actions have shape {kept.shape}: give {shape}, one for each environment")
        if not np.isfinite(kept).all():
            raise ValueError("an action is not finite: give numbers from -1 to 1")
        self._actions = kept

    def step_wait(self) -> tuple[Observation, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Step every environment; returns observations, scaled rewards, which episodes ended, and their scores."""
        observations: list[Observation] = []
        rewards = np.empty(self.num_envs, np.float32)
        dones = np.zeros(self.num_envs, np.bool_)
        infos: list[dict[str, Any]] = []
        for index, environment in enumerate(self.envs):
            observation, reward, ended, _, info = environment.step(self._actions[index])
            self._rewards[index] += reward
            self._steps[index] += 1
            if ended:
                info |= {"terminal_observation": observation, "episode": self._episode(index)}
                observation = self._start(index)
            rewards[index], dones[index] = self._scale * reward, ended
            observations.append(observation)
            infos.append(info)
        return np.stack(observations), rewards, dones, infos

    def _episode(self, index: int) -> dict[str, float]:
        seconds = round(time.perf_counter() - self._begun, 6)
        return {"r": float(self._rewards[index]), "l": int(self._steps[index]), "t": seconds}

    def close(self) -> None:
        """End the environments."""
        for environment in self.envs:
            environment.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Draw the running inspiration of each environment.

        Returns:
            RGB images of shape (240, 480, 3); None for each environment without `render_mode="rgb_array"`.
        """
        return [environment.render() for environment in self.envs]

    def _chosen(self, indices: Indices) -> list[PressureControl]:
        return [self.envs[index] for index in self._get_indices(indices)]

    def get_attr(self, attr_name: str, indices: Indices = None) -> list[Any]:
        """Return an attribute of each environment."""
        return [getattr(environment, attr_name) for environment in self._chosen(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Indices = None) -> None:
        """Set an attribute of each environment."""
        for environment in self._chosen(indices):
            setattr(environment, attr_name, value)

    def env_method(self, method_name: str, *args: Any, indices: Indices = None, **kwargs: Any) -> list[Any]:
        """Call a method of each environment."""
        return [getattr(environment, method_name)(*args, **kwargs) for environment in self._chosen(indices)]

    def env_is_wrapped(self, wrapper_class: type, indices: Indices = None) -> list[bool]:
        """Return False for each environment: none has a wrapper."""
        return [False for _ in self._chosen(indices)]
