"""A ventilator on Eupnea's device link (docs/DEVICE_LINK.md): a PID on a one-compartment lung; standard library only.
python3 device.py                 prints the pseudo-terminal at which it listens, for trainer collect --port NAME
python3 device.py /dev/ttyGS0     listens on that serial port (needs pyserial)"""
import math, os, struct, sys, time, zlib

VERSION, PERIOD_US, BATCH = 4, 1000, 16
THIRD_PARTY, STANDBY, VENTILATING, FAULT, HIGH_PRESSURE, REFUSED = 3, 0, 1, 2, 2, 9
NO_FAULT, UNKNOWN_REQUEST, QUEUE_FULL, NOT_CONFIRMED, QUEUE = 5, 13, 14, 23, 8
SETTINGS = (20, 5, 20, 1, 0, 0.5, 5, 60, 0, 0, 0, 0, 0, 0)  # in the order of the link, PIP first
RESISTANCE, COMPLIANCE, FULL_FLOW, LAG = 20.0, 0.02, 1.5, 0.025  # cmH2O/(L/s), L/cmH2O, L/s, s


def varint(number):
    low, rest = number & 127, number >> 7
    return bytes([low | 128]) + varint(rest) if rest else bytes([low])


def take_varint(data):
    number = shift = 0
    for place, byte in enumerate(data):
        number, shift = number | (byte & 127) << shift, shift + 7
        if byte < 128:
            return number, data[place + 1 :]
    raise ValueError("cut short")


def floats(*values):
    return struct.pack(f"<{len(values)}f", *values)


def frame(content):
    content, out = content + struct.pack("<I", zlib.crc32(content)), b""
    for part in content.split(b"\0"):
        while len(part) >= 254:
            out, part = out + b"\xff" + part[:254], part[254:]
        out += bytes([len(part) + 1]) + part
    return b"\0" + out + b"\0"


def content_of(stuffed):
    """The content between two delimiters; empty if it is damaged."""
    out, at = b"", 0
    while at < len(stuffed):
        code = stuffed[at]
        out, at = out + stuffed[at + 1 : at + code] + (b"\0" if code < 255 else b""), at + code
    out = out[:-1] if stuffed and code < 255 else out
    return out[:-4] if at == len(stuffed) and out[-4:] == struct.pack("<I", zlib.crc32(out[:-4])) else b""


