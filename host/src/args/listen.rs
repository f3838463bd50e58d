//! Addresses at which a command listens.

use std::net::{Ipv4Addr, SocketAddr};

/// Parses an address: `PORT`, of this computer only, or `IP:PORT`.
///
/// # Errors
/// Text of another form.
pub fn listen(text: &str) -> Result<SocketAddr, String> {
    let port = text.parse().map(|port: u16| SocketAddr::from((Ipv4Addr::LOCALHOST, port)));
    port.or_else(|_| text.parse())
        .map_err(|_| "write PORT or IP:PORT, such as 8080 or 0.0.0.0:8080".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_port_alone_is_one_of_this_computer() {
        assert_eq!(listen("5555").unwrap().to_string(), "127.0.0.1:5555");
        assert_eq!(listen("0.0.0.0:80").unwrap().to_string(), "0.0.0.0:80");
        assert!(listen("here").unwrap_err().contains("IP:PORT") && listen("70000").is_err());
    }
}
