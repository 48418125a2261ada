//! What of a token must hold, and how its claims become name and roles.

use std::sync::Arc;

use jsonwebtoken::errors::ErrorKind;
use jsonwebtoken::{Validation, decode, decode_header, get_current_timestamp};
use serde_json::{Map, Value};

use super::keys::Keys;
use super::{MAX_TOKEN_BYTES, is_address, signature};
use crate::identity::caller::is_name;
use crate::identity::config::IdentityConfig;
use crate::identity::role::{Role, Roles};

/// Seconds by which clocks may differ, at most.
const MAX_LEEWAY_S: u64 = 300;

/// For how long, and under which key, what a token told holds.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Lease {
    until_s: i64,
    /// The key's id and its own bytes.
    key: Arc<(String, Vec<u8>)>,
}

impl Lease {
    /// Whether it holds at a time, seconds since the Unix epoch, with the keys of that time.
    pub(in crate::identity) fn holds(&self, keys: &Keys, now_s: i64) -> bool {
        now_s < self.until_s && keys.print(&self.key.0) == Some(self.key.1.as_slice())
    }
}

/// Who a token names.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(in crate::identity) struct Told {
    pub(in crate::identity) name: String,
    pub(in crate::identity) roles: Roles,
    pub(in crate::identity) lease: Lease,
}

/// Why a token is not taken.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub(in crate::identity) enum NotTaken {
    /// Its key is not among those that are known; it may be a new one.
    #[error("the key that signed this token is not known; if it is new, try again in some seconds")]
    UnknownKey,
    /// Anything else, for its holder.
    #[error("{0}")]
    Other(String),
}

/// What tokens must say, beside their times.
struct Wanted<'a> {
    issuer: &'a str,
    audience: &'a str,
    required: &'a [&'a str],
}

/// Who a token names: checks size, key, algorithm, signature, issuer, audience and times.
///
/// # Errors
/// Why it is not taken.
pub(in crate::identity) fn told_by(
    token: &str,
    keys: &Keys,
    config: &IdentityConfig,
) -> Result<Told, NotTaken> {
    let required = &["exp", "nbf", "iss", "aud"];
    let wanted = Wanted { issuer: &config.jwt_issuer, audience: &config.jwt_audience, required };
    let (claims, lease) = checked(token, keys, (config, &wanted))?;
    told(&claims, lease, config)
}

/// The same of an ID token (`OpenID` Connect Core 1.0, 3.1.3.7) that answers a question with this nonce. Its lease is a session's.
///
/// # Errors
/// Why it is not taken.
pub(in crate::identity) fn told_by_id_token(
    token: &str,
    keys: &Keys,
    config: &IdentityConfig,
    nonce: &str,
) -> Result<Told, NotTaken> {
    let client = config.oidc_client_id.as_str();
    let required = &["exp", "iss", "aud", "sub"];
    let wanted = Wanted { issuer: &config.oidc_issuer, audience: client, required };
    let (claims, lease) = checked(token, keys, (config, &wanted))?;
    let other = |why: &str| NotTaken::Other(why.to_owned());
    if claims.get("nonce").and_then(Value::as_str) != Some(nonce) {
        return Err(other("it answers another question: its `nonce` is not what was sent"));
    }
    let party = claims.get("azp").map(Value::as_str);
    let several = claims.get("aud").and_then(Value::as_array).is_some_and(|audiences| audiences.len() > 1);
    if party.map_or(several, |party| party != Some(client)) {
        return Err(other("it was issued to another party (`azp`)"));
    }
    let now_s = get_current_timestamp() as i64;
    let lease = Lease { until_s: now_s.saturating_add(config.oidc_session_s as i64), ..lease };
    told(&claims, lease, config)
}

