"""The native half of the package. Pressures are in cmH2O, flows in L/s, commands in percent of the valve."""

import os
from collections.abc import Callable, Sequence
from typing import Any, TypedDict, final

import numpy as np
from numpy.typing import NDArray

_PathLike = str | os.PathLike[str]

#: P, I and D of the PID to which the chip falls back.
KNOWN_GOOD: tuple[float, float, float]
#: Names of the shipped prescriptions, of which the first are the usual ones.
PRESCRIPTIONS: list[str]

class Truth(TypedDict):
    """True state of a bench: pressures in cmH2O, flows in L/s."""

    airway_pressure: float
    sensor_pressure: float
    alveolar_pressure: float
    muscle_pressure: float
    flow_valve: float
    flow_lung: float
    flow_expiratory: float
    flow_leak: float
    flow_relief: float
    lung_volume_ml: float
    valve_position: float
    expiratory_opening: float
    efforts: float

@final
class Bench:
    """A simulated ventilator, circuit, lung and patient, in steps of 1 ms."""

    def __init__(self, lung: str = "R20C20", *, seed: int = 0, peep: float | None = None) -> None:
        """Start at rest.

        Args:
            lung: Name such as `"R20C20"`, `"iso-07"` or `"neonate-R100C2"`.
            seed: Seed of the sensors' noise.
            peep: PEEP in cmH2O; default: that of the settings.

        Raises:
            ValueError: There is no such lung, or a value is out of range.
        """

    @staticmethod
    def from_toml(text: str) -> Bench:
        """Build the bench of a description in TOML, which can set every parameter."""

    @staticmethod
    def preset(name: str) -> list[Bench]:
        """Build the benches that a name selects, such as `"paper"` (9 lungs) or `"iso"` (21)."""

    @property
    def name(self) -> str:
        """Name of the bench."""

    def to_toml(self) -> str:
        """Describe all parameters in TOML."""

    def reset(self, seed: int = 0, peep: float | None = None) -> float:
        """Go back to rest; returns the pressure there, cmH2O."""

    def step(self, u_in: float, u_out: bool) -> float:
        """Run one millisecond.

        Args:
            u_in: Command of the inspiratory valve, 0 to 100 percent; limited to that range, and 0 if it is not finite.
            u_out: Whether the expiratory valve is open.

        Returns:
            The reading of the pressure sensor at the end, cmH2O.
        """

    def run(self, u_in: Sequence[float] | NDArray[np.float32], u_out: bool) -> NDArray[np.float32]:
        """Run one millisecond for each command, shape (n,); returns the readings, shape (n,), cmH2O."""

    def set_peep(self, peep: float) -> None:
        """Set the mechanical PEEP valve, cmH2O."""

    def outlet_reading(self) -> float:
        """Read the pressure sensor at the machine's outlet, cmH2O."""

    def flow_reading(self) -> float:
        """Read the flow sensor at the airway, L/s."""

    def truth(self) -> Truth:
        """Return the true state, which no ventilator can see."""

@final
class Family:
    """Ranges for the parameters of a bench, from which a seed draws any number of plants."""

    def __init__(self, name: str) -> None:
        """Read a family: `"adult"`, `"neonate"`, `"blower"` or a TOML file."""

    @staticmethod
    def from_toml(text: str) -> Family:
        """Build the family of a description in TOML."""

    @property
    def name(self) -> str:
        """Name of the family."""

    @property
    def pid(self) -> tuple[float, float, float] | None:
        """Gains of the best single PID of the family, if known."""

    @property
    def bedside_pid(self) -> tuple[float, float, float] | None:
        """The same under the prescriptions of the bedside."""

    def draw(self, seed: int, number: int) -> Bench:
        """Draw the plant with this number, from 0, of those that a seed gives."""

