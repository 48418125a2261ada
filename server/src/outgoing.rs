//! What the service itself asks over HTTP: issuers and webhooks. It follows nowhere, and believes public authorities.

use std::time::Duration;

use reqwest::redirect::Policy;
use reqwest::{Certificate, Client, ClientBuilder, Response};

/// How long one request may take.
const PATIENCE: Duration = Duration::from_secs(10);

/// A client that believes the authorities of a PEM file and no others; without a file the public ones.
///
/// # Errors
/// In words, when the file cannot be used.
pub(crate) fn client(ca: &str) -> Result<Client, String> {
    if ca.is_empty() {
        return public_client().map_err(|error| error.to_string());
    }
    let pem = std::fs::read(ca).map_err(|error| format!("{ca}: {error}"))?;
    let authorities = Certificate::from_pem_bundle(&pem).map_err(|error| format!("{ca}: {error}"))?;
    bare().tls_certs_only(authorities).build().map_err(|error| error.to_string())
}

/// A client that believes the system's authorities, or, where there are none, as in the image, those that came with the program.
fn public_client() -> reqwest::Result<Client> {
    let builder = bare();
    if !rustls_native_certs::load_native_certs().certs.is_empty() {
        return builder.build();
    }
    let known: Result<Vec<_>, _> =
        webpki_root_certs::TLS_SERVER_ROOT_CERTS.iter().map(|der| Certificate::from_der(der)).collect();
    builder.tls_certs_only(known?).build()
}

fn bare() -> ClientBuilder {
    // The only provider that is built in; another may have been chosen already.
    let _ = rustls::crypto::ring::default_provider().install_default();
    Client::builder().timeout(PATIENCE).redirect(Policy::none())
}

/// The body of an answer: not empty, and no longer than so many bytes.
///
/// # Errors
/// In words, what it is instead.
pub(crate) async fn received(mut answer: Response, most: u64) -> Result<Vec<u8>, String> {
    let mut bytes = Vec::new();
    while let Some(chunk) = answer.chunk().await.map_err(|error| error.without_url().to_string())? {
        if (bytes.len() + chunk.len()) as u64 > most {
            return Err(format!("is larger than {most} bytes"));
        }
        bytes.extend_from_slice(&chunk);
    }
    if bytes.is_empty() {
        return Err("answered nothing".to_owned());
    }
    Ok(bytes)
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
        assert!(bare().tls_certs_only(known).build().is_ok() && client("").is_ok());
        assert!(client("/nonexistent").unwrap_err().starts_with("/nonexistent"));
    }
}
