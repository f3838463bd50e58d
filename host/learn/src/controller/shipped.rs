//! Learned controllers that come with the program, by name: one for each shipped family.
//!
//! These commands make them again, bit for bit:
//!
//! ```text
//! trainer train-family --family adult --out out/adult
//! trainer train-family --family neonate --ripple 0.4 --margin-price 4 --iterations 16000 --out out/neonate
//! trainer export out/adult/controller.safetensors --out host/learn/controllers/adult.bin
//! trainer export out/neonate/controller.safetensors --out host/learn/controllers/neonate.bin
//! ```
//!
//! Newborns get less ripple: twice as much would cost 2 % of error in later breaths.

use shared::control::residual::Residual;
use shared::weights::decode;

/// Name and weights image of every shipped controller.
const SHIPPED: [(&str, &[u8]); 2] = [
    ("adult", include_bytes!("../../controllers/adult.bin")),
    ("neonate", include_bytes!("../../controllers/neonate.bin")),
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