@final
class Controller:
    """A PID, or a PID with a learned residual: the code of the chip, with its state."""

    @staticmethod
    def pid(gains: Sequence[float], *, period_us: int = 1000) -> Controller:
        """Build a PID: percent per cmH2O, percent per cmH2O and second, percent per cmH2O/s."""

    @staticmethod
    def load(path: _PathLike) -> Controller:
        """Load a learned controller: `"adult"`, `"neonate"`, `"blower"`, a file of `train`, or a weights image (`.bin`)."""

    @property
    def name(self) -> str:
        """Gains or file."""

    @property
    def period_us(self) -> int:
        """Control period, microseconds."""

    @property
    def gains(self) -> tuple[float, float, float]:
        """Gains of the PID, or of the one underneath."""

    def reset(self) -> None:
        """Forget all breaths."""

    def start_breath(self, command: float = 0.0, *, learn: bool = True) -> None:
        """Start a breath.

        Args:
            command: Last command, percent.
            learn: Whether to adopt the breath before; do not adopt disturbed breaths. After a call of `learn`, it has no effect.
        """

    def learn(self, lesson: int, applied: float | None = None) -> None:
        """End an inspiration with a lesson, as the ventilator does; `start_breath` then adopts nothing.

        Args:
            lesson: 0 adopts the breath, 1 discards it, 2 forgets all breaths (`eupnea.policies.Lesson`).
            applied: Command that the valve had in the last tick, percent; default: the one that `step` returned.

        Raises:
            ValueError: There is no such lesson.
        """

    def step(
        self,
        pressure: float,
        target: float,
        *,
        pip: float | None = None,
        peep: float | None = None,
        rise_time: float = 0.0,
        applied: float | None = None,
    ) -> float:
        """Run one tick of an inspiration.

        Args:
            pressure: Measured pressure, cmH2O.
            target: Target, cmH2O.
            pip: PIP, cmH2O; default: the target.
            peep: PEEP, cmH2O; default: that of the settings.
            rise_time: Time of the target's rise from PEEP to PIP, s.
            applied: Command that the valve had in the last tick, percent; default: the one that was returned there.

        Returns:
            The command of the inspiratory valve before the safety filter, percent.
        """

    def __call__(
        self,
        pressures: Sequence[float] | NDArray[np.float32],
        targets: Sequence[float] | NDArray[np.float32],
        *,
        pip: float | None = None,
        peep: float | None = None,
        rise_time: float = 0.0,
    ) -> NDArray[np.float32]:
        """Run a tick for each pressure and target, shape (n,); returns the commands, shape (n,), percent."""

@final
class Ventilator:
    """The ventilator of the chip: breath timing, controller, monitors and safety filter."""

    def __init__(self, controller: Controller, *, monitors: bool = True, **settings: float) -> None:
        """Start to ventilate.

        Args:
            controller: The controller.
            monitors: Whether the safety monitors are on.
            settings: Settings by name, such as `pip=20`, `peep=5`, `rate=20`.

        Raises:
            ValueError: There is no such setting, or its value is out of range.
        """

    def step(
        self, pressure: float, outlet: float = ..., flow: float = ...
    ) -> tuple[float, bool, int, int, str | None, float, str, str | None]:
        """Run one control tick.

        Args:
            pressure: Reading of the airway sensor, cmH2O.
            outlet: Reading of the sensor at the outlet, cmH2O; NaN if there is none.
            flow: Reading of the flow sensor, L/s; NaN if there is none.

        Returns:
            Commands of the inspiratory valve (percent) and of the expiratory valve (whether it is open), number of the breath, tick
            within it, phase (`"inspiration"`, `"fall"`, `"expiration"`), target in cmH2O, level of the ladder of trust, and the alarm
            that begins, if one does. In standby the valves are safe (0, True), breath and tick are 0, the phase is None and the target
            is NaN.
        """

    def apply(self, **settings: float) -> None:
        """Change settings from the next breath on."""

    def set_controller(self, controller: Controller) -> None:
        """Replace the controller."""

    def start(self) -> None:
        """Start to ventilate after `stop`."""

    def stop(self) -> None:
        """Go to standby: the valves are safe."""

    def acknowledge(self) -> bool:
        """Acknowledge all alarms, and leave the latched safe state for standby; returns whether there was an alarm."""

    @property
    def mode(self) -> str:
        """`"standby"`, `"ventilating"` or `"fault"`."""

    @property
    def fault(self) -> str | None:
        """The fault that latched the safe state, if one did."""

    @property
    def period_us(self) -> int:
        """Control period, microseconds."""

    @property
    def settings(self) -> dict[str, float]:
        """The settings in force by name."""

