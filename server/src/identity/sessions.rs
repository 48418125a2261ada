//! Browsers that have signed in. A session stands for the token that began it, and ends with it; it is kept in memory only.

use std::time::{Duration, Instant};

use super::caller::Caller;
use super::kept::Kept;
use super::tokens::{TokenHash, hash_of, hex};

/// The cookie that holds a session's id.
pub const COOKIE: &str = "echofix_session";
/// A session lasts no longer than a working day.
pub(super) const LASTS: Duration = Duration::from_hours(12);
/// Sessions at once, at most, and those of one caller.
const MOST: usize = 4096;
const EACH: usize = 64;

pub(super) struct Sessions(Kept<Basis>);

/// What a session stands for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Basis {
    /// A token of the file, which is looked up again.
    Token(TokenHash),
    /// Whom an issuer's token named, for as long as that says.
    Jwt(Caller),
}

impl Default for Sessions {
    fn default() -> Self {
        Self(Kept::new(MOST, EACH, LASTS))
    }
}

impl Sessions {
    /// Begins one of a caller; returns its id, which is known to nobody else.
    pub(super) fn begin(&self, caller: &str, basis: Basis, now: Instant) -> Result<String, getrandom::Error> {
        self.0.put(caller, basis, now)
    }

    /// What a session rests on.
    pub(super) fn basis(&self, id: &str, now: Instant) -> Option<Basis> {
        self.0.get(id, now)
    }

    /// Ends one.
    pub(super) fn end(&self, id: &str) {
        self.0.take(id, Instant::now());
    }
}

/// What a page must bring with each change that it makes in a session. A page of another site may have the browser send the
/// session's cookie; it cannot read this. It tells nothing of the session's id.
pub(super) fn page_token(id: &str) -> String {
    hex(&hash_of(&format!("echofix page token {id}")))
}
