//! Browsers sign in at an issuer: `OpenID` Connect's authorization code flow, with PKCE, state and nonce.
//!
//! - [`rules`]: what of the configuration must hold.
//! - [`provider`]: the issuer's endpoints and keys, as it publishes them.
//! - [`exchange`]: a code becomes an ID token.
//! - [`flow`]: from the first redirect to whom the token names.
//!
//! The ID token is checked as other tokens of an issuer are (`jwt`): the same algorithms, and the same claims become name and
//! roles.

mod exchange;
mod flow;
mod provider;
mod rules;

pub use flow::{Answered, NotSignedIn};
pub(super) use flow::{Flows, LASTS};
pub(super) use rules::{client_secret, rules_of};

/// The cookie that tells which browser began to sign in. It goes with the issuer's redirect, which a strict one would not.
pub const FLOW_COOKIE: &str = "echofix_signin";
/// Where the issuer sends browsers back to, below the port's own address.
pub(super) const CALLBACK: &str = "/session/callback";
