"""User-defined controllers, judged and contained by the ventilator's safety envelope.

A policy is a function of six numbers, in the order of the policy link (docs/POLICY_LINK.md): measured pressure, target, PIP and PEEP
(cmH2O), the last applied command (percent), and the time since the breath began (s). It returns the command of the inspiratory valve,
0 to 100 percent. `Agent` makes a policy from a trained agent, `Known` from a controller of this package, `onnx` from a file.

A policy may also have:

- `period_us`: the only control period that it supports, in microseconds; without it, or with 0, any. The trainer refuses another one.
- `reset()`: called before another ventilation begins. The policy must forget everything.
- `start()`: called when a breath begins, before the first command of the breath.
- `learn(lesson, applied)`: called after the last command of an inspiration, for policies that learn from breath to breath. `lesson` is
  a `Lesson`; `applied` is the command that the valve had in the last tick, in percent.
"""

from __future__ import annotations

import enum
import math
import operator
import os
import socket
import struct
import threading
import warnings
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import numpy as np
from numpy.typing import NDArray

from eupnea._native import Controller, Observer

Policy = Callable[[NDArray[np.float32]], float]

#: Version of the policy link.
VERSION = 1
FRAME = struct.Struct("<BBH6I")
START_BYTE = 0xA6
HELLO, GREETING, RESET, START, READY, OBSERVE, COMMAND, LEARN = range(1, 9)

#: Half, and the full command in percent: as float32, so that an action gives the bits of the environment's command.
HALF, FULL = np.float32(0.5), np.float32(100)
#: Columns of a network's first input: the six numbers of a policy, these and the lesson, or these and the time of the target's rise.
SEEN, SEEN_AND_LESSON, SEEN_LESSON_AND_RISE = 6, 7, 8
#: Lesson of a row that is a tick.
NO_LESSON = -1.0


class Lesson(enum.IntEnum):
    """What a policy that learns from breath to breath should do with the breath that has ended."""

    #: It ran undisturbed: learn from it.
    ADOPT = 0
    #: It was disturbed, by an effort or the pressure limit for example: keep only what earlier breaths taught.
    DISCARD = 1
    #: The next breath has other settings than a small step of PIP or PEEP: forget all breaths.
    FORGET = 2


class Agent:
    """A policy from an agent that was trained in an environment with `action="valve"`.

    The agent gets the observations of the environment, and each of its actions is held for as many ticks as there.

    Args:
        act: Computes the action, one number from -1 to 1, for an observation.
        observation: As in the environment.
        hold: Control ticks for which an action is held, as in the environment.
        period_us: Control period in microseconds, as in the environment.

    Raises:
        ValueError: There is no such observation, or a number is out of range.
    """

    def __init__(
        self,
        act: Callable[[NDArray[np.float32]], Any],
        *,
        observation: str = "ours",
        hold: int = 10,
        period_us: int = 1000,
    ) -> None:
        self._act = act
        self._observer = Observer(observation, period_us)
        self._hold = _ticks(hold)
        #: Control period in microseconds.
        self.period_us = period_us
        self._period_s = period_us * 1e-6
        self._command = 0.0
        self._rise_ticks = 0

    def start(self, rise_time: float) -> None:
        """Begin a breath whose target rises within `rise_time` seconds."""
        self._rise_ticks = round(rise_time / self._period_s)

    def __call__(self, seen: NDArray[np.float32]) -> float:
        """Return the command in percent for the six numbers of a policy."""
        pressure, target, pip, peep, last, time = map(float, seen)
        tick = round(time / self._period_s)
        if tick == 0:
            self._observer.start_breath(last)
        else:
            self._observer.applied(last)
        observation = self._observer.see(pressure, target, pip, peep, tick, self._rise_ticks)
        if tick % self._hold == 0:
            action = np.asarray(self._act(observation), np.float32).reshape(-1)[:1]
            # An action that is not finite gives no command.
            limited = np.where(np.isfinite(action), np.clip(action, -1, 1), np.float32(np.nan))
            self._command = float((FULL * (HALF + HALF * limited))[0])
        return self._command


class Known:
    """A policy from a controller of this package.

    On the policy link, a learned controller gets the lessons of the ventilator. Elsewhere, where the time 0 begins a breath, it learns
    from every breath.

    Args:
        controller: The controller.
        as_action: Whether to return the command as the action of an environment, -1 to 1; the environment needs
            `observation="plain"` and `hold=1`.
    """

    def __init__(self, controller: Controller, *, as_action: bool = False) -> None:
        self._controller = controller
        self._as_action = as_action
        self._starts = True
        self._rise_time = 0.0

    @property
    def period_us(self) -> int:
        """Control period in microseconds."""
        return self._controller.period_us

    def reset(self) -> None:
        """Forget all breaths: another ventilation begins."""
        self._controller.reset()
        self._starts = True

    def start(self, rise_time: float) -> None:
        """Begin a breath, whose target rises within `rise_time` seconds, with the next command."""
        self._starts = True
        self._rise_time = rise_time

    def learn(self, lesson: int, applied: float) -> None:
        """Learn from the inspiration that has ended, whose last command was `applied` percent."""
        self._controller.learn(lesson, applied)

    def __call__(self, seen: NDArray[np.float32]) -> float:
        """Return the command for the six numbers of a policy."""
        pressure, target, pip, peep, last, time = map(float, seen)
        begins = self._starts or time == 0.0
        if begins:
            self._controller.start_breath(last)
            self._starts = False
        command = self._controller.step(
            pressure, target, pip=pip, peep=peep, rise_time=self._rise_time, applied=None if begins else last
        )
        return command / 50.0 - 1.0 if self._as_action else command


