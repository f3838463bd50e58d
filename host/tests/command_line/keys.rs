//! `trainer keys`, and signing with `export`.

use shared::weights::decode;
use shared::weights::trust::is_signed;

use super::support::Place;

#[test]
fn a_key_is_made_once_shown_and_signs_a_packed_image() {
    let place = Place::new();
    let made = place.json("keys --out weights.key");
    assert_eq!(made["public_key"].as_str().unwrap().len(), 64);
    assert_eq!(place.json("keys --show weights.key"), made);
    assert!(place.refused("keys --out weights.key").contains("never overwritten"));
    assert!(place.refused("keys --show weights.key.pub").contains("contains no private key"));
    let controller = place.controller();
    place.ok(&format!("export {controller} --out signed.bin --key weights.key --image-version 7"));
    place.ok(&format!("export {controller} --out unsigned.bin"));
    let [signed, unsigned] =
        ["signed.bin", "unsigned.bin"].map(|name| std::fs::read(place.path(name)).unwrap());
    assert_eq!((is_signed(&signed), decode(&signed).unwrap().version), (true, 7));
    assert_eq!((is_signed(&unsigned), decode(&unsigned).unwrap().version), (false, 0));
    assert!(place.ok("inspect signed.bin").contains("image version"));
    let again = place.run("export x --out y.bin --image-version 7");
    assert_eq!(again.status.code(), Some(2), "a version needs a key");
}
