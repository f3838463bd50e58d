//! The bedside page: watches devices and shows them in browsers, live.
//!
//! A [`source`] gives the news of a device. Its [`hub`], one thread for each device, makes messages of them ([`stream`]), with the
//! [`figures`] of each breath, their [`trends`] and the list of [`alarms`], and queues them for the open pages ([`viewers`]). [`http`] serves the
//! pages behind a [`guard`]; [`steer`] lets one of them steer, and measure the margins of a
//! device.
//!
//! Without the feature `server`, only what needs neither clock nor thread nor port is left, for a page that runs everything itself.
#![forbid(unsafe_code)]

pub mod alarms;
#[cfg(feature = "server")]
pub mod demo;
mod fault;
pub mod figures;
#[cfg(feature = "server")]
pub mod flight_recorder;
#[cfg(feature = "server")]
pub mod guard;
#[cfg(feature = "server")]
pub mod http;
#[cfg(feature = "server")]
pub mod hub;
#[cfg(feature = "server")]
mod margins;
#[cfg(feature = "server")]
mod measuring;
#[cfg(feature = "server")]
pub mod metrics;
#[cfg(feature = "server")]
pub mod record;
#[cfg(feature = "server")]
pub mod replay;
#[cfg(feature = "server")]
pub mod server;
#[cfg(feature = "server")]
pub mod source;
pub mod steer;
pub mod stream;
#[cfg(feature = "server")]
pub mod trends;
#[cfg(feature = "server")]
pub mod verdict;
#[cfg(feature = "server")]
pub mod viewers;
pub mod watched;
