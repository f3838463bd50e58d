"""Controllers of your own, judged and contained by the ventilator's safety envelope.

A policy is a function of six numbers, in the order of the policy link (docs/POLICY_LINK.md): measured pressure, target, PIP and PEEP
(cmH2O), the last applied command (percent), and the time since the breath began (s). It returns the command of the inspiratory valve,
0 to 100 percent. If it has a method `reset`, that is called before another ventilation begins. `Agent` makes a policy of an agent that
was trained in an environment, `onnx` one of a file.
"""

from __future__ import annotations

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


class Agent:
    """A policy from what was trained in an environment: it sees the same observations and holds each action as long.

    Args:
        act: Computes the action, one number from -1 to 1, for an observation.
        observation: As in the environment.
        hold: Control ticks for which an action is held.
        period_us: Control period in microseconds.

    Raises:
        ValueError: There is no such observation.
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
        self._hold = hold
        self._period_s = period_us * 1e-6
        self._command = 0.0

    def __call__(self, seen: NDArray[np.float32]) -> float:
        """Return the command in percent for the six numbers of a policy."""
        pressure, target, pip, peep, last, time = map(float, seen)
        tick = round(time / self._period_s)
        if tick == 0:
            self._observer.start_breath(last)
        else:
            self._observer.applied(last)
        observation = self._observer.see(pressure, target, pip, peep, tick)
        if tick % self._hold == 0:
            action = float(np.asarray(self._act(observation)).reshape(-1)[0])
            self._command = 50.0 + 50.0 * min(max(action, -1.0), 1.0)
        return self._command


class Known:
    """A policy from a controller of this package.

    Args:
        controller: The controller.
        as_action: Whether to return the command as the action of an environment, -1 to 1; the environment needs
            `observation="plain"` and `hold=1`.
    """

    def __init__(self, controller: Controller, *, as_action: bool = False) -> None:
        self._controller = controller
        self._as_action = as_action

    def reset(self) -> None:
        """Forget all breaths: another ventilation begins."""
        self._controller.reset()

    def __call__(self, seen: NDArray[np.float32]) -> float:
        """Return the command for the six numbers of a policy."""
        pressure, target, pip, peep, last, time = map(float, seen)
        if time == 0.0:
            self._controller.start_breath(last)
        command = self._controller.step(pressure, target, pip=pip, peep=peep)
        return command / 50.0 - 1.0 if self._as_action else command


def reset(policy: object) -> None:
    """Tell a policy that another ventilation begins, if it has a method `reset`."""
    forget = getattr(policy, "reset", None)
    if callable(forget):
        forget()


def onnx(path: str | os.PathLike[str]) -> Policy:
    """Make a policy of an ONNX file with one input of shape (1, 6) and one output, the command in percent.

    Args:
        path: The file.

    Returns:
        The policy.

    Raises:
        FileNotFoundError: There is no such file.
        ImportError: onnxruntime is missing.
        ValueError: The file is no such policy.
    """
    if not os.path.exists(path):
        raise FileNotFoundError(f"there is no policy {os.fspath(path)}")
    try:
        import onnxruntime
    except ImportError:
        raise ImportError("ONNX policies need onnxruntime: pip install './python[onnx]'") from None
    try:
        session = onnxruntime.InferenceSession(os.fspath(path), providers=["CPUExecutionProvider"])
    except Exception as error:
        raise ValueError(f"{os.fspath(path)} is not an ONNX file: {error}") from None
    inputs = session.get_inputs()
    if len(inputs) != 1:
        raise ValueError(f"{os.fspath(path)} has {len(inputs)} inputs: a policy has one, of shape (1, 6)")
    name = inputs[0].name

    def policy(seen: NDArray[np.float32]) -> float:
        return float(np.asarray(session.run(None, {name: seen.reshape(1, -1)})[0]).reshape(-1)[0])

    return policy


@contextmanager
def served(policy: Policy | str | None) -> Iterator[str | None]:
    """Serve a policy on the policy link for as long as the context lasts.

    Args:
        policy: The policy, or the address of one that is served elsewhere.

    Yields:
        The address, or None without a policy.
    """
    if policy is None or isinstance(policy, str):
        yield policy
        return
    if not callable(policy):
        raise ValueError(f"the policy is {policy!r}: give a function of six numbers, or an address")
    with socket.create_server(("127.0.0.1", 0)) as server:
        failures: list[BaseException] = []
        thread = threading.Thread(target=_serve, args=(server, policy, failures), daemon=True)
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


def _serve(server: socket.socket, policy: Policy, failures: list[BaseException]) -> None:
    while True:
        try:
            line, _ = server.accept()
        except OSError:
            return
        line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # When the ventilator closes the line, it needs no answer any more.
        with suppress(OSError), line, line.makefile("rb") as frames:
            _answer(line, frames, policy, failures)


def _answer(line: socket.socket, frames: Any, policy: Policy, failures: list[BaseException]) -> None:
    period_s = 1e-3
    while len(frame := frames.read(FRAME.size + 4)) == FRAME.size + 4:
        _, kind, number, *words = FRAME.unpack(frame[: FRAME.size])
        answer, value = READY, 0
        if kind == HELLO:
            answer, value = GREETING, VERSION
        elif kind == RESET:
            period_s = words[0] * 1e-6
        try:
            if kind == RESET:
                reset(policy)
            elif kind == OBSERVE:
                seen = np.frombuffer(frame, "<f4", 5, 4)
                answer, value = COMMAND, _command(policy, np.array([*seen, words[5] * period_s], np.float32))
        except Exception as error:
            # The link ends, and the PID commands from there on.
            failures.append(error)
            return
        body = FRAME.pack(START_BYTE, answer, number, value, 0, 0, 0, 0, 0)
        line.sendall(body + struct.pack("<I", zlib.crc32(body)))


def _command(policy: Policy, observation: NDArray[np.float32]) -> int:
    """Return the bits of the policy's command."""
    with np.errstate(over="ignore"):
        command = np.asarray(policy(observation), np.float32).reshape(())
    return int(command.view(np.uint32))
