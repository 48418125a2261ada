//! Who asks, and how that is known.

use std::fmt;

use super::jwt::Lease;
use super::role::{Role, Roles};
use crate::listen::RemoteAddress;

/// Characters of a caller's name, at most; contributors' names have no more.
const MAX_NAME: usize = 64;

/// How a caller is known.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Known {
    /// Not at all, and nobody is: the service is for its own machine.
    Unasked,
    /// Not at all; the configuration lets such callers do something.
    Anonymous,
    /// By a client certificate of the connection.
    Certificate,
    /// By a bearer token, or a session that began with one.
    Token,
    /// By a token of the configured issuer (JWT), or a session that began with one.
    Jwt,
    /// By signing in at the configured issuer (`OpenID` Connect): a session.
    Oidc,
    /// By the header of a proxy on this machine.
    Proxy,
}

impl Known {
    /// Its word in logs and answers.
    #[must_use]
    pub fn word(self) -> &'static str {
        match self {
            Self::Unasked => "unasked",
            Self::Anonymous => "anonymous",
            Self::Certificate => "certificate",
            Self::Token => "token",
            Self::Jwt => "jwt",
            Self::Oidc => "oidc",
            Self::Proxy => "proxy",
        }
    }
}

/// Who asks.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Caller {
    /// The name by which the caller is known; empty for one who is not.
    pub name: String,
    /// What the caller may do.
    pub roles: Roles,
    /// How both are known.
    pub known: Known,
    /// Where the connection comes from.
    pub address: Option<RemoteAddress>,
    /// For how long this holds, where a token says so.
    pub lease: Option<Lease>,
}

/// A contributor that the caller may not upload for.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error(
    "the upload names a contributor that is not its caller; leave header.contributor empty, or name the caller itself \
     (`{caller}`){}", .vouches.as_ref().map(|below| format!(" or a contributor below `{below}`")).unwrap_or_default()
)]
pub struct NotTheContributor {
    caller: String,
    vouches: Option<String>,
}

impl Caller {
    /// One who is asked nothing and may do everything: on the service's own machine.
    #[must_use]
    pub fn unasked() -> Self {
        Self {
            name: String::new(),
            roles: Role::Admin.into(),
            known: Known::Unasked,
            address: None,
            lease: None,
        }
    }

    /// Whether the caller may do what takes this role.
    #[must_use]
    pub fn may(&self, least: Role) -> bool {
        self.roles.include(least)
    }

    /// The name under which an upload counts.
    ///
    /// Who is known contributes under its own name; a gateway also under names below its own (`acme/car-7` for `acme`). Who
    /// is not known contributes under the name in the header, which no known caller can have.
    ///
    /// # Errors
    /// When a known caller names somebody else.
    pub fn contributor(&self, named: &str) -> Result<String, NotTheContributor> {
        match self.known {
            Known::Unasked => return Ok(named.to_owned()),
            Known::Anonymous => return Ok(format!("?{named}")),
            Known::Certificate | Known::Token | Known::Jwt | Known::Oidc | Known::Proxy => {}
        }
        let vouches = self.roles.include(Role::Gateway).then(|| format!("{}/", self.name));
        let below = |vouches: &String| named.len() > vouches.len() && named.starts_with(vouches.as_str());
        if named.is_empty() || named == self.name {
            Ok(self.name.clone())
        } else if vouches.as_ref().is_some_and(below) {
            Ok(named.to_owned())
        } else {
            Err(NotTheContributor { caller: self.name.clone(), vouches })
        }
    }

    /// Whether the caller's name stands for the contributor's.
    #[must_use]
    pub fn is_known(&self) -> bool {
        !matches!(self.known, Known::Unasked | Known::Anonymous)
    }

    /// Who, as what, and how it is known: for what is kept. From where is for the log alone.
    #[must_use]
    pub fn title(&self) -> String {
        let name = if self.name.is_empty() { "somebody" } else { &self.name };
        format!("{name} ({}, by {})", self.roles, self.known.word())
    }
}

impl fmt::Display for Caller {
    /// For the log of decisions: who, as what, how it is known, from where.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.title())?;
        self.address.map_or(Ok(()), |address| write!(f, " at {address}"))
    }
}

/// Can this be a caller's name? It is shown, compared and stored, and its slashes mean something.
pub(super) fn is_name(name: &str) -> bool {
    (1..=MAX_NAME).contains(&name.len())
        && name.bytes().all(|b| b.is_ascii_alphanumeric() || b"-._~@:+/".contains(&b))
        && !name.split('/').any(|part| part.is_empty() || part == "." || part == "..")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn caller(roles: &str, name: &str, known: Known) -> Caller {
        Caller { name: name.to_owned(), roles: roles.parse().unwrap(), known, address: None, lease: None }
    }

    /// Catches: one vehicle that is several witnesses because it gives several names.
    #[test]
    fn a_known_caller_contributes_under_one_name() {
        let car = caller("mapper", "car-7", Known::Certificate);
        assert_eq!(car.contributor("").unwrap(), "car-7");
        assert_eq!(car.contributor("car-7").unwrap(), "car-7");
        for other in ["car-8", "car-7/a", "Car-7", "car-7 ", "?car-7"] {
            let refused = car.contributor(other).unwrap_err().to_string();
            assert!(refused.contains("`car-7`") && refused.contains("empty"), "{refused}");
        }
    }

    /// Catches: a gateway that vouches for another fleet's vehicles.
    #[test]
    fn a_gateway_vouches_below_its_own_name() {
        let fleet = caller("gateway", "acme", Known::Token);
        assert_eq!(fleet.contributor("acme/car-7").unwrap(), "acme/car-7");
        assert_eq!(fleet.contributor("").unwrap(), "acme");
        for other in ["acme/", "acme2/car-7", "other/car-7", "acm", "ACME/car-7"] {
            assert!(fleet.contributor(other).unwrap_err().to_string().contains("`acme/`"), "{other}");
        }
    }

    /// Catches: somebody unknown whose uploads count as a known vehicle's.
    #[test]
    fn who_is_not_known_shares_no_name_with_who_is() {
        assert_eq!(caller("mapper", "", Known::Anonymous).contributor("car-7").unwrap(), "?car-7");
        assert!(!is_name("?car-7"));
        assert_eq!(Caller::unasked().contributor("car-7").unwrap(), "car-7");
    }

    #[test]
    fn names_are_plain() {
        for name in ["car-7", "acme/eu/car-7", "a", "ops@example.com"] {
            assert!(is_name(name), "{name}");
        }
        for name in ["", "a b", "a//b", "/a", "a/", "../a", "a\n", "caf\u{e9}", &"x".repeat(65)] {
            assert!(!is_name(name), "{name}");
        }
    }
}
