//! Learned controllers that come with the program, by name: one for each shipped family.
//!
//! `trainer train-family --family NAME --out DIR`, then `trainer pack DIR/controller.safetensors --out NAME.bin`, reproduces them.

/// Name and weights image of every shipped controller.
const SHIPPED: [(&str, &[u8]); 1] = [("adult", include_bytes!("../../controllers/adult.bin"))];

/// The weights image of the controller with this name.
pub fn image(name: &str) -> Option<&'static [u8]> {
    SHIPPED.iter().find(|(shipped, _)| *shipped == name).map(|(_, image)| *image)
}

/// The names, in a fixed order.
pub fn names() -> impl Iterator<Item = &'static str> {
    SHIPPED.iter().map(|(name, _)| *name)
}

#[cfg(test)]
mod tests {
    use super::*;
    use plant::bench::family::Family;
    use shared::weights::decode;

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
