//! This program as a host: the name that other hosts see, and the token of a connection.

use std::env;
use std::fs;
use std::hash::{BuildHasher, RandomState};

use shared::link::host_name::HostName;

/// Variables that may contain the user's name, in this order.
const USER: [&str; 3] = ["USER", "LOGNAME", "USERNAME"];
/// Variables that may contain the computer's name.
const COMPUTER: [&str; 2] = ["HOSTNAME", "COMPUTERNAME"];
/// File with the computer's name on Linux, where the variable is often not exported.
const COMPUTER_FILE: &str = "/proc/sys/kernel/hostname";

/// The name of this program: user, computer and process, as in `anna@icu-3#4711`. Long names are cut, the process is not.
pub fn name() -> HostName {
    let found = |names: &[&str]| names.iter().find_map(|name| env::var(name).ok());
    let user = found(&USER).unwrap_or_else(|| "unknown".to_owned());
    let computer = found(&COMPUTER).or_else(|| fs::read_to_string(COMPUTER_FILE).ok());
    composed(&user, computer.as_deref().map_or("unknown", str::trim), std::process::id())
}

fn composed(user: &str, computer: &str, process: u32) -> HostName {
    let cut = |text: &str, most: usize| text.chars().filter(char::is_ascii).take(most).collect::<String>();
    HostName::new(&format!("{}@{}#{process}", cut(user, 10), cut(computer, 10)))
}

/// A random number that identifies a connection.
pub fn token() -> u32 {
    RandomState::new().hash_one(std::process::id()) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_has_user_computer_and_process() {
        assert_eq!(composed("anna", "icu-3", 4711).as_str(), "anna@icu-3#4711");
        let long = composed("a-very-long-user", "a-very-long-computer", u32::MAX);
        assert_eq!(long.as_str(), "a-very-lon@a-very-lon#4294967295");
    }

    #[test]
    fn two_connections_have_different_tokens() {
        assert_ne!(token(), token());
    }
}
