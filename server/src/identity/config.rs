//! The sections `[tls]` and `[identity]`, and what of them makes sense.

use std::net::SocketAddr;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::role::{Role, Roles};
use super::{jwt, oidc};
use crate::listen::ListenAddress;

/// What encrypts both ports. An empty path is none.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TlsConfig {
    /// PEM of the service's certificate and of those between it and its authority.
    pub certificate: String,
    /// PEM of its key.
    pub key: String,
    /// PEM of the authorities whose client certificates are taken.
    pub client_ca: String,
    /// PEM of these authorities' lists of revoked certificates.
    pub crl: String,
    /// How often all of these files are looked at, seconds.
    pub reload_s: u64,
}

/// Who is let in.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct IdentityConfig {
    /// What callers may do whom nothing identifies: roles, `none`, or `auto`.
    pub anonymous: String,
    /// The file with the hashes of bearer tokens.
    pub tokens: String,
    /// Tokens may cross the network readable: something in front encrypts.
    pub plaintext: bool,
    /// The header by which a proxy on this machine tells `ROLE/NAME`.
    pub proxy_header: String,
    /// The only domain of SPIFFE ids that is taken; empty takes any that the authority signs.
    pub trust_domain: String,
    /// Whether anybody may read `/metrics`.
    pub open_metrics: bool,
    /// The issuer's public keys (JWKS), which sign tokens: a file, or an https address. Empty takes no JWT.
    pub jwt_jwks: String,
    /// PEM of the authorities of that address; empty takes those of the system.
    pub jwt_jwks_ca: String,
    /// How often the address is asked, seconds.
    pub jwt_refresh_s: u64,
    /// The issuer that tokens must name.
    pub jwt_issuer: String,
    /// The audience that tokens must name.
    pub jwt_audience: String,
    /// The claim with the caller's name.
    pub jwt_name_claim: String,
    /// The claim with what stands for roles.
    pub jwt_role_claim: String,
    /// What its values stand for, as `VALUE=ROLE`.
    pub jwt_roles: Vec<String>,
    /// By how much the issuer's clock may differ, seconds.
    pub jwt_leeway_s: u64,
    /// The issuer at which browsers sign in (`OpenID` Connect). Empty: with tokens only.
    pub oidc_issuer: String,
    /// PEM of the authorities of that issuer's address; empty takes those of the system.
    pub oidc_ca: String,
    /// The name by which the issuer knows this service.
    pub oidc_client_id: String,
    /// The file with what proves that name; empty for a public client.
    pub oidc_client_secret: String,
    /// Where the issuer sends browsers back to.
    pub oidc_redirect: String,
    /// What is asked for.
    pub oidc_scopes: Vec<String>,
    /// How long a session lasts that began so, seconds.
    pub oidc_session_s: u64,
}

/// A file that cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{key}` ({path}): {reason}")]
pub struct TlsError {
    pub(super) key: &'static str,
    pub(super) path: String,
    pub(super) reason: String,
}

/// Why nobody can be let in as configured.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Error {
    /// A port that others reach, and nothing that says who they are.
    #[error(
        "{address} can be reached from other machines, and nothing says who may do what. Ways out:\n  \
         - certificates: `echofix identity init DIR --name HOST` makes them and prints what to configure;\n  \
         - tokens: `echofix token create --role operator --name NAME --file FILE`, `identity.tokens` and \
         `tls.certificate`;\n  \
         - tokens of an issuer (JWT): `identity.jwt_jwks` and those beside it, and `tls.certificate`;\n  \
         - a proxy on this machine that authenticates: listen on 127.0.0.1 or a unix socket, and set `identity.proxy_header`;\n  \
         - nobody is asked: `--anonymous=vehicle`, `--anonymous=mapper` or `--anonymous=operator`;\n  \
         - only this machine: listen on 127.0.0.1"
    )]
    Nobody {
        /// The address of the port.
        address: SocketAddr,
    },
    /// Tokens that anybody on the way could read.
    #[error(
        "tokens would cross the network to {address} readable: set `tls.certificate` and `tls.key`, or \
         `identity.plaintext = true` where something in front encrypts"
    )]
    Readable {
        /// The address of the port.
        address: SocketAddr,
    },
    /// A value that makes no sense.
    #[error("`{key}` {rule}")]
    Value {
        /// The key, with its section.
        key: &'static str,
        /// The rule that it breaks.
        rule: &'static str,
    },
    /// A file that cannot be used.
    #[error(transparent)]
    File(#[from] TlsError),
}

