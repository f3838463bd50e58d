//! Learned controllers that come with the program, by name: one for each shipped family.
//!
//! These commands make them again, bit for bit, the second one at revision 23ce1cb:
//!
//! ```text
//! trainer train-family --family adult --out out/adult
//! trainer train-family --family neonate --ripple 0.4 --margin-price 4 --iterations 16000 --out out/neonate
//! trainer train-family --family blower --start-from adult --ripple 0.4 --margin-price 4 --iterations 16000 --out out/blower
//! trainer export out/adult/controller.safetensors --out host/learn/controllers/adult.bin
//! trainer export out/neonate/controller.safetensors --out host/learn/controllers/neonate.bin
//! trainer export out/blower/controller.safetensors --out host/learn/controllers/blower.bin
//! ```
//!
//! Newborns get less ripple: twice as much would cost 2 % of error in later breaths. With today's training, which has more high PIPs,
//! margins could be measured and were kept on 3 of 20 newborns only, so the earlier weights stay.

use shared::control::residual::Residual;
use shared::weights::decode;

/// Name and weights image of every shipped controller.
const SHIPPED: [(&str, &[u8]); 3] = [
    ("adult", include_bytes!("../../controllers/adult.bin")),
    ("neonate", include_bytes!("../../controllers/neonate.bin")),
    ("blower", include_bytes!("../../controllers/blower.bin")),
];

/// The weights image of the controller with this name.
pub fn image(name: &str) -> Option<&'static [u8]> {
    SHIPPED.iter().find(|(shipped, _)| *shipped == name).map(|(_, image)| *image)
}

/// The controller with this name.
pub fn residual(name: &str) -> Option<Residual> {
    image(name).map(|image| decode(image).expect("a test decodes every shipped image").residual)
}

/// The names, in a fixed order.
pub fn names() -> impl Iterator<Item = &'static str> {
    SHIPPED.iter().map(|(name, _)| *name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::bench::family::Family;
    use shared::breath::{DEFAULT_PERIOD_US, Phase, paper_settings};
    use shared::control::Controller;
    use ventilator::{BenchSource, Source, Tick};

    /// Mean error of a breath at PIP 22 after six at another, over units of the family `adult`, cmH2O.
    fn error_after(pip: f32) -> f32 {
        let (family, law) =
            (Family::find("adult").unwrap(), Controller::Residual(residual("adult").unwrap()));
        let (mut sum, mut ticks) = (0.0, 0);
        for unit in 0..16 {
            let bench = family.draw(31, unit);
            let mut source =
                BenchSource::new(&bench, law.clone(), &paper_settings(20.0), DEFAULT_PERIOD_US, 5).unwrap();
            for _ in 0..6 {
                source.breath(&paper_settings(pip), &mut |_| ()).unwrap();
            }
            let mut add = |tick: &Tick| {
                if tick.sample.phase == Phase::Inspiration {
                    sum += (tick.truth.unwrap().airway_pressure - tick.sample.target).abs();
                    ticks += 1;
                }
            };
            source.breath(&paper_settings(22.0), &mut add).unwrap();
        }
        sum / ticks as f32
    }

    #[test]
    fn a_small_step_of_pip_costs_less_than_half_of_what_a_first_breath_does() {
        let [settled, stepped, first] = [22.0, 21.0, 30.0].map(error_after);
        println!("settled {settled:.3}, after a step {stepped:.3}, forgotten {first:.3}");
        assert!(stepped - settled < 0.5 * (first - settled), "{settled} {stepped} {first}");
    }

    #[test]
    fn every_shipped_controller_runs_and_has_the_name_of_a_family() {
        for name in names() {
            let controller = decode(image(name).unwrap()).unwrap();
            assert!(controller.residual.network().parameters().any(|weight| *weight != 0.0), "{name}");
            Family::find(name).unwrap();
        }
        assert_eq!(image("nobody"), None);
    }
}
