"""A ventilator on Eupnea's device link (docs/DEVICE_LINK.md): a PID on a one-compartment lung; standard library only.
python3 device.py              prints the pseudo-terminal on which it listens, for trainer collect --port NAME
python3 device.py /dev/ttyS0   listens on a serial port (needs pyserial)"""
import os, struct, sys, time, tty, zlib
from contextlib import suppress

VERSION, THIRD_PARTY, PERIOD_US, BATCH, QUEUE = 4, 3, 1000, 16, 8
STANDBY, VENTILATING, FAULT = b"\0", b"\1", b"\2\2"  # modes; the fault is 2, HighPressure
REFUSED, LATCHED, NO_FAULT, UNKNOWN, FULL, NOT_CONFIRMED = 9, 4, 5, 13, 14, 23  # the response and its reasons
SETTINGS = (20, 5, 20, 1, 0, 0.5, 5, 60, 0, 0, 0, 0, 0, 0)  # PIP, PEEP, rate, ... in the order of the link
LEAST, MOST = (5, 0, 4, 0.2, 0, 0, 0, 15) + 6 * (0,), (60, 20, 80, 5, 1, 2, 20, 70, 10, 20, 3e3, 3e3, 60, 60)
RESISTANCE, COMPLIANCE, FULL_FLOW, LAG, DEAD_ZONE = 20.0, 0.02, 1.5, 0.025, 4.0  # in L, cmH2O, s, percent


def varint(number):
    low, rest = number & 127, number >> 7
    return bytes([low | 128]) + varint(rest) if rest else bytes([low])


def take_varint(data):
    higher, rest = take_varint(data[1:]) if data[0] > 127 else (0, data[1:])
    return data[0] & 127 | higher << 7, rest


def floats(*values):
    return struct.pack(f"<{len(values)}f", *values)


def frame(content):
    content, out = content + struct.pack("<I", zlib.crc32(content)), b"\0"
    for part in content.split(b"\0"):
        while len(part) >= 254:
            out, part = out + b"\xff" + part[:254], part[254:]
        out += bytes([len(part) + 1]) + part
    return out + b"\0"


def content_of(stuffed):
    """The content between two delimiters; empty if it is damaged."""
    out, zero = b"", b""
    while stuffed:
        code = stuffed[0]
        out, zero, stuffed = out + zero + stuffed[1:code], b"" if code == 255 else b"\0", stuffed[code:]
    content, crc = out[:-4], out[-4:]
    return content if crc == struct.pack("<I", zlib.crc32(content)) else b""


