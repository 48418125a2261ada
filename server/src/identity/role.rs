//! The roles, and which of them include which.

use std::fmt;
use std::str::FromStr;

/// What somebody is to the service.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
#[repr(u8)]
pub enum Role {
    /// Localizes, and reads coverage and tiles.
    Vehicle,
    /// A vehicle that uploads as well.
    Mapper,
    /// A fleet's gateway: a mapper that may vouch for contributors below its own name.
    Gateway,
    /// Sees the map, and not where anybody is.
    Viewer,
    /// Sees everything, decides about the map's history, imports and backs up.
    Operator,
    /// All of these.
    Admin,
    /// Another service that keeps a copy: reads what vehicles and viewers read.
    Replica,
}

impl Role {
    /// All of them.
    pub const ALL: [Self; 7] = [
        Self::Vehicle,
        Self::Mapper,
        Self::Gateway,
        Self::Viewer,
        Self::Operator,
        Self::Admin,
        Self::Replica,
    ];

    /// Its name in certificates, token files and messages.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Vehicle => "vehicle",
            Self::Mapper => "mapper",
            Self::Gateway => "gateway",
            Self::Viewer => "viewer",
            Self::Operator => "operator",
            Self::Admin => "admin",
            Self::Replica => "replica",
        }
    }

    /// Whether who has this role may do what takes the other one.
    #[must_use]
    pub fn includes(self, least: Self) -> bool {
        self == least
            || match self {
                Self::Admin => true,
                Self::Gateway => matches!(least, Self::Mapper | Self::Vehicle),
                Self::Mapper => least == Self::Vehicle,
                Self::Operator => least == Self::Viewer,
                Self::Replica => matches!(least, Self::Vehicle | Self::Viewer),
                Self::Vehicle | Self::Viewer => false,
            }
    }
}

impl fmt::Display for Role {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

/// A text that names no role.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is no role; the roles are vehicle, mapper, gateway, viewer, operator, admin and replica")]
pub struct NoRole(String);

impl FromStr for Role {
    type Err = NoRole;

    fn from_str(text: &str) -> Result<Self, NoRole> {
        let named = Self::ALL.into_iter().find(|role| role.name() == text);
        named.ok_or_else(|| NoRole(text.to_owned()))
    }
}

/// Some roles; mostly one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Roles(u8);

impl Roles {
    /// These and another one.
    #[must_use]
    pub fn with(self, role: Role) -> Self {
        Self(self.0 | 1 << role as u8)
    }

    /// Is it none?
    #[must_use]
    pub fn is_empty(self) -> bool {
        self.0 == 0
    }

    /// Is the role itself among these?
    #[must_use]
    pub fn contain(self, role: Role) -> bool {
        self.0 & 1 << role as u8 != 0
    }

    /// Whether one of them includes the role.
    #[must_use]
    pub fn include(self, least: Role) -> bool {
        self.iter().any(|role| role.includes(least))
    }

    /// One after the other.
    pub fn iter(self) -> impl Iterator<Item = Role> {
        Role::ALL.into_iter().filter(move |role| self.contain(*role))
    }
}

impl From<Role> for Roles {
    fn from(role: Role) -> Self {
        Self::default().with(role)
    }
}

impl FromStr for Roles {
    type Err = NoRole;

    /// Of `mapper` or `mapper,viewer`.
    fn from_str(text: &str) -> Result<Self, NoRole> {
        text.split(',').map(str::trim).try_fold(Self::default(), |roles, name| Ok(roles.with(name.parse()?)))
    }
}

impl fmt::Display for Roles {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (at, role) in self.iter().enumerate() {
            write!(f, "{}{role}", if at > 0 { "," } else { "" })?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a role that may do what was not granted to it.
    #[test]
    fn each_role_includes_these_and_no_others() {
        let includes =
            |role: Role| Role::ALL.into_iter().filter(move |least| role.includes(*least)).map(Role::name);
        let list = |role| includes(role).collect::<Vec<_>>().join(" ");
        assert_eq!(list(Role::Vehicle), "vehicle");
        assert_eq!(list(Role::Mapper), "vehicle mapper");
        assert_eq!(list(Role::Gateway), "vehicle mapper gateway");
        assert_eq!(list(Role::Viewer), "viewer");
        assert_eq!(list(Role::Operator), "viewer operator");
        assert_eq!(list(Role::Replica), "vehicle viewer replica");
        assert_eq!(includes(Role::Admin).count(), Role::ALL.len());
    }

    #[test]
    fn roles_are_written_as_they_are_read() {
        for text in ["mapper", "vehicle,operator"] {
            assert_eq!(text.parse::<Roles>().unwrap().to_string(), text);
        }
        for bad in ["", "root", "mapper;viewer", "Mapper", "mapper,"] {
            assert!(bad.parse::<Roles>().is_err(), "{bad}");
        }
        assert!("mapper,viewer".parse::<Roles>().unwrap().include(Role::Vehicle));
    }
}
