//! The link's serial line: USART1, one interrupt per byte.
//!
//! The interrupt has a higher priority than the control task: at 1 Mbaud a byte lasts 10 us, less than the work of a
//! control tick, and the receiver buffers only one. The interrupt never writes the status register: a read-modify-write
//! would clear a byte-received flag that was set in between, and lose the byte.

use core::sync::atomic::{AtomicU32, Ordering};

use embassy_stm32::interrupt::{self, InterruptExt, Priority};
use embassy_stm32::pac::USART1;
use embassy_sync::blocking_mutex::raw::CriticalSectionRawMutex;
use embassy_sync::pipe::Pipe;

/// Buffer size in each direction, bytes: 10 ms of data.
const BUFFER: usize = 1024;
/// Most bytes copied to the send buffer in one critical section, which delays the control tick: below 3 us.
const COPIED_AT_ONCE: usize = 64;

static RECEIVED: Pipe<CriticalSectionRawMutex, BUFFER> = Pipe::new();
static TO_SEND: Pipe<CriticalSectionRawMutex, BUFFER> = Pipe::new();
/// Number of received bytes that were lost.
static LOST: AtomicU32 = AtomicU32::new(0);

/// Starts the line, which [`super::open_serial`] has opened; from then on the interrupt owns the registers.
pub fn start() {
    interrupt::USART1.set_priority(Priority::P2);
    USART1.cr1().modify(|w| w.set_rxneie(true));
    // SAFETY: the handler is defined below and uses only static data.
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

/// Pauses the line while a control tick begins, so that no burst of bytes delays it. The pause ends at the sampling
/// instant, before the next byte is complete, so that no byte is lost.
pub fn pause() {
    interrupt::USART1.disable();
}

/// Ends the [`pause`].
pub fn resume() {
    // SAFETY: the line and its handler were started before the first tick.
    unsafe { interrupt::USART1.enable() };
}

/// Number of received bytes lost so far.
pub fn lost() -> u32 {
    LOST.load(Ordering::Relaxed)
}

/// Waits for at least one byte; returns the number of bytes read.
pub async fn receive(bytes: &mut [u8]) -> usize {
    RECEIVED.read(bytes).await
}

/// Sends bytes; waits while the buffer is full.
pub async fn send(mut bytes: &[u8]) {
    while !bytes.is_empty() {
        let written = TO_SEND.write(&bytes[..bytes.len().min(COPIED_AT_ONCE)]).await;
        bytes = &bytes[written..];
        cortex_m::interrupt::free(|_| USART1.cr1().modify(|w| w.set_txeie(true)));
    }
}

/// Waits until all bytes have been sent.
pub fn flush() {
    while USART1.cr1().read().txeie() || !USART1.sr().read().tc() {}
}
