//! A device at a port as a source: it runs breaths on its own clock, explores by itself, and sends every tick.
//!
//! The device receives the settings of the next breaths before it needs them, so its behaviour does not depend on the
//! speed of this computer or of the line: with the plant's seed, the same run gives the same samples as
//! [`super::BenchSource`], bit for bit.

mod course;

use std::collections::VecDeque;
use std::sync::mpsc::RecvTimeoutError;
use std::time::{Duration, Instant};

use shared::breath::Breath;
use shared::calibration::Calibration;
use shared::control::Controller;
use shared::control::pid::PidGains;
use shared::explore::Exploration;
use shared::explore::sines::SineSweep;
use shared::link::messages::{ControllerChoice, DeviceIdentity, Event, Request, Response};
use shared::link::refusal::Refusal;
use shared::link::telemetry::PackedSample;
use shared::safety::alarms::{Action, Fault};
use shared::settings::Settings;
use shared::ventilator::{Mode, Sample};
use shared::weights::{IMAGE_BYTES, Identity, decode, encode};

use super::{REST_TIME, Reseed, Source, SourceError, Tick, TickTruth};
use course::{Course, Step, wrong_pace};
use device::upload::UploadError;
use device::{Device, DeviceError};
use plant::bench::BenchConfig;
use progress::Progress;

/// Number of samples between two keep-alive requests to the device.
const HEARD_EVERY: usize = 2000;
/// Time without samples after which a ventilating device counts as silent.
const SILENCE: Duration = Duration::from_secs(20);

/// Time that a device has to raise its alarm after an impossible sample, s.
const ALARM_TIME: f32 = 1.0;

/// The true state at a tick, numbered from the start of ventilation, known only to the plant behind a device.
type Truth = Box<dyn FnMut(usize) -> Option<TickTruth> + Send>;

/// A ventilating device as a source.
pub struct PortSource {
    device: Device,
    identity: DeviceIdentity,
    plant: String,
    plant_parameters: String,
    /// Bench that a board on the desk simulates, which a restart makes it forget.
    description: Option<Vec<u8>>,
    /// Seed for the plant at the next start.
    seed: Option<u64>,
    /// Settings of the next breaths; the first `sent` are on the device.
    plan: VecDeque<Settings>,
    sent: usize,
    running: bool,
    samples: VecDeque<Sample>,
    /// Whether the first sample since the start has arrived; earlier ones belong to the previous run.
    begun: bool,
    /// Number of samples passed on since the start.
    handed: usize,
    alarm: Option<Fault>,
    /// Finding that took a pressure sensor out of use.
    finding: Option<Fault>,
    /// Number of samples since the last request to the device.
    unheard: usize,
    truth: Option<Truth>,
    /// When its samples since the start began to come.
    started: Instant,
    /// Whether the device has left out perturbations that it was asked for.
    unperturbed: bool,
    /// Images whose bytes, and therefore ids, are known.
    images: Vec<Vec<u8>>,
    /// The virtual board, if the device is one; dropped last, because the device is stopped first.
    #[cfg(unix)]
    board: Option<emulator::Emulator>,
}

impl PortSource {
    /// A connected device as a source; stops it if it ventilates. With hardware in the loop, its plant restarts with
    /// `seed`.
    ///
    /// # Errors
    /// A device that cannot be reached, or has a fault that cannot be acknowledged.
    pub fn new(mut device: Device, seed: u64) -> Result<Self, SourceError> {
        let identity = device.identify()?;
        device.stop()?;
        if let Mode::Fault(_) = identity.mode {
            device.acknowledge()?;
        }
        device.telemetry(true)?;
        let seed = identity.device.has_simulated_plant().then_some(seed);
        let plant = format!("device at {}", device.address());
        Ok(Self {
            device,
            identity,
            plant,
            plant_parameters: String::new(),
            description: None,
            seed,
            plan: VecDeque::new(),
            sent: 0,
            running: false,
            samples: VecDeque::new(),
            begun: false,
            handed: 0,
            alarm: None,
            finding: None,
            unheard: 0,
            truth: None,
            started: Instant::now(),
            unperturbed: false,
            images: Vec::new(),
            #[cfg(unix)]
            board: None,
        })
    }

