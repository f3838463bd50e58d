//! Everything that runs on the chip: start, the 1 kHz control task, the idle loop.
//!
//! | who | priority | does |
//! |---|---|---|
//! | `SysTick` | above the control task | announces a tick |
//! | control task, in the interrupt of an unused UART | 6 | reads, steps the ventilator, drives the valves |
//! | idle loop | thread | sleeps until the next interrupt |

mod board;
mod failure;

use cortex_m::peripheral::syst::SystClkSource;
use cortex_m_rt::{entry, exception};
use defmt::{Debug2Format, info, warn};
use defmt_rtt as _;
use embassy_executor::InterruptExecutor;
use embassy_stm32::interrupt;
use embassy_stm32::interrupt::{InterruptExt, Priority};
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::signal::Signal;
use shared::breath::DEFAULT_PERIOD_US;
use shared::control::Controller;
use shared::control::pid::{Pid, PidGains};
use shared::settings::Settings;
use shared::ventilator::{Mode, Ventilator, VentilatorState};

use board::Valves;

/// Number of the tick that has begun.
static TICK: Signal<CriticalSectionRawMutex, u32> = Signal::new();
static CONTROL: InterruptExecutor = InterruptExecutor::new();

#[entry]
fn main() -> ! {
    let (valves, core) = board::init();
    interrupt::UART5.set_priority(Priority::P6);
    let spawner = CONTROL.start(interrupt::UART5);
    match control(valves) {
        Ok(task) => spawner.spawn(task),
        Err(_) => unreachable!("the control task is spawned once, so its place is free"),
    }
    start_ticking(core.SYST);
    loop {
        cortex_m::asm::wfi();
    }
}

/// Lets `SysTick` announce a tick every control period.
fn start_ticking(mut timer: cortex_m::peripheral::SYST) {
    timer.set_clock_source(SystClkSource::Core);
    timer.set_reload(board::CORE_CLOCK.0 / 1_000_000 * DEFAULT_PERIOD_US - 1);
    timer.clear_current();
    timer.enable_interrupt();
    timer.enable_counter();
}

#[exception]
fn SysTick() {
    static mut NUMBER: u32 = 0;
    *NUMBER = NUMBER.wrapping_add(1);
    TICK.signal(*NUMBER);
}

#[interrupt]
unsafe fn UART5() {
    // SAFETY: this is the interrupt that the executor was started with, and nobody else calls it.
    unsafe { CONTROL.on_interrupt() }
}

/// One step of the ventilator per tick.
#[embassy_executor::task]
async fn control(mut valves: Valves) {
    let (ventilator, mut state) = standby();
    let (mut number, mut mode) = (0, state.mode());
    info!("{}", Debug2Format(&mode));
    loop {
        let now = TICK.wait().await;
        let missed = now.wrapping_sub(number).wrapping_sub(1);
        if missed > 0 {
            warn!("{} ticks missed before tick {}", missed, now);
        }
        number = now;
        let output = ventilator.step(&mut state, pressure());
        valves.apply(&output.command);
        if output.mode != mode {
            mode = output.mode;
            report(mode);
        }
    }
}

/// A ventilator in standby. Its gains are zero until gains or weights reach the chip, so it cannot push.
fn standby() -> (Ventilator, VentilatorState) {
    let pid = Pid::new(PidGains::default(), DEFAULT_PERIOD_US).expect("gains of zero are in bounds");
    let ventilator = Ventilator::new(DEFAULT_PERIOD_US, Controller::Pid(pid));
    let state = ventilator.standby(&Settings::default()).expect("the default settings are in bounds");
    (ventilator, state)
}

/// Airway pressure, cmH2O. There is no sensor driver yet, and what was not measured is no number: the supervisor
/// latches the missing sensor and the valves stay safe.
fn pressure() -> f32 {
    f32::NAN
}

fn report(mode: Mode) {
    match mode {
        Mode::Fault(fault) => warn!("safe state, {}", Debug2Format(&fault)),
        mode => info!("{}", Debug2Format(&mode)),
    }
}
