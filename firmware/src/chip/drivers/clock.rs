//! Time: `SysTick` signals the control ticks, and core clock cycles measure them.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::Peripherals;
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{DWT, SCB, SYST};
use cortex_m_rt::exception;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use shared::breath::DEFAULT_PERIOD_US;

use super::core_clock::CORE_CLOCK;
use super::link_uart;

/// Length of a control tick, cycles.
pub const TICK_CYCLES: u32 = CORE_CLOCK.0 / 1_000_000 * DEFAULT_PERIOD_US;
/// Priority of `SysTick`, the highest: a tick must be signalled while anything else runs.
const TICK_PRIORITY: u8 = 0x00;

/// Delay from the tick to its sample, cycles: longer than any interrupt or critical section can delay the control task, and
/// shorter than the 10 us of a byte, since the link is paused meanwhile.
const SAMPLING_DELAY: u32 = CORE_CLOCK.0 / 1_000_000 * 6;

/// Signals the number of the tick that has begun.
static TICK: Signal<CriticalSectionRawMutex, u32> = Signal::new();
static NUMBER: AtomicU32 = AtomicU32::new(0);
/// Whether the cycle counter counts. In QEMU it does not; there `SysTick`, which counts the same cycles, replaces it.
static COUNTER: AtomicBool = AtomicBool::new(false);

/// Starts the ticks.
pub fn start(core: &mut Peripherals) {
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
    let before = DWT::cycle_count();
    cortex_m::asm::nop();
    COUNTER.store(DWT::cycle_count() != before, Ordering::Relaxed);
    // SAFETY: no critical section in this program masks interrupts by priority, so a change of priority cannot break one.
    unsafe { core.SCB.set_priority(SystemHandler::SysTick, TICK_PRIORITY) };
    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(TICK_CYCLES - 1);
    core.SYST.clear_current();
    core.SYST.enable_interrupt();
    core.SYST.enable_counter();
}

/// Waits for the sampling instant of the next tick; returns the tick's number. The instant is fixed, so that an interrupt
/// or a critical section at the start of a tick causes no sampling jitter.
pub async fn tick() -> u32 {
    let number = TICK.wait().await;
    // `delay(n)` may take up to twice `n` cycles, so wait for half of the rest in each round.
    while let Some(left @ 1..) = SAMPLING_DELAY.checked_sub(since_tick()) {
        cortex_m::asm::delay(left / 2);
    }
    number
}

#[exception]
fn SysTick() {
    let number = NUMBER.load(Ordering::Relaxed).wrapping_add(1);
    NUMBER.store(number, Ordering::Relaxed);
    link_uart::pause();
    TICK.signal(number);
}

/// Sleeps until the next interrupt.
pub fn sleep() {
    // While the core sleeps, QEMU sets its clock forward to the next tick. It may begin that before it has counted the last
    // instructions; the tick would then be late by their time. Reading the timer makes QEMU count them.
    core::hint::black_box(SYST::get_current());
    cortex_m::asm::wfi();
}

/// Number of the last tick that has begun, wrapping.
pub fn number() -> u32 {
    NUMBER.load(Ordering::Relaxed)
}

/// Cycles since the current tick was due.
pub fn since_tick() -> u32 {
    (TICK_CYCLES - 1).saturating_sub(SYST::get_current())
}

/// Cycles since an arbitrary moment, wrapping.
pub fn now() -> u32 {
    if COUNTER.load(Ordering::Relaxed) {
        return DWT::cycle_count();
    }
    let (mut number, mut since) = (NUMBER.load(Ordering::Relaxed), since_tick());
    if SCB::is_pendst_pending() || NUMBER.load(Ordering::Relaxed) != number {
        // The timer wrapped in between: read the value again, for the next tick.
        (number, since) = (number.wrapping_add(1), since_tick());
    }
    number.wrapping_mul(TICK_CYCLES).wrapping_add(since)
}
