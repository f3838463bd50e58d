//! What is known of the controllers that come with the program.

use learn::controller::shipped;
use shared::control::pid::PidGains;
use shared::weights::decode;

/// Gains of the PID in the controller whose weights have this id.
pub fn gains(id: u32) -> Option<PidGains> {
    let images = shipped::names().filter_map(|name| decode(shipped::image(name)?).ok());
    images.filter(|image| image.id == id).map(|image| image.residual.pid().gains()).next()
}
