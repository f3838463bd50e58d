"""Environments for reinforcement learning: one at a time (`PressureControl`) or in batches (`VectorPressureControl`).

An episode is one breath or several of one plant. The agent commands the inspiratory valve during each inspiration; the ventilator
does the rest. The reward is minus the absolute error of the true airway pressure in cmH2O, so that the mean reward of an episode is
minus the score of the command line.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from eupnea import _native
from eupnea._native import Bench, Family
from eupnea.policies import begin
from eupnea.render import picture

Observation = NDArray[np.float32]
"""Float32 values, as many as the observation space has."""

Space = gymnasium.spaces.Space[Observation]
"""A Gymnasium space of float32 arrays."""

Policy = Callable[[Observation], Any]
"""Computes the action for an observation."""

FLOAT32 = np.dtype(np.float32)

#: Keyword arguments of the registered environments.
REGISTERED: dict[str, dict[str, Any]] = {
    "eupnea/PressureControl-v0": {},
    "eupnea/OneLung-v0": {"lungs": "R20C20"},
    "eupnea/NineLungs-v0": {"lungs": "paper"},
    "eupnea/AdultFamily-v0": {"family": "adult"},
    "eupnea/NeonatalFamily-v0": {"family": "neonate"},
    "eupnea/BreathingPatient-v0": {"lungs": "paper", "breathing": True, "breaths": 4},
}

#: Episodes of the reference scores: each lung at each waveform once; and many, with each patient where patients breathe, or where every
#: episode has its own prescription.
EPISODES, MANY_EPISODES = 54, 486
#: Seed of the reference scores.
SEED = 1000
#: Control ticks for which the registered environments hold an action.
HOLD = 10
#: Correction at an action of 1 without another one, percent of the valve.
AUTHORITY = 100.0


def register() -> None:
    """Register the environments with Gymnasium. `import eupnea` does it."""
    for name, options in REGISTERED.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="eupnea.environments:PressureControl",
                vector_entry_point="eupnea.environments:VectorPressureControl",
                kwargs=options,
            )


def _benches(lungs: str | Bench | Sequence[str | Bench] | None) -> list[Bench] | None:
    if lungs is None:
        return None
    if isinstance(lungs, (str, Bench)):
        lungs = [lungs]
    benches: list[Bench] = []
    for lung in lungs:
        benches.extend(Bench.preset(lung) if isinstance(lung, str) else [lung])
    return benches


def _checked(options: dict[str, Any]) -> dict[str, Any]:
    unknown = options.keys() - OPTIONS
    if unknown:
        raise TypeError(f"there is no option {sorted(unknown)[0]!r} of the environment: choose from {', '.join(OPTIONS)}")
    return options


def _task(
    *,
    lungs: str | Bench | Sequence[str | Bench] | None = None,
    family: str | Family | None = None,
    prescriptions: str | None = None,
    pips: Sequence[float] | None = None,
    settings: Mapping[str, float] | None = None,
    breathing: bool = False,
    period_us: int = 1000,
    hold: int = HOLD,
    breaths: int = 1,
    observation: str = "ours",
    action: str = "valve",
    gains: Sequence[float] | None = None,
    authority: float | None = None,
    effort: float = 0.0,
    overshoot: float = 0.0,
    monitors: bool = True,
) -> _native.Task:
    if action not in ("valve", "residual"):
        raise ValueError(f"there is no action {action!r}: choose valve or residual")
    if action == "valve" and not (gains is None and authority is None):
        raise ValueError('gains and authority belong to a residual: add action="residual", or leave them out')
    if settings is not None and "pip" in settings:
        raise ValueError("an environment has several PIPs: give pips=[...] in place of the setting pip")
    return _native.Task(
        benches=_benches(lungs),
        family=Family(family) if isinstance(family, str) else family,
        prescriptions=prescriptions,
        pips=None if pips is None else list(pips),
        settings=None if settings is None else dict(settings),
        breathing=breathing,
        period_us=period_us,
        hold=hold,
        breaths=breaths,
        observation=observation,
        residual=(None if gains is None else list(gains), AUTHORITY if authority is None else authority)
        if action == "residual"
        else None,
        reward=(1.0, effort, overshoot),
        monitors=monitors,
    )


#: Names of the options of an environment.
OPTIONS = tuple(inspect.signature(_task).parameters)

#: Values that no observation exceeds: of scaled ones, and of plain ones, whose sensor ends at 215 cmH2O.
LIMITS = {"ours": 100.0, "authors": 100.0, "plain": 1000.0}


def _spaces(task: _native.Task, kind: str) -> tuple[Space, Space]:
    limit = LIMITS[kind]
    observation: Any = gymnasium.spaces.Box(-limit, limit, (task.observations,), np.float32)
    action: Any = gymnasium.spaces.Box(-1.0, 1.0, (1,), np.float32)
    return observation, action


class PressureControl(gymnasium.Env[Observation, NDArray[np.float32]]):
    """One ventilator on one plant after the other.

    The action space is `Box(-1, 1, (1,))`: with `action="valve"`, -1 closes the inspiratory valve and 1 opens it fully; with
    `action="residual"`, the action times `authority` (percent) is added to the command of a PID with these `gains`.

    An episode ends (`terminated`) after its last inspiration, or earlier if the ventilator aborts it, for example at the pressure
    limit. Every tick that did not run then counts as the worst one: the pressure is at its limit while the target is PEEP, and the
    command jumps over the whole range. The `info` of the last step has the episode's scores under the names of the command line:
    `score`, `rise_ms`, `overshoot`, `plateau_error`, `late_error` and `effort` (means over its breaths; NaN if the episode was
    aborted), `breath_scores` (the score of each complete breath), and `fault` (the alarm, or None).

    Args:
        lungs: Names such as `"R20C20"`, `"paper"` or `"iso-07"`, or `Bench` objects, which take turns.
        family: A family of plants in place of lungs: `"adult"`, `"neonate"`, `"blower"` or a file. Every episode has its own plant.
        prescriptions: `"paper"`, the waveforms of the paper or of the family (default); `"bedside"`, drawn for every episode; or a TOML
            file. In place of `pips` and `settings`.
        pips: PIPs of the waveforms, cmH2O, which take turns; default: those of the paper or of the family.
        settings: Further settings of the breaths by name, such as `{"peep": 8, "rate": 15}`.
        breathing: Whether the patients breathe, with efforts of 3, 6 and 10 cmH2O.
        period_us: Control period in microseconds.
        hold: Control ticks for which an action is held; the remaining ones of an inspiration if these are fewer.
        breaths: Breaths of an episode.
        observation: `"ours"` (25 features), `"authors"` (10 averages of past errors) or `"plain"` (pressure, target, PIP, PEEP,
            last command, time).
        action: `"valve"` or `"residual"`.
        gains: P, I and D of the PID under a residual; default: the one that the chip falls back to.
        authority: Correction at an action of 1, percent of the valve; default: 100.
        effort: Penalty for a command that changes by one percent within a tick.
        overshoot: Further penalty for a true pressure of one cmH2O above PIP.
        monitors: Whether the safety monitors are on.
        render_mode: `"rgb_array"` or None.

    Raises:
        TypeError: There is no such option, or its value has another type.
        ValueError: The value of an option is wrong; the text says which values are possible.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012 - Gymnasium declares it so

    def __init__(self, *, render_mode: str | None = None, **options: Any) -> None:
        if render_mode not in (None, "rgb_array"):
            raise ValueError(f"there is no render_mode {render_mode!r}: choose rgb_array or None")
        self.render_mode = render_mode
        self._task = _task(**_checked(options))
        self.observation_space, self.action_space = _spaces(self._task, options.get("observation", "ours"))
        self._environment: _native.Environment | None = _native.Environment(self._task, 0)
        self._seeded = False

    def _open(self) -> _native.Environment:
        if self._environment is None:
            raise RuntimeError("the environment is closed: make another one")
        return self._environment

    @property
    def steps(self) -> int:
        """Steps of the running or the last episode if it is not aborted; before the first one, of the longest."""
        return self._open().episode()["steps"] or self._task.steps

    @property
    def settings(self) -> dict[str, float]:
        """Settings of the breaths of the running or the last episode, by name."""
        return self._open().settings()

    def exploration(self, seed: int) -> NDArray[np.float32]:
        """Draw a random perturbation for the running or the last episode, as `eupnea.collect` draws one for a breath.

        Args:
            seed: Seed of the perturbations; the number of the episode chooses one.

        Returns:
            What to add to the command in every tick of the inspiration, percent of the valve.
        """
        return self._open().exploration(seed)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Observation, dict[str, Any]]:
        """Start the next episode.

        Args:
            seed: Starts again with the first episode of this seed. Without one, the first reset draws a seed.
            options: `number` (of the episode, which is also the plant of a family), `pip` in cmH2O, and `noise`, the seed of the
                sensor noise.

        Returns:
            The first observation, and the number, plant and PIP of the episode.

        Raises:
            ValueError: An option is unknown or out of range.
        """
        environment = self._open()
        if seed is not None and seed < 0:
            raise ValueError(f"the seed is {seed}: give a whole number of at least 0")
        super().reset(seed=seed)
        chosen = dict(options or {})
        unknown = chosen.keys() - {"number", "pip", "noise"}
        if unknown:
            raise ValueError(f"there is no option {sorted(unknown)[0]!r} of reset: choose number, pip or noise")
        if seed is None and not self._seeded:
            seed = int(self.np_random.integers(2**32))
        self._seeded = True
        observation = environment.reset(seed, **chosen)
        episode = environment.episode()
        return observation, {key: episode[key] for key in ("number", "plant", "pip")}

    def step(self, action: NDArray[np.float32] | float) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Hold an action for `hold` ticks.

        Args:
            action: One number; it is limited to the range from -1 to 1.

        Returns:
            Observation, reward, whether the episode ended, False (nothing truncates it), and its scores once it has ended.

        Raises:
            ValueError: The action is not one finite number.
            RuntimeError: The environment is closed, or the episode has ended.
        """
        if self._environment is None:
            self._open()
        value = action if isinstance(action, float) else _one(action)
        observation, reward, ended = self._environment.step(value)  # type: ignore[union-attr]
        return observation, reward, ended, False, self._environment.episode() if ended else {}  # type: ignore[union-attr]

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the running inspiration, or the last one: target, true pressure and command.

        Returns:
            An array of shape (240, 480, 3), or None without a render mode.
        """
        if self.render_mode is None:
            return None
        return picture(*self._open().inspiration())

    def close(self) -> None:
        """End the environment; no further call but `close` is allowed."""
        self._environment = None


