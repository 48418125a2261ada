//! What the operators' port answers.

use std::time::Duration;

use anyhow::Context;
use serde_json::Value;

use crate::credentials::Credentials;

/// The JSON that a path of the service's HTTP port answers with. Blocks for at most 10 s.
///
/// # Errors
/// When the service is out of reach or answers with something else.
pub fn get_json(http: &str, path: &str) -> anyhow::Result<Value> {
    get_json_as(&Credentials::default(), http, path)
}

/// The same as somebody whom the service knows.
///
/// # Errors
/// When the service is out of reach or answers with something else.
pub fn get_json_as(credentials: &Credentials, http: &str, path: &str) -> anyhow::Result<Value> {
    let url = format!("{}{path}", http.trim_end_matches('/'));
    let agent = credentials.agent(&url, Duration::from_secs(10))?;
    let mut answer = agent.get(&url).call().with_context(|| {
        format!("no service answers at {url}; is it running there? Start one with `echofix serve`")
    })?;
    answer.body_mut().read_json().with_context(|| format!("{url} did not answer with JSON"))
}
