//! The bench as a task for reinforcement learning.
//!
//! An [`Environment`] runs *episodes*: one or more breaths of one plant. The agent commands the inspiratory valve during each
//! inspiration; the ventilator does the rest, with the same code as on the chip. [`Batch`] runs many environments side by
//! side. Episode `n` of a seed has the same plant, waveform and sensor noise wherever it runs: alone, in a batch, on any number of
//! threads, and on plant `n` of `lab robust` with that seed.
//!
//! ```
//! # use environment::{Environment, Task, TaskConfig};
//! let task = Task::new(TaskConfig::default())?;
//! let mut environment = Environment::new(task.into(), 1);
//! environment.reset()?;
//! let mut total = 0.0;
//! while environment.is_running() {
//!     // Half of the valve's range.
//!     total += environment.step(0.0)?.reward;
//! }
//! assert!(total < 0.0);
//! # Ok::<(), environment::EnvironmentError>(())
//! ```

#![forbid(unsafe_code)]

mod action;
mod batch;
mod episode;
mod error;
mod observation;
mod plants;
mod task;

#[cfg(test)]
mod tests;

pub use action::ActionKind;
pub use batch::{Batch, Outcomes};
pub use episode::{Environment, Episode, Step};
pub use error::EnvironmentError;
pub use observation::{ObservationKind, ObservationStream};
pub use plants::{Choice, Draw, Plants};
pub use task::{Reward, Task, TaskConfig, no_monitors};