impl Error {
    /// Is it that there is no identity, rather than one that is wrong?
    #[must_use]
    pub fn is_missing(&self) -> bool {
        matches!(self, Self::Nobody { .. } | Self::Readable { .. })
    }
}

/// What callers may do whom nothing identifies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Strangers {
    /// Everything: nobody is asked, because only this machine reaches the ports.
    Unasked,
    /// What these roles may; nothing for none.
    With(Roles),
}

impl TlsConfig {
    pub(super) fn is_on(&self) -> bool {
        !self.certificate.is_empty()
    }
}

impl IdentityConfig {
    /// Is there any way to be known?
    fn identifies(&self, tls: &TlsConfig) -> bool {
        !(tls.client_ca.is_empty()
            && self.tokens.is_empty()
            && self.jwt_jwks.is_empty()
            && self.oidc_issuer.is_empty()
            && self.proxy_header.is_empty())
    }

    pub(super) fn strangers(&self, tls: &TlsConfig) -> Strangers {
        match self.anonymous.as_str() {
            "auto" if !self.identifies(tls) => Strangers::Unasked,
            "auto" | "none" => Strangers::With(Roles::default()),
            roles => Strangers::With(roles.parse().unwrap_or_default()),
        }
    }
}

/// Checks values and, for ports at these addresses, whether anybody is asked who can reach them. Reads no file.
///
/// # Errors
/// The first rule that is broken.
pub fn check(tls: &TlsConfig, identity: &IdentityConfig, listen: &[ListenAddress]) -> Result<(), Error> {
    let rules = [rules(tls, identity), jwt::rules_of(identity), oidc::rules_of(identity)].concat();
    if let Some((key, _, rule)) = rules.into_iter().find(|(_, holds, _)| !holds) {
        return Err(Error::Value { key, rule });
    }
    let foreign = listen.iter().find_map(|address| match address {
        ListenAddress::Tcp(tcp) if !address.is_local() => Some(*tcp),
        _ => None,
    });
    let Some(address) = foreign else { return Ok(()) };
    if identity.strangers(tls) == Strangers::Unasked {
        return Err(Error::Nobody { address });
    }
    let takes_tokens =
        [&identity.tokens, &identity.jwt_jwks, &identity.oidc_issuer].into_iter().any(|way| !way.is_empty());
    if takes_tokens && !tls.is_on() && !identity.plaintext {
        return Err(Error::Readable { address });
    }
    Ok(())
}