def _ticks(hold: Any) -> int:
    """Return the ticks for which an action is held."""
    with suppress(TypeError):
        if not isinstance(hold, bool) and operator.index(hold) >= 1:
            return operator.index(hold)
    raise ValueError(f"hold is {hold!r}: give a whole number of control ticks, at least 1, as in the environment")


def begin(policy: object, rise_time: float) -> None:
    """Tell a policy that another ventilation begins, whose targets rise within `rise_time` seconds, if it has the methods for it."""
    _tell(policy, "reset")
    _tell(policy, "start", rise_time)


def _tell(policy: object, name: str, *arguments: Any) -> None:
    """Call a method of a policy that not every policy has."""
    method = getattr(policy, name, None)
    if callable(method):
        method(*arguments)


class _Network:
    """A network in onnxruntime with its state."""

    def __init__(self, session: Any) -> None:
        inputs = session.get_inputs()
        shapes = [[size if isinstance(size, int) else 1 for size in given.shape] for given in inputs]
        if not shapes or shapes[0] not in ([1, SEEN], [1, SEEN_AND_LESSON], [1, SEEN_LESSON_AND_RISE]):
            found = f"has shape {inputs[0].shape}" if inputs else "is missing"
            raise ValueError(
                f"the first input {found}: it must be (1, 6), or (1, 7) or (1, 8) for a network that learns from breath to breath"
            )
        if len(session.get_outputs()) < len(inputs):
            raise ValueError(
                f"{len(inputs)} inputs but {len(session.get_outputs())} outputs: output n must be the next value of input n, after the"
                " command"
            )
        self._session = session
        self._names = [given.name for given in inputs]
        self._columns, self._shapes = shapes[0][1], shapes[1:]
        period = session.get_modelmeta().custom_metadata_map.get("period_us", "0")
        if not (period.isascii() and period.isdigit()):
            raise ValueError(f"the metadata entry period_us is {period!r}: write a whole number of microseconds")
        #: Control period in microseconds; 0 if any is possible.
        self.period_us = int(period)
        self.reset()
        # The declared shapes of outputs may be incomplete, so a trial shows whether they are right.
        command, *state = self._run([0.0] * self._columns)
        if command.size != 1:
            raise ValueError(f"the first output has shape {command.shape}: it must have one element, the command in percent")
        for name, shape, following in zip(self._names[1:], self._shapes, state, strict=False):
            if list(following.shape) != shape or following.dtype != np.float32:
                raise ValueError(
                    f"the state {name!r} is float32 of shape {tuple(shape)}, but its next value, the output in the same place, is"
                    f" {following.dtype} of shape {following.shape}: they must be the same"
                )

    def reset(self) -> None:
        """Set the state to zero: another ventilation begins."""
        self._state = [np.zeros(shape, np.float32) for shape in self._shapes]
        self._rise_time = 0.0

    def start(self, rise_time: float) -> None:
        """Begin a breath whose target rises within `rise_time` seconds."""
        self._rise_time = rise_time

    def learn(self, lesson: int, applied: float) -> None:
        """Run the network with the lesson, if it has an input for it."""
        if self._columns > SEEN:
            self._step([0.0, 0.0, 0.0, 0.0, applied, 0.0, float(lesson), 0.0])

    def __call__(self, seen: NDArray[np.float32]) -> float:
        """Return the command for the six numbers of a policy."""
        command = self._step([*seen, NO_LESSON, self._rise_time])
        # A command that is not finite stays, so that the ventilator refuses it.
        return min(max(command, 0.0), 100.0) if math.isfinite(command) else command

    def _step(self, row: list[float]) -> float:
        command, *following = self._run(row[: self._columns])
        self._state = following[: len(self._state)]
        return float(command.item())

    def _run(self, row: list[float]) -> list[Any]:
        values = [np.array([row], np.float32), *self._state]
        outputs: list[Any] = self._session.run(None, dict(zip(self._names, values, strict=True)))
        return outputs