class Ventilator:
    period, settings, next_settings, gains = PERIOD_US * 1e-6, SETTINGS, [], (3.0, 30.0, 0.0)
    mode, telemetry, confirmed, ticks, batches = STANDBY, False, False, 0, 0
    breath = tick = integral = error = opening = 0
    volume, pressure, samples = 5 * COMPLIANCE, 5.0, []

    def answer(self, kind, rest):
        """The response to a request."""
        if kind == 0:  # Identify: no exploration, both slots empty, none runs, power on, no failure, no key
            head = varint(VERSION) + bytes([0, 1, 0, THIRD_PARTY]) + varint(PERIOD_US) + self.mode_bytes()
            return bytes([0]) + head + bytes([0]) + floats(*self.gains) + bytes([0, 0, 0, 0, 0, 0, 0])
        if kind in (2, 13):  # ApplySettings and QueueSettings
            asked = struct.unpack("<14f", rest[:56])
            low, high = (0, 3, 4, 0.2, 0, 0, 0, 15) + 6 * (0,), (60, 20, 80, 5, 1, 2, 20, 70, 10, 20, 3e3, 3e3, 60, 60)
            for field, (value, least, most) in enumerate(zip(asked, low, high)):
                if not least <= value <= most:  # which refuses NaN: Settings, OutOfBounds
                    return bytes([REFUSED, 0, 0, field]) + floats(value, least, most)
            if kind == 13 and len(self.next_settings) >= QUEUE:
                return bytes([REFUSED, QUEUE_FULL])
            self.next_settings, self.confirmed = (self.next_settings if kind == 13 else []) + [asked], True
            if kind == 13:
                return bytes([10, QUEUE - len(self.next_settings)])
        if kind in (1, 2):  # GetSettings too
            pending = b"\1" + floats(*self.next_settings[-1]) if self.next_settings else b"\0"
            return bytes([1]) + floats(*self.settings) + pending
        if kind == 3:  # Start
            if self.mode != STANDBY or not self.confirmed:
                return bytes([REFUSED, 4 if self.mode == FAULT else NOT_CONFIRMED])
            self.mode, self.breath, self.tick = VENTILATING, -1, 0
        elif kind == 4 and self.mode == VENTILATING:  # Stop
            self.mode, self.confirmed, self.next_settings = STANDBY, False, []
        elif kind == 5:  # Acknowledge
            if self.mode != FAULT:
                return bytes([REFUSED, NO_FAULT])
            self.mode, self.confirmed, self.next_settings = STANDBY, False, []
        elif kind == 6 and rest[0] == 0:  # SetController with a PID
            self.gains = struct.unpack("<3f", rest[1:13])
            return bytes([3, 0]) + floats(*self.gains)
        elif kind == 8:  # Telemetry
            self.telemetry = rest[0] == 1
            return bytes([5, rest[0]])
        elif kind == 19:  # GetAlarms: the bits of those present and indicated, and who commands: the PID
            return bytes([14]) + 2 * varint((self.mode == FAULT) << HIGH_PRESSURE) + bytes([1])
        elif kind != 4:
            return bytes([REFUSED, UNKNOWN_REQUEST])
        return bytes([2]) + self.mode_bytes()

    def mode_bytes(self):
        return bytes([FAULT, HIGH_PRESSURE] if self.mode == FAULT else [self.mode])

    def step(self):
        """One control period; returns the events to send."""
        events = b""
        lengths = [math.floor(s / self.period + 0.5) for s in (60 / self.settings[2], self.settings[3], self.settings[5])]
        if self.breath < 0 or self.tick >= lengths[0]:
            self.breath, self.tick, self.integral = self.breath + 1, 0, 0.0
            self.settings = self.next_settings.pop(0) if self.next_settings else self.settings
        pip, peep, _, inspiration, rise, fall, bias, limit = self.settings[:8]
        seconds = self.tick * self.period
        phase = 0 if self.tick < lengths[1] else 1 if self.tick < lengths[1] + lengths[2] else 2
        up = min(1.0, seconds / rise) if rise > 0 else 1.0
        target = (peep + up * (pip - peep), pip + (peep - pip) * (seconds - inspiration) / max(fall, 1e-9), peep)[phase]
        error, u_in = target - self.pressure, bias
        if phase == 0:
            p, i, d = self.gains
            change = d * (error - self.error) / self.period if self.tick else 0.0
            u_in = max(0.0, min(100.0, p * error + self.integral + change))
            self.integral = max(0.0, min(100.0, self.integral + i * error * self.period))
        self.error = error
        self.opening += self.period / (LAG + self.period) * (u_in / 100 - self.opening)
        flow = FULL_FLOW * self.opening - (phase > 0) * max(0.0, self.volume / COMPLIANCE - peep) / (RESISTANCE + 5)
        sample = varint(self.breath) + varint(self.tick) + bytes([phase, phase > 0])
        self.samples.append(sample + floats(target, self.pressure, u_in) + b"\0\0\1" + floats(flow))
        self.volume += self.period * flow
        self.pressure = self.volume / COMPLIANCE + RESISTANCE * flow
        self.ticks, self.tick = self.ticks + 1, self.tick + 1
        if not self.pressure <= limit:
            self.mode, self.volume, self.pressure = FAULT, peep * COMPLIANCE, peep
            events = frame(bytes([1, 2, HIGH_PRESSURE]) + varint(self.ticks))
        if len(self.samples) == BATCH or events:
            first = self.ticks - len(self.samples)
            head = varint(self.batches) + varint(first) + bytes(4) + floats(0.0) + varint(len(self.samples))
            events = frame(bytes([1, 0]) + head + b"".join(self.samples)) + events
            self.batches, self.samples = self.batches + 1, []
        return events


def main(name=None):
    if name:
        import serial

        port = serial.Serial(name, 1_000_000, timeout=0)
        read, write = lambda: port.read(4096), port.write
    else:
        master, slave = os.openpty()
        __import__("tty").setraw(slave)
        os.set_blocking(master, False)
        print("listening at", os.ttyname(slave), file=sys.stderr, flush=True)
        read, write = lambda: os.read(master, 4096), lambda data: os.write(master, data)
    ventilator, heard, last, due = Ventilator(), b"", (b"", b""), time.monotonic()
    while True:
        out = b""
        try:
            heard += read()
        except BlockingIOError:
            time.sleep(0.002)
        *frames, heard = heard.split(b"\0")
        for content in filter(None, map(content_of, frames)):
            if content != last[0]:  # a repeated request is answered again, not executed again
                sequence, rest = take_varint(content)
                kind, rest = take_varint(rest)
                last = content, frame(b"\0" + varint(sequence) + ventilator.answer(kind, rest))
            out += last[1]
        now = time.monotonic()
        while due <= now:
            due += ventilator.period
            events = ventilator.step() if ventilator.mode == VENTILATING else b""
            out += events if ventilator.telemetry else b""
        try:
            write(out)
        except BlockingIOError:
            pass  # nobody reads: the batch is lost, and its number shows that


main(*sys.argv[1:2])
