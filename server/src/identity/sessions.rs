//! Browsers that have signed in. A session stands for the token that began it, and ends with it; it is kept in memory only.

use std::collections::HashMap;
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use super::caller::Caller;
use super::tokens::{TokenHash, hash_of, hex};

/// The cookie that holds a session's id.
pub const COOKIE: &str = "echofix_session";
/// A session lasts no longer than a working day.
pub(super) const LASTS: Duration = Duration::from_hours(12);
/// Sessions at once, at most.
const MOST: usize = 4096;

#[derive(Default)]
pub(super) struct Sessions(Mutex<HashMap<TokenHash, Session>>);

/// What a session stands for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum Basis {
    /// A token of the file, which is looked up again.
    Token(TokenHash),
    /// Whom an issuer's token named, for as long as that says.
    Jwt(Caller),
}

struct Session {
    basis: Basis,
    until: Instant,
}

impl Sessions {
    /// Begins one; returns its id, which is known to nobody else. The one that would end first makes room if need be.
    pub(super) fn begin(&self, basis: Basis, now: Instant) -> Result<String, getrandom::Error> {
        let mut random = [0; 32];
        getrandom::fill(&mut random)?;
        let id = hex(&random);
        let mut sessions = self.locked();
        sessions.retain(|_, session| session.until > now);
        if sessions.len() >= MOST {
            let first = sessions.iter().min_by_key(|(_, session)| session.until).map(|(id, _)| *id);
            first.map(|id| sessions.remove(&id));
        }
        sessions.insert(hash_of(&id), Session { basis, until: now + LASTS });
        Ok(id)
    }

    /// What a session rests on.
    pub(super) fn basis(&self, id: &str, now: Instant) -> Option<Basis> {
        let sessions = self.locked();
        let session = sessions.get(&hash_of(id)).filter(|session| session.until > now);
        session.map(|session| session.basis.clone())
    }

    /// Ends one.
    pub(super) fn end(&self, id: &str) {
        self.locked().remove(&hash_of(id));
    }

    fn locked(&self) -> std::sync::MutexGuard<'_, HashMap<TokenHash, Session>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sessions_end_when_they_are_ended_or_in_time_and_are_bounded() {
        let (sessions, now) = (Sessions::default(), Instant::now());
        let id = sessions.begin(Basis::Token([7; 32]), now).unwrap();
        assert_eq!(sessions.basis(&id, now), Some(Basis::Token([7; 32])));
        assert_eq!(sessions.basis(&id[1..], now), None);
        assert_eq!(sessions.basis(&id, now + LASTS), None);
        sessions.end(&id);
        assert_eq!(sessions.basis(&id, now), None);
        let first = sessions.begin(Basis::Token([1; 32]), now).unwrap();
        for _ in 0..MOST {
            sessions.begin(Basis::Token([2; 32]), now + Duration::from_secs(1)).unwrap();
        }
        assert_eq!(sessions.basis(&first, now), None);
        // Not in one expression with the line above: the lock is held to its end.
        assert_eq!(sessions.locked().len(), MOST);
    }
}