fn rules(tls: &TlsConfig, identity: &IdentityConfig) -> Vec<(&'static str, bool, &'static str)> {
    let header = &identity.proxy_header;
    let strangers = |roles: Roles| {
        [Role::Admin, Role::Gateway, Role::Replica].into_iter().all(|role| !roles.contain(role))
    };
    let anonymous = ["auto", "none"].contains(&identity.anonymous.as_str())
        || identity.anonymous.parse().is_ok_and(strangers);
    let file = |path: &str| path.is_empty() || !Path::new(path).is_dir();
    vec![
        ("tls.key", tls.certificate.is_empty() == tls.key.is_empty(), "and tls.certificate go together"),
        ("tls.client_ca", tls.client_ca.is_empty() || tls.is_on(), "needs tls.certificate and tls.key"),
        ("tls.crl", tls.crl.is_empty() || !tls.client_ca.is_empty(), "needs tls.client_ca"),
        ("tls.reload_s", (1..=86_400).contains(&tls.reload_s), "must lie within 1 and 86400"),
        (
            "identity.anonymous",
            anonymous,
            "must be auto, none, or some of vehicle, mapper, viewer and operator, with commas between",
        ),
        (
            "identity.tokens",
            file(&identity.tokens),
            "is a folder; name the file that `echofix token create` writes",
        ),
        (
            "identity.proxy_header",
            header.bytes().all(|b| b.is_ascii_lowercase() || b.is_ascii_digit() || b == b'-'),
            "must be the name of a header in lower case, such as x-echofix-caller",
        ),
        (
            "identity.proxy_header",
            !["authorization", "cookie", "host"].contains(&header.as_str()),
            "must not be a header that means something else",
        ),
        (
            "identity.trust_domain",
            !identity.trust_domain.contains('/'),
            "must be a domain without scheme and path",
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn tls() -> TlsConfig {
        TlsConfig { reload_s: 10, ..TlsConfig::default() }
    }

    fn identity() -> IdentityConfig {
        IdentityConfig { anonymous: "auto".to_owned(), ..IdentityConfig::default() }
    }

    fn at(address: &str) -> [ListenAddress; 1] {
        [address.parse().unwrap()]
    }

    /// Catches: a port that others reach and that asks nobody because nobody thought of it.
    #[test]
    fn a_port_that_others_reach_needs_identity_or_words() {
        for own in ["127.0.0.1:1", "[::1]:1", "127.9.9.9:1", "[::ffff:127.0.0.1]:1", "unix:/run/a"] {
            assert_eq!(check(&tls(), &identity(), &at(own)), Ok(()), "{own}");
        }
        for open in ["0.0.0.0:1", "[::]:1", "10.0.0.7:1", "[::ffff:10.0.0.7]:1"] {
            let refused = check(&tls(), &identity(), &at(open)).unwrap_err();
            assert!(refused.is_missing() && refused.to_string().contains("--anonymous"), "{refused}");
            let told = IdentityConfig { anonymous: "mapper,viewer".to_owned(), ..identity() };
            assert_eq!(check(&tls(), &told, &at(open)), Ok(()));
            let tokens = IdentityConfig { tokens: "tokens".to_owned(), ..identity() };
            assert!(matches!(check(&tls(), &tokens, &at(open)), Err(Error::Readable { .. })));
            assert_eq!(check(&tls(), &IdentityConfig { plaintext: true, ..tokens }, &at(open)), Ok(()));
        }
    }

    /// Catches: anonymous callers that may do everything as soon as one file of identities is named.
    #[test]
    fn strangers_may_nothing_once_anybody_can_be_known() {
        assert_eq!(identity().strangers(&tls()), Strangers::Unasked);
        let nobody = Strangers::With(Roles::default());
        let tokens = IdentityConfig { tokens: "t".to_owned(), ..identity() };
        let proxy = IdentityConfig { proxy_header: "x".to_owned(), ..identity() };
        assert_eq!((tokens.strangers(&tls()), proxy.strangers(&tls())), (nobody, nobody));
        assert_eq!(identity().strangers(&TlsConfig { client_ca: "ca".to_owned(), ..tls() }), nobody);
    }

    #[test]
    fn values_that_make_no_sense_are_named() {
        let refused =
            |tls: TlsConfig, identity: IdentityConfig| check(&tls, &identity, &[]).unwrap_err().to_string();
        let certificate = TlsConfig { certificate: "c".to_owned(), ..tls() };
        assert!(refused(certificate, identity()).starts_with("`tls.key`"));
        assert!(
            refused(TlsConfig { client_ca: "c".to_owned(), ..tls() }, identity())
                .starts_with("`tls.client_ca`")
        );
        assert!(refused(TlsConfig { reload_s: 0, ..tls() }, identity()).starts_with("`tls.reload_s`"));
        for anonymous in ["", "admin", "gateway", "everybody", "viewer,admin"] {
            let identity = IdentityConfig { anonymous: anonymous.to_owned(), ..identity() };
            assert!(refused(tls(), identity).starts_with("`identity.anonymous`"), "{anonymous}");
        }
        for proxy_header in ["X-Caller", "authorization", "a b"] {
            let identity = IdentityConfig { proxy_header: proxy_header.to_owned(), ..identity() };
            assert!(refused(tls(), identity).starts_with("`identity.proxy_header`"), "{proxy_header}");
        }
    }
}
