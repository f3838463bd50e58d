"""Opens the trainer's files, and runs a learned controller in numpy as the chip does (docs/FILES.md).

  python3 files.py recording.parquet simulator.safetensors controller.safetensors [weights.bin]

The recording must be of that controller without exploration (trainer collect --controller F --exploration none).
The script computes the commands again from the recorded pressures; they must match the recorded ones to 1e-6 percent.
"""
import json, struct, sys, zlib

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
from safetensors import safe_open

F = np.float32  # all calculations are in single precision and in the documented order
TOLERANCE = 1e-6  # percent of the valve


def opened(path, kind):
    """The description and the only vector in a safetensors file of the trainer."""
    with safe_open(path, framework="np") as file:
        (name,) = file.keys()
        return json.loads(file.metadata()["eupnea-" + kind]), file.get_tensor(name)


def lag_factor(tau, period):
    return period / (F(tau) + period)


def limit(value, low, high):
    return F(min(max(value, low), high))


class Controller:
    SHAPE = (33, 32, 16, 1)

    def __init__(self, spec, parameters):
        self.period = F(spec["period_us"]) * F(1e-6)
        self.p, self.i, self.d = (F(spec["gains"][name]) for name in "pid")
        self.reach, self.authority = F(spec["lambda"]) * F(100), F(spec["authority"])
        seen = spec["features"]
        self.error_taps, self.command_taps = seen["error_taps"], seen["command_taps"]
        self.error_factors = [lag_factor(tau, self.period) for tau in seen["error_averages"]]
        self.command_factors = [lag_factor(tau, self.period) for tau in seen["command_averages"]]
        self.times = [F(tau) for tau in seen["times"]]
        self.target_ahead = seen["target_ahead"]
        self.layers, at = [], 0
        for inputs, outputs in zip(self.SHAPE, self.SHAPE[1:]):
            weights = parameters[at : at + inputs * outputs].reshape(outputs, inputs)
            at += weights.size
            self.layers.append((weights, parameters[at : at + outputs]))
            at += outputs
        assert at == parameters.size, f"the network must have the shape {self.SHAPE}"
        self.memory = Memory(spec["period_us"])

    def start_breath(self, command):
        """Starts a breath; the last command was `command` percent."""
        self.errors, self.commands = [], []
        self.before = F(command) / F(50)  # the commands before the breath
        self.error_averages, self.command_averages = [F(0)] * 2, [self.before] * 2
        self.integral, self.derivative, self.last, self.tick = F(0), F(0), None, 0

    def network(self, values):
        for number, (weights, bias) in enumerate(self.layers):
            sums = bias.copy()
            for column, value in zip(weights.T, values):  # input by input, for the same roundings
                sums += column * value
            hidden = number < len(self.layers) - 1
            values = sums / (F(1) + np.abs(sums)) if hidden else sums
        return values[0]

    def features(self, pressure, target, pip, peep, rise_ticks):
        error = (target - pressure) / F(10)
        self.errors.append(error)
        self.error_averages = averaged(self.error_averages, self.error_factors, error)
        ago = lambda past, age, first: past[self.tick - age] if age <= self.tick else first
        time = F(self.tick) * self.period
        now = rising(pip, peep, rise_ticks, self.tick)
        return [
            *(ago(self.errors, age, F(0)) for age in self.error_taps),
            *(ago(self.commands, age, self.before) for age in self.command_taps),
            *self.error_averages,
            *self.command_averages,
            self.integral / F(50),
            *(time / (time + tau) for tau in self.times),
            (pip - F(20)) / F(15),
            (peep - F(5)) / F(5),
            *((rising(pip, peep, rise_ticks, self.tick + ahead) - now) / F(10) for ahead in self.target_ahead),
        ]

    def command(self, pressure, target, pip, peep, rise_ticks):
        """The command of one tick, percent."""
        features = self.features(pressure, target, pip, peep, rise_ticks)
        output = self.network(features + self.memory.recall(self.tick))
        residual = limit(self.reach * output, -self.authority, self.authority)
        error = target - pressure
        change = F(0) if self.last is None else pressure - self.last
        self.last = pressure
        slope = -(self.d / self.period) * change
        self.derivative += lag_factor(0.01, self.period) * (slope - self.derivative)
        wanted = self.p * error + self.integral + self.derivative + residual
        if not (wanted >= 100 and error > 0 or wanted <= 0 and error < 0):
            self.integral = limit(self.integral + self.i * self.period * error, F(-100), F(100))
        return limit(wanted, F(0), F(100))

    def applied(self, command):
        """Records the applied command and ends the tick."""
        self.memory.record(self.errors[self.tick], command / F(50))
        self.commands.append(command / F(50))
        self.command_averages = averaged(self.command_averages, self.command_factors, command / F(50))
        self.tick += 1


def rising(pip, peep, rise_ticks, tick):
    """Target at a tick of an inspiration without end."""
    return peep + (pip - peep) * (F(tick) / F(rise_ticks)) if tick < rise_ticks else pip


