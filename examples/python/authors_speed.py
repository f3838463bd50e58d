r"""Times the environments of eupnea beside the learned lung of the paper's authors in JAX, the latter also with gradient.

Their packages of 2021 need JAX 0.4.13, which has lost three names that they use; the script supplies these, and empty modules for
packages that they import but do not need here. In an environment of its own (Python 3.10 or 3.11):

  pip install jax==0.4.13 jaxlib==0.4.13 flax==0.7.0 "numpy<2" "scipy<1.12" optax==0.1.7 "orbax-checkpoint<0.4" \
      dill tqdm pandas matplotlib scikit-learn ipython click
  pip install --no-deps deluca==0.0.17 deluca-lung==0.0.5
  pip install ./python
  python3 authors_speed.py 256

Their step is 30 ms of a learned lung under their deep controller, 29 steps to an inspiration, compiled before it is timed. Ours is 1 ms
of the physical bench under the whole ventilator, with the same observations. All runs share one processor core; the times are
those of the processor, so that other work on the machine counts little.
"""

from __future__ import annotations

import functools
import os
import statistics
import sys
import time
from collections.abc import Callable
from typing import Any
from unittest.mock import MagicMock

# Before JAX is imported: one thread, as for the bench of eupnea.
os.environ["XLA_FLAGS"] = "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1"
if hasattr(os, "sched_setaffinity"):
    os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})

import jax
import jax.numpy as jnp
import numpy as np

import eupnea

STEPS, ROUNDS, REPEATS, PEEP = 29, 5, 9, 5.0


def supply_what_is_missing() -> None:
    """Let the packages be imported."""
    jax.partial = functools.partial
    jax.ops.index_update = lambda array, index, value: array.at[index].set(value)
    jax.ops.index = np.s_
    for name in ("tensorflow", "torch", "torch.nn", "torch.nn.functional", "torch.utils", "torch.utils.data",
                 "torch.utils.tensorboard", "tensorboard"):  # fmt: skip
        sys.modules.setdefault(name, MagicMock())


def rollout() -> tuple[Any, Callable[[Any, jax.Array], jax.Array]]:
    """Return their controller, and its mean error from a pressure."""
    from deluca.lung.environments._stitched_sim import StitchedSim
    from deluca.lung.experimental.controllers._deep import Deep
    from deluca.lung.utils.data.transform import ShiftScaleTransform

    def scaler(mean: float, deviation: float) -> Any:
        return ShiftScaleTransform([jnp.array([mean - deviation, mean + deviation])])

    # Mean and deviation of their recordings. The speed does not depend on the weights.
    lung = StitchedSim.create(u_scaler=scaler(11.2, 15.8), p_scaler=scaler(21.2, 10.0), reset_scaled_peep=-1.51)
    controller = Deep.create(kernel_size=(5,))

    def error(controller: Any, pressure: jax.Array) -> jax.Array:
        state, seen = lung.reset()
        state = state.replace(predicted_pressure=pressure)
        memory = controller.init()

        def step(carry: Any, _: None) -> tuple[Any, jax.Array]:
            state, seen, memory = carry
            target = memory.waveform.at(seen.time)
            memory, u_in = controller(memory, seen)
            state, seen = lung(state, (u_in, 0))
            return (state, seen, memory), jnp.abs(target - seen.predicted_pressure)

        return jax.lax.scan(step, (state, seen, memory), None, length=STEPS)[1].mean()

    return controller, error


def ours(batch: int) -> Callable[[], None]:
    """Return so many steps of our environments as an inspiration of theirs has."""
    environments = eupnea.vector("eupnea/OneLung-v0", batch, observation="authors", hold=1)
    environments.reset()
    actions = np.full((batch, 1), -0.7, np.float32)

    def run() -> None:
        for _ in range(STEPS):
            environments.step(actions)

    return run


def steps_per_second(run: Callable[[], Any], batch: int) -> float:
    """Time a function that runs an inspiration of a batch."""
    run()
    rates = []
    for _ in range(REPEATS):
        begun = time.process_time()
        for _ in range(ROUNDS):
            run()
        rates.append(ROUNDS * STEPS * batch / (time.process_time() - begun))
    return statistics.median(rates)


def main() -> None:
    """Print the steps per second of a batch."""
    batch = int(sys.argv[1]) if len(sys.argv) > 1 else 256
    supply_what_is_missing()
    controller, error = rollout()
    several = jax.jit(jax.vmap(error, in_axes=(None, 0)))
    slope = jax.jit(jax.grad(lambda given, starts: several(given, starts).mean(), allow_int=True))
    starts = PEEP + jnp.linspace(0.0, 1.0, batch)
    kinds: dict[str, Callable[[], Any]] = {
        "theirs, rollout": lambda: jax.block_until_ready(several(controller, starts)),
        "theirs, rollout and gradient": lambda: jax.block_until_ready(slope(controller, starts)),
        "ours, environment": ours(batch),
    }
    for name, run in kinds.items():
        print(f"{name:>28}, batch {batch}: {steps_per_second(run, batch) / 1e6:.3f} million steps/s")


if __name__ == "__main__":
    main()
