//! What the bench knows of each breath, and a short history of it.

use std::collections::VecDeque;

use shared::sensor::Readings;
use shared::settings::Settings;

use super::flow_truth::FlowTruth;
use super::patient::Patient;
use super::sensor_truth::SensorTruth;
use plant::bench::Truth;

/// Length of the window at the end of a phase over which means are taken, ticks.
const END_OF_PHASE: u32 = 50;
/// Breaths that are kept, with the running one.
const KEPT: usize = 3;
/// Ticks from which the resistance is measured.
const RESISTANCE_TICKS: u32 = 200;
/// Command and flow between which a working valve delivers gas: percent, L/s.
const ASKED: f32 = 40.0;
const STARVED: f64 = 0.05;

/// Truth about one breath of the device.
#[derive(Clone, Debug, PartialEq)]
pub struct BreathTruth {
    /// Settings in force.
    pub settings: Settings,
    /// Whether at least two breaths before it had the same settings.
    pub settled: bool,
    /// Whether PEEP was lowered with it or with the breath before it.
    pub peep_is_lower: bool,
    /// Highest true airway pressure, cmH2O.
    pub peak: f64,
    /// Lowest true airway pressure, cmH2O.
    pub lowest: f64,
    /// Longest time for which the pressure was above the limit with the expiratory valve commanded open, ms.
    pub vented_above_ms: u32,
    /// Time at the breath's last tick since the pressure was at most 2 cmH2O above PEEP, ms.
    pub away_ms: u32,
    /// Mean pressure at the end of the inspiration, cmH2O; none before it has ended.
    pub plateau: Option<f64>,
    /// Mean pressure at the end of the expiration, cmH2O; until then that of 50 to 100 ms ago.
    pub baseline: Option<f64>,
    /// Strongest effort and cough, cmH2O.
    pub effort: f64,
    /// See `effort`.
    pub cough: f64,
    /// Strongest effort at the end of the expiration, cmH2O.
    pub effort_at_end: f64,
    /// Largest leak, L/s at 30 cmH2O.
    pub leak: f64,
    /// Flow of the leak at the end of the expiration, L/s.
    pub leak_at_end: f64,
    /// Gas that leaked, as a share of the gas inspired; 0 in the inspiration.
    pub leak_share: f64,
    /// Resistance of the airways, cmH2O/(L/s); none in the first ticks.
    pub resistance: Option<f64>,
    /// Recoil of the lung above PEEP at the breath's last tick, cmH2O: trapped gas, once the expiration has ended.
    pub trapped: f64,
    /// Whether it has ended.
    pub ended: bool,
    /// Gas that went into the lung and out of it, mL.
    pub inspired: f64,
    /// See `inspired`.
    pub expired: f64,
    /// Expired minute volume, averaged over 30 s, once the breath has ended, L/min; none in the first 30 s.
    pub minute_volume: Option<f64>,
    /// Its limits, averaged likewise.
    pub minute_limits: (f32, f32),
    /// Time without a breath that got through, once the breath has ended, s.
    pub without_s: f64,
    /// Volume that the breaths of the minutes before let expect, once the breath has ended, mL.
    pub usual: Option<f64>,
    /// Time for which breaths have been smaller than two thirds of that, once it has ended, s.
    pub small_s: f64,
    /// Longest time in which the valve was asked for much gas and gave none, ms.
    pub starved_ms: u32,
    /// The sensor at the airway.
    pub airway: SensorTruth,
    /// The sensor at the machine's outlet.
    pub outlet: SensorTruth,
    /// The flow sensor.
    pub flow: FlowTruth,
    pub(super) sums: Sums,
}

/// Running sums of a breath.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Sums {
    plateau: Mean,
    baseline: Mean,
    /// Pressure in the running window of the expiration, and its mean over the window before that.
    rest: Mean,
    rested: Option<f64>,
    leak_at_end: Mean,
    /// Gas that leaked, and gas into lung and leak in the inspiration, mL.
    leaked: f64,
    inspired: f64,
    /// Ticks, pressure drop times flow, and flow squared.
    ticks: u32,
    drop_flow: f64,
    flow_flow: f64,
    vented_above: u32,
    starved: u32,
}

#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Mean {
    sum: f64,
    count: u32,
}

impl Mean {
    fn add(&mut self, value: f64) -> f64 {
        self.sum += value;
        self.count += 1;
        self.sum / f64::from(self.count)
    }
}

