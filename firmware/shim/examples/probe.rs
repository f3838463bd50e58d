//! A small firmware that uses, on request over USART1, the parts that the shim models: clocks, flash, watchdog, plant port.
//!
//! A request has 12 bytes: a letter, three ignored bytes, two u32, little endian. Each is answered with two u32. A byte of
//! 0x80 or more in place of a request is a hello, which is sent back.
//!
//! | request | action | answer |
//! |---|---|---|
//! | `c` | | `RCC_CSR` at the start, core clock in Hz |
//! | `e` offset, bytes | erases flash | 0, or 1 for an error |
//! | `p` offset, value | programs a word of flash | 0, or 1 for an error |
//! | `r` offset | reads flash | the word; 0, or 1 for an error |
//! | `f` ticks, µs | starts the watchdog and feeds it for this number of ticks only | ticks |
//! | `h` µs | starts the watchdog and hangs | none |
//! | `s` | resets the system | none |
//! | `x` ticks | sends a frame to the plant in each tick, and reads the answer | good answers, instructions per exchange |
//! | `m` | | instructions per load from the clock registers, per load of the plant port's status |
#![cfg_attr(target_os = "none", no_std)]
#![cfg_attr(target_os = "none", no_main)]

#[cfg(not(target_os = "none"))]
fn main() {
    eprintln!("the probe runs in QEMU only; build it with: cargo xtask firmware");
    std::process::exit(1);
}

#[cfg(target_os = "none")]
mod chip {
    use core::panic::PanicInfo;
    use core::sync::atomic::{AtomicU32, Ordering};

    use cortex_m::peripheral::syst::SystClkSource;
    use cortex_m::peripheral::{SCB, SYST};
    use cortex_m_rt::{entry, exception};
    use defmt_rtt as _;
    use embassy_stm32::flash::{self, Flash};
    use embassy_stm32::mode::Blocking;
    use embassy_stm32::pac;
    use embassy_stm32::peripherals::IWDG;
    use embassy_stm32::rcc::{
        AHBPrescaler, APBPrescaler, Hse, HseMode, Pll, PllMul, PllPDiv, PllPreDiv, PllQDiv, PllSource,
        Sysclk, clocks,
    };
    use embassy_stm32::time::Hertz;
    use embassy_stm32::usart::{self, Uart};
    use embassy_stm32::wdg::IndependentWatchdog;
    use embassy_stm32::{Config, Peri};

    const CORE_CLOCK: u32 = 168_000_000;
    const BAUD: u32 = 1_000_000;
    const REQUEST_BYTES: usize = 12;
    const FIRST_HELLO: u8 = 0x80;
    const FRAME_BYTES: usize = 16;
    /// Polls of the plant's line without a byte after which it counts as silent.
    const PATIENCE: u32 = 100;
    /// Virtual time of an instruction with QEMU's `-icount shift=3`, ns.
    const INSTRUCTION_NS: u32 = 8;

    static TICKS: AtomicU32 = AtomicU32::new(0);

    #[exception]
    fn SysTick() {
        TICKS.fetch_add(1, Ordering::Relaxed);
    }

    #[panic_handler]
    fn panic(_: &PanicInfo) -> ! {
        loop {
            cortex_m::asm::wfi();
        }
    }

    struct Probe {
        flags: u32,
        core_clock: u32,
        flash: Flash<'static, flash::Blocking>,
        watchdog: Peri<'static, IWDG>,
    }

    #[entry]
    fn main() -> ! {
        let mut config = Config::default();
        config.rcc.hse = Some(Hse { freq: Hertz(8_000_000), mode: HseMode::Oscillator });
        config.rcc.pll_src = PllSource::HSE;
        config.rcc.pll = Some(Pll {
            prediv: PllPreDiv::DIV4,
            mul: PllMul::MUL168,
            divp: Some(PllPDiv::DIV2),
            divq: Some(PllQDiv::DIV7),
            divr: None,
        });
        config.rcc.sys = Sysclk::PLL1_P;
        config.rcc.ahb_pre = AHBPrescaler::DIV1;
        config.rcc.apb1_pre = APBPrescaler::DIV4;
        config.rcc.apb2_pre = APBPrescaler::DIV2;
        let chip = embassy_stm32::init(config);
        let core_clock = clocks(&chip.RCC).sys.to_hertz().map_or(0, |clock| clock.0);
        let flags = pac::RCC.csr().read().0;
        pac::RCC.csr().modify(|w| w.set_rmvf(true));

        let mut config = usart::Config::default();
        config.baudrate = BAUD;
        let link = Uart::new_blocking(chip.USART1, chip.PA10, chip.PA9, config);
        let plant = Uart::new_blocking(chip.USART2, chip.PA3, chip.PA2, config);
        let (Ok(mut link), Ok(plant)) = (link, plant) else { unreachable!("both baud rates are possible") };
        // From here on its registers are polled.
        core::mem::forget(plant);
        if let Some(core) = cortex_m::Peripherals::take() {
            start_ticking(core.SYST);
        }
        let mut probe =
            Probe { flags, core_clock, flash: Flash::new_blocking(chip.FLASH), watchdog: chip.IWDG };
        loop {
            let request = receive(&mut link);
            let answer = probe.answer(&request);
            for word in answer {
                let _ = link.blocking_write(&word.to_le_bytes());
            }
        }
    }

