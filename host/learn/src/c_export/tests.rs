use shared::weights::decode;

use super::*;
use crate::controller::shipped;

fn image(name: &str) -> Image {
    decode(shipped::image(name).unwrap()).unwrap()
}

#[test]
fn the_parts_of_the_templates_are_all_filled_and_used() {
    let written = source(&image("adult"), "adult").unwrap();
    for text in [&written.code, &written.header] {
        assert!(!text.contains('@') && !text.to_lowercase().contains(NAMES), "{text}");
    }
    for (key, _) in constants::parts(&image("adult")) {
        let marker = format!("@{key}@");
        assert!(CODE.contains(&marker) || HEADER.contains(&marker), "{key}");
    }
}

#[test]
fn the_same_controller_gives_the_same_file_and_another_one_another() {
    let code = |controller| source(&image(controller), "same").unwrap().code;
    assert_eq!(code("adult"), code("adult"));
    assert_ne!(code("adult"), code("neonate"));
}

#[test]
fn a_name_with_which_no_name_in_c_begins_is_refused() {
    for name in ["", "2nd", "my-controller", "_reserved", "été", "a b"] {
        let refused = source(&image("adult"), name).unwrap_err().to_string();
        assert!(refused.contains("use letters, digits and underscores"), "{refused}");
    }
    assert!(source(&image("adult"), "Adult_2").is_ok());
}
