//! How the service is reached.

use std::time::Duration;

use tonic::transport::{Certificate, ClientTlsConfig, Endpoint, Identity};

/// Where the service is and who the vehicle is to it.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct ServiceAddress {
    /// `http://host:port`, or `https://host:port` for TLS.
    pub url: String,
    /// PEM of the authority that signed the service's certificate; needed for `https`.
    pub ca_pem: Option<String>,
    /// PEM of the vehicle's own certificate and of its key, for a service that asks for one.
    pub identity_pem: Option<(String, String)>,
}

/// Why the service cannot be addressed.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The text is not a URL.
    #[error("`{url}` is not the address of a service; expected http://host:port or https://host:port")]
    Url {
        /// The text that is no address.
        url: String,
    },
    /// A certificate for a connection that is not encrypted, or none for one that is.
    #[error("{0}")]
    Tls(&'static str),
    /// The certificates cannot be used.
    #[error("the certificates cannot be used: {0}")]
    Certificates(#[source] tonic::transport::Error),
}

impl ServiceAddress {
    /// A service at an `http://host:port`.
    #[must_use]
    pub fn at(url: impl Into<String>) -> Self {
        Self { url: url.into(), ca_pem: None, identity_pem: None }
    }

    /// The transport's settings; nothing is connected yet.
    ///
    /// # Errors
    /// When the URL or the certificates cannot be used.
    pub fn endpoint(&self) -> Result<Endpoint, Error> {
        let not_a_url = || Error::Url { url: self.url.clone() };
        let endpoint = Endpoint::from_shared(self.url.clone()).map_err(|_| not_a_url())?;
        let endpoint = endpoint
            .user_agent(concat!("echofix-client/", env!("CARGO_PKG_VERSION")))
            .map_err(|_| not_a_url())?
            .connect_timeout(Duration::from_secs(5))
            .tcp_nodelay(true);
        match endpoint.uri().scheme_str() {
            Some("http") if self.ca_pem.is_none() && self.identity_pem.is_none() => Ok(endpoint),
            Some("http") => {
                Err(Error::Tls("certificates need an https:// address; this one is not encrypted"))
            }
            Some("https") => endpoint.tls_config(self.tls()?).map_err(Error::Certificates),
            _ => Err(not_a_url()),
        }
    }

    fn tls(&self) -> Result<ClientTlsConfig, Error> {
        let ca = self.ca_pem.as_ref().ok_or(Error::Tls(
            "an https:// address needs the certificate of the authority that signed the service's (`ca_pem`)",
        ))?;
        let tls = ClientTlsConfig::new().ca_certificate(Certificate::from_pem(ca));
        Ok(match &self.identity_pem {
            Some((certificate, key)) => tls.identity(Identity::from_pem(certificate, key)),
            None => tls,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn addresses_are_checked_before_anything_is_sent() {
        assert!(ServiceAddress::at("http://127.0.0.1:50051").endpoint().is_ok());
        for url in ["", "localhost", "ftp://host:1", "not a url"] {
            assert!(matches!(ServiceAddress::at(url).endpoint(), Err(Error::Url { .. })), "{url}");
        }
        let message = ServiceAddress::at("localhost").endpoint().unwrap_err().to_string();
        assert!(message.contains("http://host:port"), "{message}");
    }

    #[test]
    fn certificates_and_encryption_go_together() {
        assert!(matches!(ServiceAddress::at("https://host:1").endpoint(), Err(Error::Tls(_))));
        let half = ServiceAddress { ca_pem: Some(String::new()), ..ServiceAddress::at("http://host:1") };
        assert!(matches!(half.endpoint(), Err(Error::Tls(_))));
    }
}
