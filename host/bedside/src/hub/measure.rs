//! A page's measurement of the margins of a device.

use std::sync::Arc;
use std::thread::{self, JoinHandle};

use monitoring::words;
use shared::link::messages::Request;
use show::monitor::News;
use tuning::measurement::Ended;

use super::{Worker, now_ms, send};
use crate::margins::{margins, plan};
use crate::measuring::{Measuring, Next, Over, RESTARTED};
use crate::stream::{Answer, Margins, MeasuringInfo, Sines, ToPage};
use crate::viewers::Viewer;

/// Why nothing else is done while one is under way.
pub(super) const RUNS: &str = "a measurement of the margins is running: wait for its end, or stop it";
/// Told with a result if the device could not get its settings back.
const REMAIN: &str =
    "the settings of the measurement remain on the device: check them before it ventilates on";
/// Told if it could.
const RESTORED: &str = "the device gets the settings of before again";

/// The measurement of a device.
pub(super) struct PageMeasuring {
    viewer: Arc<Viewer>,
    /// Id of its request; none once it is answered.
    id: Option<u32>,
    controller: String,
    measuring: Measuring,
}

impl PageMeasuring {
    fn info(&self) -> MeasuringInfo {
        let (breath, breaths) = self.measuring.breaths();
        MeasuringInfo { breath, breaths, by: self.viewer.who.clone() }
    }
}

/// What a hub has of measurements.
#[derive(Default)]
pub(super) struct Measured {
    /// The one under way.
    running: Option<PageMeasuring>,
    /// The one whose result is being computed, which takes longer than a hub may be silent.
    computed: Option<(MeasuringInfo, JoinHandle<Margins>)>,
    /// The newest result, for every new page.
    pub newest: Option<Arc<str>>,
}

impl Measured {
    /// Whether one is under way.
    pub fn is_running(&self) -> bool {
        self.running.is_some()
    }

    /// Whether this page has started the one under way.
    pub fn is_of(&self, viewer: u64) -> bool {
        self.running.as_ref().is_some_and(|running| running.viewer.number == viewer)
    }

    /// The one under way, until its result is there.
    pub fn info(&self) -> Option<MeasuringInfo> {
        let running = self.running.as_ref().map(PageMeasuring::info);
        running.or_else(|| self.computed.as_ref().map(|(info, _)| info.clone()))
    }
}

impl Worker {
    /// Begins a measurement, which the device answers.
    ///
    /// # Errors
    /// Why it cannot begin.
    pub(super) fn measure(&mut self, viewer: &Arc<Viewer>, id: u32, sines: Sines) -> Result<(), String> {
        if self.measured.is_running() || self.measured.computed.is_some() {
            return Err(RUNS.to_owned());
        }
        if self.waiting.iter().any(|waiting| matches!(waiting.request, Request::ApplySettings(_))) {
            return Err("the settings are being changed: try again".to_owned());
        }
        let newest = self.watched.newest_breath().filter(|_| self.watched.is_sampled());
        let (Some(before), Some(newest)) = (self.watched.settings().copied(), newest) else {
            return Err(
                "the device does not ventilate: start the ventilation of the test lung first".to_owned()
            );
        };
        let measuring = Measuring::new(plan(sines, &before)?, self.period_us, before, newest)
            .map_err(|why| why.to_string())?;
        let controller = self.watched.reported().controller.map(words::controller).unwrap_or_default();
        self.source.ask(measuring.request()).map_err(|why| why.to_string())?;
        let (viewer, id) = (Arc::clone(viewer), Some(id));
        self.measured.running = Some(PageMeasuring { viewer, id, controller, measuring });
        Ok(())
    }

    /// Goes on measuring with a piece of news.
    pub(super) fn measure_on(&mut self, news: &News) {
        let Some(running) = &mut self.measured.running else { return };
        match running.measuring.take(news) {
            None => {}
            Some(Next::Ask(request)) => _ = self.source.ask(request),
            Some(Next::Begun) => {
                if let Some(id) = running.id.take() {
                    send(&running.viewer, &ToPage::Answer(Answer::done(id, "the measurement has begun")));
                }
            }
            Some(Next::Refused(why, undo)) => {
                if let Some(id) = running.id.take() {
                    send(&running.viewer, &ToPage::Answer(Answer::refused(Some(id), why)));
                }
                self.measured.running = None;
                self.ask_all(undo);
            }
            Some(Next::Over(over)) => self.finish_measuring(over),
        }
    }

    /// Ends the measurement under way, if there is one; the device gets its settings back.
    pub(super) fn stop_measuring(&mut self) {
        if let Some(running) = &self.measured.running {
            let over = running.measuring.end(Ended::Stopped);
            self.finish_measuring(over);
        }
    }

    /// Ends the measurement under way, if there is one, of a device that has restarted.
    pub(super) fn leave_measuring(&mut self) {
        if let Some(running) = &self.measured.running {
            let over = running.measuring.leave(RESTARTED);
            self.finish_measuring(over);
        }
    }

    fn finish_measuring(&mut self, over: Over) {
        let Some(running) = self.measured.running.take() else { return };
        let info = running.info();
        let PageMeasuring { viewer, id, controller, measuring } = running;
        let measurement = measuring.into_measurement();
        let nothing = over.nothing(&measurement);
        if let Some(id) = id {
            let why = nothing.clone().unwrap_or_default();
            send(&viewer, &ToPage::Answer(Answer::refused(Some(id), why)));
        }
        let Over { ended, undo, .. } = over;
        let settings = if undo.is_empty() { REMAIN } else { RESTORED };
        self.ask_all(undo);
        let (time_ms, amplitude) = (now_ms(), measurement.plan().amplitude);
        let result = thread::spawn(move || {
            let mut result = match nothing {
                Some(why) => {
                    Margins { time_ms, refused: Some(why), controller, amplitude, ..Margins::default() }
                }
                None => margins(&measurement.finished(ended), controller, time_ms),
            };
            result.remarks.push(settings.to_owned());
            result
        });
        self.measured.computed = Some((info, result));
    }

    /// Sends a result that has been computed.
    pub(super) fn send_margins(&mut self) {
        let finished = self.measured.computed.take_if(|(_, result)| result.is_finished());
        let Some((_, computed)) = finished else { return };
        // A computation that panicked has already reported it.
        let Ok(margins) = computed.join() else { return };
        let message = ToPage::Margins { device: self.device, margins: Box::new(margins) };
        let text: Arc<str> = message.to_json().into();
        self.viewers.send(&text);
        self.measured.newest = Some(text);
    }

    fn ask_all(&mut self, requests: impl IntoIterator<Item = Request>) {
        for request in requests {
            let _ = self.source.ask(request);
        }
    }
}
