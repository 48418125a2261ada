//! The last fixes and uploads, and the stream of new ones.

use std::convert::Infallible;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;

use axum::extract::rejection::QueryRejection;
use axum::extract::{Extension, Query, State};
use axum::http::HeaderMap;
use axum::response::sse::{Event, Sse};
use axum::response::{IntoResponse, Response};
use serde::{Deserialize, Serialize};
use tokio::time::{Instant, interval_at};
use tokio_stream::wrappers::{IntervalStream, WatchStream};
use tokio_stream::{Stream, StreamExt};

use super::answers::{BUSY, ErrorAnswer, FixesAnswer, MissedEvent, UploadsAnswer};
use super::error::Error;
use super::operations::fresh;
use super::{App, catalog, probes};
use crate::event_log::{EventLog, NumberedEvent};
use crate::identity::{Caller, Role};
use crate::shares::Peer;

const MAX_LIMIT: usize = 500;
/// How often a listener hears something, at least.
const ALIVE: Duration = Duration::from_secs(2);

/// `?limit=`
#[derive(Deserialize, utoipa::IntoParams)]
#[into_params(parameter_in = Query)]
pub struct FeedQuery {
    /// How many.
    #[param(minimum = 1, maximum = 500, default = 100)]
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
#[utoipa::path(
    get,
    path = "/api/v1/fixes",
    operation_id = "getFixes",
    tag = "feeds",
    summary = "The last fixes.",
    description = "",
    params(FeedQuery),
    responses(
        (status = 200, description = "Newest first.", body = FixesAnswer),
        (status = 400, description = "A bad limit.", body = ErrorAnswer),
    )
)]
pub async fn fixes(State(app): State<Arc<App>>, limit: FeedParameters) -> Result<Response, Error> {
    let mut fixes = app.state.feed.fixes.recent(limit?.get()?);
    fixes.reverse();
    Ok(fresh(FixesAnswer { fixes }))
}

/// `GET /api/v1/uploads`, newest first
#[utoipa::path(
    get,
    path = "/api/v1/uploads",
    operation_id = "getUploads",
    tag = "feeds",
    summary = "The last uploads.",
    description = "",
    params(FeedQuery),
    responses(
        (status = 200, description = "Newest first.", body = UploadsAnswer),
        (status = 400, description = "A bad limit.", body = ErrorAnswer),
    )
)]
pub async fn uploads(State(app): State<Arc<App>>, limit: FeedParameters) -> Result<Response, Error> {
    let mut uploads = app.state.feed.uploads.recent(limit?.get()?);
    uploads.reverse();
    Ok(fresh(UploadsAnswer { uploads }))
}

/// `GET /api/v1/events`, until the listener leaves or the service drains. Fixes tell where somebody is right now: only
/// operators are told of them, and of who and where in quarantine.
///
/// Every event has an id: that of the last thing that happened before it or with it. A listener that names one as
/// `Last-Event-ID` is told what happened since, or that it cannot be told.
#[utoipa::path(
    get,
    path = "/api/v1/events",
    operation_id = "listen",
    tag = "feeds",
    summary = "What happens from now on, as server-sent events.",
    description = "Events: `fix` (Fix, for operators), `upload` (Upload), `quarantine` (QuarantinedUpload), `map` (Progress), \
        `health` (Readiness), `alive` every two seconds, and `missed` (Missed) for a listener that cannot be told all. `map` and \
        `health` also come with the present state first. Every event has an id.",
    params(("last-event-id" = Option<String>, Header, description = "The last event that was heard: what happened since is told first.")),
    responses(
        (status = 200, description = "The stream, without an end.", body = String, content_type = "text/event-stream"),
        (status = 503, description = BUSY, body = ErrorAnswer),
    )
)]
pub async fn events(
    State(app): State<Arc<App>>,
    peer: Peer,
    Extension(caller): Extension<Arc<Caller>>,
    headers: HeaderMap,
) -> Result<impl IntoResponse, Error> {
    let permit = app.limiter.listen(peer)?;
    let log = Arc::clone(&app.state.feed.events);
    let sees_all = caller.may(Role::Operator);
    let map = WatchStream::new(app.state.store.progress())
        .map(|now| Told::state("map", &catalog::progress_answer(&now)));
    let progress = app.state.store.progress();
    let health = WatchStream::new(app.state.health.follow())
        .map(move |now| Told::state("health", &probes::readiness_answer(&now, &progress.borrow())));
    // An event and no comment: a page does not hear comments, and shall notice when nobody speaks any more.
    let alive = IntervalStream::new(interval_at(Instant::now() + ALIVE, ALIVE)).map(|_| Told::alive());
    let asked = headers.get("last-event-id").map(|id| id.to_str().ok().and_then(|id| log.number(id)));
    let (unknown, mut last) = (asked == Some(None), asked.flatten().unwrap_or_else(|| log.newest()));
    let unknown = unknown.then(|| Told::missed(None, "OTHER_RUN"));
    let listener = tokio_stream::iter(unknown).chain(Listener::after(last, Arc::clone(&log), sees_all));
    let stream = listener.merge(map).merge(health).merge(alive).filter_map(move |told| {
        last = told.number.unwrap_or(last);
        Some(Some(told.event(log.id(last))?))
    });
    // A listener hears something every two seconds, and no more once its token has expired.
    let gate = Arc::clone(&app.gate);
    let stream = stream.map(move |event| event.filter(|_| gate.holds(&caller)));
    let end = WatchStream::new(app.state.ending.clone()).filter(|ending| *ending).map(|_| None);
    let stream = stream.merge(end).map_while(move |event| {
        // The permit is returned when the stream ends.
        let _held = &permit;
        event.map(Ok::<_, Infallible>)
    });
    Ok(([("x-accel-buffering", "no")], Sse::new(stream)))
}

