//! What the server has done, as Prometheus reads it.

use std::fmt::Write;
use std::sync::Mutex;
use std::sync::PoisonError;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::guard::Refusal;
use crate::stream::DeviceInfo;
use crate::watched::DeviceNumbers;

/// Upper bounds of the latencies' classes, ms.
const BOUNDS_MS: [u64; 10] = [10, 20, 35, 50, 75, 100, 150, 250, 500, 1000];

/// Latencies from a control tick to the arrival of the page's report that it was drawn.
#[derive(Debug, Default)]
pub struct Latencies {
    /// Number in each class, and above all.
    classes: [AtomicU64; BOUNDS_MS.len() + 1],
    sum_ms: AtomicU64,
}

impl Latencies {
    /// Adds a latency, ms.
    pub fn add(&self, ms: u64) {
        let class = BOUNDS_MS.iter().position(|bound| ms <= *bound).unwrap_or(BOUNDS_MS.len());
        add(&self.classes[class], 1);
        add(&self.sum_ms, ms);
    }

    fn write(&self, text: &mut String) {
        let name = "eupnea_draw_latency_seconds";
        header(text, name, "histogram", "from a control tick to its picture");
        let mut count = 0;
        for (bound, class) in BOUNDS_MS.iter().zip(&self.classes) {
            count += get(class);
            let _ = writeln!(text, "{name}_bucket{{le=\"{}\"}} {count}", *bound as f64 * 1e-3);
        }
        count += get(&self.classes[BOUNDS_MS.len()]);
        let _ = writeln!(text, "{name}_bucket{{le=\"+Inf\"}} {count}");
        let _ = writeln!(text, "{name}_sum {}\n{name}_count {count}", get(&self.sum_ms) as f64 * 1e-3);
    }
}

/// All numbers of a server.
#[derive(Debug)]
pub struct Metrics {
    names: Vec<String>,
    devices: Vec<Mutex<DeviceNumbers>>,
    /// Samples that pages have lost, device by device.
    dropped: Vec<AtomicU64>,
    refused: [AtomicU64; Refusal::ALL.len()],
    viewers: AtomicU64,
    /// Latencies of the pages.
    pub latencies: Latencies,
}

impl Metrics {
    /// Zeros for these devices.
    pub fn new(devices: &[DeviceInfo]) -> Self {
        Self {
            names: labels(devices),
            devices: devices.iter().map(|_| Mutex::default()).collect(),
            dropped: devices.iter().map(|_| AtomicU64::default()).collect(),
            refused: Default::default(),
            viewers: AtomicU64::default(),
            latencies: Latencies::default(),
        }
    }

    /// Counts a refusal.
    pub fn refuse(&self, refusal: Refusal) {
        add(&self.refused[refusal as usize], 1);
    }

    /// Number of refusals for this reason.
    pub fn refused(&self, refusal: Refusal) -> u64 {
        get(&self.refused[refusal as usize])
    }

    /// Counts samples that a page has lost.
    pub fn drop_samples(&self, device: u8, samples: u32) {
        if let Some(dropped) = self.dropped.get(usize::from(device)) {
            add(dropped, samples.into());
        }
    }

    /// The number of open pages.
    pub fn viewers(&self, now: usize) {
        self.viewers.store(now as u64, Ordering::Relaxed);
    }

    /// Sets the numbers of a device.
    pub fn device(&self, device: u8, numbers: DeviceNumbers) {
        if let Some(slot) = self.devices.get(usize::from(device)) {
            *slot.lock().unwrap_or_else(PoisonError::into_inner) = numbers;
        }
    }

    /// The numbers as text.
    pub fn text(&self) -> String {
        let mut text = String::new();
        header(&mut text, "eupnea_viewers", "gauge", "open pages");
        let _ = writeln!(text, "eupnea_viewers {}", get(&self.viewers));
        header(&mut text, "eupnea_refused_total", "counter", "refused requests and messages");
        for refusal in Refusal::ALL {
            let (reason, count) = (refusal.name(), self.refused(refusal));
            let _ = writeln!(text, "eupnea_refused_total{{reason=\"{reason}\"}} {count}");
        }
        self.devices_text(&mut text);
        self.latencies.write(&mut text);
        text
    }

