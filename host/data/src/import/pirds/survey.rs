//! First pass through a PIRDS file: which sensors it has, and how often they read.

use std::collections::BTreeMap;
use std::path::Path;

use progress::Progress;

use super::{faulty, open, unusable};
use crate::import::PROGRESS_ROWS;
use crate::pirds::{
    ABSOLUTE, AIRWAY, AMBIENT, EXPIRATORY, Event, FLOW, GAUGE, INSPIRATORY, Measurement, PER_CMH2O, Sensor,
    UNSPECIFIED,
};
use crate::recording::DatasetError;

/// Places of the airway pressure, the best first.
const PRESSURES: [(char, char); 5] = [
    (GAUGE, AIRWAY),
    (GAUGE, INSPIRATORY),
    (GAUGE, UNSPECIFIED),
    (ABSOLUTE, AIRWAY),
    (ABSOLUTE, INSPIRATORY),
];
/// Places of a flow in both directions, the best first.
const NET_FLOWS: [(char, char); 3] = [(FLOW, AIRWAY), (FLOW, INSPIRATORY), (FLOW, UNSPECIFIED)];
/// Pressure from which a median must be an absolute one, cmH2O.
const ABSOLUTE_FROM: f64 = 300.0;
/// Number of time steps that determine the sample period.
const MOST_STEPS: usize = 20_000;
/// Kinds of events that are counted by name; all further ones together.
const MOST_KINDS: usize = 64;
/// Name under which these are counted.
const FURTHER: &str = "further kinds";

/// Counts of events by name.
pub(super) type Unused = BTreeMap<String, usize>;

/// The sensors of the flow.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum FlowSensors {
    /// One that measures both directions, positive into the lung.
    Net(Sensor),
    /// One for each direction.
    Each {
        /// Into the circuit.
        inward: Sensor,
        /// Out of the circuit.
        outward: Sensor,
    },
}

/// What a file contains.
#[derive(Debug)]
pub(super) struct Survey {
    /// Sensor of the airway pressure.
    pub(super) pressure: Sensor,
    /// Sensor of the ambient pressure, to subtract from an absolute one, and its median in units.
    pub(super) ambient: Option<(Sensor, i32)>,
    /// Sensors of the flow.
    pub(super) flow: Option<FlowSensors>,
    /// Median time step of the pressure, us.
    pub(super) period_us: u32,
    /// Number of marks of phases.
    pub(super) phases: usize,
    /// Events that no row uses.
    pub(super) unused: Unused,
}

/// The readings of a sensor.
#[derive(Debug, Default)]
struct Readings {
    count: usize,
    /// Number of readings of each value.
    values: BTreeMap<i32, usize>,
    steps: Vec<u32>,
    last_ms: Option<u32>,
}

impl Readings {
    fn add(&mut self, ms: u32, value: i32) {
        self.count += 1;
        *self.values.entry(value).or_default() += 1;
        if let Some(last) = self.last_ms.replace(ms)
            && ms > last
            && self.steps.len() < MOST_STEPS
        {
            self.steps.push(ms - last);
        }
    }

    /// The value below which this share of the readings lies.
    fn quantile(&self, share: f64) -> i32 {
        let mut below = 0;
        let mut found = self.values.iter().find(|(_, count)| {
            below += **count;
            below as f64 >= share * self.count as f64
        });
        found.take().map_or(0, |(value, _)| *value)
    }

    fn period_us(&mut self) -> u32 {
        self.steps.sort_unstable();
        self.steps.get(self.steps.len() / 2).map_or(0, |ms| ms.saturating_mul(1000))
    }
}

