# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # From `pip install` to a better controller in 15 lines
#
# This notebook records a virtual ventilator, learns a simulator from the recording, trains a small network by back-propagation through
# that simulator, and compares it with a PID. It needs a minute, and `pip install './python[frames]' matplotlib` from a clone of the
# repository. Open it as a notebook with `jupytext --to ipynb first_controller.py`.

# %%
import eupnea

# %% [markdown]
# **Record.** A PID with known-good gains ventilates a lung with R 20 cmH2O/(L/s) and C 20 mL/cmH2O; random perturbations make the
# recording varied.

# %%
recording = eupnea.collect(bench="R20C20", breaths=120, seed=1)
recording.pandas().query("breath == 10").plot("tick", ["target", "pressure", "u_in"], subplots=True, figsize=(7, 4))

# %% [markdown]
# **Learn a simulator.** The open-loop distance is its error when it replays the recorded commands without ever seeing a pressure.

# %%
fitted = eupnea.fit(recording, out="simulator.safetensors", epochs=300)
print(f"open-loop distance on held-out breaths: {fitted['open_loop']:.3f} cmH2O")

# %% [markdown]
# **Train and compare.** A residual learns through the simulator. It is added to the best PID for this lung, which `trainer tune-pid`
# found. Both are scored on the true bench, under the same sensor noise.

# %%
gains = (6.5, 265, 0.13)
trained = eupnea.train("run", simulator="simulator.safetensors", gains=gains, iterations=300)
result = eupnea.evaluate(trained["controller"], bench="R20C20")
for name, scores in result["mean"].items():
    print(f"{name:8} error {scores['score']:.3f} cmH2O, overshoot {scores['overshoot']:.2f} cmH2O")

# %%
breath = {"bench": "R20C20", "breaths": 1, "pips": 25, "exploration": "none", "seed": 7}
curves = eupnea.collect(gains=gains, **breath).pandas()[["tick", "target", "pressure_true"]].set_axis(["tick", "target", "PID"], axis=1)
curves["learned"] = eupnea.collect(controller=trained["controller"], **breath)["pressure_true"]
colours = {"target": "#3F4B57", "PID": "#0072B2", "learned": "#D55E00"}  # those of the reports
curves[:500].plot("tick", color=colours, xlabel="time, ms", ylabel="airway pressure, cmH2O", figsize=(7, 3))

# %%
assert result["mean"]["learned"]["score"] < result["mean"]["pid"]["score"], "the learned controller is better"

# %% [markdown]
# ## Beneath the commands
#
# The simulator is differentiable: this is how the pressure at 100 ms depends on each command before.

# %%
import matplotlib.pyplot as plt
import numpy as np

simulator = eupnea.Simulator.load("simulator.safetensors")
commands = np.full((1, 300), 20, np.float32)
at_100_ms = np.zeros_like(commands)
at_100_ms[0, 100] = 1
plt.figure(figsize=(7, 2))
plt.plot(simulator.gradient(commands, at_100_ms)[0, :120])
plt.xlabel("time of the command, ms")
plt.ylabel("cmH2O per percent")
plt.show()

# %% [markdown]
# Bench and ventilator step tick by tick. The ventilator is the code of the chip, monitors included.

# %%
bench, ventilator = eupnea.Bench("R20C20", seed=7), eupnea.Ventilator(eupnea.Controller.load(trained["controller"]), pip=25)
pressure, commands = 5.0, []
for _ in range(500):
    u_in, u_out, *_ = ventilator.step(pressure, bench.outlet_reading(), bench.flow_reading())
    pressure = bench.step(u_in, u_out)
    commands.append(u_in)
plt.figure(figsize=(7, 2))
plt.plot(commands)
plt.xlabel("time, ms")
plt.ylabel("inspiratory valve, %")
plt.show()
