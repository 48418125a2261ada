//! The last fixes and uploads, for operators to watch.
//!
//! Kept in memory only, bounded, and without any vehicle's name: a feed, not a record.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use serde::Serialize;
use utoipa::ToSchema;

use crate::event_log::EventLog;

/// Events in memory for a page that opens late.
const RECENT: usize = 500;

/// An answer to a localization request.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Fix)]
pub struct FixEvent {
    /// Microseconds since the Unix epoch at which the service answered.
    pub answered_us: i64,
    /// The status, as the contract names it without the prefix: `USABLE`, `AMBIGUOUS`, ...
    pub status: &'static str,
    /// The sentence that gives the status' reason.
    pub reason: String,
    /// Corrected position, degrees north.
    pub latitude_deg: f64,
    /// Corrected position, degrees east.
    pub longitude_deg: f64,
    /// Corrected heading, radians counter-clockwise from true east.
    pub yaw_rad: f64,
    /// The prior's position, degrees north.
    pub prior_latitude_deg: f64,
    /// The prior's position, degrees east.
    pub prior_longitude_deg: f64,
    /// Distance from the prior, metres.
    pub correction_m: f64,
    /// Fraction of the batch that lies on mapped structure, 0 to 1.
    pub matched_fraction: f64,
    /// Horizontal protection level, metres; absent when not valid.
    #[schema(required)]
    pub protection_m: Option<f64>,
    /// Milliseconds spent aligning.
    pub align_ms: f64,
}

/// An upload that was counted or refused.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = Upload)]
pub struct UploadEvent {
    /// Microseconds since the Unix epoch at which the service answered.
    pub answered_us: i64,
    /// The id that the contributor chose.
    pub upload_id: String,
    /// `COUNTED`, `DUPLICATE` or the reason of the refusal; `QUARANTINED` once vetting kept it out.
    pub outcome: String,
    /// Detections that count.
    pub detections_counted: u64,
    /// Detections left out.
    pub detections_dropped: u64,
    /// Tiles that learn from it.
    pub tiles: usize,
    /// Epoch from which on the map shows it, unless vetting keeps it out: then it is listed under this epoch in
    /// quarantine. 0 when it was refused.
    pub epoch: u64,
}

/// An upload that vetting kept out of the map.
#[derive(Debug, Clone, Serialize, ToSchema)]
#[schema(as = QuarantinedUpload)]
pub struct QuarantineEvent {
    /// Its epoch: the one that the upload was told.
    pub epoch: u64,
    /// The id that the contributor chose; null once it is compacted, and for viewers.
    #[schema(required, format = "uuid")]
    pub upload_id: Option<String>,
    /// Keyed hash of the contributor's pseudonym, 16 hexadecimal digits. It can be revoked by it. Null for viewers.
    #[schema(required)]
    pub contributor: Option<String>,
    /// `SHIFTED`, `ROTATED` or `DISAGREES`.
    #[schema(example = "SHIFTED")]
    pub reason: &'static str,
    /// UTC date of the drive.
    #[schema(format = Date)]
    pub date: String,
    /// Where it lies, for viewers to a hundredth of a degree; null where its zone does not reach.
    #[schema(required)]
    pub place: Option<Place>,
    /// What would move it onto the map; null when it shows something else.
    #[schema(required)]
    pub offset: Option<MapOffset>,
    /// How far it lies beside the map, metres, where that could be measured.
    #[schema(required)]
    pub offset_m: Option<f64>,
}

/// A position, WGS-84.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
pub struct Place {
    /// Degrees north.
    pub lat: f64,
    /// Degrees east.
    pub lon: f64,
}

/// What would move an upload onto the map.
#[derive(Debug, Clone, Copy, Serialize, ToSchema)]
#[schema(as = Offset)]
pub struct MapOffset {
    /// Metres east on the grid.
    pub east_m: f64,
    /// Metres north on the grid.
    pub north_m: f64,
    /// Degrees, counter-clockwise.
    pub yaw_deg: f64,
}

/// What operators watch, and what of it viewers may know: not who was where.
pub trait Watched: Clone + Serialize {
    /// As viewers may know it; nothing where they may not.
    fn for_viewers(&self) -> Option<Self>;
}

impl Watched for FixEvent {
    fn for_viewers(&self) -> Option<Self> {
        None
    }
}

impl Watched for UploadEvent {
    fn for_viewers(&self) -> Option<Self> {
        Some(self.clone())
    }
}

impl Watched for QuarantineEvent {
    fn for_viewers(&self) -> Option<Self> {
        let place = self.place.map(Place::coarse);
        Some(Self { upload_id: None, contributor: None, place, ..self.clone() })
    }
}

impl Place {
    /// To about a kilometre: which part of a town, and not which drive.
    #[must_use]
    pub fn coarse(self) -> Self {
        let hundredth = |degrees: f64| (degrees * 100.0).round() / 100.0;
        Self { lat: hundredth(self.lat), lon: hundredth(self.lon) }
    }
}

/// The last fixes and the last uploads.
pub struct Feed {
    /// Answers to localization requests.
    pub fixes: Channel<FixEvent>,
    /// Uploads that were counted or refused.
    pub uploads: Channel<UploadEvent>,
    /// Uploads that vetting kept out of the map.
    pub quarantined: Channel<QuarantineEvent>,
    /// All of these in the order in which they happened, for those who listen.
    pub events: Arc<EventLog>,
}

impl Default for Feed {
    fn default() -> Self {
        let events: Arc<EventLog> = Arc::default();
        let (fixes, uploads) = (Channel::new("fix", &events), Channel::new("upload", &events));
        Self { fixes, uploads, quarantined: Channel::new("quarantine", &events), events }
    }
}

