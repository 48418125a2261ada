//! How a request was addressed before proxies passed it on: by which scheme, name and path its caller reached them.
//!
//! Each proxy on the way adds its word behind those before: the first item of a list is what the caller said.

use axum::extract::Request;
use axum::http::uri::{PathAndQuery, Uri};
use axum::http::{HeaderMap, header};

use super::hosts::Hosts;

/// The address under which a caller sees this port.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Outside {
    /// Whether the caller's connection is encrypted, here or in front.
    pub encrypted: bool,
    /// Name and port; nothing when the request names none that can be written into an address.
    pub host: Option<String>,
    /// What stands before each of this port's paths: empty, or a path without a slash at its end.
    pub prefix: String,
}

impl Outside {
    /// Of a request that came by a connection which is `encrypted` or not, to a port that is mounted at `base_path`. A
    /// forwarded name is believed only where the port answers to it.
    pub fn of(request: &Request, encrypted: bool, hosts: &Hosts, base_path: &str) -> Self {
        let headers = request.headers();
        let scheme = forwarded(headers, "proto", "x-forwarded-proto").map(str::to_ascii_lowercase);
        let encrypted = match scheme.as_deref() {
            Some("https") => true,
            Some("http") => false,
            _ => encrypted,
        };
        let said = forwarded(headers, "host", "x-forwarded-host").filter(|host| is_plain_host(host));
        let in_header = headers.get(header::HOST).and_then(|host| host.to_str().ok());
        let own = in_header.or_else(|| request.uri().authority().map(axum::http::uri::Authority::as_str));
        let host = said.filter(|host| hosts.know(host)).or(own.filter(|host| is_plain_host(host)));
        let prefix = first(headers, "x-forwarded-prefix").map(|path| path.trim_end_matches('/'));
        let prefix = prefix.filter(|path| is_base_path(path)).unwrap_or(base_path);
        Self { encrypted, host: host.map(str::to_owned), prefix: prefix.to_owned() }
    }

    /// What stands before each of this port's paths in an absolute address; in one without a host where none is known.
    pub fn address(&self) -> String {
        let scheme = if self.encrypted { "https" } else { "http" };
        self.host
            .as_ref()
            .map_or_else(|| self.prefix.clone(), |host| format!("{scheme}://{host}{}", self.prefix))
    }
}

/// Can a path stand before all others? It has no slash at its end, and begins with one only: two would name a host.
#[must_use]
pub fn is_base_path(path: &str) -> bool {
    let plain = |b: u8| b.is_ascii_alphanumeric() || b"-_.~".contains(&b);
    path.is_empty()
        || path.strip_prefix('/').is_some_and(|rest| {
            rest.split('/').all(|part| ![".", "..", ""].contains(&part) && part.bytes().all(plain))
        })
}

/// A request without the path at which the port is mounted. A proxy may have taken that off already.
pub fn unmounted<B>(base_path: &str, mut request: axum::http::Request<B>) -> axum::http::Request<B> {
    if let Some(uri) = below(base_path, request.uri()) {
        *request.uri_mut() = uri;
    }
    request
}

fn below(base_path: &str, uri: &Uri) -> Option<Uri> {
    let rest = uri.path_and_query()?.as_str().strip_prefix(base_path)?;
    let path = match rest.bytes().next() {
        None => "/".to_owned(),
        Some(b'/') => rest.to_owned(),
        Some(b'?') => format!("/{rest}"),
        Some(_) => return None,
    };
    let mut parts = uri.clone().into_parts();
    parts.path_and_query = Some(path.parse::<PathAndQuery>().ok()?);
    Uri::from_parts(parts).ok()
}

/// What `Forwarded` says under a key (RFC 7239), or else another header.
fn forwarded<'a>(headers: &'a HeaderMap, key: &str, other: &str) -> Option<&'a str> {
    let list = headers.get(header::FORWARDED).and_then(|value| value.to_str().ok());
    let pairs =
        list.and_then(|list| unquoted(list, b',').next()).into_iter().flat_map(|item| unquoted(item, b';'));
    let mut pairs = pairs.filter_map(|pair| pair.split_once('='));
    let told = pairs.find(|(name, _)| name.trim().eq_ignore_ascii_case(key));
    told.map(|(_, value)| value.trim().trim_matches('"')).or_else(|| first(headers, other))
}

