//! What of the configuration must hold.

use super::CALLBACK;
use crate::identity::config::{IdentityConfig, TlsError};
use crate::identity::jwt::is_address;

/// Key, whether it makes sense, and the rule.
pub(in crate::identity) fn rules_of(config: &IdentityConfig) -> Vec<(&'static str, bool, &'static str)> {
    let on = !config.oidc_issuer.is_empty();
    let with_issuer = "and identity.oidc_issuer go together";
    let redirect = &config.oidc_redirect;
    let plain = |text: &String| {
        !text.is_empty() && text.bytes().all(|b| b.is_ascii_graphic() && b != b'"' && b != b'\\')
    };
    vec![
        (
            "identity.oidc_issuer",
            !on || (is_address(&config.oidc_issuer) && !config.oidc_issuer.contains(['?', '#'])),
            "must be an https:// address (http:// of this machine only), as the issuer writes it",
        ),
        ("identity.oidc_client_id", config.oidc_client_id.is_empty() != on, with_issuer),
        (
            "identity.oidc_client_secret",
            on || config.oidc_client_secret.is_empty(),
            "needs identity.oidc_issuer",
        ),
        (
            "identity.oidc_redirect",
            redirect.is_empty() != on && (!on || (is_address(redirect) && redirect.ends_with(CALLBACK))),
            "must be the address of this port as browsers know it, and end in /session/callback, as \
             https://maps.example/session/callback",
        ),
        (
            "identity.oidc_scopes",
            !on || (config.oidc_scopes.iter().any(|scope| scope == "openid")
                && config.oidc_scopes.iter().all(plain)),
            "must list openid, and names without spaces",
        ),
        (
            "identity.oidc_session_s",
            !on || (60..=43_200).contains(&config.oidc_session_s),
            "must lie within 60 and 43200",
        ),
    ]
}

/// What proves this service to the issuer, from its file.
///
/// # Errors
/// When the file cannot be read, or does not hold one line.
pub(in crate::identity) fn client_secret(identity: &IdentityConfig) -> Result<Option<String>, TlsError> {
    let path = &identity.oidc_client_secret;
    if path.is_empty() {
        return Ok(None);
    }
    let failed = |reason: String| TlsError { key: "identity.oidc_client_secret", path: path.clone(), reason };
    let text = std::fs::read_to_string(path).map_err(|error| failed(error.to_string()))?;
    let secret = text.trim();
    let one_line = !secret.is_empty() && !secret.contains(char::is_control);
    if one_line { Ok(Some(secret.to_owned())) } else { Err(failed("does not hold one line".to_owned())) }
}