    fn start_ticking(mut timer: SYST) {
        timer.set_clock_source(SystClkSource::Core);
        timer.set_reload(CORE_CLOCK / 1000 - 1);
        timer.clear_current();
        timer.enable_interrupt();
        timer.enable_counter();
    }

    fn receive(link: &mut Uart<'static, Blocking>) -> [u8; REQUEST_BYTES] {
        let mut request = [0; REQUEST_BYTES];
        let mut length = 0;
        while length < REQUEST_BYTES {
            while !pac::USART1.sr().read().rxne() {
                cortex_m::asm::wfi();
            }
            let byte = pac::USART1.dr().read().dr() as u8;
            if length == 0 && byte >= FIRST_HELLO {
                // Writing only waits for room, so it cannot fail.
                let _ = link.blocking_write(&[byte]);
            } else {
                request[length] = byte;
                length += 1;
            }
        }
        request
    }

    impl Probe {
        fn answer(&mut self, request: &[u8; REQUEST_BYTES]) -> [u32; 2] {
            let &[letter, _, _, _, a0, a1, a2, a3, b0, b1, b2, b3] = request;
            let (a, b) = (u32::from_le_bytes([a0, a1, a2, a3]), u32::from_le_bytes([b0, b1, b2, b3]));
            match letter {
                b'c' => [self.flags, self.core_clock],
                b'e' => [self.flash.blocking_erase(a, a.wrapping_add(b)).is_err().into(), 0],
                b'p' => [self.flash.blocking_write(a, &b.to_le_bytes()).is_err().into(), 0],
                b'r' => {
                    let mut word = [0; 4];
                    let failed = self.flash.blocking_read(a, &mut word).is_err();
                    [u32::from_le_bytes(word), failed.into()]
                }
                b'f' => {
                    self.start_watchdog(b);
                    for _ in 0..a {
                        wait_for_tick();
                        probe_feed();
                    }
                    [a, 0]
                }
                b'h' => {
                    self.start_watchdog(a);
                    loop {
                        cortex_m::asm::nop();
                    }
                }
                b's' => SCB::sys_reset(),
                b'x' => exchanges(a),
                b'm' => [cost(|| _ = pac::RCC.cr().read()), cost(|| _ = pac::USART2.sr().read())],
                _ => [0, 0],
            }
        }

        fn start_watchdog(&mut self, timeout_us: u32) {
            IndependentWatchdog::new(self.watchdog.reborrow(), timeout_us).unleash();
        }
    }

    /// Exported under its own name, so that a debugger can find it.
    #[unsafe(no_mangle)]
    #[inline(never)]
    extern "C" fn probe_feed() {
        pac::IWDG.kr().write(|w| w.set_key(pac::iwdg::vals::Key::RESET));
    }

    fn wait_for_tick() {
        let now = TICKS.load(Ordering::Relaxed);
        while TICKS.load(Ordering::Relaxed) == now {
            cortex_m::asm::wfi();
        }
    }

    /// Sends numbered frames, which the plant must echo.
    fn exchanges(ticks: u32) -> [u32; 2] {
        let (mut good, mut total_ns) = (0, 0_u64);
        for number in 0..ticks {
            wait_for_tick();
            let mut frame = [number as u8; FRAME_BYTES];
            // Never all zeros, which means a missing answer.
            frame[0] = u8::MAX;
            let start = now_ns();
            good += u32::from(exchange(&frame) == frame);
            total_ns += u64::from(now_ns().wrapping_sub(start));
        }
        let mean_ns = total_ns / u64::from(ticks.max(1));
        [good, mean_ns as u32 / INSTRUCTION_NS]
    }

    fn exchange(frame: &[u8; FRAME_BYTES]) -> [u8; FRAME_BYTES] {
        for &byte in frame {
            while !pac::USART2.sr().read().txe() {}
            pac::USART2.dr().write(|w| w.set_dr(byte.into()));
        }
        let mut answer = [0; FRAME_BYTES];
        for byte in &mut answer {
            let mut patience = PATIENCE;
            while !pac::USART2.sr().read().rxne() {
                patience -= 1;
                if patience == 0 {
                    return answer;
                }
            }
            *byte = pac::USART2.dr().read().dr() as u8;
        }
        answer
    }

    /// Number of instructions of `something`.
    fn cost(something: impl Fn()) -> u32 {
        const TIMES: u32 = 64;
        let start = now_ns();
        for _ in 0..TIMES {
            something();
        }
        now_ns().wrapping_sub(start) / INSTRUCTION_NS / TIMES
    }

    /// Virtual time, wrapping, from the timer that the shim has started.
    fn now_ns() -> u32 {
        pac::TIM5.cnt().read()
    }
}
