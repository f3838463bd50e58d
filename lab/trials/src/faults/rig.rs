//! The device of a trial: the control half as it runs on the chip, its prescription and weight slots, and a host that polls it.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::control::residual::Residual;
use shared::device::ControlRequest;
use shared::device::absence::ClockTime;
use shared::device::control::Control;
use shared::device::prescription::{Interruption, Prescription, PrescriptionMemory};
use shared::device::server::{DeviceFacts, NextStep, Server};
use shared::explore::Exploration;
use shared::link::host_name::HostName;
use shared::link::messages::{ControllerChoice, DeviceKind, Request, Response, ToDevice, ToHost};
use shared::link::refusal::Refusal;
use shared::recorder::RecorderMemory;
use shared::reset::ResetCause;
use shared::safety::monitors::Monitors;
use shared::sensor::Readings;
use shared::settings::Settings;
use shared::timing::TickTime;
use shared::ventilator::{Output, VentilatorState};
use shared::weights::slots::SlotState;
use shared::weights::{IMAGE_BYTES, Identity, Image, encode};

use super::flash::Flash;
use super::injection::Damage;
use device::DeviceError;
use device::upload::UploadError;
use ventilator::SourceError;

/// Ticks between two requests of the host.
const HOST_ASKS_EVERY: u32 = 1000;
/// Ticks between two notes of the time at which the device ventilates.
const NOTED_EVERY: u32 = 250;
const TICKS_PER_S: u32 = 1_000_000 / DEFAULT_PERIOD_US;
/// Clock rate of the simulated device, Hz.
const CORE_HZ: u32 = 1_000_000;

/// A device and its host.
pub struct Rig<'a> {
    control: Control,
    memory: &'a PrescriptionMemory,
    prescription: Prescription<'a>,
    learned: Option<Residual>,
    settings: Settings,
    monitors: Monitors,
    /// Whether the host still sends requests.
    pub host_speaks: bool,
    ticks: u32,
}

impl<'a> Rig<'a> {
    /// A device just started by a host, with new memory for its prescription.
    pub fn started(
        memory: &'a PrescriptionMemory,
        controller: &Controller,
        settings: &Settings,
        monitors: Monitors,
        exploration: Option<Exploration>,
    ) -> Result<Self, SourceError> {
        let learned = match controller {
            Controller::Residual(residual) => Some(residual.clone()),
            Controller::Pid(_) => None,
        };
        let mut rig = Self {
            control: device(learned.as_ref(), monitors)?,
            memory,
            prescription: Prescription::attach(memory, None, None),
            learned,
            settings: *settings,
            monitors,
            host_speaks: true,
            ticks: 0,
        };
        rig.control.execute(&ControlRequest::Exploration(exploration));
        if let Controller::Pid(pid) = controller {
            rig.control.execute(&ControlRequest::Controller(ControllerChoice::Pid(pid.gains())));
        }
        rig.start();
        Ok(rig)
    }

    /// Starts the device as a host does.
    pub fn start(&mut self) {
        self.control.execute(&ControlRequest::Apply(self.settings));
        self.control.execute(&ControlRequest::Start);
    }

    /// The host sends settings for the next breath.
    pub fn apply(&mut self, settings: Settings) {
        self.settings = settings;
        self.control.execute(&ControlRequest::Apply(settings));
    }

    /// Acknowledges what has stopped the device, and starts it again.
    pub fn restart(&mut self) {
        self.control.execute(&ControlRequest::Acknowledge);
        self.start();
    }

    /// The PEEP to which the PEEP valve must be turned before the next tick, cmH2O; none if it is unchanged.
    pub fn new_peep(&mut self) -> Option<f32> {
        self.control.plant_change().peep
    }

    /// Runs one tick.
    pub fn step(&mut self, readings: Readings, missed: u32) -> Output {
        self.control.record(&TickTime { latency: 0, work: 0, period: None, missed });
        if self.prescription.is_due() {
            self.prescription.resume(&mut self.control, true);
        }
        let output = self.control.step(readings);
        self.prescription.keep(&self.control, &output);
        self.ticks += 1;
        if output.sample.is_some() && self.ticks.is_multiple_of(NOTED_EVERY) {
            self.memory.ventilates_at(clock(self.ticks / TICKS_PER_S));
        }
        if self.host_speaks && self.ticks.is_multiple_of(HOST_ASKS_EVERY) {
            self.control.execute(&ControlRequest::Status);
        }
        output
    }

