//! The bedside page: watches devices and shows them in browsers, live.
#![forbid(unsafe_code)]
