//! Who is there, and what they may do. The same for both ports.
//!
//! - [`role`]: the roles, and which of them include which.
//! - [`caller`]: who asks, and how that is known.
//! - [`access`]: the one table of calls and the least role of each; what is not in it is denied.
//! - [`certificate`]: the name and the roles that a certificate's URIs tell.
//! - [`tokens`]: bearer tokens, of which a file keeps the hashes.
//! - [`sessions`]: browsers that have signed in; [`kept`]: how many of them are remembered.
//! - [`oidc`]: browsers sign in at an issuer.
//! - [`tls`]: certificate, key, authority and revocations, checked and made into rustls's configuration.
//! - [`config`]: the sections `[tls]` and `[identity]`.
//! - [`jwt`]: tokens of an issuer, its keys, and what its claims stand for.
//! - [`keys_kept`]: that issuer's keys are asked for again.
//! - [`remote_end`]: the other end of a connection.
//! - [`gate`]: all of it together: from a request's connection and headers to its caller, and whether that may do it.
//!   [`refusal`]: why it may not; [`headers`]: what requests carry of who asks; [`browsers`]: signing in and out.
//! - [`rates`]: how often a caller may ask.
//! - [`reload`]: files that changed are read again, and connections that no longer pass are told to go.

pub mod access;
mod browsers;
mod caller;
mod certificate;
mod config;
mod gate;
mod headers;
mod jwt;
mod kept;
mod keys_kept;
mod oidc;
mod rates;
mod refusal;
mod reload;
mod remote_end;
mod role;
mod sessions;
mod tls;
pub mod tokens;

pub use caller::{Caller, Known, NotTheContributor};
pub use certificate::{is_caller_uri, serial_of_pem};
pub use config::{Error, IdentityConfig, TlsConfig, TlsError, check};
pub use gate::Gate;
pub use headers::{CookieScope, PAGE_TOKEN};
pub use jwt::Lease;
pub use keys_kept::keep as keep_keys;
pub use oidc::{Answered, FLOW_COOKIE, NotSignedIn};
pub use rates::{Rated, Rates, RatesConfig};
pub use refusal::Refusal;
pub use reload::keep as keep_current;
pub use remote_end::{Closing, Entry, RemoteEnd};
pub use role::{Role, Roles};
pub use sessions::COOKIE;
pub use tls::Identified;
