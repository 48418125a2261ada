//! What the operators' port answers.

use std::time::Duration;

use anyhow::Context;
use serde_json::Value;

/// The JSON that a path of the service's HTTP port answers with. Blocks for at most 10 s.
///
/// # Errors
/// When the service is out of reach or answers with something else.
pub fn get_json(http: &str, path: &str) -> anyhow::Result<Value> {
    let url = format!("{}{path}", http.trim_end_matches('/'));
    let agent: ureq::Agent = ureq::Agent::config_builder()
        .timeout_global(Some(Duration::from_secs(10)))
        // 503 with a reason is an answer, too.
        .http_status_as_error(false)
        .build()
        .into();
    let mut answer = agent.get(&url).call().with_context(|| {
        format!("no service answers at {url}; is it running there? Start one with `echofix serve`")
    })?;
    answer.body_mut().read_json().with_context(|| format!("{url} did not answer with JSON"))
}
