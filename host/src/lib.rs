//! The learning side of Eupnea.
#![forbid(unsafe_code)]