def onnx(path: str | os.PathLike[str]) -> Policy:
    """Make a policy from an ONNX file, such as a controller that `eupnea.export` wrote.

    The first input has the shape (1, 6): the six numbers of a policy. The first output has one element, the command in percent, which
    is then limited to 0 to 100. With an input of shape (1, 7), the network learns from breath to breath: the last number is -1 in a
    tick; after each inspiration, it is the lesson, in a run of its own. With (1, 8), the number after it is the time of the target's
    rise in seconds. Every further input is a part of the state, which is zero when a ventilation begins: input `n` gets the value of
    output `n` of the run before. All are float32. A dimension without a size, such as that of a batch, is 1. The metadata entry
    `period_us` is the network's control period in microseconds.

    Args:
        path: The file.

    Returns:
        The policy.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: onnxruntime is missing.
        ValueError: The file is not such a network.
    """
    path = os.fspath(path)
    if not os.path.exists(path):
        raise FileNotFoundError(f"there is no policy {path}")
    try:
        import onnxruntime
    except ImportError:
        raise ImportError("ONNX policies need onnxruntime: pip install './python[onnx]'") from None
    options = onnxruntime.SessionOptions()
    # A small network is faster without a pool of threads.
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    try:
        session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise ValueError(f"{path} is not an ONNX file: {error}") from None
    try:
        return _Network(session)
    except Exception as error:
        # A wrong type of an input shows in the trial only, as an error of onnxruntime.
        raise ValueError(f"{path} is not a policy: {error}") from None


@contextmanager
def served(policy: Policy | str | None) -> Iterator[str | None]:
    """Serve a policy on the policy link for as long as the context lasts.

    Args:
        policy: The policy, or the address of one that is served elsewhere.

    Yields:
        The address, or None without a policy.
    """
    if policy is None or (isinstance(policy, str) and policy.strip()):
        yield policy
        return
    if not callable(policy):
        text = "give a function of six numbers, or an address (tcp:HOST:PORT or pipe:COMMAND)"
        raise ValueError(f"the policy is {policy!r}: {text}")
    period_us = _period_us(policy)
    with socket.create_server(("127.0.0.1", 0)) as server:
        failures: list[BaseException] = []
        thread = threading.Thread(target=_serve, args=(server, policy, period_us, failures), daemon=True)
        thread.start()
        try:
            yield f"tcp:127.0.0.1:{server.getsockname()[1]}"
        except RuntimeError as error:
            if failures:
                raise RuntimeError(f"the policy failed: {failures[0]!r}; {error}") from failures[0]
            raise
        finally:
            server.shutdown(socket.SHUT_RDWR)
            thread.join()
    if failures:
        warnings.warn(f"the policy failed, and the PID went on: {failures[0]!r}", RuntimeWarning, stacklevel=4)


def _serve(server: socket.socket, policy: Policy, period_us: int, failures: list[BaseException]) -> None:
    while True:
        try:
            line, _ = server.accept()
        except OSError:
            return
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # When the ventilator closes the line, it needs no answer any more.
        with suppress(OSError), line, line.makefile("rb") as frames:
            _answer(line, frames, policy, period_us, failures)


def _answer(line: socket.socket, frames: Any, policy: Policy, period_us: int, failures: list[BaseException]) -> None:
    period_s = 1e-3
    while len(frame := frames.read(FRAME.size + 4)) == FRAME.size + 4:
        _, kind, number, *words = FRAME.unpack(frame[: FRAME.size])
        answer, value, own_period_us = READY, 0, 0
        if kind == HELLO:
            answer, value, own_period_us = GREETING, VERSION, period_us
        elif kind == RESET:
            period_s = words[0] * 1e-6
        try:
            if kind == RESET:
                _tell(policy, "reset")
            elif kind == START:
                _tell(policy, "start", words[4] * period_s)
            elif kind == LEARN:
                _tell(policy, "learn", Lesson(words[0]), struct.unpack("<f", struct.pack("<I", words[1]))[0])
            elif kind == OBSERVE:
                seen = np.frombuffer(frame, "<f4", 5, 4)
                answer, value = COMMAND, _command(policy, np.array([*seen, words[5] * period_s], np.float32))
        except Exception as error:
            # The link ends, and the PID commands from there on.
            failures.append(error)
            return
        body = FRAME.pack(START_BYTE, answer, number, value, own_period_us, 0, 0, 0, 0)
        line.sendall(body + struct.pack("<I", zlib.crc32(body)))


def _period_us(policy: object) -> int:
    """Return the control period of a policy, microseconds; 0 if it supports any."""
    period_us = getattr(policy, "period_us", 0)
    with suppress(TypeError):
        if 0 <= operator.index(period_us) < 2**32:
            return operator.index(period_us)
    raise ValueError(f"period_us of the policy is {period_us!r}: give a whole number of microseconds, or 0 for any period")


def _command(policy: Policy, observation: NDArray[np.float32]) -> int:
    """Return the bits of the policy's command."""
    with np.errstate(over="ignore"):
        command = np.asarray(policy(observation), np.float32).reshape(())
    return int(command.view(np.uint32))
