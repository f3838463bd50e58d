//! Who may talk to the server: checks of the headers Host and Origin, and of the token.
//!
//! A page of another site can make a browser send requests here, but not with this server's Origin; and a name that it points
//! at this computer (DNS rebinding) appears as Host. Only the address itself and `localhost` are accepted.

use std::fmt;
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
    /// A request that a page of another site has made.
    #[error("refused: the request came from another site; open this page by typing its address")]
    CrossSite,
    /// More messages than allowed.
    #[error("refused: too many messages per second")]
    Flood,
    /// A message that cannot be read.
    #[error("refused: the message cannot be read")]
    Malformed,
    /// More pages or connections than the server feeds.
    #[error("refused: the maximum number of pages is open; close one")]
    Crowded,
    /// A page that must start again, because it was too slow or another device is there.
    #[error("the page is out of date: it starts again")]
    Outdated,
}

impl Refusal {
    /// All reasons.
    pub const ALL: [Self; 8] = [
        Self::Host,
        Self::Origin,
        Self::Token,
        Self::CrossSite,
        Self::Flood,
        Self::Malformed,
        Self::Crowded,
        Self::Outdated,
    ];

    /// Its name in the metrics.
    pub fn name(self) -> &'static str {
        match self {
            Self::Host => "host",
            Self::Origin => "origin",
            Self::Token => "token",
            Self::CrossSite => "cross_site",
            Self::Flood => "flood",
            Self::Malformed => "malformed",
            Self::Crowded => "crowded",
            Self::Outdated => "outdated",
        }
    }
}

/// The rules of a server.
#[derive(Clone)]
pub struct Guard {
    bound: SocketAddr,
    token: Option<String>,
    steer: bool,
}

impl fmt::Debug for Guard {
    /// Without the token, which must not reach a log.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { bound, token, steer } = self;
        let token = token.as_ref().map(|_| "(hidden)");
        f.debug_struct("Guard").field("bound", bound).field("token", &token).field("steer", steer).finish()
    }
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

    /// Checks the headers with which a browser says where a request comes from, which a page cannot change. Another site may only
    /// link to the page itself, at `/`.
    ///
    /// # Errors
    /// [`Refusal::CrossSite`].
    pub fn check_site(&self, path: &str, site: Option<&str>, mode: Option<&str>) -> Result<(), Refusal> {
        match site {
            None | Some("same-origin" | "none") => Ok(()),
            _ if path == "/" && mode == Some("navigate") => Ok(()),
            Some(_) => Err(Refusal::CrossSite),
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
            // No sign and no leading zero: a browser sends neither.
            Some((name, port)) if !port.ends_with(']') => {
                (name, port.parse().ok().filter(|number: &u16| number.to_string() == port))
            }
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
    use crate::stream::{FromPage, Secret};
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

    #[test]
    fn another_site_may_only_link_to_the_page() {
        let guard = guard("127.0.0.1:8080");
        let check = |path, site, mode| guard.check_site(path, site, mode).is_ok();
        assert!(check("/metrics", None, None), "no browser, or an old one");
        assert!(check("/metrics", Some("none"), Some("navigate")), "typed");
        assert!(check("/app.js", Some("same-origin"), Some("no-cors")));
        assert!(check("/", Some("cross-site"), Some("navigate")), "a link");
        assert!(!check("/", Some("cross-site"), Some("no-cors")));
        assert!(!check("/metrics", Some("cross-site"), Some("navigate")));
        assert!(!check("/app.js", Some("same-site"), Some("no-cors")), "another port of this computer");
        assert!(!check("/api/stream", Some("cross-site"), Some("websocket")));
    }

    #[test]
    fn no_log_contains_the_token() {
        let guard = Guard::new("127.0.0.1:8080".parse().unwrap(), true);
        let message = FromPage::Token { token: Secret(guard.token().unwrap().to_owned()) };
        for text in [format!("{guard:?}"), format!("{message:?}")] {
            assert!(!text.contains(guard.token().unwrap()), "{text}");
        }
    }

    proptest! {
        #[test]
        fn no_header_of_a_stranger_passes(host in ".{0,40}") {
            prop_assume!(host != "localhost:8080" && host != "127.0.0.1:8080");
            prop_assert_eq!(guard("127.0.0.1:8080").check(Some(&host), None), Err(Refusal::Host));
        }

        #[test]
        fn a_right_host_with_any_change_does_not_pass(
            own in prop::sample::select(vec!["localhost:8080", "127.0.0.1:8080"]),
            place in 0_usize..15,
            change in prop_oneof![Just(String::new()), "[ -~]{1,3}", any::<char>().prop_map(String::from)],
            replace in any::<bool>(),
        ) {
            let place = place.min(own.len());
            let rest = if replace { own.get(place + 1..).unwrap_or_default() } else { &own[place..] };
            let host = format!("{}{change}{rest}", &own[..place]);
            prop_assume!(!host.eq_ignore_ascii_case(own));
            prop_assert_eq!(guard("127.0.0.1:8080").check(Some(&host), None), Err(Refusal::Host), "{}", host);
        }
    }
}
