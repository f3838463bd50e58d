//! The device of a trial: a [`Rig`] with the prescription and the weight slots of a chip, and a host that polls it.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::control::residual::Residual;
use shared::device::ControlRequest;
use shared::device::absence::ClockTime;
use shared::device::control::Control;
use shared::device::prescription::{Interruption, Prescription, PrescriptionMemory};
use shared::device::server::{DeviceFacts, Server};
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
use shared::ventilator::Output;
use shared::weights::slots::SlotState;
use shared::weights::{IMAGE_BYTES, Identity, encode};

use super::injection::Damage;
use device::upload::UploadError;
use plant::bench::BenchPlant;
use ventilator::SourceError;
use virtual_chip::{Flash, Rig};

/// Ticks between two requests of the host.
const HOST_ASKS_EVERY: u32 = 1000;
/// Ticks between two notes of the time at which the device ventilates.
const NOTED_EVERY: u32 = 250;
const TICKS_PER_S: u32 = 1_000_000 / DEFAULT_PERIOD_US;

/// A device on a bench, and its host.
pub struct Attended<'a> {
    /// The device and its bench.
    pub rig: Rig,
    memory: &'a PrescriptionMemory,
    prescription: Prescription<'a>,
    learned: Option<Residual>,
    settings: Settings,
    monitors: Monitors,
    /// Whether the host still sends requests.
    pub host_speaks: bool,
}

impl<'a> Attended<'a> {
    /// A device just started by a host, with new memory for its prescription, on a plant at rest.
    pub fn started(
        memory: &'a PrescriptionMemory,
        plant: BenchPlant,
        controller: &Controller,
        settings: &Settings,
        monitors: Monitors,
        exploration: Option<Exploration>,
    ) -> Self {
        let learned = match controller {
            Controller::Residual(residual) => Some(residual.clone()),
            Controller::Pid(_) => None,
        };
        let control = virtual_chip::control(learned.as_ref()).with_monitors(monitors);
        let mut attended = Self {
            rig: Rig::new(control, plant, settings.peep),
            memory,
            prescription: Prescription::attach(memory, None, None),
            learned,
            settings: *settings,
            monitors,
            host_speaks: true,
        };
        attended.rig.control.execute(&ControlRequest::Exploration(exploration));
        if let Controller::Pid(pid) = controller {
            let choice = ControllerChoice::Pid(pid.gains());
            attended.rig.control.execute(&ControlRequest::Controller(choice));
        }
        attended.start();
        attended
    }

    /// Starts the device as a host does.
    pub fn start(&mut self) {
        self.rig.control.execute(&ControlRequest::Apply(self.settings));
        self.rig.control.execute(&ControlRequest::Start);
    }

    /// The host sends settings for the next breath.
    pub fn apply(&mut self, settings: Settings) {
        self.settings = settings;
        self.rig.control.execute(&ControlRequest::Apply(settings));
    }

    /// Acknowledges what has stopped the device, and starts it again.
    pub fn restart(&mut self) {
        self.rig.control.execute(&ControlRequest::Acknowledge);
        self.start();
    }

    /// Runs one tick of the device; it has missed some before.
    pub fn step(&mut self, readings: Readings, missed: u32) -> Output {
        let control = &mut self.rig.control;
        control.record(&TickTime { latency: 0, work: 0, period: None, missed });
        if self.prescription.is_due() {
            self.prescription.resume(control, true);
        }
        let output = self.rig.step(readings);
        self.prescription.keep(&self.rig.control, &output);
        let ticks = self.rig.ticks;
        if output.sample.is_some() && ticks.is_multiple_of(NOTED_EVERY) {
            self.memory.ventilates_at(clock(ticks / TICKS_PER_S));
        }
        if self.host_speaks && ticks.is_multiple_of(HOST_ASKS_EVERY) {
            self.rig.control.execute(&ControlRequest::Status);
        }
        output
    }

    /// Another host sends its own settings and gains, and stops the device, while this rig's host holds the lease. Returns
    /// whether every request is refused because of the lease.
    pub fn other_host(&mut self) -> bool {
        let [first, second] = [1, 2];
        let lease = Request::AcquireLease { name: HostName::default(), take_over: false };
        let mut server = Server::new(DeviceFacts::blank(DeviceKind::Simulated), &NO_RECORDING);
        let (Rig { control, ticks, .. }, mut flash) = (&mut self.rig, Flash::default());
        let mut ask = |message| server.serve(&message, *ticks, control, &mut flash);
        ask(ToDevice { sequence: 0, request: lease.clone(), host: Some(first) });
        let requests = [
            lease,
            Request::ApplySettings(Settings { pip: f32::NAN, ..self.settings }),
            Request::ApplySettings(Settings::default()),
            Request::SetController(ControllerChoice::Pid(shared::device::KNOWN_GOOD)),
            Request::Stop,
        ];
        let mut refused = true;
        for (sequence, request) in (0..).zip(requests) {
            let answer = ask(ToDevice { sequence, request, host: Some(second) });
            refused &= matches!(
                answer.message,
                ToHost::Response { response: Response::Refused(Refusal::Lease { .. }), .. }
            );
        }
        refused
    }

    /// Restarts the chip with the weights it contains, after its supply was away for some seconds.
    pub fn reset(&mut self, cause: ResetCause, away_s: u32) {
        let control = virtual_chip::control(self.learned.as_ref());
        self.boot(cause, away_s, control, [SlotState::Empty; 2]);
    }

    /// Restarts the chip with damaged weights in flash.
    pub fn reset_with(&mut self, damage: Damage, rng: &mut ChaCha8Rng) -> Result<(), SourceError> {
        let mut flash = Flash::default();
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
        let learned = slots.load(|image| image.residual.clone()).map(|(_, learned)| learned);
        let control = virtual_chip::control(learned.as_ref());
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
        let now = clock(self.rig.ticks / TICKS_PER_S + away_s);
        self.prescription =
            Prescription::attach(self.memory, Interruption::of(cause, false, false), Some(now));
        let mut control = control.with_monitors(self.monitors);
        control.report_boot(cause, self.prescription.is_interrupted(), &slots);
        self.rig.restart(control);
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
