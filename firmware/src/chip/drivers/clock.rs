//! Time: `SysTick` announces the control ticks, and cycles of the core's clock measure them.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use cortex_m::Peripherals;
use cortex_m::peripheral::scb::SystemHandler;
use cortex_m::peripheral::syst::SystClkSource;
use cortex_m::peripheral::{DWT, SCB, SYST};
use cortex_m_rt::exception;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use shared::breath::DEFAULT_PERIOD_US;

use super::super::board::CORE_CLOCK;
use super::link_uart;

/// Cycles of a control tick.
pub const TICK_CYCLES: u32 = CORE_CLOCK.0 / 1_000_000 * DEFAULT_PERIOD_US;
/// Priority of `SysTick`, the most urgent: a tick must be announced while anything else runs.
const TICK_PRIORITY: u8 = 0x00;

/// Cycles from the tick to its sample: longer than whatever the tick may have interrupted takes to let it through.
const SAMPLING_DELAY: u32 = CORE_CLOCK.0 / 1_000_000 * 12;

/// Number of the tick that has begun.
static TICK: Signal<CriticalSectionRawMutex, u32> = Signal::new();
static NUMBER: AtomicU32 = AtomicU32::new(0);
/// Whether the cycle counter counts. Emulators have none; there `SysTick`'s value, which counts the same cycles, takes
/// its place.
static COUNTER: AtomicBool = AtomicBool::new(false);

/// Starts the ticks.
pub fn start(core: &mut Peripherals) {
    core.DCB.enable_trace();
    core.DWT.enable_cycle_counter();
    let before = DWT::cycle_count();
    cortex_m::asm::nop();
    COUNTER.store(DWT::cycle_count() != before, Ordering::Relaxed);
    // SAFETY: the priority is the highest there is, so no critical section that masks by priority exists above it.
    unsafe { core.SCB.set_priority(SystemHandler::SysTick, TICK_PRIORITY) };
    core.SYST.set_clock_source(SystClkSource::Core);
    core.SYST.set_reload(TICK_CYCLES - 1);
    core.SYST.clear_current();
    core.SYST.enable_interrupt();
    core.SYST.enable_counter();
}

/// Waits for the instant to sample in the next tick; gives its number. The instant is fixed, so that an interrupt or a
/// critical section at the start of a tick does not become jitter of the sampling.
pub async fn tick() -> u32 {
    let number = TICK.wait().await;
    // A delay of so many cycles may take twice as many; each round at least halves what is left.
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

/// Cycles since the present tick was due.
pub fn since_tick() -> u32 {
    (TICK_CYCLES - 1).saturating_sub(SYST::get_current())
}

/// Cycles since some moment in the past, wrapping.
pub fn now() -> u32 {
    if COUNTER.load(Ordering::Relaxed) {
        return DWT::cycle_count();
    }
    let (mut number, mut since) = (NUMBER.load(Ordering::Relaxed), since_tick());
    if SCB::is_pendst_pending() || NUMBER.load(Ordering::Relaxed) != number {
        // The timer wrapped in between: a value read now belongs to the next tick.
        (number, since) = (number.wrapping_add(1), since_tick());
    }
    number.wrapping_mul(TICK_CYCLES).wrapping_add(since)
}
