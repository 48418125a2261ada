//! The last fixes and uploads, and the stream of new ones.

use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;

use axum::extract::rejection::QueryRejection;
use axum::extract::{Extension, Query, State};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use serde_json::json;
use tokio::sync::broadcast::Receiver;
use tokio_stream::wrappers::{BroadcastStream, WatchStream};
use tokio_stream::{Stream, StreamExt};

use super::error::Error;
use super::operations::fresh;
use super::{App, catalog, probes};
use crate::identity::{Caller, Role};
use crate::shares::Peer;

const MAX_LIMIT: usize = 500;
/// How often a listener hears something, at least.
const ALIVE: Duration = Duration::from_secs(2);

/// `?limit=`
#[derive(Deserialize)]
pub struct FeedQuery {
    limit: Option<usize>,
}

impl FeedQuery {
    fn get(&self) -> Result<usize, Error> {
        let limit = self.limit.unwrap_or(100);
        let refusal = || Error::BadRequest(format!("limit is {limit}; expected 1 to {MAX_LIMIT}"));
        (1..=MAX_LIMIT).contains(&limit).then_some(limit).ok_or_else(refusal)
    }
}

type FeedParameters = Result<Query<FeedQuery>, QueryRejection>;

/// `GET /api/v1/fixes`, newest first
pub async fn fixes(State(app): State<Arc<App>>, limit: FeedParameters) -> Result<Response, Error> {
    let mut fixes = app.state.feed.fixes.recent(limit?.get()?);
    fixes.reverse();
    Ok(fresh(json!({ "fixes": fixes })))
}

/// `GET /api/v1/uploads`, newest first
pub async fn uploads(State(app): State<Arc<App>>, limit: FeedParameters) -> Result<Response, Error> {
    let mut uploads = app.state.feed.uploads.recent(limit?.get()?);
    uploads.reverse();
    Ok(fresh(json!({ "uploads": uploads })))
}

/// `GET /api/v1/events`, until the listener leaves or the service drains. Fixes tell where somebody is right now: only
/// operators are told of them.
pub async fn events(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
) -> Result<impl IntoResponse, Error> {
    let permit = app.limiter.listen(peer)?;
    let feed = &app.state.feed;
    let sees_fixes = caller.may(Role::Operator);
    let map =
        WatchStream::new(app.state.store.progress()).map(|now| event("map", &catalog::progress_json(&now)));
    let progress = app.state.store.progress();
    let health = WatchStream::new(app.state.health.follow())
        .map(move |now| event("health", &probes::readiness_json(&now, &progress.borrow())));
    let stream = map
        .merge(health)
        .merge(feed_events("fix", feed.fixes.subscribe()).filter(move |_| sees_fixes))
        .merge(feed_events("upload", feed.uploads.subscribe()))
        .merge(feed_events("quarantine", feed.quarantined.subscribe()))
        .map(Some);
    let end = WatchStream::new(app.state.ending.clone()).filter(|ending| *ending).map(|_| None);
    let stream = stream.merge(end).map_while(move |event| {
        // The permit is returned when the stream ends.
        let _held = &permit;
        event.map(Ok::<_, Infallible>)
    });
    // An event and no comment: a page does not hear comments, and shall notice when nobody speaks any more.
    let alive = KeepAlive::new().interval(ALIVE).event(Event::default().event("alive").data(""));
    let sse = Sse::new(stream).keep_alive(alive);
    Ok(([("x-accel-buffering", "no")], sse))
}

/// Events of a feed; a listener that was too slow gets the number it missed.
fn feed_events<T>(name: &'static str, feed: Receiver<T>) -> impl Stream<Item = Event>
where
    T: Serialize + Clone + Send + 'static,
{
    BroadcastStream::new(feed).map(move |next| match next {
        Ok(item) => event(name, &item),
        Err(tokio_stream::wrappers::errors::BroadcastStreamRecvError::Lagged(missed)) => {
            event("missed", &json!({ "event": name, "count": missed }))
        }
    })
}

fn event(name: &'static str, body: &impl Serialize) -> Event {
    let event = Event::default().event(name);
    // Our own plain structs always have a JSON form; an event without one is sent without a body.
    event.clone().json_data(body).unwrap_or(event)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::testing::{TestSite, a_fix, an_upload, json_of};

    /// Reads the stream until `wanted` was seen.
    async fn read_until(body: axum::body::Body, wanted: &[&str]) -> String {
        let mut stream = body.into_data_stream();
        let mut text = String::new();
        let reading = async {
            while !wanted.iter().all(|w| text.contains(w)) {
                text += std::str::from_utf8(&stream.next().await.unwrap().unwrap()).unwrap();
            }
        };
        tokio::time::timeout(Duration::from_secs(5), reading).await.unwrap();
        text
    }

    #[tokio::test]
    async fn a_published_fix_reaches_the_page() {
        let site = TestSite::default();
        let response = site.get("/api/v1/events").await;
        assert_eq!(response.headers()["content-type"], "text/event-stream");
        site.state.feed.fixes.publish(a_fix());
        site.state.feed.uploads.publish(an_upload());
        let wanted = [
            "event: map",
            "event: fix",
            "\"correction_m\":1.25",
            "event: upload",
            "event: health",
            "starting",
        ];
        read_until(response.into_body(), &wanted).await;
    }

    /// Catches: a page that cannot tell a silent service from a dead one.
    #[tokio::test]
    async fn a_listener_hears_that_the_service_lives() {
        let site = TestSite::default();
        let body = site.get("/api/v1/events").await.into_body();
        read_until(body, &["event: health", "event: alive"]).await;
    }

    #[tokio::test]
    async fn a_new_epoch_is_feed_events() {
        let site = TestSite::default();
        let response = site.get("/api/v1/events").await;
        site.store.publish_epoch(42);
        read_until(response.into_body(), &["\"epoch\":42"]).await;
    }

    #[tokio::test]
    async fn the_stream_ends_when_the_service_drains() {
        let site = TestSite::default();
        let body = site.get("/api/v1/events").await.into_body();
        site.ending.send_replace(true);
        let whole = axum::body::to_bytes(body, 1 << 20);
        tokio::time::timeout(Duration::from_secs(5), whole).await.unwrap().unwrap();
    }

    #[tokio::test]
    async fn lists_are_newest_first_and_limits_checked() {
        let site = TestSite::default();
        for answered_us in [1, 2, 3] {
            site.state.feed.fixes.publish(crate::feed::FixEvent { answered_us, ..a_fix() });
        }
        let body = json_of(site.get("/api/v1/fixes?limit=2").await).await;
        let times: Vec<_> =
            body["fixes"].as_array().unwrap().iter().map(|f| f["answered_us"].clone()).collect();
        assert_eq!(times, [3, 2]);
        for bad in ["0", "501", "many", "-1"] {
            assert_eq!(site.get(&format!("/api/v1/uploads?limit={bad}")).await.status(), 400, "{bad}");
        }
    }
}
