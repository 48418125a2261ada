//! From the first redirect to whom the issuer's ID token names.

use std::time::{Duration, Instant};

use base64::Engine;
use base64::engine::general_purpose::URL_SAFE_NO_PAD;
use ring::digest::{SHA256, digest};
use serde::Deserialize;

use super::exchange::{NotExchanged, exchanged};
use super::provider::Provider;
use crate::identity::config::IdentityConfig;
use crate::identity::jwt::{NotTaken, Told, told_by_id_token};
use crate::identity::kept::{Kept, secret};
use crate::shares;

/// How long somebody may take to sign in at the issuer.
pub(in crate::identity) const LASTS: Duration = Duration::from_mins(10);
/// Browsers that sign in at once, at most, and those of one address.
const MOST: usize = 1024;
const EACH: usize = 64;
/// Characters of the issuer's own words that are passed on, at most.
const MAX_WORDS: usize = 200;

/// A browser that was sent to the issuer.
#[derive(Clone)]
struct Flow {
    state: String,
    nonce: String,
    verifier: String,
}

/// What the issuer has the browser bring back.
#[derive(Debug, Default, Deserialize)]
pub struct Answered {
    /// What stands for a token.
    pub code: Option<String>,
    /// What was sent along, to know the answer by.
    pub state: Option<String>,
    /// Why there is no code.
    pub error: Option<String>,
    /// The same for people.
    pub error_description: Option<String>,
    /// Who answers (RFC 9207).
    pub iss: Option<String>,
}

/// Why nobody is signed in.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum NotSignedIn {
    /// It is not configured.
    #[error("nobody signs in at an issuer here: `identity.oidc_issuer` is not set")]
    NotConfigured,
    /// The issuer cannot be asked, or does not answer as issuers do.
    #[error("the issuer cannot be asked: {0}; try again")]
    Issuer(String),
    /// It is not known who that is, or they may nothing.
    #[error("{0}")]
    Refused(String),
}

/// Browsers that sign in, and the issuer they sign in at.
pub(in crate::identity) struct Flows {
    provider: Provider,
    begun: Kept<Flow>,
}

impl Default for Flows {
    fn default() -> Self {
        Self { provider: Provider::default(), begun: Kept::new(MOST, EACH, LASTS) }
    }
}

impl Flows {
    /// Where a browser is sent, and the id that its cookie holds.
    pub(in crate::identity) async fn begin(
        &self,
        config: &IdentityConfig,
        from: shares::Peer,
    ) -> Result<(String, String), NotSignedIn> {
        let known = self.provider.current(config).await.map_err(NotSignedIn::Issuer)?;
        let flow = Flow::drawn().map_err(|error| NotSignedIn::Issuer(error.to_string()))?;
        let mut location = known.authorization.clone();
        location.query_pairs_mut().extend_pairs([
            ("response_type", "code"),
            ("client_id", &config.oidc_client_id),
            ("redirect_uri", &config.oidc_redirect),
            ("scope", &config.oidc_scopes.join(" ")),
            ("state", &flow.state),
            ("nonce", &flow.nonce),
            ("code_challenge", &flow.challenge()),
            ("code_challenge_method", "S256"),
        ]);
        let id = self.begun.put(&from.to_string(), flow, Instant::now());
        let id = id.map_err(|error| NotSignedIn::Issuer(error.to_string()))?;
        Ok((location.into(), id))
    }

    /// Whom the issuer's answer names. A browser has one try: the cookie's id counts no longer, whatever comes of it.
    pub(in crate::identity) async fn finish(
        &self,
        (config, secret): (&IdentityConfig, Option<&str>),
        id: Option<&str>,
        answered: Answered,
    ) -> Result<Told, NotSignedIn> {
        let refused = |why: &str| NotSignedIn::Refused(why.to_owned());
        let id = id.ok_or_else(|| refused("this browser did not begin to sign in here, or too long ago"))?;
        let flow = self.begun.take(id, Instant::now());
        let flow =
            flow.ok_or_else(|| refused("this was used already, or begun too long ago; sign in again"))?;
        if answered.state.as_deref() != Some(&flow.state) {
            return Err(refused("the answer is not to what this browser asked; sign in again"));
        }
        if answered.iss.is_some_and(|iss| iss != config.oidc_issuer) {
            return Err(refused("the answer is of another issuer"));
        }
        if let Some(error) = answered.error {
            let words = answered.error_description.unwrap_or_default();
            return Err(NotSignedIn::Refused(plain(&format!("the issuer refuses: {error} {words}"))));
        }
        let code = answered.code.ok_or_else(|| refused("the issuer's answer holds no code"))?;
        let known = self.provider.current(config).await.map_err(NotSignedIn::Issuer)?;
        let token = exchanged(&known, (config, secret), (&code, &flow.verifier)).await;
        let token = token.map_err(|error| match error {
            NotExchanged::Refused(why) => {
                NotSignedIn::Refused(plain(&format!("the issuer does not take the code: {why}")))
            }
            NotExchanged::Failed(why) => NotSignedIn::Issuer(why),
        })?;
        let told = match told_by_id_token(&token, &known.keys, config, &flow.nonce) {
            // It may be a new one.
            Err(NotTaken::UnknownKey) => {
                let newer = self.provider.not_before(config, Some(Instant::now())).await;
                told_by_id_token(&token, &newer.map_err(NotSignedIn::Issuer)?.keys, config, &flow.nonce)
            }
            told => told,
        };
        told.map_err(|error| NotSignedIn::Refused(format!("the issuer's ID token: {error}")))
    }

    /// Whether the key of a lease is still the issuer's.
    pub(in crate::identity) fn holds(&self, lease: &crate::identity::jwt::Lease, now_s: i64) -> bool {
        self.provider.last().is_some_and(|known| lease.holds(&known.keys, now_s))
    }

    /// Asks the issuer again for its keys: one that it took back ends the sessions that rest on it.
    pub(in crate::identity) async fn refresh(&self, config: &IdentityConfig) -> Result<(), String> {
        if self.provider.last().is_some() {
            self.provider.current(config).await?;
        }
        Ok(())
    }
}

impl Flow {
    fn drawn() -> Result<Self, getrandom::Error> {
        Ok(Self { state: secret()?, nonce: secret()?, verifier: secret()? })
    }

    /// What the issuer holds the verifier against (RFC 7636, S256).
    fn challenge(&self) -> String {
        URL_SAFE_NO_PAD.encode(digest(&SHA256, self.verifier.as_bytes()))
    }
}

/// Somebody else's words, without what is not to be shown.
fn plain(words: &str) -> String {
    let shown = words.trim().chars().filter(|c| c.is_ascii_graphic() || *c == ' ');
    shown.take(MAX_WORDS).collect()
}
