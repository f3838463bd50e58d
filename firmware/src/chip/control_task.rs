//! The control task: it runs one tick of the device per millisecond, and last silences the sounder and feeds the watchdog.

use core::sync::atomic::{AtomicBool, AtomicU8, Ordering};

use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::channel::Channel;
use embassy_sync::signal::Signal;
use shared::breath::DEFAULT_PERIOD_US;
use shared::device::control::Control;
use shared::device::prescription::Prescription;
use shared::device::{ControlReply, ControlReport, ControlRequest, HostRole};
use shared::link::messages::DeviceKind;
use shared::link::refusal::Refusal;
use shared::recorder::keeper::Leave;
use shared::recorder::{ChipEvent, Recorder};
use shared::timing::TickTime;

use static_cell::StaticCell;

use super::board::SelectedPlant;
use super::drivers::alarm_outputs::AlarmOutputs;
use super::drivers::core_clock::CORE_CLOCK;
use super::drivers::plant_interface::PlantInterface;
use super::drivers::watchdog::Watchdog;
use super::drivers::{clock, link_uart, oscillator, supply};

/// Capacity of the queue of reports to the link task: more than 0.1 s of samples.
const REPORTS_LENGTH: usize = 128;

/// Request from the link task, and the role of its host; one at a time.
pub static REQUEST: Signal<CriticalSectionRawMutex, (ControlRequest, HostRole)> = Signal::new();
/// Reply to the link task.
pub static REPLY: Signal<CriticalSectionRawMutex, ControlReply> = Signal::new();
/// Reports to the link task.
pub static REPORTS: Channel<CriticalSectionRawMutex, ControlReport, REPORTS_LENGTH> = Channel::new();

/// Whether the last tick was one of a breath.
static VENTILATES: AtomicBool = AtomicBool::new(false);

/// Whether the device ventilates.
pub fn ventilates() -> bool {
    VENTILATES.load(Ordering::Relaxed)
}

/// What may be done to the flash, as the number of a [`Leave`].
static LEAVE: AtomicU8 = AtomicU8::new(Leave::Nothing as u8);

/// What may be done to the flash. Only requests of the link task, which asks, and a due resumption start ventilation; the
/// answer takes both into account, so it holds until that task sends its next request.
pub fn leave() -> Leave {
    Leave::of(LEAVE.load(Ordering::Relaxed))
}

/// The device's control half. Static and built in place: as part of the task it would be moved through the stack.
/// With its error, which never occurs: taking the value out would copy kilobytes through the stack.
static CONTROL: StaticCell<Result<Control, Refusal>> = StaticCell::new();

/// Builds the control half. Called once.
#[inline(never)]
pub fn prepare(kind: DeviceKind) -> &'static mut Control {
    match CONTROL.init_with(|| Control::new(kind, DEFAULT_PERIOD_US, CORE_CLOCK.0)) {
        Ok(control) => control,
        Err(_) => unreachable!("the default settings and gains are valid"),
    }
}

/// Runs the ticks; never returns.
#[embassy_executor::task]
pub async fn run(
    control: &'static mut Control,
    mut recorder: Recorder<'static>,
    mut prescription: Prescription<'static>,
    mut plant: SelectedPlant,
    mut alarms: AlarmOutputs,
    mut watchdog: Watchdog,
) {
    let mut before = None;
    loop {
        let number = clock::tick().await;
        if oscillator::recover() {
            recorder.log(ChipEvent::CrystalStopped);
        }
        let (latency, begun) = (clock::since_tick(), clock::now());
        link_uart::resume();
        if prescription.is_due()
            && let Some(reason) = prescription.resume(control, supply::has_returned())
        {
            recorder.log(reason);
        }
        let change = control.plant_change();
        let readings = plant.read(&change);
        let read = clock::now();
        let output = control.step(readings);
        plant.drive(&output.command);
        control.report(&output, &mut |report| REPORTS.try_send(report).is_ok());
        prescription.keep(control, &output);
        if let Some((request, role)) = REQUEST.try_take() {
            REPLY.signal(prescription.execute(control, &request, role));
        }
        let (missed, period) = since(before, number, begun);
        LEAVE.store(prescription.leave(control) as u8, Ordering::Relaxed);
        VENTILATES.store(output.sample.is_some(), Ordering::Relaxed);
        recorder.record(&control.moment(readings.airway, &output, missed));
        let work = clock::now().wrapping_sub(read);
        control.record(&TickTime { latency, work, period, missed });
        before = Some((number, begun));
        alarms.apply(control.signals());
        watchdog.pet();
    }
}

/// Ticks missed since the last one, and the cycles between the starts of two consecutive ticks.
fn since(before: Option<(u32, u32)>, number: u32, begun: u32) -> (u32, Option<u32>) {
    let Some((last, start)) = before else { return (0, None) };
    let missed = number.wrapping_sub(last).wrapping_sub(1);
    (missed, (missed == 0).then(|| begun.wrapping_sub(start)))
}
