//! What a first breath could gain by knowing its unit: trains controllers for the first breath alone that are told nothing, the numbers
//! of the machine, those of machine and lung, or these after 50 ms, or that keep a state of their own, and prints their error on held-out units of the simulators.
//!
//! ```text
//! cargo run --release -p learn --example oracle -- adult 6000
//! ```

use std::error::Error;

use learn::controller::Told;
use learn::pipeline::family::FamilyRun;
use plant::bench::family::Family;
use progress::Progress;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let family = Family::find(&arguments.next().unwrap_or_else(|| "adult".to_owned()))?;
    let iterations = arguments.next().map_or(Ok(6000), |count| count.parse())?;
    let mut run = FamilyRun::of(&family, &family.prescriptions("paper")?);
    run.train.iterations = iterations;
    let units = run.fit_units(&family, None, &Progress::silent())?;
    println!("told       first breath, geometric mean, cmH2O");
    for told in [Told::Nothing, Told::Machine, Told::Unit, Told::Student, Told::Recurrent] {
        run.train.told = Some(told);
        let trained = run.train_on(&units, &family, None, &Progress::silent())?;
        println!("{told:<10?} {:.3}", trained.learned.origin.validation);
    }
    Ok(())
}
