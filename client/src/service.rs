//! How the service is reached.

use std::time::Duration;

use tonic::codegen::http::Uri;
use tonic::metadata::{Ascii, MetadataValue};
use tonic::service::Interceptor;
use tonic::service::interceptor::InterceptedService;
use tonic::transport::{Certificate, Channel, ClientTlsConfig, Endpoint, Identity};
use tonic::{Request, Status};

/// Where the service is and who the vehicle is to it.
#[derive(Clone, PartialEq, Eq, Default)]
pub struct ServiceAddress {
    /// `http://host:port`, `https://host:port` for TLS, or `unix:/path` for a socket of this machine.
    pub url: String,
    /// PEM of the authority that signed the service's certificate; without it the public ones count.
    pub ca_pem: Option<String>,
    /// PEM of the vehicle's own certificate and of its key, for a service that asks for one.
    pub identity_pem: Option<(String, String)>,
    /// The bearer token by which the caller is known, for a service that takes them.
    pub token: Option<String>,
    /// Further addresses of the same service, as `url`: answers that name one of its replicas are believed as far as these go.
    /// With `https://` and an authority of one's own (`ca_pem`) its certificates say enough, and none need be listed.
    pub replicas: Vec<String>,
}

impl std::fmt::Debug for ServiceAddress {
    /// Without the token and the key.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("ServiceAddress")
            .field("url", &self.url)
            .field("ca_pem", &self.ca_pem.is_some())
            .field("identity_pem", &self.identity_pem.is_some())
            .field("token", &self.token.is_some())
            .field("replicas", &self.replicas)
            .finish()
    }
}

/// The transport's settings, and the token that goes with each call.
#[derive(Debug, Clone)]
pub struct ServiceEndpoint {
    /// How the service is connected to.
    pub transport: Endpoint,
    bearer: Bearer,
    /// What it was made of, where replicas can be followed to.
    address: Option<ServiceAddress>,
}

impl From<Endpoint> for ServiceEndpoint {
    fn from(transport: Endpoint) -> Self {
        Self { transport, bearer: Bearer::default(), address: None }
    }
}

impl ServiceEndpoint {
    /// A connection that is made with its first call, within a tokio runtime.
    #[must_use]
    pub fn connect_lazy(&self) -> CallerChannel {
        InterceptedService::new(self.transport.connect_lazy(), self.bearer.clone())
    }

    /// The same for another replica of the service, which one of its answers named. `None` where nothing vouches for it: only
    /// addresses that were configured are taken, and those of certificates by the vehicle's own authority. So neither the
    /// token nor a question goes to anybody else, whoever answered.
    #[must_use]
    pub fn follows(&self, url: &str) -> Option<Self> {
        let address = self.address.as_ref()?;
        let vouched =
            url.starts_with("https://") && address.url.starts_with("https://") && address.ca_pem.is_some();
        let configured = address.replicas.iter().chain([&address.url]).any(|known| same(known, url));
        if !vouched && !configured {
            return None;
        }
        let replica = ServiceAddress { url: url.to_owned(), ..address.clone() }.endpoint().ok()?;
        Some(Self { transport: kept_alive(replica.transport), ..replica })
    }

    /// One whose connection is noticed to be dead while nothing is asked.
    pub(crate) fn kept_alive(self) -> Self {
        Self { transport: kept_alive(self.transport), ..self }
    }
}

fn kept_alive(transport: Endpoint) -> Endpoint {
    transport
        .http2_keep_alive_interval(Duration::from_secs(5))
        .keep_alive_timeout(Duration::from_secs(5))
        .keep_alive_while_idle(true)
}

/// Do two addresses name the same port of the same host?
fn same(one: &str, other: &str) -> bool {
    let parts = |url: &str| {
        let uri: Uri = url.parse().ok()?;
        let host = uri.host()?.to_ascii_lowercase();
        let plain = !uri.authority()?.as_str().contains('@');
        plain.then(|| (uri.scheme_str().map(str::to_owned), host, uri.port_u16()))
    };
    parts(one).is_some_and(|one| Some(one) == parts(other))
}

