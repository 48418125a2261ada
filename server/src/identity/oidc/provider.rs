//! The issuer's endpoints and keys, as it publishes them.

use std::sync::Arc;
use std::time::{Duration, Instant};

use arc_swap::ArcSwapOption;
use reqwest::{Client, Url};
use serde::Deserialize;
use tokio::sync::Mutex;

use crate::identity::config::IdentityConfig;
use crate::identity::jwt::{Keys, is_address};
use crate::outgoing::{client, received};

/// Bytes of the issuer's description of itself, at most.
const MAX_BYTES: u64 = 256 << 10;
/// Between two looks, at least, however many browsers come.
const REST: Duration = Duration::from_secs(5);

/// What is known of the issuer.
pub(super) struct Known {
    pub(super) authorization: Url,
    pub(super) token: Url,
    /// Whether the secret goes into the body of a request, for an issuer that takes it nowhere else.
    pub(super) secret_in_body: bool,
    pub(super) client: Client,
    pub(super) keys: Keys,
    at: Instant,
}

/// The part of the issuer's description that counts (`OpenID` Connect Discovery 1.0).
#[derive(Deserialize)]
struct Description {
    issuer: String,
    authorization_endpoint: String,
    token_endpoint: String,
    jwks_uri: String,
    #[serde(default)]
    token_endpoint_auth_methods_supported: Vec<String>,
}

#[derive(Default)]
pub(super) struct Provider {
    known: ArcSwapOption<Known>,
    /// When the issuer was asked last; whoever comes meanwhile waits for the answer.
    asked: Mutex<Option<Instant>>,
}

impl Provider {
    /// What is known, if anything is.
    pub(super) fn last(&self) -> Option<Arc<Known>> {
        self.known.load_full()
    }

    /// What is known, asked for again where it is older than `identity.jwt_refresh_s`.
    pub(super) async fn current(&self, config: &IdentityConfig) -> Result<Arc<Known>, String> {
        let refresh = Duration::from_secs(config.jwt_refresh_s.max(10));
        self.not_before(config, Instant::now().checked_sub(refresh)).await
    }

    /// What is known since a time, asked for again where it is older; but not if it was asked just now.
    pub(super) async fn not_before(
        &self,
        config: &IdentityConfig,
        since: Option<Instant>,
    ) -> Result<Arc<Known>, String> {
        let fresh = |known: &Arc<Known>| since.is_none_or(|since| known.at >= since);
        if let Some(known) = self.last().filter(fresh) {
            return Ok(known);
        }
        let mut asked = self.asked.lock().await;
        if asked.is_some_and(|asked| asked.elapsed() < REST) {
            return self.last().ok_or_else(|| "it did not answer some seconds ago".to_owned());
        }
        *asked = Some(Instant::now());
        let answered = ask(config).await;
        // Whoever waited meanwhile asks no further.
        *asked = Some(Instant::now());
        match answered {
            Ok(known) => {
                let known = Arc::new(known);
                self.known.store(Some(Arc::clone(&known)));
                Ok(known)
            }
            // What was known goes on to count, as the keys of other tokens do.
            Err(error) => self.last().ok_or(error),
        }
    }
}

async fn ask(config: &IdentityConfig) -> Result<Known, String> {
    let client = client(&config.oidc_ca)?;
    let issuer = config.oidc_issuer.as_str();
    let url = format!("{}/.well-known/openid-configuration", issuer.trim_end_matches('/'));
    let described = get(&client, &url).await?;
    let described: Description =
        serde_json::from_slice(&described).map_err(|error| format!("{url}: no description: {error}"))?;
    if described.issuer != issuer {
        return Err(format!("{url} describes another issuer: {:?}", described.issuer));
    }
    let endpoint = |text: &str| {
        let url = Url::parse(text).ok().filter(|_| is_address(text));
        url.ok_or_else(|| format!("{url:?} names {text:?}, which is not encrypted", url = &issuer))
    };
    let (authorization, token) =
        (endpoint(&described.authorization_endpoint)?, endpoint(&described.token_endpoint)?);
    let keys = get(&client, endpoint(&described.jwks_uri)?.as_str()).await?;
    let keys = Keys::read(&keys).map_err(|error| format!("{} {error}", described.jwks_uri))?;
    let methods = described.token_endpoint_auth_methods_supported;
    let takes = |method: &str| methods.iter().any(|taken| taken == method);
    // Without a word it takes it in the header.
    let secret_in_body = takes("client_secret_post") && !takes("client_secret_basic");
    Ok(Known { authorization, token, secret_in_body, client, keys, at: Instant::now() })
}

async fn get(client: &Client, url: &str) -> Result<Vec<u8>, String> {
    let answer = client.get(url).send().await.map_err(|error| format!("{url}: {}", error.without_url()))?;
    if !answer.status().is_success() {
        return Err(format!("{url} answered {}", answer.status()));
    }
    received(answer, MAX_BYTES).await.map_err(|error| format!("{url} {error}"))
}