    fn devices_text(&self, text: &mut String) {
        let numbers: Vec<DeviceNumbers> =
            self.devices.iter().map(|slot| *slot.lock().unwrap_or_else(PoisonError::into_inner)).collect();
        let mut family = |name: &str, kind: &str, help: &str, value: &dyn Fn(&DeviceNumbers) -> u64| {
            header(text, name, kind, help);
            for (label, numbers) in self.names.iter().zip(&numbers) {
                let _ = writeln!(text, "{name}{{device=\"{label}\"}} {}", value(numbers));
            }
        };
        family("eupnea_samples_total", "counter", "samples received", &|n| n.samples);
        family("eupnea_lost_batches_total", "counter", "batches lost on the line", &|n| n.lost_batches);
        family("eupnea_corrupt_frames_total", "counter", "damaged frames", &|n| n.corrupt);
        family("eupnea_device_dropped_total", "counter", "reports the device dropped", &|n| {
            n.reports_dropped
        });
        family("eupnea_connected", "gauge", "1 if the device answers", &|n| n.connected.into());
        family("eupnea_ventilating", "gauge", "1 if it ventilates", &|n| n.ventilating.into());
        for (place, priority) in ["high", "medium", "low"].into_iter().enumerate() {
            let name = format!("eupnea_alarms_{priority}");
            family(&name, "gauge", "indicated alarms of this priority", &|n| n.alarms[place]);
        }
        header(text, "eupnea_viewer_dropped_samples_total", "counter", "samples that slow pages lost");
        for (label, dropped) in self.names.iter().zip(&self.dropped) {
            let _ =
                writeln!(text, "eupnea_viewer_dropped_samples_total{{device=\"{label}\"}} {}", get(dropped));
        }
    }
}

fn add(counter: &AtomicU64, more: u64) {
    counter.fetch_add(more, Ordering::Relaxed);
}

fn get(counter: &AtomicU64) -> u64 {
    counter.load(Ordering::Relaxed)
}

fn header(text: &mut String, name: &str, kind: &str, help: &str) {
    let _ = writeln!(text, "# HELP {name} {help}\n# TYPE {name} {kind}");
}

/// The devices' labels: their names, and for equal ones a number, since Prometheus refuses two series of one label.
fn labels(devices: &[DeviceInfo]) -> Vec<String> {
    let mut labels: Vec<String> = Vec::new();
    for DeviceInfo { name, .. } in devices {
        let numbered = (2..).map(|number| label(&format!("{name} ({number})")));
        let free = std::iter::once(label(name)).chain(numbered).find(|label| !labels.contains(label));
        labels.extend(free);
    }
    labels
}

/// A text as the value of a label.
fn label(text: &str) -> String {
    text.replace('\\', "\\\\").replace('"', "\\\"").replace('\n', "\\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stream::Kind;

    #[test]
    fn devices_of_one_name_have_a_series_each() {
        let device = |name: &str| DeviceInfo { id: 0, name: name.into(), kind: Kind::Board, period_us: 1000 };
        let names = ["lung", "lung (2)", "lung", "lung"].map(device);
        assert_eq!(labels(&names), ["lung", "lung (2)", "lung (3)", "lung (4)"]);
    }

    #[test]
    fn all_numbers_are_in_the_text() {
        let name = "a \"lung\"".to_owned();
        let metrics = Metrics::new(&[DeviceInfo { id: 0, name, kind: Kind::Board, period_us: 1000 }]);
        metrics.refuse(Refusal::Flood);
        metrics.drop_samples(0, 32);
        metrics.drop_samples(9, 32);
        metrics.viewers(2);
        metrics.device(0, DeviceNumbers { samples: 500, alarms: [1, 0, 2], ..DeviceNumbers::default() });
        for ms in [5, 30, 30, 4000] {
            metrics.latencies.add(ms);
        }
        let text = metrics.text();
        for line in [
            "eupnea_viewers 2",
            "eupnea_refused_total{reason=\"flood\"} 1",
            "eupnea_refused_total{reason=\"host\"} 0",
            "eupnea_samples_total{device=\"a \\\"lung\\\"\"} 500",
            "eupnea_alarms_low{device=\"a \\\"lung\\\"\"} 2",
            "eupnea_viewer_dropped_samples_total{device=\"a \\\"lung\\\"\"} 32",
            "eupnea_draw_latency_seconds_bucket{le=\"0.01\"} 1",
            "eupnea_draw_latency_seconds_bucket{le=\"0.035\"} 3",
            "eupnea_draw_latency_seconds_bucket{le=\"+Inf\"} 4",
            "eupnea_draw_latency_seconds_sum 4.065",
        ] {
            assert!(text.lines().any(|found| found == line), "{line} is not in\n{text}");
        }
    }
}
