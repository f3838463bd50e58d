//! Who may talk to the server: checks of the headers Host and Origin, and of the token.
//!
//! A page of another site can make a browser send requests here, but not with this server's Origin; and a name that it points
//! at this computer (DNS rebinding) appears as Host. Only the address itself and `localhost` are accepted.

use std::hint::black_box;
use std::net::{IpAddr, SocketAddr};

use rand::RngExt;
use thiserror::Error;

/// The content security policy of every response: nothing from anywhere else.
pub const CONTENT_SECURITY_POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

/// Port of HTTP that a browser leaves out.
const DEFAULT_PORT: u16 = 80;

/// Why a request is refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Error)]
pub enum Refusal {
    /// Another name than the server's.
    #[error("refused: open this page by the address that `trainer serve` prints, not by another name")]
    Host,
    /// A page of another site.
    #[error("refused: only a page of this server may use it")]
    Origin,
    /// No token, or a wrong one.
    #[error(
        "refused: the token is missing or wrong; open the address that `trainer serve` prints, with its token"
    )]
    Token,
    /// More messages than allowed.
    #[error("refused: more messages in a second than a page sends")]
    Flood,
    /// A message that cannot be read.
    #[error("refused: the message cannot be read")]
    Malformed,
    /// More pages than the server feeds.
    #[error("refused: as many pages are open as the server feeds; close one")]
    Crowded,
}

impl Refusal {
    /// All reasons.
    pub const ALL: [Self; 6] =
        [Self::Host, Self::Origin, Self::Token, Self::Flood, Self::Malformed, Self::Crowded];

    /// Its name in the metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Host => "host",
            Self::Origin => "origin",
            Self::Token => "token",
            Self::Flood => "flood",
            Self::Malformed => "malformed",
            Self::Crowded => "crowded",
        }
    }
}

/// The rules of a server.
#[derive(Clone, Debug)]
pub struct Guard {
    bound: SocketAddr,
    token: Option<String>,
    steer: bool,
}

impl Guard {
    /// The rules of a server that is bound to this address; pages may steer if `steer`. Makes a token if one is needed.
    pub fn new(bound: SocketAddr, steer: bool) -> Self {
        let needed = steer || !bound.ip().is_loopback();
        Self { bound, token: needed.then(new_token), steer }
    }

    /// The token; none if everybody on this computer may read and nobody may steer.
    pub fn token(&self) -> Option<&str> {
        self.token.as_deref()
    }

    /// Whether pages may steer.
    pub fn steer(&self) -> bool {
        self.steer
    }

    /// Whether even reading needs the token: the server can be reached from other computers.
    pub fn reading_needs_token(&self) -> bool {
        !self.bound.ip().is_loopback()
    }

    /// Checks the headers of a request.
    ///
    /// # Errors
    /// [`Refusal::Host`] or [`Refusal::Origin`].
    pub fn check(&self, host: Option<&str>, origin: Option<&str>) -> Result<(), Refusal> {
        let host = host.filter(|host| self.is_own(host)).ok_or(Refusal::Host)?;
        match origin.map(|origin| origin.strip_prefix("http://")) {
            None => Ok(()),
            Some(Some(from)) if from.eq_ignore_ascii_case(host) => Ok(()),
            Some(_) => Err(Refusal::Origin),
        }
    }

    /// Whether a token is the right one. Takes the same time for each wrong token of the same length.
    ///
    /// # Errors
    /// [`Refusal::Token`]; also if the server has no token.
    pub fn check_token(&self, token: &str) -> Result<(), Refusal> {
        let right = self.token.as_ref().ok_or(Refusal::Token)?;
        let differ = right
            .bytes()
            .zip(token.bytes())
            .fold(0, |differ, (one, other)| black_box(differ | (one ^ other)));
        if differ == 0 && right.len() == token.len() { Ok(()) } else { Err(Refusal::Token) }
    }

    /// Whether a Host header names this server.
    fn is_own(&self, host: &str) -> bool {
        let (name, port) = match host.rsplit_once(':') {
            Some((name, port)) if !port.ends_with(']') => (name, port.parse().ok()),
            _ => (host, Some(DEFAULT_PORT)),
        };
        port == Some(self.bound.port()) && self.is_own_name(name)
    }

