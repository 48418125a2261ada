//! Pages of other origins that may ask this port: those that are listed for whatever their callers may, and, where `*` is
//! listed, all others for what viewers read.

use axum::http::{HeaderName, HeaderValue, Method, header};
use std::time::Duration;
use tower_http::cors::{AllowCredentials, AllowOrigin, CorsLayer};

use crate::identity::PAGE_TOKEN;
use crate::trace::REQUEST_ID;

/// All origins.
const ANY: &str = "*";
/// How long a browser need not ask again whether it may ask.
const REMEMBERED: Duration = Duration::from_mins(10);

/// Origins whose pages may ask this port.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Origins(Vec<String>);

impl Origins {
    /// As configured.
    #[must_use]
    pub fn of(listed: &[String]) -> Self {
        Self(listed.to_vec())
    }

    /// May pages of this origin ask for all that their callers may?
    pub fn list(&self, origin: &str) -> bool {
        origin != ANY && self.0.iter().any(|listed| listed == origin)
    }

    /// May pages of any origin ask for what viewers read?
    pub fn let_all_read(&self) -> bool {
        self.0.iter().any(|listed| listed == ANY)
    }

    /// Answers browsers that ask whether a page may ask, and tells them what they may hand to it; `None` where no other page
    /// may ask anything.
    pub fn layer(&self) -> Option<CorsLayer> {
        if self.0.is_empty() {
            return None;
        }
        let mut methods = vec![Method::GET, Method::HEAD];
        if self.0.iter().any(|listed| listed != ANY) {
            methods.extend([Method::POST, Method::DELETE]);
        }
        let lists =
            |origins: &Self, origin: &HeaderValue| origin.to_str().is_ok_and(|origin| origins.list(origin));
        let (known, trusted) = (self.clone(), self.clone());
        let may_ask = move |origin: &HeaderValue, _: &_| known.let_all_read() || lists(&known, origin);
        // Cookies and certificates go with the requests of listed pages only.
        let with_credentials = move |origin: &HeaderValue, _: &_| lists(&trusted, origin);
        let layer = CorsLayer::new()
            .allow_origin(AllowOrigin::predicate(may_ask))
            .allow_credentials(AllowCredentials::predicate(with_credentials))
            .allow_methods(methods)
            .allow_headers([
                header::AUTHORIZATION,
                header::CONTENT_TYPE,
                header::IF_NONE_MATCH,
                HeaderName::from_static("last-event-id"),
                HeaderName::from_static(PAGE_TOKEN),
                REQUEST_ID,
            ])
            .expose_headers([header::ETAG, header::RETRY_AFTER, REQUEST_ID])
            .max_age(REMEMBERED);
        Some(layer)
    }
}

/// Is it written as browsers write an origin, or `*`? Anything else would never be found equal to one.
#[must_use]
pub fn is_origin(text: &str) -> bool {
    let default =
        |scheme: &str, port: u16| (scheme == "https" && port == 443) || (scheme == "http" && port == 80);
    let written = |(scheme, rest): (&str, &str)| {
        let (host, port) = match rest.rfind(':').filter(|at| !rest[*at..].contains(']')) {
            Some(at) => (&rest[..at], Some(&rest[at + 1..])),
            None => (rest, None),
        };
        let plain = |b: u8| b.is_ascii_lowercase() || b.is_ascii_digit() || b"-._".contains(&b);
        let address =
            |host: &str| host.strip_prefix('[')?.strip_suffix(']')?.parse::<std::net::Ipv6Addr>().ok();
        let named = !host.is_empty() && host.bytes().all(plain);
        let port = port.is_none_or(|port| {
            port.parse().is_ok_and(|number: u16| number.to_string() == port && !default(scheme, number))
        });
        ["http", "https"].contains(&scheme)
            && port
            && (named || address(host).is_some_and(|a| format!("[{a}]") == host))
    };
    text == ANY || text.split_once("://").is_some_and(written)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: an origin that is taken and then never matches what a browser sends.
    #[test]
    fn origins_are_written_as_browsers_write_them() {
        for origin in
            ["*", "https://maps.example", "http://localhost:3000", "http://[::1]:8080", "https://10.0.0.7"]
        {
            assert!(is_origin(origin), "{origin}");
        }
        for other in [
            "",
            "null",
            "maps.example",
            "https://",
            "https://maps.example/",
            "https://maps.example/map",
            "https://Maps.example",
            "https://maps.example:443",
            "http://maps.example:80",
            "https://maps.example:",
            "https://maps.example:99999",
            "https://*.example",
            "ftp://maps.example",
            "https://user@maps.example",
            "http://[::1",
        ] {
            assert!(!is_origin(other), "{other}");
        }
    }
}