/// What a listener is told.
struct Told {
    kind: &'static str,
    /// Nothing where this listener is not told.
    data: Option<String>,
    /// Of what happened; what only says how things are has none.
    number: Option<u64>,
}

impl Told {
    fn state(kind: &'static str, body: &impl Serialize) -> Self {
        // Our own plain structs always have a JSON form.
        Self { kind, data: serde_json::to_string(body).ok(), number: None }
    }

    fn alive() -> Self {
        Self { kind: "alive", data: Some(String::new()), number: None }
    }

    /// So many events are not told: `TOO_OLD` is no longer kept, `OTHER_RUN` happened before the service was started.
    fn missed(count: Option<u64>, reason: &'static str) -> Self {
        Self::state("missed", &MissedEvent { count, reason })
    }

    fn event(self, id: String) -> Option<Event> {
        Some(Event::default().event(self.kind).id(id).data(self.data?))
    }
}

/// What happens after a number, in order; what is gone before it was told is counted.
struct Listener {
    log: Arc<EventLog>,
    moved: WatchStream<u64>,
    last: u64,
    /// Whether it is told what viewers are not.
    all: bool,
    next: std::vec::IntoIter<Arc<NumberedEvent>>,
}

impl Listener {
    fn after(last: u64, log: Arc<EventLog>, all: bool) -> Self {
        Self { moved: WatchStream::new(log.follow()), log, last, all, next: Vec::new().into_iter() }
    }
}

impl Stream for Listener {
    type Item = Told;

    fn poll_next(mut self: Pin<&mut Self>, context: &mut Context<'_>) -> Poll<Option<Told>> {
        loop {
            if let Some(event) = self.next.next() {
                self.last = event.number;
                let data = if self.all { Some(event.data.clone()) } else { event.for_viewers.clone() };
                let kind = event.kind;
                return Poll::Ready(Some(Told { kind, data, number: Some(event.number) }));
            }
            let (gone, events) = self.log.after(self.last);
            self.next = events.into_iter();
            if gone > 0 {
                self.last += gone;
                let missed = Told { number: Some(self.last), ..Told::missed(Some(gone), "TOO_OLD") };
                return Poll::Ready(Some(missed));
            }
            if self.next.len() > 0 {
                continue;
            }
            match Pin::new(&mut self.moved).poll_next(context) {
                Poll::Ready(Some(_)) => {}
                Poll::Ready(None) => return Poll::Ready(None),
                Poll::Pending => return Poll::Pending,
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::feed::FixEvent;
    use crate::http::testing::{TestSite, a_fix, an_upload, json_of};
    use axum::http::Method;

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

    async fn resumed(site: &TestSite, id: &str, wanted: &[&str]) -> String {
        let answer = site.send(Method::GET, "/api/v1/events", &[("last-event-id", id)]).await;
        read_until(answer.into_body(), wanted).await
    }

    fn fix(answered_us: i64) -> FixEvent {
        FixEvent { answered_us, ..a_fix() }
    }

    /// Catches: an event that a listener missed while it was away, or hears twice, and an event without an id.
    #[tokio::test]
    async fn who_comes_again_is_told_what_was_missed() {
        let site = TestSite::default();
        (101..=103).for_each(|us| site.state.feed.fixes.publish(fix(us)));
        site.state.feed.uploads.publish(an_upload());
        let log = &site.state.feed.events;
        let text =
            resumed(&site, &log.id(1), &["event: upload", "event: map", "event: health", "event: alive"])
                .await;
        assert!(!text.contains("\"answered_us\":101") && !text.contains("event: missed"), "{text}");
        let at = |us: i64| text.find(&format!("\"answered_us\":{us}")).unwrap();
        assert!(at(102) < at(103));
        let blocks: Vec<_> = text.split("\n\n").filter(|block| block.contains("event:")).collect();
        assert!(blocks.iter().all(|block| block.contains("id: ")), "{text}");
        // What says how things are carries the id of what was told before: who resumes from it misses nothing.
        let last = blocks.iter().find(|block| block.contains("event: alive")).unwrap();
        assert!(last.contains(&log.id(4)), "{text}");
    }

    /// Catches: a gap that is passed over in silence: of events that are gone, or of another run of the service.
    #[tokio::test]
    async fn who_cannot_be_told_is_told_that() {
        let site = TestSite::default();
        (0..2_010).for_each(|us| site.state.feed.fixes.publish(fix(us)));
        let gone = resumed(&site, &site.state.feed.events.id(3), &["\"answered_us\":2009"]).await;
        assert!(
            gone.contains(r#"{"count":7,"reason":"TOO_OLD"}"#) && gone.contains("\"answered_us\":10,"),
            "{gone}"
        );
        let other = TestSite::default();
        other.state.feed.uploads.publish(an_upload());
        for id in [&site.state.feed.events.id(1), "1", "", "caf\u{e9}"] {
            let text = resumed(&other, id, &["event: missed", "event: map"]).await;
            assert!(
                text.contains(r#"{"count":null,"reason":"OTHER_RUN"}"#) && !text.contains("event: upload"),
                "{text}"
            );
        }
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
            site.state.feed.fixes.publish(FixEvent { answered_us, ..a_fix() });
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