    fn is_own_name(&self, name: &str) -> bool {
        let bare = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name);
        let own = self.bound.ip();
        match bare.parse::<IpAddr>() {
            // A site cannot point a number at this computer.
            Ok(address) => address == own || own.is_unspecified(),
            Err(_) => name.eq_ignore_ascii_case("localhost") && (own.is_loopback() || own.is_unspecified()),
        }
    }
}

/// A random token, in hexadecimal digits.
fn new_token() -> String {
    format!("{:032x}", rand::rng().random::<u128>())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn guard(bound: &str) -> Guard {
        Guard::new(bound.parse().unwrap(), false)
    }

    #[test]
    fn only_the_bound_address_and_localhost_are_the_server() {
        let guard = guard("127.0.0.1:8080");
        for own in ["127.0.0.1:8080", "localhost:8080", "LOCALHOST:8080"] {
            assert_eq!(guard.check(Some(own), None), Ok(()), "{own}");
        }
        for foreign in [
            "evil.example:8080",
            "127.0.0.1:8081",
            "127.0.0.1",
            "127.0.0.1.evil.example:8080",
            "localhost.evil.example:8080",
            "192.168.0.7:8080",
            "",
            ":8080",
            "localhost:",
        ] {
            assert_eq!(guard.check(Some(foreign), None), Err(Refusal::Host), "{foreign}");
        }
        assert_eq!(guard.check(None, None), Err(Refusal::Host));
    }

    #[test]
    fn port_80_may_be_left_out_and_ipv6_has_brackets() {
        assert_eq!(guard("127.0.0.1:80").check(Some("localhost"), None), Ok(()));
        let six = guard("[::1]:8080");
        assert_eq!(six.check(Some("[::1]:8080"), None), Ok(()));
        assert_eq!(six.check(Some("[::2]:8080"), None), Err(Refusal::Host));
        assert_eq!(guard("[::1]:80").check(Some("[::1]"), None), Ok(()));
    }

    #[test]
    fn a_server_on_all_interfaces_is_any_number_but_no_name() {
        let guard = guard("0.0.0.0:8080");
        assert_eq!(guard.check(Some("192.168.0.7:8080"), None), Ok(()));
        assert_eq!(guard.check(Some("evil.example:8080"), None), Err(Refusal::Host));
    }

    #[test]
    fn an_origin_must_be_the_page_of_this_server() {
        let guard = guard("127.0.0.1:8080");
        let host = Some("localhost:8080");
        assert_eq!(guard.check(host, Some("http://localhost:8080")), Ok(()));
        for foreign in [
            "http://evil.example",
            "https://localhost:8080",
            "http://127.0.0.1:8080",
            "null",
            "http://localhost:8081",
            "",
        ] {
            assert_eq!(guard.check(host, Some(foreign)), Err(Refusal::Origin), "{foreign}");
        }
    }

    #[test]
    fn a_token_is_made_for_steering_and_for_other_computers() {
        assert_eq!(guard("127.0.0.1:8080").token(), None);
        assert!(guard("0.0.0.0:8080").reading_needs_token());
        let steering = Guard::new("127.0.0.1:8080".parse().unwrap(), true);
        let token = steering.token().unwrap().to_owned();
        assert_eq!((token.len(), steering.reading_needs_token()), (32, false));
        assert_ne!(Guard::new("127.0.0.1:8080".parse().unwrap(), true).token().unwrap(), token);
        assert_eq!(steering.check_token(&token), Ok(()));
        for wrong in ["", &token[1..], &format!("{token}0"), &token.to_uppercase().replace('0', "g")] {
            assert_eq!(steering.check_token(wrong), Err(Refusal::Token), "{wrong}");
        }
        assert_eq!(guard("127.0.0.1:8080").check_token(""), Err(Refusal::Token));
    }

    proptest! {
        #[test]
        fn no_header_of_a_stranger_passes(host in ".{0,40}") {
            prop_assume!(!host.to_ascii_lowercase().starts_with("localhost:"));
            prop_assume!(!host.starts_with("127.0.0.1:"));
            prop_assert_eq!(guard("127.0.0.1:8080").check(Some(&host), None), Err(Refusal::Host));
        }
    }
}