impl BreathTruth {
    /// A breath of which nothing is known yet.
    pub fn new(settings: &Settings, settled: bool) -> Self {
        Self {
            settings: *settings,
            settled,
            peep_is_lower: false,
            peak: f64::NEG_INFINITY,
            lowest: f64::INFINITY,
            vented_above_ms: 0,
            away_ms: 0,
            plateau: None,
            baseline: None,
            effort: 0.0,
            cough: 0.0,
            effort_at_end: 0.0,
            leak: 0.0,
            leak_at_end: 0.0,
            leak_share: 0.0,
            resistance: None,
            trapped: 0.0,
            ended: false,
            inspired: 0.0,
            expired: 0.0,
            minute_volume: None,
            minute_limits: (settings.minute_volume_low, settings.minute_volume_high),
            without_s: 0.0,
            usual: None,
            small_s: 0.0,
            starved_ms: 0,
            airway: SensorTruth::default(),
            outlet: SensorTruth::default(),
            flow: FlowTruth::default(),
            sums: Sums::default(),
        }
    }

    /// PEEP, cmH2O.
    pub fn peep(&self) -> f64 {
        f64::from(self.settings.peep)
    }

    /// The pressure limit, cmH2O.
    pub fn limit(&self) -> f64 {
        f64::from(self.settings.pressure_limit)
    }

    /// Gas that leaked, mL.
    pub fn leaked(&self) -> f64 {
        self.sums.leaked
    }

    /// What the lung is given and gives out again, mL: refilling after a strain, it gives out hardly any.
    pub fn given(&self) -> f64 {
        self.expired.max(0.5 * (self.inspired + self.expired))
    }

    /// Length, s.
    pub fn seconds(&self) -> f64 {
        1e-3 * f64::from(self.sums.ticks)
    }

    fn add(&mut self, moment: &Moment<'_>) {
        let Moment { truth, tick, total, inspiration, command, .. } = *moment;
        let pressure = truth.airway_pressure;
        let sums = &mut self.sums;
        self.peak = self.peak.max(pressure);
        self.lowest = self.lowest.min(pressure);
        self.effort = self.effort.max(truth.muscle_pressure);
        self.cough = self.cough.max(-truth.muscle_pressure);
        let limit = f64::from(self.settings.pressure_limit);
        sums.vented_above = if command.1 && pressure > limit { sums.vented_above + 1 } else { 0 };
        self.vented_above_ms = self.vented_above_ms.max(sums.vented_above);
        let starved = command.0 > ASKED && truth.flow_valve < STARVED;
        sums.starved = if starved { sums.starved + 1 } else { 0 };
        self.starved_ms = self.starved_ms.max(sums.starved);
        self.leak = self.leak.max(moment.leak);
        sums.drop_flow += (pressure - truth.alveolar_pressure) * truth.flow_lung;
        sums.flow_flow += truth.flow_lung * truth.flow_lung;
        // At 1 L/s, 1 mL a tick.
        sums.leaked += truth.flow_leak;
        if tick < inspiration {
            sums.inspired += truth.flow_lung + truth.flow_leak;
        } else if sums.inspired > 0.0 {
            self.leak_share = sums.leaked / sums.inspired;
        }
        sums.ticks += 1;
        self.resistance = (sums.ticks >= RESISTANCE_TICKS).then(|| sums.drop_flow / sums.flow_flow);
        self.inspired += truth.flow_lung.max(0.0);
        self.expired += (-truth.flow_lung).max(0.0);
        self.trapped = truth.alveolar_pressure + truth.muscle_pressure - f64::from(self.settings.peep);
        if tick < inspiration && tick + END_OF_PHASE >= inspiration {
            self.plateau = Some(sums.plateau.add(pressure));
        }
        if tick >= inspiration && tick + END_OF_PHASE < total {
            // An effort may end the expiration at any time: then this is its baseline.
            let mean = sums.rest.add(pressure);
            if sums.rest.count == END_OF_PHASE {
                self.baseline = sums.rested.replace(mean);
                sums.rest = Mean::default();
            }
        }
        if tick < total && tick + END_OF_PHASE >= total {
            self.baseline = Some(sums.baseline.add(pressure));
            self.leak_at_end = sums.leak_at_end.add(truth.flow_leak);
            self.effort_at_end = self.effort_at_end.max(truth.muscle_pressure);
        }
    }
}

