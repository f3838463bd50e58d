//! The virtual bench as a plant, and families of benches. The bench itself is a crate of its own, [`::bench`], which a chip can run too.

mod bench_plant;
pub mod family;

pub use ::bench::*;
pub use bench_plant::BenchPlant;
