// A simple breath at 1 kHz for the fake server: a first-order pressure behind a square target, and a lung of one resistance and
// one compliance. It looks like a ventilator and is none.

const PHASES = { inspiration: 0, fall: 1, expiration: 2 };

function phaseAt(t, inspiration, fall) {
  if (t < inspiration) return "inspiration";
  return t < inspiration + fall ? "fall" : "expiration";
}

export class Lung {
  constructor({ resistance = 20, compliance = 20, learned = true } = {}) {
    Object.assign(this, { resistance, compliance, learned });
    this.tick = 0;
    this.pressure = 5;
    this.volume = 0;
    this.fault = "none";
    this.number = 0;
    this.coughLeft = 0;
    /** Whether a flow sensor measures flow and volume. */
    this.measured = false;
    /** A single sample with this pressure comes next. */
    this.spike = null;
    this.restart();
  }

  restart() {
    this.age = 0;
    this.peak = 0;
    this.tidal = 0;
    this.error = 0;
    this.errors = 0;
    this.start = this.volume;
  }

  /** One millisecond: the sample, and the finished breath's figures or null. */
  step({ pip, peep, rate, inspiratory_time: inspiration, fall_time: fall }) {
    const t = this.age / 1000;
    const phase = phaseAt(t, inspiration, fall);
    const target = { inspiration: pip, fall: pip - ((pip - peep) * (t - inspiration)) / fall, expiration: peep }[phase];
    this.move(phase, target, peep);
    const flow = phase === "inspiration" ? Math.max(0, this.inflow) : this.inflow;
    const measured = this.spike ?? (this.fault === "stick" ? 5 : this.pressure + 0.15 * (Math.random() - 0.5));
    this.spike = null;
    const u_in = phase === "inspiration" ? Math.min(100, 8 + 60 * Math.max(0, flow)) : 5;
    this.note(phase, target);
    const learned = this.learned ? (phase === "inspiration" ? 20 + 30 * Math.exp(-t / 0.15) : 5) : Number.NaN;
    const sample = [measured, target, u_in, phase === "inspiration" ? 0 : 100, learned, flow, this.volume - this.start, PHASES[phase]];
    this.tick += 1;
    this.age += 1;
    const breath = this.age >= 60_000 / rate ? this.figures(pip, rate, inspiration) : null;
    if (breath) this.restart();
    return { sample, breath };
  }

  move(phase, target, peep) {
    const delay = this.learned ? 0.03 : 0.06;
    const wanted = this.fault === "disconnect" ? 1 : target + (this.learned || phase !== "inspiration" ? 0 : 1.5 * Math.exp(-this.age / 120));
    this.pressure += ((wanted - this.pressure) * 0.001) / delay;
    if (this.coughLeft > 0) {
      this.coughLeft -= 1;
      this.pressure += 0.25 * Math.sin((Math.PI * this.coughLeft) / 250);
    }
    const alveolar = peep + this.volume / this.compliance;
    this.inflow = (this.pressure - alveolar) / this.resistance;
    this.volume += this.inflow;
    this.peak = Math.max(this.peak, this.pressure);
    this.tidal = Math.max(this.tidal, this.volume - this.start);
  }

  note(phase, target) {
    if (phase !== "inspiration") return;
    this.error += Math.abs(this.pressure - target);
    this.errors += 1;
    this.plateau = this.pressure;
  }

  figures(pip, rate, inspiration) {
    this.number += 1;
    const expiration = 60 / rate - inspiration;
    return {
      number: this.number, pip: this.peak, plateau: this.plateau, peep: this.pressure, tidal_volume: this.tidal,
      minute_volume: (this.tidal * rate) / 1000, rate, rate_set: rate, ie: expiration / inspiration,
      resistance: this.resistance, compliance: this.compliance, leak: this.measured ? 4.2 : null, error: this.error / this.errors,
      rise_ms: this.learned ? 66 : 130, overshoot: Math.max(0, this.peak - pip), estimated: !this.measured, triggered: false,
    };
  }
}