class Memory:
    """What earlier breaths have taught: error and command, averaged over bins."""

    SECTIONS = ((64, 1), (32, 2), (32, 16))  # number of bins, and their width in shortest bins
    LEAST_BINS, LEARNING = 8, 4
    ERRORS_AHEAD, COMMANDS_AHEAD = (1, 3, 5, 7, 10), (0, 3)
    SURPRISE = F(0.05)

    def __init__(self, period_us):
        self.ticks = max(1, int(0.008e6 / period_us + 0.5))
        self.widths = [width for bins, width in self.SECTIONS for _ in range(bins)]
        self.pieces, start = [], 0
        for bins, width in self.SECTIONS:
            first, bin = F(start + 0.5 * (width - 1)), sum(n for n, w in self.SECTIONS if w < width)
            if self.pieces:
                last, number, rate = self.pieces[-1]
                last += F(bin - 1 - number) / rate
                self.pieces.append((last, bin - 1, F(1) / (first - last)))
            self.pieces.append((first, bin, F(1) / F(width)))
            start += bins * width
        self.forget()
        self.start()

    def start(self):
        """Starts an inspiration."""
        self.running, self.difference = [], F(0)
        self.sums, self.filled = [F(0), F(0)], 0

    def forget(self):
        self.mean, self.adopted, self.surprised = [], 0, False

    def record(self, error, command):
        """Records a tick of the inspiration."""
        self.sums = [self.sums[0] + error, self.sums[1] + command]
        self.filled += 1
        ticks = self.ticks * self.widths[min(len(self.running), len(self.widths) - 1)]
        if self.filled == ticks:
            self.fill([F(1) / F(ticks) * value for value in self.sums])
            self.sums, self.filled = [F(0), F(0)], 0

    def fill(self, new):
        place = len(self.running)
        if place == len(self.widths):
            return
        if place < len(self.mean):
            old = self.mean[place]
            self.difference += abs(new[0] - old[0])
            if not self.surprised:
                new = [a + F(0.5) * (b - a) for a, b in zip(old, new)]
        self.running.append(new)

    def adopt(self):
        """Ends an undisturbed inspiration."""
        filled = len(self.running)
        surprises = self.adopted >= self.LEARNING and self.difference >= self.SURPRISE * F(filled)
        if filled >= self.LEAST_BINS and (not surprises or self.surprised):
            self.mean, self.surprised = self.running, False
            self.adopted = 1 if surprises else min(self.adopted + 1, self.LEARNING)
        else:
            self.surprised = bool(surprises)
        self.start()

    def recall(self, tick):
        """What is recalled at a tick of the inspiration."""
        if not self.mean:
            return [F(0)] * (len(self.ERRORS_AHEAD) + len(self.COMMANDS_AHEAD) + 1)
        now = F(max(tick - self.ticks // 2, 0)) / F(self.ticks)

        def at(ahead, signal):
            time = now + F(ahead)
            middle, bin, rate = [piece for piece in self.pieces if time >= piece[0]][-1]
            bins = (time - middle) * rate
            place = bin + int(bins)
            first, second = (self.mean[min(place + n, len(self.mean) - 1)][signal] for n in (0, 1))
            return first + (bins - F(int(bins))) * (second - first)

        errors = [at(ahead, 0) for ahead in self.ERRORS_AHEAD]
        return errors + [at(ahead, 1) for ahead in self.COMMANDS_AHEAD] + [F(1)]


def averaged(averages, factors, value):
    return [average + factor * (value - average) for average, factor in zip(averages, factors)]


def replayed(controller, recording):
    """Largest difference from the recorded commands over all inspirations, and the number of ticks."""
    worst, ticks, command, settings = 0.0, 0, 0.0, None
    for _, breath in recording.groupby("breath"):
        before, settings = settings, (breath.pip.iloc[0], breath.peep.iloc[0])
        if settings != before:
            controller.memory.forget()
        controller.start_breath(command)
        inspiration = breath[breath.phase == 0]
        rise_ticks = int((inspiration.target < inspiration.pip).sum())
        for row in inspiration.itertuples():
            wanted = controller.command(F(row.pressure), F(row.target), F(row.pip), F(row.peep), rise_ticks)
            worst, ticks = max(worst, abs(float(wanted) - row.u_in)), ticks + 1
            controller.applied(F(row.u_in))
        controller.memory.adopt()
        command = breath.u_in.iloc[-1]
    return worst, ticks


def exercised(controller):
    """Last command, and CRC-32 of all commands, in the exercise of the weights image."""
    controller.memory.forget()
    commands = b""
    for ticks in (160, 80):
        controller.start_breath(5)
        for tick in range(ticks):
            error = F(0.5) * F(7 * tick % 16) - F(2)
            target = rising(F(25), F(8), 64, tick)
            command = controller.command(target - error, target, F(25), F(8), 64)
            controller.applied(command)
            commands += struct.pack("<f", command)
        controller.memory.adopt()
    return commands[-4:], zlib.crc32(commands)


def main(recording_path, simulator_path, controller_path, image_path=None):
    recording = pd.read_parquet(recording_path)
    origin = json.loads(pq.read_metadata(recording_path).metadata[b"eupnea"])
    print(f"recording: {recording.breath.nunique()} breaths of {origin['plant']}, {origin['period_us']} us")
    print(recording.groupby("pip").pressure.agg(["count", "max"]).head(3).to_string())
    simulator, parameters = opened(simulator_path, "simulator")
    assert np.isfinite(parameters).all()
    print(f"simulator: {simulator['architecture']}, {parameters.size} parameters, of {simulator['plant']}")
    spec, network = opened(controller_path, "controller")
    controller = Controller(spec, network)
    assert spec["period_us"] == origin["period_us"], "recording and controller have different control periods"
    worst, ticks = replayed(controller, recording)
    print(f"controller: {ticks} commands replayed, the largest difference is {worst:.1e} percent")
    if not (ticks > 0 and worst <= TOLERANCE):
        sys.exit(f"the commands differ by more than {TOLERANCE} percent; use a recording of this controller without exploration")
    if image_path:
        with open(image_path, "rb") as file:
            image = file.read()
        golden = image[115:119], struct.unpack("<I", image[119:123])[0]
        if exercised(controller) != golden:
            sys.exit("the exercise gives other bits than the weights image; pack the image from this controller")
        print("weights image: all commands of its exercise are the same, bit for bit")


if __name__ == "__main__":
    main(*sys.argv[1:])
