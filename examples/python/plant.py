"""A lung model on Eupnea's plant link (docs/PLANT_LINK.md) with a control period of 30 ms; standard library only.
As a server: python3 plant.py 7000, then trainer collect --plant tcp:localhost:7000 --out a.parquet
On a pipe: trainer collect --plant 'pipe:python3 plant.py' --out a.parquet"""
import random, socket, struct, sys, zlib

VERSION, HIGHEST_CMH2O, PERIOD_US, PIECE = 1, 150, 30_000, 0.006  # the model's time step is 6 ms
RESISTANCE, COMPLIANCE, FULL_FLOW = 20.0, 0.02, 1.5  # cmH2O/(L/s), L/cmH2O, L/s
LATE, LAG, DEAD_ZONE, NOISE = 2, 0.025, 4.0, 0.1  # valve: steps, s, percent; sensor: cmH2O


class Lung:
    peep, seed, measured = 5.0, 0, 5.0

    def reset(self):
        self.random = random.Random(self.seed)
        self.volume, self.opening, self.command = self.peep * COMPLIANCE, 0.0, 0.0
        self.pressure = self.measured = self.peep

    def step(self, u_in, u_out):
        for piece in range(5):
            above = (self.command if piece < LATE else u_in) - DEAD_ZONE
            self.opening += PIECE / (LAG + PIECE) * (max(0.0, above / (100.0 - DEAD_ZONE)) ** 1.3 - self.opening)
            flow = FULL_FLOW * self.opening * max(0.0, 1.0 - self.pressure / HIGHEST_CMH2O)
            flow -= u_out * max(0.0, self.volume / COMPLIANCE - self.peep) / (RESISTANCE + 5.0)
            self.volume += PIECE * flow
            self.pressure = self.volume / COMPLIANCE + RESISTANCE * flow
        self.command, self.measured = u_in, self.pressure + self.random.gauss(0.0, NOISE)


def serve(reader, writer):
    lung = Lung()
    while len(frame := reader.read(16)) == 16:
        _, kind, tick, payload, crc = struct.unpack("<BBH8sI", frame)
        assert crc == zlib.crc32(frame[:12]), "damaged frame of the plant link"
        if kind == 1:  # Reset
            lung.reset()
        elif kind == 2:  # Step
            lung.step(*struct.unpack("<fI", payload))
        elif kind == 5:  # Peep
            lung.peep = struct.unpack("<fI", payload)[0]
        elif kind == 6:  # Seed
            lung.seed = struct.unpack("<Q", payload)[0]
        if kind == 7:  # Hello: Greeting
            head = struct.pack("<BBHHHI", 0xA5, 8, tick, VERSION, HIGHEST_CMH2O, PERIOD_US)
        else:  # Truth to Reset and Step, else Ready
            answer, truth = (9, lung.pressure) if kind in (1, 2) else (3, 0.0)
            head = struct.pack("<BBHff", 0xA5, answer, tick, lung.measured, truth)
        writer.write(head + struct.pack("<I", zlib.crc32(head)))
        writer.flush()


if len(sys.argv) == 1:
    serve(sys.stdin.buffer, sys.stdout.buffer)
else:
    server = socket.create_server(("localhost", int(sys.argv[1])))
    print("listening on port", server.getsockname()[1], file=sys.stderr, flush=True)
    while True:
        with server.accept()[0] as line, line.makefile("rwb") as both:
            serve(both, both)
