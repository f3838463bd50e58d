//! The name under which a host steers a device, for refusals that other hosts receive.

use core::fmt;

use heapless::String;
use serde::{Deserialize, Deserializer, Serialize, Serializer};

/// Longest name of a host, bytes.
pub const HOST_NAME_BYTES: usize = 32;

/// A host's name, such as `user@machine`: at most [`HOST_NAME_BYTES`] bytes without control characters.
#[derive(Clone, Copy, Default, PartialEq, Eq)]
pub struct HostName {
    bytes: [u8; HOST_NAME_BYTES],
    length: u8,
}

impl HostName {
    /// The printable characters of a text, as far as they fit.
    pub fn new(text: &str) -> Self {
        let mut name = Self::default();
        for character in text.chars().filter(|character| !character.is_control()) {
            let start = usize::from(name.length);
            let Some(place) = name.bytes.get_mut(start..start + character.len_utf8()) else { break };
            character.encode_utf8(place);
            name.length += character.len_utf8() as u8;
        }
        name
    }

    /// The name as text; empty if the host gave none.
    pub fn as_str(&self) -> &str {
        let bytes = self.bytes.get(..self.length.into()).unwrap_or_default();
        core::str::from_utf8(bytes).unwrap_or_default()
    }
}

impl fmt::Display for HostName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(if self.length == 0 { "a host without a name" } else { self.as_str() })
    }
}

impl fmt::Debug for HostName {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        fmt::Debug::fmt(self.as_str(), f)
    }
}

impl Serialize for HostName {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(self.as_str())
    }
}

impl<'de> Deserialize<'de> for HostName {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        String::<HOST_NAME_BYTES>::deserialize(deserializer).map(|text| Self::new(&text))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::string::ToString;

    #[test]
    fn a_name_is_cut_between_characters_and_has_no_control_characters() {
        assert_eq!(HostName::new("anna@icu-3").as_str(), "anna@icu-3");
        assert_eq!(HostName::new("\x1b[31manna\n").as_str(), "[31manna");
        let long = "\u{e9}".repeat(HOST_NAME_BYTES);
        assert_eq!(HostName::new(&long).as_str(), "\u{e9}".repeat(HOST_NAME_BYTES / 2));
        assert_eq!(HostName::new(&std::format!("x{long}")).as_str().len(), HOST_NAME_BYTES - 1);
    }

    #[test]
    fn a_host_that_gives_no_name_is_told_as_such() {
        assert_eq!(HostName::default().to_string(), "a host without a name");
        assert_eq!(std::format!("{} {:?}", HostName::new("anna"), HostName::new("anna")), "anna \"anna\"");
    }

    proptest! {
        #[test]
        fn any_text_gives_a_name_that_survives_the_link(text in ".{0,60}") {
            let (name, mut buffer) = (HostName::new(&text), [0; HOST_NAME_BYTES + 1]);
            let bytes = postcard::to_slice(&name, &mut buffer).unwrap();
            prop_assert_eq!(postcard::from_bytes(bytes), Ok(name));
        }
    }
}