@final
class Simulator:
    """A learned simulator of a plant, which anything differentiable can be trained through."""

    @staticmethod
    def load(path: _PathLike) -> Simulator:
        """Load a file of `fit`."""

    @property
    def plant(self) -> str:
        """Name of the plant it was learned from."""

    @property
    def architecture(self) -> str:
        """Name of the architecture."""

    @property
    def parameters(self) -> int:
        """Number of parameters."""

    @property
    def period_us(self) -> int:
        """Control period, microseconds."""

    @property
    def noise(self) -> float:
        """Standard deviation of the sensor noise in the recording, cmH2O."""

    @property
    def start_pressure(self) -> float:
        """Mean pressure before an inspiration in the recording, cmH2O."""

    def roll_out(
        self,
        commands: NDArray[np.float32],
        *,
        start_pressure: float | None = None,
        pip: float | None = None,
        rest: float | None = None,
        plateau_command: float | None = None,
        peep: float | None = None,
        resistance: float | None = None,
        compliance: float | None = None,
    ) -> NDArray[np.float32]:
        """Predict the pressures of inspirations.

        Args:
            commands: Commands of the inspiratory valve, percent, shape (breaths, ticks).
            start_pressure: Pressure before the inspiration, cmH2O; default: that of the recording.
            pip: Pressure at the end of the last inspiration, cmH2O; default: 20.
            rest: Command before the inspiration, percent; default: 5.
            plateau_command: Command at the end of the last inspiration, percent; default: `rest`.
            peep: PEEP, cmH2O, for a simulator of a family; default: 5.
            resistance: Resistance of the lung, cmH2O/(L/s), for a hybrid simulator; default: 20.
            compliance: Compliance of the lung, mL/cmH2O, for a hybrid simulator; default: 20.

        Returns:
            Pressures at the start of every tick, cmH2O, shape (breaths, ticks).

        Raises:
            TypeError: There is no such argument.
            ValueError: A shape is wrong, or a number is not finite.
        """

    def gradient(
        self,
        commands: NDArray[np.float32],
        d_pressures: NDArray[np.float32],
        *,
        start_pressure: float | None = None,
        pip: float | None = None,
        rest: float | None = None,
        plateau_command: float | None = None,
        peep: float | None = None,
        resistance: float | None = None,
        compliance: float | None = None,
    ) -> NDArray[np.float32]:
        """Back-propagate through `roll_out`.

        Args:
            commands: As in `roll_out`.
            d_pressures: Gradient of a loss with respect to the pressures, shape (breaths, ticks).
            start_pressure: As in `roll_out`, like all that follow.
            pip: Pressure at the end of the last inspiration.
            rest: Command before the inspiration.
            plateau_command: Command at the end of the last inspiration.
            peep: PEEP.
            resistance: Resistance of the lung.
            compliance: Compliance of the lung.

        Returns:
            Gradient of the loss with respect to the commands, shape (breaths, ticks).
        """

@final
class Observer:
    """The observations of an environment, for an agent that was trained there and runs elsewhere."""

    def __init__(self, kind: str = "ours", period_us: int = 1000) -> None:
        """Observe as in an environment: `"ours"`, `"authors"` or `"plain"`."""

    def start_breath(self, command: float) -> None:
        """Start a breath; the last command was `command` percent."""

    def see(self, pressure: float, target: float, pip: float, peep: float, tick: int, rise_ticks: int = 0) -> NDArray[np.float32]:
        """Return the observation of a tick, shape (length,); pressures in cmH2O, the target rises within `rise_ticks`."""

    def applied(self, command: float) -> None:
        """Record the command applied in the tick, percent."""