/// One tick, as the bench knows it.
#[derive(Clone, Copy, Debug)]
pub struct Moment<'a> {
    /// True state after the tick.
    pub truth: &'a Truth,
    /// Leak, L/s at 30 cmH2O.
    pub leak: f64,
    /// Readings after the tick.
    pub readings: &'a Readings,
    /// Command: inspiratory valve in percent, and whether the expiratory valve is open.
    pub command: (f32, bool),
    /// Tick within the breath.
    pub tick: u32,
    /// Length of the inspiration, and of the breath as set, ticks.
    pub inspiration: u32,
    /// See `inspiration`.
    pub total: u32,
}

/// The breaths of the last minutes, the oldest first.
#[derive(Clone, Debug, Default)]
struct Usual {
    breaths: VecDeque<UsualBreath>,
    time_s: f64,
    small_s: f64,
}

/// A breath that has ended: when, s, its volume, mL, and its settings.
#[derive(Clone, Copy, Debug)]
struct UsualBreath {
    at_s: f64,
    volume: f64,
    settings: Settings,
}

impl UsualBreath {
    /// The least that the same lung takes at other settings, mL.
    fn at(&self, settings: &Settings) -> f64 {
        let filling = |of: &Settings| of.inspiratory_time - 0.5 * of.rise_time;
        let emptying = |of: &Settings| 60.0 / of.rate - of.inspiratory_time;
        let rise = |of: &Settings| of.pip - of.peep;
        let ratio = |of: fn(&Settings) -> f32| f64::from(of(settings) / of(&self.settings)).min(1.0);
        self.volume * ratio(rise) * ratio(filling) * ratio(emptying)
    }
}

impl Usual {
    /// Adds a breath of a length, s.
    fn add(&mut self, breath: &mut BreathTruth, seconds: f64) {
        self.time_s += seconds;
        let now = self.time_s;
        self.breaths.retain(|earlier| now - earlier.at_s <= USUAL_S.1);
        let earlier = self.breaths.iter().filter(|earlier| now - earlier.at_s >= USUAL_S.0);
        let mut volumes: Vec<_> = earlier.map(|earlier| earlier.at(&breath.settings)).collect();
        volumes.sort_by(f64::total_cmp);
        breath.usual = volumes.get(volumes.len() / 2).copied();
        let volume = 0.5 * (breath.inspired + breath.expired);
        let small = breath.usual.is_some_and(|usual| volume < SMALL * usual);
        self.small_s = if small { self.small_s + seconds } else { 0.0 };
        breath.small_s = self.small_s;
        self.breaths.push_back(UsualBreath { at_s: now, volume, settings: breath.settings });
    }
}

/// Age of the breaths that are the usual ones, s.
const USUAL_S: (f64, f64) = (20.0, 240.0);
/// Share of a usual volume that is small, with the flow sensor's tolerance.
const SMALL: f64 = 0.75;

/// Volumes over many breaths.
#[derive(Clone, Copy, Debug, Default)]
struct Volumes {
    /// Mean minute volume and its limits, L/min, and the time that it covers, s.
    minute: f64,
    low: f64,
    high: f64,
    covers_s: f64,
    /// Time since the last breath that got through, s.
    without_s: f64,
}

impl Volumes {
    fn add(&mut self, breath: &BreathTruth) {
        let seconds = breath.seconds();
        self.covers_s = (self.covers_s + seconds).min(AVERAGED_S);
        let weight = seconds / self.covers_s;
        self.minute += weight * (per_minute(breath.expired, seconds) - self.minute);
        self.low += weight * (f64::from(breath.settings.minute_volume_low) - self.low);
        self.high += weight * (f64::from(breath.settings.minute_volume_high) - self.high);
        self.without_s =
            if breath.inspired.min(breath.expired) >= DELIVERED_ML { 0.0 } else { self.without_s + seconds };
    }
}

/// A volume, mL, in a time, s, as a minute volume, L/min.
pub fn per_minute(volume: f64, seconds: f64) -> f64 {
    0.06 * volume / seconds
}

/// The running breath and those before it.
#[derive(Clone, Debug)]
pub struct History {
    breaths: VecDeque<BreathTruth>,
    /// Breaths in a row with the present settings.
    unchanged: u32,
    /// Breaths since PEEP was lowered.
    since_lower_peep: u32,
    away_ms: u32,
    volumes: Volumes,
    usual: Usual,
    /// The patient's own resistance, cmH2O/(L/s), and compliance, mL/cmH2O.
    lung: (f64, f64),
    /// The outlet sensor's lag per tick, its tube, and the pressure behind the lag.
    outlet_share: f64,
    tube: f64,
    outlet: f64,
}