class Ventilator:
    settings, queue, gains, mode, confirmed = SETTINGS, [], (3.0, 30.0, 0.0), STANDBY, False
    telemetry, samples, batches, ticks, breath, tick = False, [], 0, 0, 0, 0
    opening, volume, pressure, integral, before = 0.0, 5 * COMPLIANCE, 5.0, 0.0, 0.0

    def answer(self, kind, rest):
        if kind == 0:  # Identify: kind, period, mode, PID; explores not, no weights, power on, no failure, no key
            head = bytes([0]) + varint(VERSION) + bytes([0, 1, 0, THIRD_PARTY]) + varint(PERIOD_US)
            return head + self.mode + b"\0" + floats(*self.gains) + bytes(7)
        if kind in (2, 13):  # ApplySettings, QueueSettings
            asked = struct.unpack("<14f", rest[:56])
            for field, (value, least, most) in enumerate(zip(asked, LEAST, MOST)):
                if not least <= value <= most:  # also NaN
                    return bytes([REFUSED, 0, 0, field]) + floats(value, least, most)
            if kind == 13 and len(self.queue) == QUEUE:
                return bytes([REFUSED, FULL])
            self.queue, self.confirmed = (self.queue if kind == 13 else []) + [asked], True
            if kind == 13:
                return bytes([10, QUEUE - len(self.queue)])
        if kind in (1, 2):  # GetSettings
            return b"\1" + floats(*self.settings) + (b"\1" + floats(*self.queue[0]) if self.queue else b"\0")
        if kind == 3:  # Start
            if self.mode != STANDBY or not self.confirmed:
                return bytes([REFUSED, LATCHED if self.mode == FAULT else NOT_CONFIRMED])
            self.mode, self.breath, self.tick, self.samples = VENTILATING, 0, 0, []
        elif kind == 5 and self.mode != FAULT:
            return bytes([REFUSED, NO_FAULT])
        elif kind == 5 or kind == 4 and self.mode == VENTILATING:  # Acknowledge, Stop
            self.mode, self.confirmed, self.queue = STANDBY, False, []
        elif kind == 6 and rest[0] == 0:  # SetController: a PID
            self.gains = struct.unpack("<3f", rest[1:13])
            return b"\3\0" + floats(*self.gains)
        elif kind == 8:  # Telemetry
            self.telemetry = rest[0] == 1
            return b"\5" + rest[:1]
        elif kind == 19:  # GetAlarms: present and indicated, a bit per fault; the PID is in command
            return b"\x0e" + 2 * varint((self.mode == FAULT) << 2) + b"\1"
        elif kind != 4:
            return bytes([REFUSED, UNKNOWN])
        return b"\2" + self.mode

    def step(self, dt):
        """One control period of a ventilation; returns the events to send."""
        if self.tick == 0 and self.queue:
            self.settings = self.queue.pop(0)
        pip, peep, rate, inspiration, rise, fall, u_in, limit = self.settings[:8]
        total, inspired, fallen = (int(s / dt + 0.5) for s in (60 / rate, inspiration, inspiration + fall))
        phase = (self.tick >= inspired) + (self.tick >= fallen)  # inspiration, fall, expiration
        way = (min(1, self.tick * dt / rise if rise else 1), 1 - (self.tick - inspired) / max(1, fallen - inspired), 0)
        target, (p, i, d) = peep + way[phase] * (pip - peep), self.gains
        error, first = target - self.pressure, self.tick == 0
        if phase == 0:
            self.integral = 0.0 if first else min(100, max(0, self.integral + i * error * dt))
            u_in = min(100, max(0, p * error + self.integral + (0 if first else d * (error - self.before) / dt)))
        self.before = error
        self.opening += dt / (LAG + dt) * (max(0, u_in - DEAD_ZONE) / (100 - DEAD_ZONE) - self.opening)
        flow = FULL_FLOW * self.opening - (phase > 0) * max(0, self.volume / COMPLIANCE - peep) / (RESISTANCE + 5)
        sample = varint(self.breath) + varint(self.tick) + bytes([phase, phase > 0])
        self.samples.append(sample + floats(target, self.pressure, u_in) + b"\0\0\1" + floats(flow))
        self.volume += dt * flow
        self.pressure = self.volume / COMPLIANCE + RESISTANCE * flow
        self.ticks, self.tick, alarm = self.ticks + 1, self.tick + 1, b""
        if self.tick >= total:
            self.breath, self.tick = self.breath + 1, 0
        if not self.pressure <= limit:  # latches the safe state: here the lung empties at once
            self.mode, self.opening, self.volume, self.pressure = FAULT, 0.0, peep * COMPLIANCE, peep
            alarm = frame(b"\1\2" + FAULT[1:] + varint(self.ticks))
        if len(self.samples) < BATCH and not alarm:
            return b""
        batch, count = varint(self.batches) + varint(self.ticks - len(self.samples)), varint(len(self.samples))
        content = b"\1\0" + batch + bytes(8) + count + b"".join(self.samples)
        self.batches, self.samples = self.batches + 1, []
        return frame(content) + alarm


def opened(name=None):
    if name:
        import serial
        port = serial.Serial(name, 1_000_000, timeout=0.002)
        return lambda: port.read(4096), port.write
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    print("listening on", os.ttyname(slave), file=sys.stderr, flush=True)
    return lambda: os.read(master, 4096), lambda data: os.write(master, data)


(read, write), ventilator, due = opened(*sys.argv[1:2]), Ventilator(), time.monotonic()
heard, pending, last = b"", b"", (b"", b"")
while True:
    out = time.sleep(0.002) or b""
    with suppress(BlockingIOError):  # nothing has come
        heard += read()
    *frames, heard = heard.split(b"\0")
    for content in filter(None, map(content_of, frames)):
        if content != last[0]:  # a repeated request is answered again, but not executed again
            sequence, rest = take_varint(content)
            kind, rest = take_varint(rest)
            last = content, frame(b"\0" + varint(sequence) + ventilator.answer(kind, rest))
        out += last[1]
    while due <= time.monotonic():
        due += PERIOD_US * 1e-6
        events = ventilator.step(PERIOD_US * 1e-6) if ventilator.mode == VENTILATING else b""
        out += events if ventilator.telemetry else b""
    pending += out if len(pending) < 65536 else b""  # nobody reads: lost batches show in their numbers
    with suppress(BlockingIOError):
        pending = pending[write(pending) :]
