//! What the faults at the demonstration's buttons do to a simulated device.

use plant::bench::Failure;
use virtual_chip::PlantFault;

use crate::stream::DemoFault;

/// Peak of a cough, cmH2O.
const COUGH: f64 = 40.0;

impl From<DemoFault> for PlantFault {
    fn from(fault: DemoFault) -> Self {
        match fault {
            DemoFault::Disconnect => Self::Part(Failure::Disconnected),
            DemoFault::Cough => Self::Cough(COUGH),
            DemoFault::Stick => Self::ReadingSticks,
            DemoFault::None => Self::None,
        }
    }
}
