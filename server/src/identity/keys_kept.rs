//! The issuer's keys (JWKS) are asked for again, where they have an address.

use std::sync::Arc;
use std::time::Duration;

use reqwest::Client;

use super::gate::Gate;
use super::jwt::{MAX_SET_BYTES, check, is_address};
use super::reload::refresh;
use crate::metrics::Metrics;
use crate::outgoing;
use crate::sparse;

/// Between two looks, at least, however many unknown keys come.
const REST: Duration = Duration::from_secs(5);
/// After a look that failed.
const AGAIN: Duration = Duration::from_secs(15);

/// Keeps the issuer's keys current for as long as it is polled: asks the address every so often, and soon where a token's key
/// is not known.
pub async fn keep(gate: Arc<Gate>, metrics: Arc<Metrics>) {
    let config = gate.identity();
    if !is_address(&config.jwt_jwks) {
        return keep_issuer(&gate, &metrics).await;
    }
    let (url, every) = (config.jwt_jwks.clone(), Duration::from_secs(config.jwt_refresh_s.max(1)));
    loop {
        let fetched = match outgoing::client(&config.jwt_jwks_ca) {
            Ok(client) => fetch(&client, &url).await,
            Err(reason) => Err(reason),
        };
        let wait = match fetched {
            Ok(bytes) => {
                gate.refresh_issuer().await.unwrap_or_else(|error| unreachable(&error, &metrics));
                gate.key_source().put(bytes);
                refresh(&gate, &metrics).await;
                every
            }
            Err(error) => {
                unreachable(&error, &metrics);
                AGAIN.min(every)
            }
        };
        tokio::time::sleep(REST.min(wait)).await;
        // Who asks meanwhile is remembered, once.
        let more = tokio::time::timeout(wait.saturating_sub(REST), gate.key_source().wanted()).await;
        tracing::debug!(unknown_key = more.is_ok(), "asking for the issuer's keys");
    }
}

/// The same where only the issuer's own description names its keys.
async fn keep_issuer(gate: &Gate, metrics: &Metrics) {
    let config = gate.identity();
    if config.oidc_issuer.is_empty() {
        return;
    }
    loop {
        tokio::time::sleep(Duration::from_secs(config.jwt_refresh_s.max(1))).await;
        gate.refresh_issuer().await.unwrap_or_else(|error| unreachable(&error, metrics));
    }
}

fn unreachable(error: &str, metrics: &Metrics) {
    metrics.tls_reload_failures.inc();
    if let Some(left_out) = sparse::line("the issuer's keys cannot be fetched") {
        tracing::error!(error, left_out, "the issuer's keys cannot be fetched; the last good ones stay");
    }
}

/// A key set that was checked.
async fn fetch(client: &Client, url: &str) -> Result<Vec<u8>, String> {
    let answer = client.get(url).send().await.map_err(|error| error.without_url().to_string())?;
    if !answer.status().is_success() {
        return Err(format!("answered {}", answer.status()));
    }
    let bytes = outgoing::received(answer, MAX_SET_BYTES).await?;
    check(&bytes).map(|_| bytes)
}
