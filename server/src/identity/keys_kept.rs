//! The issuer's keys (JWKS) are asked for again, where they have an address.

use std::sync::Arc;
use std::time::Duration;

use reqwest::{Certificate, Client};

use super::gate::Gate;
use super::jwt::{MAX_SET_BYTES, check, is_address};
use super::reload::refresh;
use crate::metrics::Metrics;
use crate::sparse;

/// How long one look at the address may take.
const PATIENCE: Duration = Duration::from_secs(10);
/// Between two looks, at least, however many unknown keys come.
const REST: Duration = Duration::from_secs(5);
/// After a look that failed.
const AGAIN: Duration = Duration::from_secs(15);

/// Keeps the issuer's keys current for as long as it is polled: asks the address every so often, and soon where a token's key
/// is not known.
pub async fn keep(gate: Arc<Gate>, metrics: Arc<Metrics>) {
    let config = gate.identity();
    if !is_address(&config.jwt_jwks) {
        return;
    }
    let (url, every) = (config.jwt_jwks.clone(), Duration::from_secs(config.jwt_refresh_s.max(1)));
    loop {
        let fetched = match client(&config.jwt_jwks_ca) {
            Ok(client) => fetch(&client, &url).await,
            Err(reason) => Err(reason),
        };
        let wait = match fetched {
            Ok(bytes) => {
                gate.key_source().put(bytes);
                refresh(&gate, &metrics).await;
                every
            }
            Err(error) => {
                metrics.tls_reload_failures.inc();
                if let Some(left_out) = sparse::line("the issuer's keys cannot be fetched") {
                    tracing::error!(
                        error,
                        left_out,
                        "the issuer's keys cannot be fetched; the last good ones stay"
                    );
                }
                AGAIN.min(every)
            }
        };
        tokio::time::sleep(REST.min(wait)).await;
        // Who asks meanwhile is remembered, once.
        let more = tokio::time::timeout(wait.saturating_sub(REST), gate.key_source().wanted()).await;
        tracing::debug!(unknown_key = more.is_ok(), "asking for the issuer's keys");
    }
}

fn client(ca: &str) -> Result<Client, String> {
    // The only provider that is built in; another may have been chosen already.
    let _ = rustls::crypto::ring::default_provider().install_default();
    let mut builder = Client::builder().timeout(PATIENCE).redirect(reqwest::redirect::Policy::none());
    if !ca.is_empty() {
        let pem = std::fs::read(ca).map_err(|error| format!("{ca}: {error}"))?;
        let authorities = Certificate::from_pem_bundle(&pem).map_err(|error| format!("{ca}: {error}"))?;
        builder = builder.tls_certs_only(authorities);
    }
    builder.build().map_err(|error| error.to_string())
}

/// A key set that was checked.
async fn fetch(client: &Client, url: &str) -> Result<Vec<u8>, String> {
    let mut answer = client.get(url).send().await.map_err(|error| error.without_url().to_string())?;
    if !answer.status().is_success() {
        return Err(format!("answered {}", answer.status()));
    }
    let mut bytes = Vec::new();
    while let Some(chunk) = answer.chunk().await.map_err(|error| error.without_url().to_string())? {
        if (bytes.len() + chunk.len()) as u64 > MAX_SET_BYTES {
            return Err(format!("is larger than {MAX_SET_BYTES} bytes"));
        }
        bytes.extend_from_slice(&chunk);
    }
    if bytes.is_empty() {
        return Err("answered nothing".to_owned());
    }
    check(&bytes).map(|_| bytes)
}