def _one(action: Any) -> float:
    # The action of most agents, without the checks of all others.
    if isinstance(action, np.ndarray) and action.dtype is FLOAT32 and action.shape == (1,):
        return float(action[0])
    values = _numbers(action, "one number from -1 to 1")
    if values.size != 1:
        raise ValueError(f"the action has shape {values.shape}: give one number from -1 to 1")
    return float(values.reshape(-1)[0])


def _numbers(actions: Any, wanted: str) -> NDArray[np.float32]:
    """Return the numbers of actions. Text and complex numbers are none."""
    try:
        values = np.asarray(actions)
    except ValueError:
        raise ValueError(f"the actions are {actions!r}: give {wanted}") from None
    if values.dtype.kind not in "fiub":
        raise ValueError(f"the actions are {actions!r}: give {wanted}")
    with np.errstate(over="ignore"):  # a number too large for a float32 becomes infinite, and is refused
        return np.ascontiguousarray(values, dtype=np.float32)


class VectorPressureControl(gymnasium.vector.VectorEnv[Observation, NDArray[np.float32], NDArray[Any]]):
    """Environments that step together, in Rust, with the interpreter's lock released.

    Environment `i` of `n` runs the episodes `i`, `i + n`, `i + 2 n`, ... of a seed, whatever the number of threads. An environment
    whose episode has ended starts the next one at the next step, whose action it ignores (`AutoresetMode.NEXT_STEP`).

    Args:
        num_envs: Number of environments.
        seed: Seed of the episodes until `reset` names another one.
        threads: Number of threads.
        copy: Whether every step returns arrays of its own. Without, the next step overwrites them.
        options: As for `PressureControl`.
    """

    def __init__(
        self,
        num_envs: int = 1,
        *,
        seed: int = 0,
        threads: int = 1,
        copy: bool = True,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        if render_mode is not None:
            raise ValueError("a vector environment has no render mode: render a single one")
        for name, number in (("num_envs", num_envs), ("seed", seed), ("threads", threads)):
            if not isinstance(number, (int, np.integer)):
                raise TypeError(f"{name} is {number!r}: give a whole number")
        self._task = _task(**_checked(options))
        self.single_observation_space, self.single_action_space = _spaces(self._task, options.get("observation", "ours"))
        self._batch: _native.Batch | None = _native.Batch(self._task, seed, num_envs, threads)
        self.num_envs = num_envs
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.metadata = {"autoreset_mode": gymnasium.vector.AutoresetMode.NEXT_STEP, "render_modes": []}
        self.render_mode = None
        self._copy = copy
        self._never = np.zeros(num_envs, dtype=np.bool_)
        self._buffers = self._new_buffers()

    def _new_buffers(self) -> tuple[Observation, NDArray[np.float64], NDArray[np.bool_]]:
        shape = (self.num_envs, self._task.observations)
        return np.empty(shape, np.float32), np.zeros(self.num_envs), np.zeros(self.num_envs, np.bool_)

    def _open(self) -> _native.Batch:
        if self._batch is None:
            raise RuntimeError("the environments are closed: make other ones")
        return self._batch

    @property
    def steps(self) -> int:
        """Steps of the longest episode."""
        return self._task.steps

    def reset(
        self, *, seed: int | Sequence[int | None] | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Start an episode in every environment.

        Args:
            seed: Starts again with the first episodes of this seed.
            options: None: single environments have options.

        Returns:
            Observations of shape (num_envs, length), and an empty dictionary.

        Raises:
            ValueError: The seed is a list, or there are options.
        """
        if options:
            raise ValueError("a vector environment has no options of reset: use a single one")
        if seed is not None and not isinstance(seed, (int, np.integer)):
            raise ValueError("give one seed: the environments share its episodes")
        if self._copy:
            self._buffers = self._new_buffers()
        self._open().reset(None if seed is None else int(seed), *self._buffers)
        return self._buffers[0], {}

    def step(self, actions: NDArray[np.float32]) -> tuple[Observation, NDArray[Any], NDArray[Any], NDArray[Any], dict[str, Any]]:
        """Hold one action in every environment.

        Args:
            actions: Numbers from -1 to 1 of shape (num_envs, 1) or (num_envs,).

        Returns:
            Observations, rewards, which episodes ended, False for all, and the scores of those that ended (with masks, as
            Gymnasium has them).

        Raises:
            ValueError: The shape is wrong, or an action is not finite; then nothing moves.
            RuntimeError: The environments are closed.
        """
        batch = self._open()
        values = _flat(actions, self.num_envs)
        if self._copy:
            self._buffers = self._new_buffers()
        observations, rewards, ended = self._buffers
        batch.step(values, observations, rewards, ended)
        infos = self._infos(batch, ended) if ended.any() else {}
        truncated = np.zeros(self.num_envs, np.bool_) if self._copy else self._never
        return observations, rewards, ended, truncated, infos

    def _infos(self, batch: _native.Batch, ended: NDArray[np.bool_]) -> dict[str, Any]:
        infos: dict[str, Any] = {}
        for index in np.flatnonzero(ended):
            infos = self._add_info(infos, batch.episode(int(index)), int(index))
        return infos

    def close(self, **kwargs: Any) -> None:
        """End the environments; no further call but `close` is allowed."""
        self._batch = None
        self.closed = True


def _flat(actions: Any, count: int) -> NDArray[np.float32]:
    values = _numbers(actions, f"numbers of shape ({count}, 1)")
    if values.shape not in ((count, 1), (count,)):
        raise ValueError(f"the actions have shape {values.shape}: give ({count}, 1)")
    return values.reshape(count)


def vector(id: str, num_envs: int, seed: int = 0, threads: int = 1, **options: Any) -> VectorPressureControl:
    """Make a batch of a registered environment.

    Args:
        id: Name of the environment, such as `"eupnea/AdultFamily-v0"`.
        num_envs: Number of environments.
        seed: Seed of the episodes.
        threads: Number of threads; the results do not depend on it.
        options: Options of the environment in place of the registered ones.

    Returns:
        The environments, before their first episodes.

    Raises:
        ValueError: There is no such environment, or an option is wrong.
    """
    if id not in REGISTERED:
        raise ValueError(f"there is no environment {id!r}: choose from {', '.join(REGISTERED)}")
    return VectorPressureControl(num_envs, seed=seed, threads=threads, **{**REGISTERED[id], **options})


def protocol_episodes(*, prescriptions: str | None = None, breathing: bool = False, **_: Any) -> int:
    """Return the number of episodes of a reference score: 54, or 486 where patients breathe or prescriptions are drawn."""
    listed = prescriptions in (None, _native.PRESCRIPTIONS[0])
    return EPISODES if listed and not breathing else MANY_EPISODES


def score(
    policy: Policy,
    id: str = "eupnea/OneLung-v0",
    *,
    episodes: int | None = None,
    seed: int = SEED,
    **options: Any,
) -> dict[str, float]:
    """Score a policy: the protocol of the reference scores.

    Args:
        policy: Computes the action, one number from -1 to 1, for an observation. If it has the methods `reset()` and
            `start(rise_time)`, with the time of the target's rise in seconds, they are called before every episode.
        id: Name of the environment.
        episodes: Number of episodes, from the first one of the seed; default: that of the reference scores, `protocol_episodes`.
        seed: Seed of the episodes; the reference scores are those of the default.
        options: Options of the environment in place of the registered ones.

    Returns:
        Means over the complete episodes: `overshoot`, `rise_ms`, `plateau_error`, `late_error` and `effort` (NaN if there is none);
        the means over all episodes: `score`, for which an aborted episode counts with minus its mean reward, and `return`, the sum of
        an episode's rewards; and the share of episodes that the ventilator aborted, `aborted`.
    """
    if id not in REGISTERED:
        raise ValueError(f"there is no environment {id!r}: choose from {', '.join(REGISTERED)}")
    chosen = {**REGISTERED[id], **options}
    if episodes is None:
        episodes = protocol_episodes(**chosen)
    if episodes < 1:
        raise ValueError(f"{episodes} episodes: give at least one")
    environment = PressureControl(**chosen)
    ends: list[dict[str, Any]] = []
    for number in range(episodes):
        observation, _ = environment.reset(seed=seed, options={"number": number})
        begin(policy, environment.settings["rise_time"])
        rewards: list[float] = []
        ended = False
        info: dict[str, Any] = {}
        while not ended:
            observation, reward, ended, _, info = environment.step(policy(observation))
            rewards.append(reward)
        if info["fault"] is not None:
            info["score"] = -sum(rewards) / info["steps"]
        info["return"] = sum(rewards)
        ends.append(info)
    names = ("score", "overshoot", "rise_ms", "plateau_error", "late_error", "effort")
    complete = [end for end in ends if end["fault"] is None]
    means = {name: float(np.mean([end[name] for end in complete])) if complete else float("nan") for name in names}
    for name in ("score", "return"):
        means[name] = float(np.mean([end[name] for end in ends]))
    return {**means, "aborted": float(np.mean([end["fault"] is not None for end in ends]))}
