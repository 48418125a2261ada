//! Why a call is not answered.

use super::role::{Role, Roles};

/// Why a call is not answered.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Refusal {
    /// It is not in the table.
    #[error("nothing is served under this name and method")]
    NotServed,
    /// Nobody knows who asks.
    #[error("{0}")]
    Unauthenticated(String),
    /// It is known who asks, and that is not enough.
    #[error("this takes the role {least}; {name} has {roles}")]
    Forbidden {
        /// The least role that may.
        least: Role,
        /// Who asks.
        name: String,
        /// As what.
        roles: Roles,
    },
    /// A session's change without what its page must bring.
    #[error(
        "a change that is made in a session takes what `GET /session` tells its page as `csrf`, in the header x-echofix-csrf; \
         reload the page"
    )]
    Forged,
}

/// Nobody knows who asks, in words for them.
pub(super) fn refused(why: &str) -> Refusal {
    Refusal::Unauthenticated(why.to_owned())
}
