//! What the service itself asks over HTTP: issuers and webhooks. It follows nowhere, and believes public authorities.

use std::time::Duration;

use reqwest::redirect::Policy;
use reqwest::{Certificate, Client, ClientBuilder};

/// How long one request may take.
const PATIENCE: Duration = Duration::from_secs(10);

/// A client that believes the system's authorities, or, where there are none, as in the image, those that came with the program.
///
/// # Errors
/// When it cannot be made.
pub(crate) fn client() -> reqwest::Result<Client> {
    let builder = bare();
    if !rustls_native_certs::load_native_certs().certs.is_empty() {
        return builder.build();
    }
    let known: Result<Vec<_>, _> =
        webpki_root_certs::TLS_SERVER_ROOT_CERTS.iter().map(|der| Certificate::from_der(der)).collect();
    builder.tls_certs_only(known?).build()
}

/// A client that believes the authorities of a PEM file and no others.
///
/// # Errors
/// In words, when the file cannot be used.
pub(crate) fn client_believing(ca: &str) -> Result<Client, String> {
    let pem = std::fs::read(ca).map_err(|error| format!("{ca}: {error}"))?;
    let authorities = Certificate::from_pem_bundle(&pem).map_err(|error| format!("{ca}: {error}"))?;
    bare().tls_certs_only(authorities).build().map_err(|error| error.to_string())
}

fn bare() -> ClientBuilder {
    // The only provider that is built in; another may have been chosen already.
    let _ = rustls::crypto::ring::default_provider().install_default();
    Client::builder().timeout(PATIENCE).redirect(Policy::none())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: an image without authorities, whose service reaches no issuer.
    #[test]
    fn the_built_in_authorities_can_be_used() {
        let known = webpki_root_certs::TLS_SERVER_ROOT_CERTS;
        assert!(known.len() > 50, "{}", known.len());
        let known = known.iter().map(|der| Certificate::from_der(der).unwrap());
        assert!(bare().tls_certs_only(known).build().is_ok() && client().is_ok());
        assert!(client_believing("/nonexistent").unwrap_err().starts_with("/nonexistent"));
    }
}