/// Reads a whole file.
///
/// # Errors
/// A file that cannot be read, a line that is not an event, no usable pressure sensor, or a request to stop.
pub(super) fn survey(path: &Path, progress: &Progress<'_>) -> Result<Survey, DatasetError> {
    let (mut reader, _) = open(path)?;
    let mut events = 0_usize;
    let (mut sensors, mut unused, mut phases) = (BTreeMap::<Sensor, Readings>::new(), Unused::new(), 0);
    while let Some(event) = reader.next_event().map_err(|fault| faulty(path, fault))? {
        if events.is_multiple_of(PROGRESS_ROWS) && progress.stopped() {
            return Err(DatasetError::Stopped);
        }
        events += 1;
        match event {
            Event::Phase(..) => phases += 1,
            Event::Measurement(Measurement { sensor, ms, value, beyond_range }) => {
                if beyond_range {
                    count(&mut unused, "beyond the sensor's range", 1);
                }
                sensors.entry(sensor).or_default().add(ms, value);
            }
            Event::Other(name) => count(&mut unused, &name, 1),
        }
    }
    let flow = flow(&sensors);
    let (pressure, ambient) = pressure(path, &sensors)?;
    for (sensor, readings) in &sensors {
        if !uses(flow, *sensor)
            && *sensor != pressure
            && ambient.is_none_or(|(ambient, _)| *sensor != ambient)
        {
            count(&mut unused, &sensor.to_string(), readings.count);
        }
    }
    let readings = sensors.entry(pressure).or_default();
    let period_us = readings.period_us();
    if period_us == 0 {
        return Err(unusable(path, "the time `ms` does not increase from reading to reading: correct it"));
    }
    Ok(Survey { pressure, ambient, flow, period_us, phases, unused })
}

fn count(unused: &mut Unused, name: &str, events: usize) {
    let known = unused.len() < MOST_KINDS || unused.contains_key(name);
    *unused.entry(if known { name } else { FURTHER }.to_owned()).or_default() += events;
}

fn uses(flow: Option<FlowSensors>, sensor: Sensor) -> bool {
    match flow {
        Some(FlowSensors::Net(net)) => net == sensor,
        Some(FlowSensors::Each { inward, outward }) => [inward, outward].contains(&sensor),
        None => false,
    }
}

/// The first sensor of a type at a location.
fn at(sensors: &BTreeMap<Sensor, Readings>, (kind, location): (char, char)) -> Option<Sensor> {
    sensors.keys().copied().find(|sensor| (sensor.kind, sensor.location) == (kind, location))
}

/// The sensor of the airway pressure and, if it is an absolute one, that of the ambient pressure with its median.
fn pressure(
    path: &Path,
    sensors: &BTreeMap<Sensor, Readings>,
) -> Result<(Sensor, Option<(Sensor, i32)>), DatasetError> {
    let found = PRESSURES.into_iter().find_map(|place| at(sensors, place)).ok_or_else(|| {
        unusable(
            path,
            "no airway pressure: it needs readings of type D (relative) or P at location A, I or D; \
             give the file of a sensor in the airway",
        )
    })?;
    if found.kind == GAUGE {
        return Ok((found, None));
    }
    let ambient = at(sensors, (ABSOLUTE, AMBIENT));
    // Some ventilators write a relative pressure as P.
    let absolute = f64::from(sensors[&found].quantile(0.5)) / PER_CMH2O > ABSOLUTE_FROM;
    match ambient {
        None if absolute => Err(unusable(
            path,
            "the airway pressure is absolute (type P), and no ambient one (P at location B) is there to \
             subtract: add ambient or relative (type D) readings",
        )),
        ambient => {
            let median = |sensor| (sensor, sensors[&sensor].quantile(0.5));
            Ok((found, ambient.filter(|_| absolute).map(median)))
        }
    }
}

fn flow(sensors: &BTreeMap<Sensor, Readings>) -> Option<FlowSensors> {
    let [inward, outward] = [INSPIRATORY, EXPIRATORY].map(|location| at(sensors, (FLOW, location)));
    match (at(sensors, NET_FLOWS[0]), inward, outward) {
        (None, Some(inward), Some(outward)) => Some(FlowSensors::Each { inward, outward }),
        _ => NET_FLOWS.into_iter().find_map(|place| at(sensors, place)).map(FlowSensors::Net),
    }
}
