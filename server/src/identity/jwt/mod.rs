//! JSON Web Tokens of an issuer: who they name, as what, and until when.
//!
//! - [`keys`]: the issuer's public keys (JWKS), checked before they count.
//! - [`rules`]: what of a token must hold, and how its claims become name and roles.
//! - [`signature`]: ring checks the signatures.
//! - [`source`]: where the keys come from: a file, or an address that is asked again.

mod keys;
mod rules;
mod signature;
mod source;

pub(super) use keys::Keys;
pub use rules::Lease;
pub(super) use rules::{NotTaken, Told, check, rules_of, told_by, told_by_id_token};
pub(super) use source::{Source, is_address};

/// Bytes of a token, at most: looked at before anything of it is parsed.
pub(super) const MAX_TOKEN_BYTES: usize = 8 << 10;
/// Bytes of a key set, at most.
pub(super) const MAX_SET_BYTES: u64 = 1 << 20;

/// Does a bearer token look like a JWT? Tokens of a file hold no dots.
pub(super) fn looks_like_one(token: &str) -> bool {
    token.bytes().filter(|&b| b == b'.').count() == 2
}

#[cfg(test)]
mod tests;