    /// The ventilator's state.
    pub fn state(&self) -> &VentilatorState {
        self.control.state()
    }

    /// Another host sends its own settings and gains, and stops the device, while this rig's host holds the lease. Returns
    /// whether every request is refused because of the lease.
    pub fn other_host(&mut self) -> bool {
        let [first, second] = [1, 2];
        let lease = Request::AcquireLease { name: HostName::default(), take_over: false };
        let mut server = Server::new(DeviceFacts::blank(DeviceKind::Simulated), &NO_RECORDING);
        server.receive(&ToDevice { sequence: 0, request: lease.clone(), host: Some(first) }, self.ticks);
        let requests = [
            lease,
            Request::ApplySettings(Settings { pip: f32::NAN, ..self.settings }),
            Request::ApplySettings(Settings::default()),
            Request::SetController(ControllerChoice::Pid(shared::device::KNOWN_GOOD)),
            Request::Stop,
        ];
        let mut refused = true;
        for (sequence, request) in (0..).zip(requests) {
            let step = server.receive(&ToDevice { sequence, request, host: Some(second) }, self.ticks);
            if let NextStep::Control(request) = &step {
                self.control.execute(request);
            }
            refused &= matches!(
                step,
                NextStep::Send(ToHost::Response { response: Response::Refused(Refusal::Lease { .. }), .. })
            );
        }
        refused
    }

    /// Restarts the chip with the weights it contains, after its supply was away for some seconds.
    pub fn reset(&mut self, cause: ResetCause, away_s: u32) -> Result<(), SourceError> {
        let control = device(self.learned.as_ref(), self.monitors)?;
        self.boot(cause, away_s, control, [SlotState::Empty; 2]);
        Ok(())
    }

    /// Restarts the chip with damaged weights in flash.
    pub fn reset_with(&mut self, damage: Damage, rng: &mut ChaCha8Rng) -> Result<(), SourceError> {
        let mut flash = Flash::new();
        let image = self.image()?;
        // The slots show later whether the store succeeded.
        let _ = flash.slots().store(&image);
        match damage {
            Damage::FlippedBit => flash.flip(rng.random_range(0..8 * IMAGE_BYTES)),
            Damage::TornStore => {
                flash.supply = rng.random_range(1..IMAGE_BYTES);
                let _ = flash.slots().store(&image);
                flash.supply = usize::MAX;
            }
        }
        let mut slots = flash.slots();
        let image = slots.load(Image::clone).map(|(_, image)| image);
        let control = device(image.as_ref().map(|image| &image.residual), self.monitors)?;
        self.boot(ResetCause::BrownOut, 0, control, slots.states());
        Ok(())
    }

    fn image(&self) -> Result<[u8; IMAGE_BYTES], SourceError> {
        let Some(residual) = &self.learned else { return Ok([0; IMAGE_BYTES]) };
        let mut image = [0; IMAGE_BYTES];
        encode(residual, &Identity::default(), &mut image).map_err(UploadError::from)?;
        Ok(image)
    }

    fn boot(&mut self, cause: ResetCause, away_s: u32, control: Control, slots: [SlotState; 2]) {
        let now = clock(self.ticks / TICKS_PER_S + away_s);
        self.prescription =
            Prescription::attach(self.memory, Interruption::of(cause, false, false), Some(now));
        self.control = control;
        self.control.report_boot(cause, self.prescription.is_interrupted(), &slots);
    }
}

/// What a calendar clock shows some seconds after midnight.
fn clock(seconds: u32) -> ClockTime {
    let decimal = |number: u32| 16 * (number / 10) + number % 10;
    let [hour, minute, second] = [seconds / 3600 % 24, seconds / 60 % 60, seconds % 60].map(decimal);
    ClockTime { time: hour << 16 | minute << 8 | second, ..ClockTime::FIRST }
}

/// The server's recorder memory; nothing is recorded.
static NO_RECORDING: RecorderMemory = RecorderMemory::new();

fn device(learned: Option<&Residual>, monitors: Monitors) -> Result<Control, SourceError> {
    let control = Control::new(DeviceKind::Simulated, DEFAULT_PERIOD_US, CORE_HZ);
    let mut control = control.map_err(DeviceError::from)?.with_monitors(monitors);
    if let Some(learned) = learned {
        control.learn(learned);
    }
    Ok(control)
}