    /// Makes a board on the desk simulate this bench from its next start of ventilation on.
    ///
    /// # Errors
    /// A device that simulates none, or cannot be reached.
    pub fn simulate(&mut self, bench: &BenchConfig) -> Result<(), SourceError> {
        let description = bench.to_bytes();
        self.device.set_bench(&description)?;
        (self.plant, self.plant_parameters) = (bench.name.clone(), bench.to_toml());
        self.description = Some(description);
        Ok(())
    }

    /// Keeps the virtual board that is the device.
    #[cfg(unix)]
    pub(super) fn with_board(mut self, board: emulator::Emulator) -> Self {
        self.board = Some(board);
        self
    }

    /// Sets the name and the description of the plant, which the host knows, and the source of its true states.
    #[must_use]
    pub fn with_plant(
        mut self,
        plant: String,
        parameters: String,
        truth: impl FnMut(usize) -> Option<TickTruth> + Send + 'static,
    ) -> Self {
        (self.plant, self.plant_parameters) = (plant, parameters);
        self.truth = Some(Box::new(truth));
        self
    }

    /// Registers an image to upload unchanged when its controller is selected, so that its id stays the same.
    pub fn know(&mut self, image: Vec<u8>) {
        self.images.push(image);
    }

    /// Restarts the device, which then runs the newest weights, corrects by the newest calibration, and has forgotten the zeros of a
    /// self-test.
    ///
    /// # Errors
    /// A device that cannot be reached.
    pub fn restart(&mut self) -> Result<(), SourceError> {
        self.halt()?;
        self.identity = self.device.restart()?;
        if let Some(description) = &self.description {
            self.device.set_bench(description)?;
        }
        Ok(self.device.telemetry(true)?)
    }

    /// The newest calibration that is stored on the device, if there is one.
    ///
    /// # Errors
    /// A device that cannot be reached.
    pub fn calibration(&mut self) -> Result<Option<Calibration>, SourceError> {
        Ok(self.device.calibration(0)?.1)
    }

    /// The device's identity.
    pub fn identity(&self) -> &DeviceIdentity {
        &self.identity
    }

    /// Stops the device and discards the samples still in transit.
    fn halt(&mut self) -> Result<(), SourceError> {
        if self.running {
            self.device.stop()?;
            self.running = false;
        }
        while self.device.events().try_recv().is_ok() {}
        self.samples.clear();
        (self.sent, self.handed, self.alarm, self.finding) = (0, 0, None, None);
        Ok(())
    }

