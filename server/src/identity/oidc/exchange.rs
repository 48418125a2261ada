//! A code becomes an ID token, at the issuer's token endpoint.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use reqwest::{Url, header};
use serde::Deserialize;

use super::provider::Known;
use crate::identity::config::IdentityConfig;
use crate::identity::jwt::MAX_TOKEN_BYTES;
use crate::outgoing::received;

/// Bytes of the answer, at most: access and refresh tokens come with it, and are not kept.
const MAX_BYTES: u64 = 8 * MAX_TOKEN_BYTES as u64;

#[derive(Deserialize)]
struct Tokens {
    id_token: String,
}

#[derive(Deserialize)]
struct Refused {
    error: String,
}

/// Pairs as a form writes them.
pub(super) fn form(pairs: &[(&str, &str)]) -> String {
    // A URL library writes the query of any address so.
    let Ok(mut url) = Url::parse("http://localhost/") else { return String::new() };
    url.query_pairs_mut().extend_pairs(pairs);
    url.query().unwrap_or_default().to_owned()
}

/// The ID token that the issuer gives for a code.
///
/// # Errors
/// In words: whether the issuer refused, and otherwise what went wrong.
pub(super) async fn exchanged(
    known: &Known,
    (config, secret): (&IdentityConfig, Option<&str>),
    (code, verifier): (&str, &str),
) -> Result<String, NotExchanged> {
    let id = config.oidc_client_id.as_str();
    let mut pairs = vec![
        ("grant_type", "authorization_code"),
        ("code", code),
        ("redirect_uri", &config.oidc_redirect),
        ("client_id", id),
        ("code_verifier", verifier),
    ];
    let mut request = known.client.post(known.token.clone());
    if let Some(secret) = secret {
        if known.secret_in_body {
            pairs.push(("client_secret", secret));
        } else {
            let pair = format!("{}:{}", escaped(id), escaped(secret));
            request = request.header(header::AUTHORIZATION, format!("Basic {}", STANDARD.encode(pair)));
        }
    }
    let request = request
        .header(header::CONTENT_TYPE, "application/x-www-form-urlencoded")
        .header(header::ACCEPT, "application/json")
        .body(form(&pairs));
    let failed = |why: String| NotExchanged::Failed(why);
    let answer = request.send().await.map_err(|error| failed(error.without_url().to_string()))?;
    let status = answer.status();
    let body = received(answer, MAX_BYTES).await.map_err(|why| failed(format!("its answer {why}")))?;
    if status.is_client_error() {
        let error = serde_json::from_slice::<Refused>(&body).map_or_else(|_| status.to_string(), |r| r.error);
        return Err(NotExchanged::Refused(error));
    }
    if !status.is_success() {
        return Err(failed(format!("it answered {status}")));
    }
    let tokens: Tokens =
        serde_json::from_slice(&body).map_err(|_| failed("it gave no ID token".to_owned()))?;
    Ok(tokens.id_token)
}

/// Why there is no token for a code.
pub(super) enum NotExchanged {
    /// The issuer says so.
    Refused(String),
    /// It did not answer as issuers do.
    Failed(String),
}

/// A client's id or secret as the header takes it (RFC 6749, 2.3.1).
fn escaped(text: &str) -> String {
    form(&[("", text)]).trim_start_matches('=').to_owned()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn forms_are_written_as_issuers_read_them() {
        assert_eq!(form(&[("code", "a b&c=d"), ("x", "\u{e9}/")]), "code=a+b%26c%3Dd&x=%C3%A9%2F");
        assert_eq!(escaped("s:e%c=t"), "s%3Ae%25c%3Dt");
    }
}
