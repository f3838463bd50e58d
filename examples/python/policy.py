"""A policy on Eupnea's policy link (docs/POLICY_LINK.md): a PI in Python, or a network from an ONNX or PyTorch file.

The PI needs the standard library only; --onnx needs numpy and onnxruntime, --torch needs numpy and torch.

Examples:
  python3 policy.py --port 7100 &
  lab evaluate --policy tcp:localhost:7100 --bench R20C20
  lab evaluate --policy 'pipe:python3 policy.py --gains 2,30'
  lab evaluate --policy 'pipe:python3 policy.py --onnx controller.onnx' --gains 6.5,265,0.13"""
import argparse, math, socket, struct, sys, zlib

VERSION, START, FRAME, DEFAULT_PERIOD_US = 1, 0xA6, 32, 1000
HELLO, GREETING, RESET, BREATH, READY, OBSERVE, COMMAND, LEARN = range(1, 9)


class Pi:
    """Proportional-integral control of the inspiratory valve."""

    period_us = 0  # any

    def __init__(self, gains):
        self.p, self.i = gains

    def reset(self, period_s):
        self.period_s = period_s

    def start(self, rise_s):
        self.integral = 0.0

    def command(self, pressure, target, pip, peep, applied, time_s):
        error = target - pressure
        wanted = self.p * error + self.integral
        if 0.0 < wanted < 100.0 or (wanted >= 100.0) != (error > 0.0):  # a saturated integral does not wind up
            self.integral += self.i * self.period_s * error
        return wanted

    def learn(self, lesson, applied):
        pass


class Network:
    """A network with the inputs of docs/POLICY_LINK.md; `run` maps a list of arrays to one. Other inputs and outputs are its state."""

    def __init__(self, run, shapes, period_us):
        import numpy

        self.numpy, self.run, self.shapes, self.period_us = numpy, run, shapes, period_us

    def reset(self, period_s):
        self.state = [self.numpy.zeros(shape, self.numpy.float32) for shape in self.shapes[1:]]

    def start(self, rise_s):
        self.rise_s = rise_s  # the network sees by the time that a breath begins

    def command(self, *seen):
        return self.step(*seen, -1.0, self.rise_s)

    def learn(self, lesson, applied):
        if self.shapes[0][1] > 6:  # it learns from breath to breath
            self.step(0.0, 0.0, 0.0, 0.0, applied, 0.0, float(lesson), 0.0)

    def step(self, *seen):
        row = self.numpy.array([seen[: self.shapes[0][1]]], self.numpy.float32)
        outputs = self.run([row] + self.state)
        self.state = outputs[1 : 1 + len(self.state)]
        return float(outputs[0].reshape(-1)[0])


def onnx(path):
    import onnxruntime

    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # a small network is faster without a pool of threads
    session = onnxruntime.InferenceSession(path, options, providers=["CPUExecutionProvider"])
    inputs = session.get_inputs()
    shapes = [[size if isinstance(size, int) else 1 for size in given.shape] for given in inputs]
    period_us = int(session.get_modelmeta().custom_metadata_map.get("period_us", 0))
    names, kinds = zip(*[(given.name, given.type) for given in inputs])
    if set(kinds) != {"tensor(float)"} or shapes[0][-1] not in (6, 8):
        sys.exit(f"{path} takes {kinds[0]} of shape {shapes[0]}: export it with float32 of shape [1, 6] or [1, 8]")
    return Network(lambda values: session.run(None, dict(zip(names, values))), shapes, period_us)


def torch(path):
    import torch

    try:
        model = torch.jit.load(path)
    except RuntimeError:
        model = torch.export.load(path).module()

    def run(values):
        with torch.no_grad():
            outputs = model(*[torch.from_numpy(value) for value in values])
        return [output.numpy() for output in (outputs if isinstance(outputs, (tuple, list)) else [outputs])]

    return Network(run, [[1, 6]], 0)


def limited(percent):
    """Within the valve's range, unless it is not a number: the ventilator must see that."""
    return min(100.0, max(0.0, percent)) if math.isfinite(percent) else percent


def serve(policy, reader, writer):
    period_s = DEFAULT_PERIOD_US * 1e-6
    while len(frame := reader.read(FRAME)) == FRAME:
        start, kind, number, payload, crc = struct.unpack("<BBH24sI", frame)
        assert start == START and crc == zlib.crc32(frame[:28]), "damaged frame of the policy link"
        answer = (READY, b"")
        if kind == HELLO:
            answer = (GREETING, struct.pack("<II", VERSION, policy.period_us))
        elif kind == RESET:
            period_s = struct.unpack_from("<I", payload)[0] * 1e-6
            policy.reset(period_s)
        elif kind == BREATH:
            policy.start(struct.unpack_from("<I", payload, 16)[0] * period_s)
        elif kind == OBSERVE:
            *seen, tick = struct.unpack("<fffffI", payload)
            answer = (COMMAND, struct.pack("<f", limited(policy.command(*seen, tick * period_s))))
        elif kind == LEARN:
            policy.learn(*struct.unpack_from("<If", payload))
        head = struct.pack("<BBH24s", START, answer[0], number, answer[1])
        writer.write(head + struct.pack("<I", zlib.crc32(head)))
        writer.flush()


def main():
    described = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=described)
    which = parser.add_mutually_exclusive_group()
    which.add_argument("--gains", default="3,60", metavar="P,I", help="percent per cmH2O, and per cmH2O and second")
    which.add_argument("--onnx", metavar="FILE", help="run this network with onnxruntime")
    which.add_argument("--torch", metavar="FILE", help="run this TorchScript or torch.export file")
    parser.add_argument("--port", type=int, help="serve TCP on this port, 0 for any [default: standard input and output]")
    given = parser.parse_args()
    found = [load(path) for path, load in [(given.onnx, onnx), (given.torch, torch)] if path]
    policy = found[0] if found else Pi(float(gain) for gain in given.gains.split(","))
    if given.port is None:
        return serve(policy, sys.stdin.buffer, sys.stdout.buffer)
    server = socket.create_server(("localhost", given.port))
    print("listening on port", server.getsockname()[1], file=sys.stderr, flush=True)
    while True:
        with server.accept()[0] as line, line.makefile("rwb") as both:
            line.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            serve(policy, both, both)


if __name__ == "__main__":
    main()
