//! The link's serial line: USART1, byte by byte by interrupt.
//!
//! The interrupt is more urgent than the control task: at 1 Mbaud a byte lasts 10 us, less than a tick of the controller,
//! and the receiver holds only one. It never writes the status register: a read-modify-write there would clear a
//! byte-received flag that rose in between, and the byte with it.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::USART1;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::pipe::Pipe;

/// Bytes that wait on each way: 10 ms of the line.
const BUFFER: usize = 1024;

static RECEIVED: Pipe<CriticalSectionRawMutex, BUFFER> = Pipe::new();
static TO_SEND: Pipe<CriticalSectionRawMutex, BUFFER> = Pipe::new();
/// Bytes that came faster than they were taken.
static LOST: AtomicU32 = AtomicU32::new(0);

/// Starts the line, which [`super::open_serial`] has opened: from here on the interrupt owns the registers.
pub fn start() {
    interrupt::USART1.set_priority(Priority::P2);
    USART1.cr1().modify(|w| w.set_rxneie(true));
    // SAFETY: the handler below is there, and what it uses is static.
    unsafe { interrupt::USART1.enable() };
}

#[embassy_stm32::interrupt]
fn USART1() {
    let status = USART1.sr().read();
    if status.rxne() || status.ore() {
        // Reading the byte clears both flags.
        let byte = USART1.dr().read().dr() as u8;
        if RECEIVED.try_write(&[byte]).is_err() || status.ore() {
            LOST.store(lost().wrapping_add(1), Ordering::Relaxed);
        }
    }
    if status.txe() && USART1.cr1().read().txeie() {
        let mut byte = [0];
        match TO_SEND.try_read(&mut byte) {
            Ok(_) => USART1.dr().write(|w| w.set_dr(byte[0].into())),
            Err(_) => USART1.cr1().modify(|w| w.set_txeie(false)),
        }
    }
}

/// Lets the line wait while a control tick begins, so that no burst of bytes delays it. A byte lasts longer than that.
pub fn pause() {
    interrupt::USART1.disable();
}

/// Ends [`pause`].
pub fn resume() {
    // SAFETY: the line was opened, with its handler in place, before the first tick.
    unsafe { interrupt::USART1.enable() };
}

/// Bytes lost so far.
pub fn lost() -> u32 {
    LOST.load(Ordering::Relaxed)
}

/// Waits for some bytes; gives how many came.
pub async fn receive(bytes: &mut [u8]) -> usize {
    RECEIVED.read(bytes).await
}

/// Sends bytes; waits while there is no room.
pub async fn send(mut bytes: &[u8]) {
    while !bytes.is_empty() {
        let written = TO_SEND.write(bytes).await;
        bytes = &bytes[written..];
        cortex_m::interrupt::free(|_| USART1.cr1().modify(|w| w.set_txeie(true)));
    }
}

/// Waits until everything is on the line.
pub fn flush() {
    while USART1.cr1().read().txeie() || !USART1.sr().read().tc() {}
}
