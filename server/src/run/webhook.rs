//! Alarms are sent to a webhook: a bounded queue, tried again for a while, beside all else. Folding never waits for it.

use std::sync::Arc;
use std::time::Duration;

use echofix_core::vetting::alarm::{Alarm, AlarmKind};
use reqwest::header::{AUTHORIZATION, CONTENT_TYPE, HeaderValue};
use reqwest::{Client, StatusCode};
use serde_json::Value;
use tokio::sync::mpsc;

use crate::config::AlarmsConfig;
use crate::metrics::{Metrics, OutcomeLabel};
use crate::outgoing;
use crate::sparse;

/// Messages that wait, at most; more are left out and counted.
const WAITING: usize = 64;
/// How often a message is tried, at most.
const TRIES: u32 = 8;
/// Pauses between tries double up to this.
const LONGEST_PAUSE: Duration = Duration::from_mins(1);

/// Where messages are put; they are sent beside.
#[derive(Clone)]
pub(super) struct Webhook {
    queue: mpsc::Sender<Value>,
    metrics: Arc<Metrics>,
}

/// Where messages go.
struct Destination {
    client: Client,
    url: String,
    secret: Option<HeaderValue>,
    /// The first pause between two tries.
    pause: Duration,
}

impl Webhook {
    /// Sends to where the configuration says, for as long as this or a clone of it is there; nothing without a URL. Runs within
    /// tokio.
    pub(super) fn of(config: &AlarmsConfig, metrics: Arc<Metrics>) -> Option<Self> {
        if config.webhook.is_empty() {
            return None;
        }
        let secret = config.secret().inspect_err(|error| {
            tracing::error!(%error, "the webhook's secret cannot be read: alarms are sent without");
        });
        let client = outgoing::client("")
            .inspect_err(
                |error| tracing::error!(%error, "no alarm can be sent: there is no client for the webhook"),
            )
            .ok()?;
        let secret = secret.ok().flatten();
        let to = Destination { client, url: config.webhook.clone(), secret, pause: Duration::from_secs(1) };
        Some(Self::to(to, metrics))
    }

    fn to(to: Destination, metrics: Arc<Metrics>) -> Self {
        let (queue, waiting) = mpsc::channel(WAITING);
        tokio::spawn(send_all(to, waiting, Arc::clone(&metrics)));
        Self { queue, metrics }
    }

    /// Puts a message into the queue; where that is full it is left out, and counted.
    pub(super) fn put(&self, message: Value) {
        if self.queue.try_send(message).is_err() {
            count(&self.metrics, "dropped");
            if let Some(left_out) = sparse::line("an alarm was not sent: too many wait") {
                tracing::error!(left_out, "an alarm was not sent: too many wait for the webhook");
            }
        }
    }
}

async fn send_all(to: Destination, mut waiting: mpsc::Receiver<Value>, metrics: Arc<Metrics>) {
    while let Some(message) = waiting.recv().await {
        let mut pause = to.pause;
        for left in (0..TRIES).rev() {
            let Err(error) = to.send(&message).await else {
                count(&metrics, "delivered");
                break;
            };
            if left == 0 {
                count(&metrics, "failed");
                tracing::error!(%error, tries = TRIES, "an alarm could not be sent, and is given up");
                break;
            }
            count(&metrics, "retried");
            if let Some(left_out) = sparse::line("an alarm could not be sent") {
                tracing::warn!(%error, left_out, "an alarm could not be sent; trying again");
            }
            tokio::time::sleep(pause).await;
            pause = (2 * pause).min(LONGEST_PAUSE);
        }
    }
}

fn count(metrics: &Metrics, outcome: &'static str) {
    metrics.webhook.get_or_create(&OutcomeLabel { outcome }).inc();
}

/// Why a message did not arrive. The URL may hold a secret and is not told.
#[derive(Debug, thiserror::Error)]
enum NotSent {
    #[error("the webhook answers {0}")]
    Refused(StatusCode),
    #[error("the webhook is not reached: {0}")]
    Unreached(reqwest::Error),
}

impl Destination {
    async fn send(&self, message: &Value) -> Result<(), NotSent> {
        let mut request = self.client.post(&self.url).header(CONTENT_TYPE, "application/json");
        if let Some(secret) = &self.secret {
            request = request.header(AUTHORIZATION, secret.clone());
        }
        let answer = request.body(message.to_string()).send().await;
        let status = answer.map_err(|error| NotSent::Unreached(error.without_url()))?.status();
        if status.is_success() { Ok(()) } else { Err(NotSent::Refused(status)) }
    }
}

