//! What happens when the program cannot go on: the valves are put in their safe state and everything stops.
//!
//! The chip is not restarted: a program that fails again and again would move the valves each time.

use core::panic::PanicInfo;

use cortex_m_rt::{ExceptionFrame, exception};
use defmt::{Debug2Format, Display2Format, error};

use super::board;

#[panic_handler]
fn panic(info: &PanicInfo) -> ! {
    stop_safely();
    error!("{}", Display2Format(info));
    sleep()
}

#[exception]
unsafe fn HardFault(frame: &ExceptionFrame) -> ! {
    stop_safely();
    error!("hard fault, {}", Debug2Format(frame));
    sleep()
}

fn stop_safely() {
    cortex_m::interrupt::disable();
    board::force_valves_safe();
}

fn sleep() -> ! {
    loop {
        cortex_m::asm::wfi();
    }
}
