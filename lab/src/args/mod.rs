//! Arguments that commands of the laboratory share: any control law in the place of a controller, and the program of a command.

pub mod law;
pub mod policy;
pub mod program;