/// Alarms that were told, so that each is told once while it lasts.
#[derive(Default)]
pub(super) struct Told(Vec<Alarm>);

impl Told {
    /// Those of all alarms that were not told yet. An alarm is the same while its kind is and its middle stays within so many
    /// metres.
    pub(super) fn new_of(&mut self, alarms: &[Alarm], within_m: f64) -> Vec<Alarm> {
        let shifts = |alarm: &Alarm| matches!(alarm.kind, AlarmKind::Shift(_));
        let same = |a: &Alarm, b: &Alarm| {
            a.zone == b.zone && shifts(a) == shifts(b) && a.position.distance_m(b.position) <= within_m
        };
        let new = alarms.iter().filter(|alarm| !self.0.iter().any(|told| same(told, alarm)));
        let new = new.copied().collect();
        self.0 = alarms.to_vec();
        new
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::sync::Mutex;

    use axum::Router;
    use axum::extract::State;
    use axum::http::HeaderMap;
    use axum::routing::post;
    use echofix_core::geo::Zone;
    use echofix_core::point::MapPoint;
    use serde_json::json;

    type Heard = Arc<Mutex<Vec<(Option<String>, String)>>>;

    /// Fails twice, then takes everything.
    async fn listener(State(heard): State<Heard>, headers: HeaderMap, body: String) -> StatusCode {
        let mut heard = heard.lock().unwrap();
        let secret = headers.get(AUTHORIZATION).map(|value| value.to_str().unwrap().to_owned());
        heard.push((secret, body));
        if heard.len() <= 2 { StatusCode::SERVICE_UNAVAILABLE } else { StatusCode::NO_CONTENT }
    }

    /// Catches: a message that is lost when its receiver is away for a moment, one that comes without its secret, and a queue that
    /// makes who puts something into it wait.
    #[tokio::test]
    async fn messages_arrive_once_the_receiver_takes_them() {
        let heard = Heard::default();
        let port = tokio::net::TcpListener::bind("127.0.0.1:0").await.unwrap();
        let url = format!("http://{}/alarms", port.local_addr().unwrap());
        let routes = Router::new().route("/alarms", post(listener)).with_state(Arc::clone(&heard));
        tokio::spawn(async move { axum::serve(port, routes).await });
        let metrics = Arc::new(Metrics::default());
        let _ = rustls::crypto::ring::default_provider().install_default();
        let secret = Some(HeaderValue::from_static("Bearer s3cret"));
        let to = Destination { client: Client::new(), url, secret, pause: Duration::from_millis(1) };
        let webhook = Webhook::to(to, Arc::clone(&metrics));
        for number in 0..WAITING + 9 {
            webhook.put(json!({ "number": number }));
        }
        let of = |outcome| metrics.webhook.get_or_create(&OutcomeLabel { outcome }).get();
        let deadline = std::time::Instant::now() + Duration::from_secs(30);
        while of("delivered") < WAITING as u64 {
            assert!(std::time::Instant::now() < deadline, "{} delivered", of("delivered"));
            tokio::time::sleep(Duration::from_millis(5)).await;
        }
        assert_eq!((of("retried"), of("dropped"), of("failed")), (2, 9, 0));
        let heard = heard.lock().unwrap();
        assert!(heard.iter().all(|(secret, _)| secret.as_deref() == Some("Bearer s3cret")), "{heard:?}");
        assert!(heard[..3].iter().all(|(_, body)| body == "{\"number\":0}"), "{heard:?}");
    }

    /// Catches: an alarm that is sent with every upload that joins it, and one elsewhere that is not sent.
    #[test]
    fn an_alarm_is_told_once_while_it_lasts() {
        let zone = Zone::from_epsg(32614).unwrap();
        let at = |x_m: f64| Alarm {
            zone,
            position: MapPoint::new(x_m, 0.0),
            kind: AlarmKind::Changed,
            contributors: 3,
            since: 20_000,
        };
        let mut told = Told::default();
        assert_eq!(told.new_of(&[at(0.0)], 100.0).len(), 1);
        assert_eq!(told.new_of(&[at(9.0)], 100.0).len(), 0, "another upload moved its middle");
        assert_eq!(told.new_of(&[at(9.0), at(500.0)], 100.0).len(), 1);
        assert_eq!(told.new_of(&[], 100.0).len(), 0);
        assert_eq!(told.new_of(&[at(9.0)], 100.0).len(), 1, "it had ended");
    }
}
