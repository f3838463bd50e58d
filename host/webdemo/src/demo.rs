//! All devices of the demonstration, and their stream to the page.

use std::collections::VecDeque;

use bedside::steer;
use bedside::stream::{Answer, DeviceInfo, EventKind, FromPage, Kind, ToPage};
use bedside::watched::Out;
use plant::bench::BenchConfig;
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::pid::PidGains;
use shared::link::messages::Request;
use shared::weights::IMAGE_BYTES;

use crate::page::{Message, Shown, VIEWER, hand_on, hello};
use crate::patient::{PAGE, Patient, PatientError};

/// The learned controller: its name, which is also that of the family for which it was trained, and its weights.
const CONTROLLER: (&str, &[u8; IMAGE_BYTES]) = ("adult", include_bytes!("../../learn/controllers/adult.bin"));
/// The best single PID of that family.
#[expect(clippy::unreadable_literal, reason = "the build writes the gains")]
pub const RIVAL: PidGains = include!(concat!(env!("OUT_DIR"), "/rival.rs"));
/// Ticks between two messages of samples.
const FRAME_TICKS: u32 = 20;
/// Most ticks to catch up at once. A page that slept for longer goes on from where it was, so that it does not freeze.
const MOST_TICKS: u32 = 2000;
/// Why there are no recordings.
const NO_FILES: &str = "a page without a server writes no files: run `cargo trainer serve --demo` to record";

/// A device with what the page has and asks for.
struct Bed {
    patient: Patient,
    watched: bool,
    shown: Shown,
}

/// The running demonstration.
pub struct Demo {
    beds: Vec<Bed>,
    out: VecDeque<Message>,
    /// Time of the first tick, ms since 1970, and ticks so far.
    origin_ms: f64,
    ticks: f64,
}

impl Demo {
    /// Starts all devices at a time in ms since 1970: for each lung the PID, then the learned controller.
    ///
    /// # Errors
    /// [`PatientError`], if a device does not start.
    pub fn start(now_ms: f64) -> Result<Self, PatientError> {
        let mut beds = Vec::new();
        for bench in BenchConfig::paper_lungs() {
            for (title, controller) in [("PID", Ok(RIVAL)), (CONTROLLER.0, Err(CONTROLLER.1))] {
                let number = beds.len() as u8;
                let patient = Patient::start(number, title, &bench, controller)?;
                beds.push(Bed { patient, watched: true, shown: Shown::default() });
            }
        }
        let mut demo = Self { beds, out: VecDeque::new(), origin_ms: now_ms, ticks: 0.0 };
        demo.greet();
        Ok(demo)
    }

    /// Greets the page, also again after it has shown something else.
    pub fn greet(&mut self) {
        let info = |(id, bed): (u8, &Bed)| DeviceInfo {
            id,
            name: bed.patient.name.clone(),
            kind: Kind::Simulated,
            period_us: DEFAULT_PERIOD_US,
        };
        let devices = (0..).zip(&self.beds).map(info).collect();
        self.queue(&hello(true, devices));
        self.beds.iter_mut().for_each(|bed| bed.shown.forget());
    }

    /// Runs all devices until a time in ms since 1970.
    pub fn advance(&mut self, now_ms: f64) {
        let due = now_ms - self.origin_ms - self.ticks;
        if !due.is_finite() || due > f64::from(MOST_TICKS) {
            self.origin_ms = now_ms - self.ticks - f64::from(FRAME_TICKS);
        }
        let mut due = (now_ms - self.origin_ms - self.ticks).max(0.0) as u32;
        self.ticks += f64::from(due);
        while due > 0 {
            let ticks = due.min(FRAME_TICKS);
            due -= ticks;
            for bed in &mut self.beds {
                bed.patient.run(ticks, now_ms as u64);
                bed.patient.watched.flush(&mut bed.patient.out);
            }
        }
        self.send(now_ms as u64);
    }

    /// The next message to the page.
    pub fn take(&mut self) -> Option<Message> {
        self.out.pop_front()
    }

    /// Takes a message of the page, at a time in ms since 1970.
    pub fn receive(&mut self, text: &str, now_ms: f64) {
        match FromPage::parse(text) {
            Err(why) => self.queue(&ToPage::Answer(Answer::refused(None, why.to_string()))),
            Ok(FromPage::Watch { devices }) => {
                for (number, bed) in (0..).zip(&mut self.beds) {
                    bed.watched = devices.contains(&number);
                }
            }
            Ok(message) => {
                if let Some(device) = message.device().filter(|device| usize::from(*device) < self.beds.len())
                {
                    self.obey(device, &message, now_ms as u64);
                }
            }
        }
        self.send(now_ms as u64);
    }

    /// Does what the page asks of a device.
    fn obey(&mut self, device: u8, message: &FromPage, now_ms: u64) {
        let bed = &mut self.beds[usize::from(device)];
        match message {
            FromPage::Take { .. } => {
                // There is no other page.
                let _ = bed.patient.wheel.take(VIEWER, PAGE, false);
                bed.shown.forget();
                self.queue(&ToPage::Steerer { device, who: Some(PAGE.to_owned()), yours: true });
            }
            FromPage::Release { .. } => {
                bed.patient.wheel.release(VIEWER);
                let _ = bed.patient.ask(Request::ReleaseLease, now_ms);
                bed.shown.forget();
                self.queue(&ToPage::Steerer { device, who: None, yours: false });
            }
            _ => {
                if let Some(id) = message.id() {
                    let answer = carry_out(bed, device, id, message, now_ms);
                    self.queue(&ToPage::Answer(answer));
                }
            }
        }
    }

    fn queue(&mut self, message: &ToPage) {
        self.out.push_back(Message::text(message));
    }

    /// Queues what the devices have for the page, and the states that have changed or are due.
    fn send(&mut self, now_ms: u64) {
        for Bed { patient, watched, shown } in &mut self.beds {
            hand_on(&mut patient.out, *watched, &mut self.out);
            let state = || patient.watched.state(now_ms, patient.wheel.who(), None, None);
            shown.update(now_ms, state, &mut self.out);
        }
    }
}

/// Carries out a request.
fn carry_out(bed: &mut Bed, device: u8, id: u32, message: &FromPage, now_ms: u64) -> Answer {
    let patient = &mut bed.patient;
    match message {
        FromPage::Mark { text, .. } => {
            let (kind, tick) = (EventKind::Marker, patient.watched.newest_tick());
            let event = ToPage::Event { device, time_ms: now_ms, kind, text: text.clone(), tick };
            patient.out.push(Out::Message(event));
            return Answer::done(id, "marked");
        }
        FromPage::Record { .. } | FromPage::Capture { .. } => return Answer::refused(Some(id), NO_FILES),
        _ => {}
    }
    if let Err(why) = patient.wheel.check(VIEWER) {
        return Answer::refused(Some(id), why.to_string());
    }
    if let FromPage::Fault { fault, .. } = message {
        patient.inject((*fault).into());
        return Answer::done(id, "done");
    }
    match steer::request(message, patient.watched.settings()) {
        Ok(Some(request)) => steer::answer(id, &patient.ask(request, now_ms)),
        Ok(None) => Answer::refused(Some(id), NO_FILES),
        Err(why) => Answer::refused(Some(id), why.to_string()),
    }
}
