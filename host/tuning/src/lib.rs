//! Stability margins of a ventilator that breathes, measured from outside: a device at a port, a plant, or a bench.
//!
//! The core adds sines to the command during the inspirations ([`shared::explore::sines`]) and the host sees every tick. The ratio of
//! the commands before and after the sine is the **loop** gain, not the response of the closed loop: each signal is correlated with
//! the known sine, to which noise and patient are not related, so that the feedback does not bias the ratio.
//!
//! | module | contains |
//! |---|---|
//! | [`measure`] | measures a unit that this program runs |
//! | [`measurement`] | the breaths: a warm-up, the check of the amplitude, the sweep |
//! | [`estimate`] | the response at a frequency, from the signals of its breaths |
//! | [`interval`] | how sure the margins are |
//! | [`stability`] | margins from a loop gain, also of the laboratory's measurements |
//! | [`advice`] | what limits the loop, in words |
//! | [`figures`] | Nyquist and Bode plots, and the breath beside them |
//! | [`words`] | the result in rows and words |
#![forbid(unsafe_code)]

pub mod advice;
pub mod estimate;
pub mod figures;
pub mod interval;
pub mod measure;
pub mod measurement;
pub mod response;
pub mod stability;
#[cfg(test)]
mod tests;
pub mod words;