/// Time over which minute volumes are averaged, s.
const AVERAGED_S: f64 = 30.0;
/// Volume, in and out, of a breath that gets through, mL.
const DELIVERED_ML: f64 = 4.0;

/// Pressure above PEEP up to which the pressure is not away from it, cmH2O.
const AWAY: f64 = 2.0;

impl History {
    /// The history of a patient whose first breath is about to start.
    pub fn new(patient: &Patient) -> Self {
        let (lung, outlet) = (&patient.bench.lung.first, &patient.bench.outlet_sensor);
        Self {
            breaths: VecDeque::from([BreathTruth::new(&patient.settings, false)]),
            unchanged: 0,
            since_lower_peep: u32::MAX,
            away_ms: 0,
            volumes: Volumes::default(),
            usual: Usual::default(),
            lung: (lung.resistance_cmh2o_per_l_s, lung.compliance_ml_per_cmh2o),
            outlet_share: if outlet.lag_ms > 0.0 { 1.0 - (-1.0 / outlet.lag_ms).exp() } else { 1.0 },
            tube: outlet.tube_resistance_cmh2o_per_l_s,
            outlet: f64::from(patient.settings.peep),
        }
    }

    /// A history of these breaths, the running one last, on a lung with this resistance and compliance.
    #[cfg(test)]
    pub fn of(breaths: Vec<BreathTruth>, lung: (f64, f64)) -> Self {
        let breaths = VecDeque::from(breaths);
        let volumes = Volumes::default();
        let usual = Usual::default();
        Self {
            breaths,
            unchanged: 9,
            since_lower_peep: u32::MAX,
            away_ms: 0,
            volumes,
            usual,
            lung,
            outlet_share: 1.0,
            tube: 0.0,
            outlet: 0.0,
        }
    }

    /// Starts a breath.
    pub fn start_breath(&mut self, settings: &Settings) {
        self.end_breath();
        self.unchanged = if self.running().settings == *settings { self.unchanged + 1 } else { 0 };
        let lowered = settings.peep < self.running().settings.peep;
        self.since_lower_peep = if lowered { 0 } else { self.since_lower_peep.saturating_add(1) };
        if self.breaths.len() == KEPT {
            self.breaths.pop_front();
        }
        let peep_is_lower = self.since_lower_peep < 2;
        self.breaths
            .push_back(BreathTruth { peep_is_lower, ..BreathTruth::new(settings, self.unchanged >= 2) });
    }

    /// Adds the running breath to the minute volumes and to the time without a breath.
    fn end_breath(&mut self) {
        let Some(ended) = self.breaths.back_mut().filter(|breath| breath.sums.ticks > 0) else { return };
        self.volumes.add(ended);
        ended.minute_limits = (self.volumes.low as f32, self.volumes.high as f32);
        let seconds = ended.seconds();
        self.usual.add(ended, seconds);
        ended.ended = true;
        ended.minute_volume = (self.volumes.covers_s >= AVERAGED_S).then_some(self.volumes.minute);
        ended.without_s = self.volumes.without_s;
    }

    /// Adds a tick of the running breath.
    pub fn add(&mut self, moment: &Moment<'_>) {
        let truth = moment.truth;
        self.outlet +=
            self.outlet_share * (truth.airway_pressure + self.tube * truth.flow_valve - self.outlet);
        let (outlet, lagged) = (self.outlet, truth.sensor_pressure);
        let near = truth.airway_pressure <= self.running().peep() + AWAY;
        self.away_ms = if near { 0 } else { self.away_ms + 1 };
        let away_ms = self.away_ms;
        let Some(running) = self.breaths.back_mut() else { return };
        running.airway.add(moment.readings.airway, lagged);
        running.outlet.add(moment.readings.outlet, outlet);
        running.flow.add(moment.readings.flow, truth.flow_lung + truth.flow_leak);
        running.away_ms = away_ms;
        running.add(moment);
    }

    /// The running breath.
    pub fn running(&self) -> &BreathTruth {
        self.breaths.back().expect("a history always has a running breath")
    }

    /// The last complete breath.
    pub fn last(&self) -> Option<&BreathTruth> {
        self.breaths.iter().rev().nth(1)
    }

    /// The running breath and the two before it, the latest first.
    pub fn window(&self) -> impl Iterator<Item = &BreathTruth> {
        self.breaths.iter().rev()
    }

    /// The patient's own resistance, cmH2O/(L/s), and compliance, mL/cmH2O.
    pub fn lung(&self) -> (f64, f64) {
        self.lung
    }
}
