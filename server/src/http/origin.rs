//! Which pages may change anything, and by which names they may be asked.
//!
//! A page of a stranger's name can have that name lead to this port (DNS rebinding): its requests then carry the stranger's
//! name as their host. And any page can send requests here, which then carry its origin.

use std::sync::Arc;

use axum::extract::{MatchedPath, Request, State};
use axum::http::{HeaderMap, Method, header};
use axum::middleware::Next;
use axum::response::{IntoResponse, Response};

use super::Place;
use super::error::Error;
use super::outside::Outside;
use crate::identity::access::{Access, Call, of};
use crate::identity::{self, Role};

/// Probes, which are sent to whatever name or address a machine has and tell nothing.
const PROBES: [&str; 2] = ["/healthz", "/readyz"];

/// Refuses requests for another name, and changes that another page asks for.
pub async fn guard(State(place): State<Arc<Place>>, mut request: Request, next: Next) -> Response {
    let encrypted = request.extensions().get::<Arc<identity::RemoteEnd>>().is_some_and(|peer| peer.encrypted);
    let outside = Outside::of(&request, encrypted, &place.hosts, &place.base_path);
    let checked = checked(&place, &request, &outside);
    request.extensions_mut().insert(outside);
    match checked {
        Ok(()) => next.run(request).await,
        Err(error) => error.into_response(),
    }
}

fn checked(place: &Place, request: &Request, outside: &Outside) -> Result<(), Error> {
    let Place { hosts, origins, .. } = place;
    let path = request.uri().path();
    if PROBES.contains(&path) {
        return Ok(());
    }
    let headers = request.headers();
    // HTTP/2 has the host in the address; HTTP/1 may have it in both, and then they must agree.
    let in_header = text(headers, header::HOST.as_str());
    let in_address = request.uri().authority().map(axum::http::uri::Authority::as_str);
    let stranger = [in_header, in_address].into_iter().flatten().any(|host| !hosts.know(host));
    if stranger || headers.get_all(header::HOST).iter().count() > 1 {
        return Err(Error::WrongHost);
    }
    let own = is_own(headers, [in_header.or(in_address), outside.host.as_deref()]);
    if !own && text(headers, header::ORIGIN.as_str()).is_some_and(|origin| origins.list(origin)) {
        return Ok(());
    }
    let site = text(headers, "sec-fetch-site").unwrap_or("none");
    let reads = [Method::GET, Method::HEAD, Method::OPTIONS].contains(request.method());
    if !reads {
        let moved = !["same-origin", "none"].contains(&site);
        return if moved || !own { Err(Error::WrongOrigin) } else { Ok(()) };
    }
    // Even a picture of another page could start work, or read what it may not. Not all browsers say which page it is of.
    let works = path.starts_with("/api/") || (path.starts_with("/tiles/") && request.uri().query().is_some());
    let foreign = works && (site == "cross-site" || !own);
    if foreign && !(origins.let_all_read() && is_for_viewers(request)) {
        return Err(Error::WrongOrigin);
    }
    Ok(())
}

/// Is it a route that takes a viewer at most? Where nobody is asked, pages could read the rest as well: backups hold a key.
fn is_for_viewers(request: &Request) -> bool {
    let route = request.extensions().get::<MatchedPath>();
    let access = route.and_then(|route| of(Call::Http("GET", route.as_str())));
    matches!(access, Some(Access::Open | Access::Metrics | Access::Least(Role::Viewer)))
}

/// Does the request come from no page, or from one of the hosts it is sent to: here, or to a proxy in front?
fn is_own(headers: &HeaderMap, hosts: [Option<&str>; 2]) -> bool {
    let mut origins = headers.get_all(header::ORIGIN).iter();
    let Some(origin) = origins.next() else { return true };
    let authority = origin.to_str().ok().and_then(|origin| origin.split_once("://")).map(|(_, rest)| rest);
    let is = |host: &str| authority.is_some_and(|origin| origin.eq_ignore_ascii_case(host));
    hosts.into_iter().flatten().any(is) && origins.next().is_none()
}

