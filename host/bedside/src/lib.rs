//! The bedside page: watches devices and shows them in browsers, live.
//!
//! A [`source`] gives the news of a device. Its [`hub`], one thread for each device, makes messages of them ([`stream`]), with the
//! [`figures`] of each breath, their [`trends`] and the list of [`alarms`], and queues them for the open pages ([`viewers`]). [`http`] serves the
//! pages behind a [`guard`]; [`steer`] lets one of them steer.
#![forbid(unsafe_code)]

pub mod alarms;
pub mod demo;
pub mod figures;
pub mod guard;
pub mod http;
pub mod hub;
pub mod log;
pub mod metrics;
pub mod record;
pub mod replay;
pub mod server;
pub mod source;
pub mod steer;
pub mod stream;
pub mod trends;
pub mod verdict;
pub mod viewers;