/// The claims of a token that holds, and for how long it does.
fn checked(
    token: &str,
    keys: &Keys,
    (config, wanted): (&IdentityConfig, &Wanted<'_>),
) -> Result<(Map<String, Value>, Lease), NotTaken> {
    let other = |why: &str| NotTaken::Other(why.to_owned());
    if token.len() > MAX_TOKEN_BYTES {
        return Err(NotTaken::Other(format!("the token is longer than {MAX_TOKEN_BYTES} bytes")));
    }
    signature::install();
    let unsigned = "the token is not signed by an algorithm that is taken: RS256, PS256, ES256 or EdDSA";
    let header = decode_header(token).map_err(|_| other(unsigned))?;
    let (id, key) = keys.get(header.kid.as_deref()).ok_or(NotTaken::UnknownKey)?;
    if !key.algorithms.contains(&header.alg) {
        return Err(other(unsigned));
    }
    // The library holds each algorithm against the key's family, too.
    let mut validation = Validation::new(header.alg);
    validation.algorithms.clone_from(&key.algorithms);
    validation.leeway = config.jwt_leeway_s;
    validation.validate_nbf = true;
    validation.set_audience(&[wanted.audience]);
    validation.set_issuer(&[wanted.issuer]);
    validation.set_required_spec_claims(wanted.required);
    let claims = decode::<Map<String, Value>>(token, &key.decoding, &validation)
        .map_err(|error| NotTaken::Other(in_words(error.kind())))?
        .claims;
    // The library has found it to be a number.
    let expires = claims.get("exp").and_then(Value::as_f64).unwrap_or(0.0);
    // The library lets the last second pass, in which sessions and streams have ended.
    let lease = Lease {
        until_s: (expires as i64).saturating_add(config.jwt_leeway_s as i64),
        key: Arc::new((id.to_owned(), key.print().to_vec())),
    };
    if get_current_timestamp() as i64 >= lease.until_s {
        return Err(NotTaken::Other(in_words(&ErrorKind::ExpiredSignature)));
    }
    Ok((claims, lease))
}

/// Whom claims name, and as what.
fn told(claims: &Map<String, Value>, lease: Lease, config: &IdentityConfig) -> Result<Told, NotTaken> {
    let name = claim(claims, &config.jwt_name_claim).and_then(Value::as_str).filter(|name| is_name(name));
    let name = name.ok_or_else(|| {
        let claim = &config.jwt_name_claim;
        NotTaken::Other(format!("the token's `{claim}` is no name; letters, digits and -._~@:+/, 64 at most"))
    })?;
    let roles = roles_of(claims, config);
    if roles.is_empty() {
        let claim = &config.jwt_role_claim;
        return Err(NotTaken::Other(format!("nothing in the token's `{claim}` stands for a role here")));
    }
    Ok(Told { name: name.to_owned(), roles, lease })
}

fn in_words(kind: &ErrorKind) -> String {
    match kind {
        ErrorKind::ExpiredSignature => "the token has expired; get another".to_owned(),
        ErrorKind::ImmatureSignature => "the token is not valid yet; do the clocks differ?".to_owned(),
        ErrorKind::InvalidIssuer => "the token is of another issuer".to_owned(),
        ErrorKind::InvalidAudience => "the token is for another audience".to_owned(),
        ErrorKind::MissingRequiredClaim(claim) => format!("the token has no `{claim}`"),
        ErrorKind::InvalidSignature => "the token's signature is wrong".to_owned(),
        _ => "the token cannot be read".to_owned(),
    }
}

/// A claim by its name, or by a JSON pointer (`/realm_access/roles`).
fn claim<'a>(claims: &'a Map<String, Value>, path: &str) -> Option<&'a Value> {
    let Some(pointer) = path.strip_prefix('/') else { return claims.get(path) };
    let (first, rest) = pointer.split_once('/').map_or((pointer, None), |(first, rest)| (first, Some(rest)));
    let found = claims.get(first)?;
    rest.map_or(Some(found), |rest| found.pointer(&format!("/{rest}")))
}

/// The roles that the claim's values stand for: a list, or one text with spaces between. What stands for nothing is passed over.
fn roles_of(claims: &Map<String, Value>, config: &IdentityConfig) -> Roles {
    let mut values: Vec<&str> = Vec::new();
    match claim(claims, &config.jwt_role_claim) {
        Some(Value::String(text)) => values.extend(text.split_whitespace()),
        Some(Value::Array(list)) => values.extend(list.iter().filter_map(Value::as_str)),
        _ => {}
    }
    let meant = config.jwt_roles.iter().filter_map(|entry| meaning(entry));
    let told = meant.filter(|(value, _)| values.contains(value));
    told.fold(Roles::default(), |roles, (_, role)| roles.with(role))
}

/// Of `VALUE=ROLE`.
fn meaning(entry: &str) -> Option<(&str, Role)> {
    let (value, role) = entry.rsplit_once('=')?;
    let one_word = !value.is_empty() && !value.contains(char::is_whitespace);
    Some((value, role.parse().ok()?)).filter(|_| one_word)
}

/// What of the configuration must hold: key, whether it does, and the rule.
pub(in crate::identity) fn rules_of(config: &IdentityConfig) -> Vec<(&'static str, bool, &'static str)> {
    let (on, oidc) = (!config.jwt_jwks.is_empty(), !config.oidc_issuer.is_empty());
    let is_url = config.jwt_jwks.contains("://");
    vec![
        (
            "identity.jwt_jwks",
            !is_url || is_address(&config.jwt_jwks),
            "must be a file, or an https:// address (http:// of this machine only)",
        ),
        ("identity.jwt_issuer", config.jwt_issuer.is_empty() != on, "and identity.jwt_jwks go together"),
        ("identity.jwt_audience", config.jwt_audience.is_empty() != on, "and identity.jwt_jwks go together"),
        (
            "identity.jwt_roles",
            config.jwt_roles.is_empty() != (on || oidc),
            "and identity.jwt_jwks or identity.oidc_issuer go together: without it no token means anything",
        ),
        (
            "identity.jwt_roles",
            config.jwt_roles.iter().all(|entry| meaning(entry).is_some()),
            "must list VALUE=ROLE; the roles are vehicle, mapper, gateway, viewer, operator, admin and replica",
        ),
        ("identity.jwt_role_claim", !(on || oidc) || !config.jwt_role_claim.is_empty(), "must name a claim"),
        ("identity.jwt_name_claim", !(on || oidc) || !config.jwt_name_claim.is_empty(), "must name a claim"),
        ("identity.jwt_leeway_s", config.jwt_leeway_s <= MAX_LEEWAY_S, "must be at most 300"),
        (
            "identity.jwt_refresh_s",
            !(on || oidc) || (10..=86_400).contains(&config.jwt_refresh_s),
            "must lie within 10 and 86400",
        ),
        (
            "identity.jwt_jwks_ca",
            config.jwt_jwks_ca.is_empty() || is_url,
            "needs identity.jwt_jwks to be an https:// address",
        ),
    ]
}

/// Checks a key set's text, as it would count.
///
/// # Errors
/// In words, why it does not.
pub(in crate::identity) fn check(bytes: &[u8]) -> Result<Keys, String> {
    if bytes.is_empty() { Ok(Keys::default()) } else { Keys::read(bytes) }
}