impl Feed {
    /// An upload was counted or refused. Vetting may have been faster.
    pub fn upload(&self, event: UploadEvent) {
        let epoch = event.epoch;
        self.uploads.publish(event);
        if self.quarantined.remembers(|kept_out| kept_out.epoch == epoch) {
            self.mark_quarantined(epoch);
        }
    }

    /// Vetting kept an upload out, which was counted before or is told of in a moment.
    pub fn quarantine(&self, event: QuarantineEvent) {
        let epoch = event.epoch;
        self.quarantined.publish(event);
        self.mark_quarantined(epoch);
    }

    fn mark_quarantined(&self, epoch: u64) {
        self.uploads.amend(|upload| {
            if upload.epoch == epoch && upload.outcome == "COUNTED" {
                "QUARANTINED".clone_into(&mut upload.outcome);
            }
        });
    }
}

/// A bounded memory of events of a kind, which are told to listeners, too.
pub struct Channel<T> {
    kind: &'static str,
    recent: Mutex<VecDeque<T>>,
    events: Arc<EventLog>,
}

impl<T: Watched> Channel<T> {
    fn new(kind: &'static str, events: &Arc<EventLog>) -> Self {
        Self { kind, recent: Mutex::new(VecDeque::with_capacity(RECENT)), events: Arc::clone(events) }
    }

    /// Adds an event and sends it to the listeners.
    pub fn publish(&self, event: T) {
        let mut recent = self.lock();
        if recent.len() == RECENT {
            recent.pop_front();
        }
        self.events.add(self.kind, &event, event.for_viewers().as_ref());
        recent.push_back(event);
    }

    /// Is there such an event among those that are remembered?
    pub fn remembers(&self, such: impl FnMut(&T) -> bool) -> bool {
        self.lock().iter().any(such)
    }

    /// Changes what is remembered; listeners are told by an event of their own.
    pub fn amend(&self, change: impl FnMut(&mut T)) {
        self.lock().iter_mut().for_each(change);
    }

    /// The newest events, at most `limit`, oldest first.
    pub fn recent(&self, limit: usize) -> Vec<T> {
        let recent = self.lock();
        recent.iter().skip(recent.len().saturating_sub(limit)).cloned().collect()
    }

    fn lock(&self) -> MutexGuard<'_, VecDeque<T>> {
        // A panic while holding the lock leaves a queue that is still a queue.
        self.recent.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    impl Watched for usize {
        fn for_viewers(&self) -> Option<Self> {
            None
        }
    }

    /// Catches: somebody who only looks at the map and is told who drove where.
    #[test]
    fn viewers_are_told_neither_who_nor_where() {
        let place = Some(Place { lat: 30.267_153, lon: -97.743_061 });
        let event = QuarantineEvent {
            epoch: 7,
            upload_id: Some("018f4e3c-0000-7000-8000-000000000000".to_owned()),
            contributor: Some("00000000000000ff".to_owned()),
            reason: "SHIFTED",
            date: "2026-01-01".to_owned(),
            place,
            offset: None,
            offset_m: Some(1.5),
        };
        let feed = Feed::default();
        feed.quarantine(event);
        let (_, events) = feed.events.after(0);
        let told = &events[0];
        for secret in ["018f4e3c", "00000000000000ff", "30.267", "97.743"] {
            assert!(
                told.data.contains(secret) && !told.for_viewers.as_ref().unwrap().contains(secret),
                "{secret}"
            );
        }
        let coarse = told.for_viewers.as_ref().unwrap();
        assert!(
            coarse.contains("30.27") && coarse.contains("-97.74") && coarse.contains("SHIFTED"),
            "{coarse}"
        );
    }

    /// Catches: a quarantined upload that stays "counted", because vetting was faster than the answer.
    #[test]
    fn a_quarantined_upload_is_marked_whichever_comes_first() {
        let feed = Feed::default();
        let upload = |epoch| UploadEvent {
            answered_us: 0,
            upload_id: String::new(),
            outcome: "COUNTED".to_owned(),
            detections_counted: 1,
            detections_dropped: 0,
            tiles: 1,
            epoch,
        };
        let kept_out = |epoch| QuarantineEvent {
            epoch,
            upload_id: None,
            contributor: Some("00000000000000ff".to_owned()),
            reason: "SHIFTED",
            date: "2026-01-01".to_owned(),
            place: None,
            offset: None,
            offset_m: Some(1.5),
        };
        feed.upload(upload(1));
        feed.quarantine(kept_out(1));
        feed.quarantine(kept_out(2));
        feed.upload(upload(2));
        feed.upload(upload(3));
        let outcomes: Vec<_> = feed.uploads.recent(3).into_iter().map(|upload| upload.outcome).collect();
        assert_eq!(outcomes, ["QUARANTINED", "QUARANTINED", "COUNTED"]);
    }

    #[test]
    fn the_memory_is_bounded_and_keeps_the_newest() {
        let channel = Channel::new("number", &Arc::default());
        (0..RECENT + 10).for_each(|i| channel.publish(i));
        assert_eq!(channel.recent(2), [RECENT + 8, RECENT + 9]);
        assert_eq!(channel.recent(usize::MAX).len(), RECENT);
        assert_eq!(channel.events.newest(), RECENT as u64 + 10, "listeners are told of all");
        channel.amend(|event| *event += 1000);
        assert_eq!(channel.recent(1), [RECENT + 1009]);
    }
}