/// A header that is text; one that is not counts as a name nobody knows.
fn text<'a>(headers: &'a HeaderMap, name: &str) -> Option<&'a str> {
    headers.get(name).map(|value| value.to_str().unwrap_or("?"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::Hosts;
    use axum::body::Body;

    fn asked(method: Method, path: &str, headers: &[(&str, &str)]) -> Result<(), u16> {
        let hosts = Hosts::of("127.0.0.1".parse().unwrap(), &["maps.example.com".to_owned()]);
        let request = Request::builder().method(method).uri(path);
        let request = headers.iter().fold(request, |request, (name, value)| request.header(*name, *value));
        let place = Place { hosts, ..Place::any() };
        let request = request.body(Body::empty()).unwrap();
        let checked = checked(&place, &request, &Outside::of(&request, false, &place.hosts, ""));
        checked.map_err(|error| error.into_response().status().as_u16())
    }

    /// Catches: a page whose name was led to this port, and that then reads the backup.
    #[test]
    fn only_own_names_are_answered() {
        let get = |host: &str| asked(Method::GET, "/api/v1/map/backup", &[("host", host)]);
        for own in [
            "127.0.0.1:8080",
            "localhost",
            "LOCALHOST:9000",
            "[::1]:8080",
            "maps.example.com:443",
            "localhost.",
        ] {
            assert_eq!(get(own), Ok(()), "{own}");
        }
        for foreign in [
            "evil.example",
            "evil.example:8080",
            "127.0.0.1.evil.example",
            "localhost.evil.example:8080",
            "10.0.0.7:8080",
            "",
            "evil.example:8080@127.0.0.1",
        ] {
            assert_eq!(get(foreign), Err(421), "{foreign}");
        }
        assert_eq!(asked(Method::GET, "/readyz", &[("host", "10.0.0.7")]), Ok(()), "probes come by any name");
        assert_eq!(asked(Method::GET, "http://evil.example/", &[("host", "localhost")]), Err(421));
    }

    /// Catches: another page that rolls the map back.
    #[test]
    fn only_own_pages_change_anything() {
        let post = |headers: &[(&str, &str)]| {
            let headers = [&[("host", "localhost:8080")], headers].concat();
            asked(Method::POST, "/api/v1/map/rollback", &headers)
        };
        assert_eq!(post(&[]), Ok(()), "a command is no page");
        assert_eq!(post(&[("origin", "http://localhost:8080"), ("sec-fetch-site", "same-origin")]), Ok(()));
        for foreign in ["https://evil.example", "null", "http://localhost:3000", "http://localhost", ""] {
            assert_eq!(post(&[("origin", foreign)]), Err(403), "{foreign}");
        }
        assert_eq!(post(&[("sec-fetch-site", "cross-site")]), Err(403));
        assert_eq!(post(&[("sec-fetch-site", "same-site")]), Err(403));
        let proxied = [("x-forwarded-host", "maps.example.com"), ("origin", "https://maps.example.com")];
        assert_eq!(post(&proxied), Ok(()), "the console behind a proxy that asks by another name");
        let stranger = [("x-forwarded-host", "evil.example"), ("origin", "https://evil.example")];
        assert_eq!(post(&stranger), Err(403));
        let picture = [("host", "localhost"), ("sec-fetch-site", "cross-site")];
        assert_eq!(asked(Method::GET, "/api/v1/map/verify", &picture), Err(403));
        assert_eq!(asked(Method::GET, "/", &picture), Ok(()), "a link to the console is one");
    }

    #[test]
    fn a_port_on_all_addresses_answers_to_any_address_and_to_no_other_name() {
        let hosts = Hosts::of("::".parse().unwrap(), &[]);
        assert!(hosts.know("10.0.0.7:8080") && hosts.know("[fe80::1]:8080") && hosts.know("localhost"));
        assert!(!hosts.know("evil.example") && !hosts.know("maps.example.com"));
        assert!(Hosts::any().know("evil.example"));
    }
}
