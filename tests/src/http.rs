//! What the operators' port answers.

use std::io::{BufRead, BufReader};
use std::time::Duration;

use serde_json::Value;
use ureq::Agent;

/// An answer, whatever its status.
#[derive(Debug)]
pub struct Answer {
    /// The HTTP status.
    pub status: u16,
    headers: Vec<(String, String)>,
    /// The body.
    pub body: Vec<u8>,
}

impl Answer {
    /// A header's value.
    pub fn header(&self, name: &str) -> Option<&str> {
        let found = self.headers.iter().find(|(key, _)| key.eq_ignore_ascii_case(name));
        found.map(|(_, value)| value.as_str())
    }

    /// The body as text.
    pub fn text(&self) -> &str {
        std::str::from_utf8(&self.body).expect("the body is UTF-8")
    }

    /// The body as JSON.
    pub fn json(&self) -> Value {
        serde_json::from_slice(&self.body)
            .unwrap_or_else(|error| panic!("not JSON ({error}): {}", self.text()))
    }
}

/// `GET url`; fails the test when nobody answers.
pub fn get(url: &str) -> Answer {
    get_with(url, &[])
}

/// The same with headers.
pub fn get_with(url: &str, headers: &[(&str, &str)]) -> Answer {
    fetch(url, headers).unwrap_or_else(|error| panic!("no answer from {url}: {error}"))
}

/// `GET url`; `None` when nobody answers.
pub fn try_get(url: &str) -> Option<Answer> {
    fetch(url, &[]).ok()
}

/// `POST url` with JSON; fails the test when nobody answers.
pub fn post(url: &str, body: &Value) -> Answer {
    let request = agent(Duration::from_secs(20)).post(url).header("content-type", "application/json");
    let answer = request.send(body.to_string()).and_then(answer);
    answer.unwrap_or_else(|error| panic!("no answer from {url}: {error}"))
}

/// A request without a body, by any method; fails the test when nobody answers.
pub fn send(method: &str, url: &str, headers: &[(&str, &str)]) -> Answer {
    let mut request = ureq::http::Request::builder().method(method).uri(url);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    let sent =
        agent(Duration::from_secs(20)).run(request.body(()).expect("it is a request")).and_then(answer);
    sent.unwrap_or_else(|error| panic!("no answer from {url}: {error}"))
}

fn fetch(url: &str, headers: &[(&str, &str)]) -> Result<Answer, ureq::Error> {
    let mut request = agent(Duration::from_secs(20)).get(url);
    for (name, value) in headers {
        request = request.header(*name, *value);
    }
    answer(request.call()?)
}

fn answer(mut response: ureq::http::Response<ureq::Body>) -> Result<Answer, ureq::Error> {
    let headers = response.headers().iter();
    let headers = headers.map(|(k, v)| (k.to_string(), String::from_utf8_lossy(v.as_bytes()).into_owned()));
    let headers = headers.collect();
    Ok(Answer { status: response.status().as_u16(), headers, body: response.body_mut().read_to_vec()? })
}

/// An answer is an answer: 304, 404 and 503 too.
fn agent(patience: Duration) -> Agent {
    Agent::config_builder().timeout_global(Some(patience)).http_status_as_error(false).build().into()
}

/// A metric's value in an OpenMetrics text, its labels written as they are rendered; 0 when it is
/// not there, as a counter before its first event.
pub fn metric(text: &str, name_and_labels: &str) -> f64 {
    let value = text.lines().find_map(|line| line.strip_prefix(name_and_labels)?.strip_prefix(' '));
    value.map_or(0.0, |value| value.trim().parse().expect("a metric is a number"))
}

/// An open stream of server-sent events.
pub struct Events {
    lines: Box<dyn BufRead + Send>,
    /// The id of the last event that was read; empty before the first.
    pub id: String,
}

impl Events {
    /// Listens; an event must come within `patience` of the start.
    pub fn listen(url: &str, patience: Duration) -> Self {
        Self::of(agent(patience).get(url), url)
    }

    /// The same for one who was told the event of an id before.
    pub fn resume(url: &str, id: &str, patience: Duration) -> Self {
        Self::of(agent(patience).get(url).header("last-event-id", id), url)
    }

    fn of(request: ureq::RequestBuilder<ureq::typestate::WithoutBody>, url: &str) -> Self {
        let response = request.call().unwrap_or_else(|error| panic!("no {url}: {error}"));
        assert_eq!(response.status(), 200);
        Self { lines: Box::new(BufReader::new(response.into_body().into_reader())), id: String::new() }
    }

    /// The next event of a name.
    pub fn next(&mut self, name: &str) -> Value {
        let (mut event, mut data, mut line) = (String::new(), String::new(), String::new());
        loop {
            line.clear();
            let read =
                self.lines.read_line(&mut line).unwrap_or_else(|e| panic!("no `{name}` event came: {e}"));
            assert!(read > 0, "the stream of events ended before a `{name}` came");
            if let Some(name) = line.strip_prefix("event:") {
                name.trim().clone_into(&mut event);
            } else if let Some(id) = line.strip_prefix("id:") {
                id.trim().clone_into(&mut self.id);
            } else if let Some(text) = line.strip_prefix("data:") {
                text.clone_into(&mut data);
            } else if line.trim().is_empty() && event == name {
                return serde_json::from_str(&data).expect("an event carries JSON");
            }
        }
    }
}