/// The parts of a text between separators that stand in no quotes.
fn unquoted(text: &str, separator: u8) -> impl Iterator<Item = &str> {
    let mut quoted = false;
    text.split(move |c: char| {
        quoted ^= c == '"';
        c == char::from(separator) && !quoted
    })
}

fn first<'a>(headers: &'a HeaderMap, list: &str) -> Option<&'a str> {
    let list = headers.get(list).and_then(|value| value.to_str().ok());
    list.and_then(|list| list.split(',').next()).map(str::trim)
}

fn is_plain_host(host: &str) -> bool {
    !host.is_empty() && host.bytes().all(|b| b.is_ascii_alphanumeric() || b".:-[]_".contains(&b))
}

#[cfg(test)]
mod tests {
    use super::*;
    use axum::body::Body;

    fn seen(headers: &[(&str, &str)]) -> String {
        let hosts = Hosts::of("127.0.0.1".parse().unwrap(), &["maps.example".to_owned()]);
        let request = Request::builder().uri("/tiles/age.json");
        let request = headers.iter().fold(request, |request, (name, value)| request.header(*name, *value));
        Outside::of(&request.body(Body::empty()).unwrap(), false, &hosts, "/base").address()
    }

    /// Catches: the last proxy's word taken for the caller's, and a list read as one name.
    #[test]
    fn the_first_of_each_list_counts() {
        let host = ("host", "localhost:8080");
        let listed = [
            host,
            ("x-forwarded-host", "maps.example, inner:8080"),
            ("x-forwarded-proto", "HTTPS, http"),
            ("x-forwarded-prefix", "/echofix/, /inner"),
        ];
        assert_eq!(seen(&listed), "https://maps.example/echofix");
        let standard =
            ("forwarded", r#"for="a,b;c";Host="maps.example:8443";proto=https, for=x;host=inner;proto=http"#);
        assert_eq!(seen(&[host, standard]), "https://maps.example:8443/base");
        assert_eq!(seen(&[host, standard, listed[1]]), "https://maps.example:8443/base");
        assert_eq!(seen(&[host]), "http://localhost:8080/base");
    }

    /// Catches: whatever name, scheme or path somebody writes into a header in the addresses that a page follows.
    #[test]
    fn what_makes_no_sense_or_is_not_ours_is_not_believed() {
        let host = ("host", "localhost");
        for (header, value) in [
            ("x-forwarded-host", "evil.example"),
            ("x-forwarded-host", "maps.example\"><script>"),
            ("forwarded", "host=evil.example"),
            ("x-forwarded-proto", "javascript"),
            ("x-forwarded-prefix", "//evil.example"),
            ("x-forwarded-prefix", "/a/../b"),
            ("x-forwarded-prefix", "/\"><script>"),
            ("x-forwarded-prefix", "evil"),
        ] {
            assert_eq!(seen(&[host, (header, value)]), "http://localhost/base", "{header}: {value}");
        }
    }

    /// Catches: a path that is taken off twice, or off another name that begins alike.
    #[test]
    fn the_base_path_is_taken_off_once_and_only_whole() {
        for (path, inside) in [
            ("/echofix", "/"),
            ("/echofix?epoch=3", "/?epoch=3"),
            ("/echofix/", "/"),
            ("/echofix/api/v1/map?epoch=3", "/api/v1/map?epoch=3"),
            ("/echofix/echofix/x", "/echofix/x"),
            ("/echofixed/x", "/echofixed/x"),
            ("/api/v1/map", "/api/v1/map"),
            ("http://maps.example/echofix/readyz", "http://maps.example/readyz"),
        ] {
            let request = axum::http::Request::builder().uri(path).body(()).unwrap();
            assert_eq!(unmounted("/echofix", request).uri().to_string(), inside, "{path}");
        }
    }
}
