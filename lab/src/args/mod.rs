//! Arguments that commands of the laboratory share: any control law in the place of a controller.

pub mod law;
pub mod policy;