@final
class Task:
    """A validated task of an environment."""

    def __init__(
        self,
        *,
        benches: Sequence[Bench] | None = None,
        family: Family | None = None,
        prescriptions: str | None = None,
        pips: Sequence[float] | None = None,
        settings: dict[str, float] | None = None,
        breathing: bool = False,
        period_us: int = 1000,
        hold: int = 10,
        breaths: int = 1,
        observation: str = "ours",
        residual: tuple[Sequence[float] | None, float] | None = None,
        reward: tuple[float, float, float] = ...,
        monitors: bool = True,
    ) -> None: ...
    @property
    def observations(self) -> int:
        """Length of an observation."""

    @property
    def steps(self) -> int:
        """Steps of the longest episode."""

@final
class Environment:
    """One environment, before Gymnasium's interface."""

    def __init__(self, task: Task, seed: int) -> None: ...
    def reset(
        self,
        seed: int | None = None,
        number: int | None = None,
        pip: float | None = None,
        noise: int | None = None,
    ) -> NDArray[np.float32]:
        """Start an episode; returns its first observation, shape (observations,)."""

    def step(self, action: float) -> tuple[NDArray[np.float32], float, bool]:
        """Run one action; returns the observation, the reward, and whether the episode ended."""

    def episode(self) -> dict[str, Any]:
        """Return number, plant, PIP, steps and scores of the running or the last episode."""

    def settings(self) -> dict[str, float]:
        """Return the settings of its breaths by name."""

    def exploration(self, seed: int) -> NDArray[np.float32]:
        """Return the perturbation that a seed draws for the episode, percent, shape (ticks,)."""

    def inspiration(self) -> list[NDArray[np.float64]]:
        """Return true pressure and target (cmH2O) and command (percent) of the last inspiration, each of shape (ticks,)."""

@final
class Batch:
    """Environments that step together, before Gymnasium's interface."""

    def __init__(self, task: Task, seed: int, count: int, threads: int) -> None: ...
    def reset(
        self,
        seed: int | None,
        observations: NDArray[np.float32],
        rewards: NDArray[np.float64],
        ended: NDArray[np.bool_],
    ) -> None:
        """Start an episode in each of n environments.

        Args:
            seed: Starts again with the first episodes of this seed; None for the next ones.
            observations: Receives the observations, shape (n, observations).
            rewards: Receives zeros, shape (n,).
            ended: Receives False, shape (n,).
        """

    def step(
        self,
        actions: NDArray[np.float32],
        observations: NDArray[np.float32],
        rewards: NDArray[np.float64],
        ended: NDArray[np.bool_],
    ) -> None:
        """Run one action in each of n environments.

        Args:
            actions: Actions from -1 to 1, shape (n,).
            observations: Receives the observations, shape (n, observations).
            rewards: Receives the rewards, shape (n,).
            ended: Receives whether each episode ended, shape (n,).
        """

    def episode(self, index: int) -> dict[str, Any]:
        """Return number, plant, PIP and scores of the running or the last episode of an environment."""

def call(arguments: Sequence[str], progress: Callable[[str, int, int], None] | None = None) -> str:
    """Run a command of the trainer; returns the content of its JSON."""

def command_help(command: str) -> str:
    """Return the help of a command of the trainer."""

def command_options(command: str) -> dict[str, bool]:
    """Return the options of a command of the trainer, each with whether it is repeated for several values."""

def noise_seeds(command: str, seed: int) -> list[int]:
    """Return the seeds of the sensor noise that `"collect"`, `"evaluate"` or `"tune-pid"` uses with this seed."""