/// A connection whose calls tell who makes them.
pub type CallerChannel = InterceptedService<Channel, Bearer>;

/// Puts the caller's token into each call.
#[derive(Clone, Default)]
pub struct Bearer(Option<MetadataValue<Ascii>>);

impl std::fmt::Debug for Bearer {
    /// Without the token.
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if self.0.is_some() { "Bearer(...)" } else { "Bearer(none)" })
    }
}

impl Interceptor for Bearer {
    fn call(&mut self, mut request: Request<()>) -> Result<Request<()>, Status> {
        if let Some(bearer) = &self.0 {
            request.metadata_mut().insert("authorization", bearer.clone());
        }
        Ok(request)
    }
}

/// Why the service cannot be addressed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The text is not a URL.
    #[error(
        "`{url}` is not the address of a service; expected http://host:port, https://host:port or unix:/path"
    )]
    Url {
        /// The text that is no address.
        url: String,
    },
    /// A certificate or token for a connection that is not encrypted, or a token that is none.
    #[error("{0}")]
    Tls(&'static str),
    /// The certificates cannot be used.
    #[error("the certificates cannot be used: {0}")]
    Certificates(#[source] tonic::transport::Error),
}

const NOT_ENCRYPTED: Error = Error::Tls("certificates need an https:// address; this one is not encrypted");

impl ServiceAddress {
    /// A service at an `http://host:port`.
    #[must_use]
    pub fn at(url: impl Into<String>) -> Self {
        Self { url: url.into(), ca_pem: None, identity_pem: None, token: None, replicas: Vec::new() }
    }

    /// The transport's settings; nothing is connected yet.
    ///
    /// # Errors
    /// When the URL, the certificates or the token cannot be used.
    pub fn endpoint(&self) -> Result<ServiceEndpoint, Error> {
        let bearer = Bearer(self.token.as_deref().map(bearer).transpose()?);
        let address = Some(self.clone());
        Ok(ServiceEndpoint { transport: self.transport()?, bearer, address })
    }

    fn transport(&self) -> Result<Endpoint, Error> {
        let not_a_url = || Error::Url { url: self.url.clone() };
        let endpoint = Endpoint::from_shared(self.url.clone()).map_err(|_| not_a_url())?;
        let endpoint = endpoint
            .user_agent(concat!("echofix-client/", env!("CARGO_PKG_VERSION")))
            .map_err(|_| not_a_url())?
            .connect_timeout(Duration::from_secs(5))
            .tcp_nodelay(true);
        if self.url.starts_with("unix:") {
            let plain = self.ca_pem.is_none() && self.identity_pem.is_none();
            return if plain { Ok(endpoint) } else { Err(NOT_ENCRYPTED) };
        }
        match endpoint.uri().scheme_str() {
            Some("http") if self.token.is_some() && !endpoint.uri().host().is_some_and(is_loopback) => {
                Err(Error::Tls("a token needs an https:// address: anybody on the way could read it"))
            }
            Some("http") if self.ca_pem.is_none() && self.identity_pem.is_none() => Ok(endpoint),
            Some("http") => Err(NOT_ENCRYPTED),
            Some("https") => endpoint.tls_config(self.tls()).map_err(Error::Certificates),
            _ => Err(not_a_url()),
        }
    }

    fn tls(&self) -> ClientTlsConfig {
        let tls = match &self.ca_pem {
            Some(ca) => ClientTlsConfig::new().ca_certificate(Certificate::from_pem(ca)),
            None => ClientTlsConfig::new().with_webpki_roots(),
        };
        match &self.identity_pem {
            Some((certificate, key)) => tls.identity(Identity::from_pem(certificate, key)),
            None => tls,
        }
    }
}

fn bearer(token: &str) -> Result<MetadataValue<Ascii>, Error> {
    let no_token = |_| Error::Tls("the token holds characters that no token has");
    let mut bearer: MetadataValue<Ascii> = format!("Bearer {}", token.trim()).parse().map_err(no_token)?;
    bearer.set_sensitive(true);
    Ok(bearer)
}

/// Does a host, as it stands in an address, lie on this machine?
fn is_loopback(host: &str) -> bool {
    let bare = host.trim_start_matches('[').trim_end_matches(']');
    bare == "localhost" || bare.parse().is_ok_and(|address: std::net::IpAddr| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_checked_before_anything_is_sent() {
        // A socket's connection is made within a runtime; its settings are not.
        for url in ["http://127.0.0.1:50051", "unix:/run/echofix/grpc", "unix:///run/echofix/grpc"] {
            assert!(ServiceAddress::at(url).endpoint().is_ok(), "{url}");
        }
        for url in ["", "localhost", "ftp://host:1", "not a url"] {
            assert!(matches!(ServiceAddress::at(url).endpoint(), Err(Error::Url { .. })), "{url}");
        }
        let message = ServiceAddress::at("localhost").endpoint().unwrap_err().to_string();
        assert!(message.contains("http://host:port"), "{message}");
    }

    #[test]
    fn certificates_and_encryption_go_together() {
        assert!(ServiceAddress::at("https://host:1").endpoint().is_ok(), "the public authorities");
        let half = ServiceAddress { ca_pem: Some(String::new()), ..ServiceAddress::at("http://host:1") };
        assert!(matches!(half.endpoint(), Err(Error::Tls(_))));
    }

    /// Catches: a token that anybody on the way reads, or that a log shows.
    #[test]
    fn tokens_go_over_encrypted_connections_only_and_are_not_shown() {
        let with = |url: &str| {
            ServiceAddress { token: Some("secret-7".to_owned()), ..ServiceAddress::at(url) }.endpoint()
        };
        let secrets = ("certificate-7".to_owned(), "key-7".to_owned());
        let address = ServiceAddress {
            token: Some("secret-7".to_owned()),
            identity_pem: Some(secrets),
            ..ServiceAddress::at("https://host:1")
        };
        assert!(!format!("{address:?}").contains("-7"), "{address:?}");
        for url in ["https://host:1", "http://127.0.0.1:1", "http://[::1]:1", "http://localhost:1"] {
            assert!(!format!("{:?}", with(url).unwrap()).contains("secret-7"), "{url}");
        }
        assert!(matches!(with("http://host:1"), Err(Error::Tls(_))));
        let mut bearer = with("https://host:1").unwrap().bearer;
        let request = bearer.call(Request::new(())).unwrap();
        assert_eq!(request.metadata().get("authorization").unwrap(), "Bearer secret-7");
    }

    /// Catches: a token or a question that goes to whomever an answer names.
    #[test]
    fn replicas_are_followed_to_where_something_vouches_for_them() {
        let listed = |url: &str, replicas: &[&str]| {
            let replicas = replicas.iter().map(|&replica| replica.to_owned()).collect();
            ServiceAddress { replicas, ..ServiceAddress::at(url) }.endpoint().unwrap()
        };
        let plain = listed("http://fleet:50051", &["http://a:1", "http://B:1"]);
        for url in ["http://a:1", "http://b:1", "http://fleet:50051"] {
            assert!(plain.follows(url).is_some(), "{url}");
        }
        for url in ["http://a:2", "https://a:1", "http://c:1", "http://a:1@c:1", "", "a:1", "http://a"] {
            assert!(plain.follows(url).is_none(), "{url}");
        }
        let public = listed("https://fleet:1", &["https://a:1"]);
        assert!(public.follows("https://a:1").is_some());
        assert!(public.follows("https://anybody:1").is_none(), "public authorities vouch for anybody");
        let ca_pem = Some(String::new());
        let own = ServiceAddress { ca_pem, ..ServiceAddress::at("https://fleet:1") }.endpoint().unwrap();
        assert!(own.follows("https://b:1").is_some());
        assert!(own.follows("http://b:1").is_none(), "unencrypted");
        let other = ServiceEndpoint::from(Endpoint::from_static("http://a:1"));
        assert!(other.follows("http://a:1").is_none(), "nothing is known of it");
    }
}
