//! A ventilator as a device at the end of a link: everything between the bytes of the link, the ventilator and the
//! weights slots that is not tied to a chip.

pub mod timing;
