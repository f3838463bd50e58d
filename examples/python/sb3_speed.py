"""Times the PPO of sb3.py on the environments of eupnea, and on the same bench behind the plant link (docs/PLANT_LINK.md).

Behind the link, every tick of every environment is one exchange of 16-byte frames over TCP with a process that serves the bench;
observations and rewards are the same, but no ventilator checks the commands. PPO runs on one thread, the bench on another.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import socket
import statistics
import struct
import sys
import threading
import time
import zlib
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from sb3 import BREATHS, HOLD, learner
from stable_baselines3.common.vec_env import DummyVecEnv, VecEnv

import eupnea
from eupnea._native import Observer
from eupnea.sb3 import REWARD_SCALE, VecPressureControl

EXAMPLES = """examples:
  python3 sb3_speed.py
  python3 sb3_speed.py --steps 25600 --repeats 5 --json speed.json

Run it where nothing else runs: the median over the repeats is printed."""

LUNG = "R20C20"
FRAME, PERIOD_US = 16, 1000
#: Ticks of inspiration, fall and the rest of the breath, and the commands in the latter two, percent.
TICKS, FALL, REST, NONE, BIAS = 1000, 500, 1500, 0.0, 5.0
PIPS, PEEP = (10.0, 15.0, 20.0, 25.0, 30.0, 35.0), 5.0
RESET, STEP, READY, SET_PEEP, SEED, HELLO, GREETING, TRUTH = 1, 2, 3, 5, 6, 7, 8, 9


def framed(kind: int, tick: int, payload: bytes) -> bytes:
    """Make a frame."""
    head = struct.pack("<BBH", 0xA5, kind, tick) + payload
    return head + struct.pack("<I", zlib.crc32(head))


def opened(frame: bytes) -> tuple[int, int, bytes]:
    """Return kind, tick and payload of a frame."""
    _, kind, tick, payload, crc = struct.unpack("<BBH8sI", frame)
    if crc != zlib.crc32(frame[:12]):
        raise ValueError("a frame of the plant link is damaged")
    return kind, tick, payload


def answer(line: socket.socket) -> None:
    """Be the bench at the end of one line."""
    line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    bench, seed, peep, reading = eupnea.Bench(LUNG), 0, PEEP, PEEP
    with line, line.makefile("rb") as frames:
        while len(frame := frames.read(FRAME)) == FRAME:
            kind, tick, payload = opened(frame)
            if kind == STEP:
                u_in, u_out = struct.unpack("<fI", payload)
                reading = bench.step(u_in, bool(u_out))
            elif kind == RESET:
                reading = bench.reset(seed, peep)
            elif kind == SET_PEEP:
                peep = struct.unpack("<fI", payload)[0]
                bench.set_peep(peep)
            elif kind == SEED:
                seed = struct.unpack("<Q", payload)[0]
            if kind == HELLO:
                reply = framed(GREETING, tick, struct.pack("<HHI", 1, 1000, PERIOD_US))
            elif kind in (RESET, STEP):
                reply = framed(TRUTH, tick, struct.pack("<ff", reading, bench.truth()["airway_pressure"]))
            else:
                reply = framed(READY, tick, struct.pack("<ff", reading, 0.0))
            line.sendall(reply)


def serve(server: socket.socket) -> None:
    """Serve a bench to everyone who connects."""
    while True:
        line, _ = server.accept()
        threading.Thread(target=answer, args=(line,), daemon=True).start()


class LinkedControl(gymnasium.Env[np.ndarray, np.ndarray]):
    """One bench behind the plant link, with the observations and rewards of `PressureControl`."""

    def __init__(self, port: int, first: int, hold: int) -> None:
        like = eupnea.PressureControl(hold=hold)
        self.observation_space, self.action_space = like.observation_space, like.action_space
        self._line = socket.create_connection(("localhost", port))
        self._line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        self._answers = self._line.makefile("rb")
        self._observer = Observer("ours", PERIOD_US)
        self._number, self._frames, self._tick, self._breath = first, 0, 0, 0
        self._pip, self._hold = PIPS[0], hold
        self._exchange(HELLO, struct.pack("<II", 1, 0))

    def _exchange(self, kind: int, payload: bytes) -> tuple[float, float]:
        self._frames = (self._frames + 1) % 65536
        self._line.sendall(framed(kind, self._frames, payload))
        _, tick, values = opened(self._answers.read(FRAME))
        if tick != self._frames:
            raise ValueError("the plant answered another frame")
        return struct.unpack("<ff", values)

    def _see(self, pressure: float) -> np.ndarray:
        return self._observer.see(pressure, self._pip, self._pip, PEEP, self._tick)

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict[str, Any]]:
        """Start the next inspiration."""
        super().reset(seed=seed)
        self._pip = PIPS[self._number % len(PIPS)]
        self._tick = self._breath = 0
        self._exchange(SEED, struct.pack("<Q", self._number))
        self._exchange(SET_PEEP, struct.pack("<fI", PEEP, 0))
        pressure, self._true = self._exchange(RESET, struct.pack("<II", PERIOD_US, 0))
        self._number += 1
        self._observer.start_breath(0.0)
        return self._see(pressure), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict[str, Any]]:
        """Hold an action."""
        command = 50.0 + 50.0 * float(action[0])
        error = 0.0
        for _ in range(self._hold):
            error += abs(self._true - self._pip)
            pressure, self._true = self._exchange(STEP, struct.pack("<fI", command, 0))
            self._observer.applied(command)
            self._tick += 1
            observation = self._see(pressure)
        ended = False
        if self._tick >= TICKS:
            self._breath += 1
            ended = self._breath == BREATHS
            if not ended:
                observation = self._expire()
        return observation, -REWARD_SCALE * error / self._hold, ended, False, {}

    def _expire(self) -> np.ndarray:
        """Run the expiration; returns the first observation of the next breath."""
        for ticks, command in ((FALL, NONE), (REST, BIAS)):
            for _ in range(ticks):
                pressure, self._true = self._exchange(STEP, struct.pack("<fI", command, 1))
        self._tick = 0
        self._observer.start_breath(BIAS)
        return self._see(pressure)


def check(port: int, hold: int) -> None:
    """Exit if an episode behind the link has other observations or rewards than that of the package with the same noise."""
    number = 3
    link, native = LinkedControl(port, number, hold), eupnea.PressureControl(hold=hold, breaths=BREATHS)
    seen, _ = link.reset()
    expected, _ = native.reset(seed=0, options={"pip": PIPS[number], "noise": number})
    ended, step = False, 0
    while not ended:
        # Open to the middle for the rise, then less.
        action = np.full(1, -0.5 if step * hold % TICKS < TICKS // 10 else -0.7, np.float32)
        same = np.array_equal(seen, expected)
        seen, reward, ended, _, _ = link.step(action)
        expected, wanted, *_ = native.step(action)
        if not same or abs(reward - REWARD_SCALE * wanted) > 1e-6:
            sys.exit(f"step {step} behind the link differs from that of the package")
        step += 1


def seconds(make: Callable[[], VecEnv], steps: int) -> tuple[float, float]:
    """Time the environments alone, and with PPO, for so many steps."""
    environments = make()
    environments.reset()
    actions = np.full((environments.num_envs, 1), -0.6, np.float32)
    begun = time.perf_counter()
    for _ in range(steps // environments.num_envs):
        environments.step(actions)
    alone = time.perf_counter() - begun
    model = learner("ppo", environments, 1)  # type: ignore[arg-type]
    begun = time.perf_counter()
    model.learn(steps)
    return alone, time.perf_counter() - begun


def main() -> int:
    """Run the command line; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, epilog=EXAMPLES, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--envs", type=int, default=8, metavar="N", help="environments [default: 8]")
    parser.add_argument("--hold", type=int, default=HOLD, metavar="N",
                        help=f"ticks for which an action is held [default: {HOLD}]")  # fmt: skip
    parser.add_argument("--steps", type=int, default=12_800, metavar="N", help="steps of a run [default: 12800]")
    parser.add_argument("--repeats", type=int, default=3, metavar="N", help="runs of each kind [default: 3]")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write the results as JSON")
    given = parser.parse_args()
    torch.set_num_threads(1)
    server = socket.create_server(("localhost", 0))
    process = multiprocessing.get_context("fork").Process(target=serve, args=(server,), daemon=True)
    process.start()
    port = server.getsockname()[1]
    check(port, given.hold)
    kinds: dict[str, Callable[[], VecEnv]] = {
        "native": lambda: VecPressureControl(num_envs=given.envs, hold=given.hold, breaths=BREATHS),
        "link": lambda: DummyVecEnv([partial(LinkedControl, port, number, given.hold) for number in range(given.envs)]),
    }
    times: dict[str, list[tuple[float, float]]] = {name: [] for name in kinds}
    # In turn, so that a busy machine slows both.
    for _ in range(given.repeats):
        for name, make in kinds.items():
            times[name].append(seconds(make, given.steps))
    process.terminate()
    results: dict[str, Any] = {"steps": given.steps, "envs": given.envs, "hold": given.hold, "lung": LUNG}
    for index, what in enumerate(("environments", "ppo")):
        median = {name: statistics.median(run[index] for run in runs) for name, runs in times.items()}
        results[what] = {**{f"{name}_s": median[name] for name in kinds}, "ratio": median["link"] / median["native"]}
        print(f"{what:>12}: native {median['native']:7.2f} s, plant link {median['link']:7.2f} s, "
              f"{median['link'] / median['native']:5.1f} times")  # fmt: skip
    if given.json:
        given.json.write_text(json.dumps(results, indent=2) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