    /// Sends as many settings as the device accepts.
    fn fill(&mut self) -> Result<(), SourceError> {
        while let Some(settings) = self.plan.get(self.sent) {
            match self.device.queue(*settings) {
                Ok(_) => self.sent += 1,
                Err(DeviceError::Refused(Refusal::QueueFull)) => break,
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    fn start(&mut self) -> Result<(), SourceError> {
        self.fill()?;
        if let Some(seed) = self.seed {
            self.device.reset_plant(seed)?;
        }
        self.device.start()?;
        (self.running, self.begun, self.handed) = (true, false, 0);
        Ok(())
    }

    /// Sends a keep-alive request at intervals on the device's clock: it explores only while a host is present.
    fn be_heard(&mut self, samples: usize) -> Result<(), SourceError> {
        self.unheard += samples;
        if self.unheard >= HEARD_EVERY {
            self.unheard = 0;
            match self.device.settings() {
                // It was heard all the same.
                Ok(_) | Err(DeviceError::Unknown(_)) => {}
                Err(error) => return Err(error.into()),
            }
        }
        Ok(())
    }

    /// The next sample, or the fault that occurred instead.
    fn sample(&mut self, breath: u32) -> Result<Option<Sample>, SourceError> {
        let deadline = Instant::now() + SILENCE;
        loop {
            while let Some(sample) = self.samples.pop_front() {
                if !self.begun && (sample.breath, sample.tick) == (0, 0) {
                    (self.begun, self.started) = (true, Instant::now());
                }
                if self.begun {
                    return Ok(Some(sample));
                }
            }
            if self.alarm.is_some() {
                return Ok(None);
            }
            // Events may come without end, but none that helps.
            if Instant::now() >= deadline {
                return Err(if self.begun { SourceError::Silent { breath } } else { SourceError::NotBegun });
            }
            match self.device.events().recv_timeout(deadline.saturating_duration_since(Instant::now())) {
                Ok(Event::Telemetry(batch)) => {
                    self.samples.extend(batch.samples.iter().map(PackedSample::unpack));
                    self.be_heard(batch.samples.len())?;
                }
                Ok(Event::Alarm { fault, .. }) => self.heed(fault)?,
                // An alarm of an earlier recording is none of this one; the deadline is looked at above.
                Ok(Event::Breath(_) | Event::Unacknowledged { .. }) | Err(RecvTimeoutError::Timeout) => {}
                Err(RecvTimeoutError::Disconnected) => {
                    return Err(DeviceError::Gone(self.device.address().clone()).into());
                }
            }
        }
    }

    /// An alarm ends a recording if ventilation ends, or goes on without a pressure reading.
    fn heed(&mut self, fault: Fault) -> Result<(), SourceError> {
        match fault.alarm().action {
            Action::Vent => self.alarm = Some(fault),
            Action::Backup if fault == Fault::BackupVentilation => {
                self.device.stop()?;
                self.alarm = Some(self.finding.unwrap_or(fault));
            }
            Action::Backup => self.finding = Some(fault),
            Action::Report | Action::Pid | Action::CappedPid => {}
        }
        Ok(())
    }

    /// Uploads a learned controller to the device, unless it already runs there.
    fn install(&mut self, controller: &Controller) -> Result<ControllerChoice, SourceError> {
        let Controller::Residual(residual) = controller else {
            return Ok(ControllerChoice::Pid(controller.pid().gains()));
        };
        let known =
            self.images.iter().find(|image| decode(image).is_ok_and(|image| image.residual == *residual));
        let image = if let Some(image) = known {
            image.clone()
        } else {
            let mut image = vec![0; IMAGE_BYTES];
            encode(residual, &Identity::default(), &mut image).map_err(UploadError::from)?;
            image
        };
        let id = decode(&image).map_err(UploadError::from)?.id;
        if self.identity.running_id() != Some(id) {
            self.device.upload(&image, &Progress::silent())?;
            self.restart()?;
        }
        Ok(ControllerChoice::Learned)
    }

    /// Selects a controller. A device may have its own, which it does not change: its greeting must then name the one that was asked
    /// for, so that a recording names the one that ran.
    fn choose(&mut self, asked: ControllerChoice) -> Result<(), SourceError> {
        let runs = match self.device.request(&Request::SetController(asked)) {
            Ok(Response::Controller(applied)) => applied,
            Ok(_) => return Ok(()),
            Err(DeviceError::Unknown(_)) => self.identity.controller,
            Err(error) => return Err(error.into()),
        };
        if runs == asked {
            Ok(())
        } else {
            Err(SourceError::OtherController { runs: named(runs), asked: named(asked) })
        }
    }

    /// Sets the exploration. A device that cannot explore runs the controller alone, which [`Source::shortfalls`] says.
    fn explore(&mut self, asked: Option<Exploration>) -> Result<(), SourceError> {
        let applied = match self.device.request(&Request::SetExploration(asked)) {
            Ok(Response::Exploration(applied)) => applied,
            Ok(_) | Err(DeviceError::Unknown(_)) => None,
            Err(error) => return Err(error.into()),
        };
        self.unperturbed |= asked.is_some() && applied.is_none();
        Ok(())
    }

    /// The error of a sample that no sound device sends. Without a sound sensor the device raises an alarm, which is then the reason.
    fn disbelieve(&mut self, what: String, breath: u32, tick: u32) -> SourceError {
        for _ in 0..shared::math::ticks(ALARM_TIME, self.period_us()) {
            match self.sample(breath) {
                Ok(Some(_)) => {}
                Ok(None) => return self.fault(breath, tick),
                Err(error) => return error,
            }
        }
        self.impossible(what, breath)
    }

    /// Stops the device, whose samples are useless.
    fn impossible(&mut self, what: String, breath: u32) -> SourceError {
        self.running = false;
        // The reason for the stop matters more than whether it succeeds.
        let _ = self.device.stop();
        SourceError::Impossible { what, breath }
    }

    fn fault(&mut self, breath: u32, tick: u32) -> SourceError {
        self.running = false;
        match self.alarm.take() {
            Some(fault) => SourceError::Fault { fault, breath, tick },
            None => SourceError::Silent { breath },
        }
    }
}

impl Source for PortSource {
    fn period_us(&self) -> u32 {
        self.identity.period_us
    }

    fn plant(&self) -> String {
        self.plant.clone()
    }

    fn plant_parameters(&self) -> String {
        self.plant_parameters.clone()
    }

    fn configure(
        &mut self,
        controller: Controller,
        exploration: Option<Exploration>,
    ) -> Result<(), SourceError> {
        self.halt()?;
        let choice = self.install(&controller)?;
        self.choose(choice)?;
        self.explore(exploration)
    }

    fn sweep(&mut self, sweep: Option<SineSweep>) -> Result<(), SourceError> {
        Ok(self.device.sweep(sweep)?)
    }

    fn upcoming(&mut self, settings: &[Settings]) -> Result<(), SourceError> {
        self.halt()?;
        self.plan = settings.iter().copied().collect();
        Ok(())
    }

    fn breath(&mut self, settings: &Settings, sink: &mut dyn FnMut(&Tick)) -> Result<(), SourceError> {
        let asked = Breath::new(settings, self.period_us())?;
        if self.plan.front() != Some(settings) {
            self.upcoming(core::slice::from_ref(settings))?;
        }
        if !self.running {
            self.start()?;
        }
        let mut course = Course::new(&asked);
        loop {
            let (breath, tick) = (course.breath.unwrap_or(0), course.ticks);
            let Some(sample) = self.sample(breath)? else {
                return Err(self.fault(breath, tick));
            };
            match course.take(&sample) {
                Step::Next => {}
                Step::NextBreath => {
                    // An expiration can be longer or shorter than the settings say.
                    self.samples.push_front(sample);
                    break;
                }
                Step::Gap => return Err(SourceError::Lost { breath: course.breath.unwrap_or(0), tick }),
                Step::Cut => {
                    // The pressure limit ended the inspiration, so this is not the requested breath.
                    self.device.stop()?;
                    self.alarm = Some(Fault::HighPressure);
                    return Err(self.fault(sample.breath, tick));
                }
                Step::Impossible(what) => return Err(self.disbelieve(what, sample.breath, tick)),
            }
            let number = self.handed;
            self.handed += 1;
            let truth = self.truth.as_mut().and_then(|truth| truth(number));
            sink(&Tick { sample, truth });
        }
        let Self { identity, handed, started, .. } = self;
        if let Some(what) = wrong_pace(identity.device, identity.period_us, *handed, started.elapsed()) {
            return Err(self.impossible(what, course.breath.unwrap_or(0)));
        }
        self.plan.pop_front();
        self.sent = self.sent.saturating_sub(1);
        self.fill()
    }

    fn shortfalls(&self) -> Vec<String> {
        let missing = "the device does not explore (SetExploration): the breaths have no perturbations, from which a simulator learns most";
        self.unperturbed.then(|| missing.to_owned()).into_iter().collect()
    }

    fn acknowledge(&mut self) -> Result<(), SourceError> {
        let ticks = |device: &mut Device| device.timing(false).map(|times| times.ticks);
        match ticks(&mut self.device) {
            Ok(from) => {
                let rest = shared::math::ticks(REST_TIME, self.period_us());
                let deadline = Instant::now() + SILENCE;
                while ticks(&mut self.device)?.wrapping_sub(from) < rest && Instant::now() < deadline {
                    std::thread::sleep(Duration::from_millis(20));
                }
            }
            // A device that counts no ticks has this computer's time.
            Err(DeviceError::Unknown(_)) => std::thread::sleep(Duration::from_secs_f32(REST_TIME)),
            Err(error) => return Err(error.into()),
        }
        match self.device.acknowledge() {
            Ok(_) | Err(DeviceError::Refused(Refusal::NoFault) | DeviceError::Unknown(_)) => {}
            Err(error) => return Err(error.into()),
        }
        // The plant continues from its present state, like a patient.
        self.seed = None;
        self.halt()
    }
}

impl Reseed for PortSource {
    /// A real ventilator's plant is unaffected; the simulated plant of hardware in the loop restarts.
    fn reseed(&mut self, seed: u64) {
        self.seed = self.identity.device.has_simulated_plant().then_some(seed);
    }
}

/// A controller in words.
fn named(choice: ControllerChoice) -> String {
    match choice {
        ControllerChoice::Pid(PidGains { p, i, d }) => format!("the PID {p},{i},{d}"),
        ControllerChoice::Learned => "its learned controller".to_owned(),
    }
}

impl Drop for PortSource {
    /// Stops the ventilation that it started; a device that cannot be reached continues by itself.
    fn drop(&mut self) {
        if self.running {
            let _ = self.device.stop();
        }
    }
}
