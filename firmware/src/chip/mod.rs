//! The program on the chip: start, the 1 kHz control task, the link task. Fulfils: host-independence.
//!
//! | context | priority | work |
//! |---|---|---|
//! | supply voltage detector | 0 | makes the valves safe and restarts |
//! | `SysTick` | 0 | signals a tick |
//! | USART1 | 2 | receives and sends the link's bytes |
//! | control task, in the interrupt of an unused CAN port | 4 | reads, steps the ventilator, drives the valves, feeds the watchdog |
//! | link task, in another such interrupt | 14 | answers the host, sends telemetry, stores weights and calibrations, copies the flight recorder, notes when the device ventilates |
//! | idle loop | thread | sleeps until the next interrupt |

mod board;
mod control_task;
mod drivers;
mod failure;
mod link_task;
mod prescription;
mod recorder;
mod self_test;
mod storage;
mod trust;

use cortex_m_rt::entry;
use defmt::{Debug2Format, info};
use defmt_rtt as _;
use embassy_executor::InterruptExecutor;
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use shared::breath::DEFAULT_PERIOD_US;
use shared::device::control::Control;
use shared::device::prescription::Interruption;
use shared::device::self_test::BootFindings;
use shared::device::server::DeviceFacts;
use shared::recorder::{ChipEvent, Recorder};
use shared::reset::ResetCause;
use shared::weights::slots::{Slot, Slots};

use drivers::flash::BoardFlash;
use drivers::plant_interface::PlantInterface;
use drivers::{clock, flash, reset, supply, taken_once};
use storage::Storage;

static CONTROL: InterruptExecutor = InterruptExecutor::new();
static LINK: InterruptExecutor = InterruptExecutor::new();

#[entry]
fn main() -> ! {
    start();
    loop {
        clock::sleep();
    }
}

/// Starts everything. It is a separate function because `main` never returns and so never frees its stack frame.
#[inline(never)]
fn start() {
    let memory = self_test::is_memory_sound();
    let failure = failure::of_last_run();
    let mut board = board::start();
    let reset = reset::cause();
    let mut stored = Slots::new(board.flash, flash::slots()).trusting(trust::TRUST);
    let kind = board::SelectedPlant::KIND;
    let control = control_task::prepare(kind);
    let running = load(&mut stored, control);
    let slots = stored.states();
    let mut storage = Storage::attach(stored, control);
    info!("started after {}, weights {}", Debug2Format(&reset), Debug2Format(&slots));
    let (recorder, keeper) = recorder::attach(reset, failure.is_some(), &slots, running, storage.flash());
    if !board.crystal {
        recorder.log(ChipEvent::NoCrystal);
    }
    let was_low = failure.as_deref() == Some(failure::SUPPLY_LOW);
    let prescription = prescription::attach(Interruption::of(reset, failure.is_some(), was_low));
    if let Some(reason) = prescription.refused() {
        recorder.log(reason);
    }
    check_supply(&recorder, reset, was_low);
    let program = self_test::is_program_sound();
    control.require_self_test(&BootFindings { program, memory: Some(memory), slots });
    control.report_boot(reset, recorder.interrupted() || prescription.is_interrupted(), &slots);
    let facts = DeviceFacts {
        firmware: link_task::VERSION,
        device: kind,
        period_us: DEFAULT_PERIOD_US,
        slots,
        running,
        reset,
        failure,
        trust: trust::TRUST,
    };
    interrupt::CAN2_SCE.set_priority(Priority::P4);
    let spawner = CONTROL.start(interrupt::CAN2_SCE);
    board.watchdog.unleash();
    spawner.spawn(taken_once(
        control_task::run(control, recorder, prescription, board.plant, board.alarms, board.watchdog).ok(),
    ));
    interrupt::CAN2_RX0.set_priority(Priority::P14);
    LINK.start(interrupt::CAN2_RX0)
        .spawn(taken_once(link_task::run(link_task::prepare(facts), storage, keeper).ok()));
    clock::start(&mut board.core);
}

/// Gives the control half the weights in flash; the slot they are from. A separate function, so that they leave the stack.
#[inline(never)]
fn load(stored: &mut Slots<BoardFlash>, control: &mut Control) -> Option<Slot> {
    let (slot, ()) = stored.load(|image| control.learn(&image.residual))?;
    Some(slot)
}

/// Logs a low supply, programs the brown-out level if it is wrong, and then watches the supply. The option bytes are left alone
/// while the supply is in doubt: if it failed while they are programmed, they would be lost.
fn check_supply(recorder: &Recorder, reset: ResetCause, was_low: bool) {
    let low = supply::is_low();
    if low || was_low {
        recorder.log(ChipEvent::SupplyLow);
    }
    if !supply::is_brown_out_level_set() {
        let sound = !low && !was_low && reset != ResetCause::BrownOut;
        let set = sound && supply::set_brown_out_level();
        recorder.log(if set { ChipEvent::BrownOutLevelSet } else { ChipEvent::BrownOutLevelWrong });
    }
    supply::watch();
}

#[interrupt]
unsafe fn CAN2_SCE() {
    // SAFETY: the executor was started with this interrupt, and no other code calls it.
    unsafe { CONTROL.on_interrupt() }
}

#[interrupt]
unsafe fn CAN2_RX0() {
    // SAFETY: as above.
    unsafe { LINK.on_interrupt() }
}
