//! `MappingService.Upload`: receive, vet, journal, answer.

use std::sync::Arc;
use std::time::{Duration, Instant};

use echofix_core::evidence::Pass;
use echofix_proto::v1::upload_request::Part;
use echofix_proto::v1::{
    DroppedDetections, TileContribution, UploadChunk, UploadHeader, UploadRequest, UploadResponse,
};
use prost::Message;
use tokio::sync::Semaphore;
use tokio_stream::{Stream, StreamExt};
use tonic::Status;
use uuid::Uuid;

use super::violation::{Violation, require, required};
use super::{blocking, decode, now_us, status, tile_id};
use crate::feed::{Feed, UploadEvent};
use crate::mapping::{self, Chunk, Contributed, MappingConfig, Refusal, Submission};
use crate::metrics::{Metrics, Outcome};
use crate::store::{MapStore, Receipt, Upload};

const DAY_US: i64 = 86_400_000_000;
/// Scans of one upload, at most: some that hold no detections cost few bytes to send.
const MAX_SCANS: usize = 65_536;
/// Poses of one upload, at most.
const MAX_POSES: usize = 262_144;
/// When a vehicle that was turned away should come again.
const RETRY: Duration = Duration::from_secs(2);

/// Accepts contributions to the map.
#[derive(Clone)]
pub struct MappingApi {
    store: Arc<dyn MapStore>,
    feed: Arc<Feed>,
    metrics: Arc<Metrics>,
    config: Arc<MappingConfig>,
    places: Arc<Semaphore>,
    /// The longest silence of a caller.
    stall: Duration,
}

/// An upload whose columns are sound.
struct Received {
    id: Uuid,
    contributor: String,
    day: u16,
    submission: Submission,
}

/// What came of an upload, for the feed.
struct Told {
    response: UploadResponse,
    agreement: Option<f64>,
}

impl MappingApi {
    /// Journals uploads in `store`. A caller that sends nothing for as long as `stall` is given up.
    #[must_use]
    pub fn new(
        store: Arc<dyn MapStore>,
        feed: Arc<Feed>,
        metrics: Arc<Metrics>,
        config: MappingConfig,
        stall: Duration,
    ) -> Self {
        let places = Arc::new(Semaphore::new(config.uploads_at_once));
        Self { store, feed, metrics, config: Arc::new(config), places, stall }
    }

    /// One upload, from its first message to its answer.
    pub(super) async fn receive(
        &self,
        requests: impl Stream<Item = Result<UploadRequest, Status>> + Unpin,
    ) -> Result<UploadResponse, Status> {
        let place = self.places.clone().try_acquire_owned();
        let place = place.map_err(|_| self.shed("too many uploads at once"))?;
        let progress = *self.store.progress().borrow();
        if progress.journaled.saturating_sub(progress.epoch) > self.config.max_unfolded {
            return Err(self.shed("uploads wait to be folded"));
        }
        let received = self.collect(requests).await.inspect_err(|_| self.count("INVALID"))?;
        let began = Instant::now();
        let (id, this) = (received.id, self.clone());
        // Not tied to this call: once begun, it ends, whether or not the caller waits for it.
        let outcome = blocking(move || {
            let outcome = this.count_in(received);
            drop(place);
            outcome
        })
        .await?;
        self.metrics.commit_seconds.observe(began.elapsed().as_secs_f64());
        self.publish(id, &outcome);
        outcome.map(|told| told.response).map_err(|error| error.status())
    }

    /// Reads and decodes all messages. Bounded in bytes, detections and the caller's silence.
    async fn collect(
        &self,
        mut requests: impl Stream<Item = Result<UploadRequest, Status>> + Unpin,
    ) -> Result<Received, Status> {
        let invalid = |violation| status::invalid(&violation);
        let Some(Part::Header(header)) = self.next(&mut requests).await? else {
            return Err(invalid(Violation::new("header", "must be the first message")));
        };
        let reference_time_us = header.reference_time_us;
        let mut received = begin(header).map_err(invalid)?;
        let mounts = received.submission.mounts.len();
        let mut size = Size::default();
        while let Some(part) = self.next(&mut requests).await? {
            let Part::Chunk(chunk) = part else {
                return Err(invalid(Violation::new("header", "must be the first message only")));
            };
            size.add(&chunk);
            size.check(&self.config).map_err(invalid)?;
            let scans = required(chunk.scans, "chunk.scans").map_err(invalid)?;
            let poses = required(chunk.poses, "chunk.poses").map_err(invalid)?;
            same_day(&poses.time_offset_us, "chunk.poses.time_offset_us").map_err(invalid)?;
            same_day(&scans.time_offset_us, "chunk.scans.time_offset_us").map_err(invalid)?;
            received.submission.chunks.push(Chunk {
                poses: decode::geo_poses(&poses, reference_time_us, "chunk.poses").map_err(invalid)?,
                scans: decode::scans(scans, reference_time_us, mounts, "chunk.scans")
                    .map_err(invalid)?
                    .split(),
            });
        }
        require(!received.submission.chunks.is_empty(), "chunk", "is missing; send at least one")
            .map_err(invalid)?;
        Ok(received)
    }

    async fn next(
        &self,
        requests: &mut (impl Stream<Item = Result<UploadRequest, Status>> + Unpin),
    ) -> Result<Option<Part>, Status> {
        let silent = |_| Status::deadline_exceeded("the upload fell silent");
        let Some(request) = tokio::time::timeout(self.stall, requests.next()).await.map_err(silent)? else {
            return Ok(None);
        };
        let part = required(request?.part, "part").map_err(|violation| status::invalid(&violation))?;
        Ok(Some(part))
    }

    /// Vets a received upload and journals it.
    fn count_in(&self, received: Received) -> Result<Told, Error> {
        let Received { id, contributor, day, submission } = received;
        if let Some(receipt) = self.store.counted(id)? {
            return repeated(receipt, None);
        }
        let forget_before = self.oldest_day(day)?;
        let contributed = mapping::contribute(submission, &self.config)?;
        // Only told, never decided by: an upload does not fail for it.
        let agreement = mapping::agreement(&*self.store, &contributed).unwrap_or_else(|error| {
            tracing::warn!(upload = %id, %error, "an upload cannot be compared with the map");
            None
        });
        let response = response(id, &contributed);
        let pass = Pass { day, contributor: self.store.contributor(&contributor) };
        let (contribution, answer) = (contributed.contribution, response.encode_to_vec());
        match self.store.commit(Upload { id, pass, forget_before, contribution, answer })? {
            Receipt::Counted { epoch } => {
                Ok(Told { response: UploadResponse { epoch, ..response }, agreement })
            }
            duplicate @ Receipt::Duplicate { .. } => repeated(duplicate, agreement),
        }
    }

    /// The oldest day still taken, 0 without a limit. An upload of an older one is refused.
    fn oldest_day(&self, day: u16) -> Result<u16, Refusal> {
        let most_days = self.config.max_age_days;
        if most_days == 0 {
            return Ok(0);
        }
        let today = (now_us() / DAY_US) as u16;
        let age_days = today.saturating_sub(day);
        if age_days > most_days {
            return Err(Refusal::TooOld { age_days, most_days });
        }
        Ok(today.saturating_sub(most_days))
    }

    fn shed(&self, message: &str) -> Status {
        self.count("SHED");
        status::overloaded(message, RETRY)
    }

    fn count(&self, outcome: &'static str) {
        self.metrics.uploads.get_or_create(&Outcome { outcome }).inc();
    }

    fn publish(&self, id: Uuid, outcome: &Result<Told, Error>) {
        let word = match outcome {
            Ok(told) if told.response.duplicate => "DUPLICATE",
            Ok(_) => "COUNTED",
            Err(error) => error.reason(),
        };
        self.count(word);
        let nothing = UploadResponse::default();
        let (response, agreement) = match outcome {
            Ok(told) => (&told.response, told.agreement),
            Err(error) => {
                tracing::info!(upload = %id, reason = word, %error, "upload refused");
                (&nothing, None)
            }
        };
        let dropped = response.dropped.unwrap_or_default();
        self.feed.uploads.publish(UploadEvent {
            answered_us: now_us(),
            upload_id: id.to_string(),
            outcome: word.to_owned(),
            detections_counted: response.detections_counted,
            detections_dropped: dropped.too_slow + dropped.too_far + dropped.moving + dropped.without_pose,
            tiles: response.tiles.len(),
            agreement,
        });
    }
}

/// What an upload holds so far.
#[derive(Debug, Default)]
struct Size {
    bytes: usize,
    scans: usize,
    poses: usize,
    detections: usize,
}

impl Size {
    fn add(&mut self, chunk: &UploadChunk) {
        self.bytes += chunk.encoded_len();
        self.scans += chunk.scans.as_ref().map_or(0, |scans| scans.sensor.len());
        self.poses += chunk.poses.as_ref().map_or(0, |poses| poses.time_offset_us.len());
        self.detections += chunk.scans.as_ref().map_or(0, |scans| scans.range_m.len());
    }

    fn check(&self, config: &MappingConfig) -> Result<(), Violation> {
        let limits = [
            ("chunk", self.bytes, config.max_upload_bytes, "bytes"),
            ("chunk.scans", self.scans, MAX_SCANS, "scans"),
            ("chunk.poses", self.poses, MAX_POSES, "poses"),
            ("chunk.scans", self.detections, config.max_upload_detections, "detections"),
        ];
        limits.into_iter().try_for_each(|(field, found, most, what)| {
            require(found <= most, field, &format!("exceeds {most} {what} in all; split the upload"))
        })
    }
}

/// A header's part of an upload.
fn begin(header: UploadHeader) -> Result<Received, Violation> {
    let named = Uuid::try_parse(&header.upload_id);
    let id = named.map_err(|error| Violation::new("header.upload_id", format!("is not a UUID: {error}")))?;
    let length = header.contributor.chars().count();
    require((1..=64).contains(&length), "header.contributor", "must have 1 to 64 characters")?;
    decode::reference_time(header.reference_time_us, "header.reference_time_us")?;
    let tomorrow = now_us() / DAY_US + 1;
    let told = "lies in the future; check the vehicle's clock";
    require(header.reference_time_us / DAY_US <= tomorrow, "header.reference_time_us", told)?;
    let mounts = decode::mounts(&header.mounts, "header.mounts")?;
    let day = (header.reference_time_us / DAY_US) as u16;
    let submission = Submission { mounts, chunks: Vec::new() };
    Ok(Received { id, contributor: header.contributor, day, submission })
}

/// The votes of an upload count for the day of its reference time, so nothing in it may lie far off.
fn same_day(offsets_us: &[i64], field: &str) -> Result<(), Violation> {
    match offsets_us.iter().position(|offset| !(-DAY_US..=DAY_US).contains(offset)) {
        Some(row) => {
            let told = "lies more than 24 h from the upload's reference time; split the upload";
            Err(Violation::new(format!("{field}[{row}]"), told))
        }
        None => Ok(()),
    }
}

/// The answer, without what only the journal knows.
fn response(id: Uuid, contributed: &Contributed) -> UploadResponse {
    let Contributed { contribution, dropped, .. } = contributed;
    let tile = |(id, share): (&_, &echofix_core::evidence::Share)| TileContribution {
        tile: Some(tile_id(*id)),
        cells: share.cells.len() as u32,
        detections: share.cells.iter().map(|cell| cell.hits).sum(),
    };
    UploadResponse {
        upload_id: id.to_string(),
        detections_counted: contribution.detections,
        dropped: Some(DroppedDetections {
            too_slow: dropped.too_slow,
            too_far: dropped.too_far,
            moving: dropped.moving,
            without_pose: dropped.without_pose,
        }),
        tiles: contribution.tiles.iter().map(tile).collect(),
        ..UploadResponse::default()
    }
}

/// The answer that was given the first time.
fn repeated(receipt: Receipt, agreement: Option<f64>) -> Result<Told, Error> {
    let (Receipt::Duplicate { epoch, .. } | Receipt::Counted { epoch }) = receipt;
    let answer = if let Receipt::Duplicate { answer, .. } = receipt { answer } else { Vec::new() };
    let first = UploadResponse::decode(&answer[..])?;
    Ok(Told { response: UploadResponse { duplicate: true, epoch, ..first }, agreement })
}

/// Why an upload was not counted.
#[derive(Debug, thiserror::Error)]
enum Error {
    #[error(transparent)]
    Refused(#[from] Refusal),
    #[error(transparent)]
    Store(#[from] crate::store::Error),
    #[error("the journal holds an answer that cannot be read: {0}")]
    Answer(#[from] prost::DecodeError),
}

impl Error {
    /// One of a fixed set of words.
    fn reason(&self) -> &'static str {
        match self {
            Self::Refused(refusal) => match refusal {
                Refusal::PoseTooUncertain { .. } => "POSE_TOO_UNCERTAIN",
                Refusal::TooSlow { .. } => "TOO_SLOW",
                Refusal::NoDetections { .. } => "NO_DETECTIONS",
                Refusal::Outside(_) => "OUTSIDE_UTM",
                Refusal::TooOld { .. } => "TOO_OLD",
                Refusal::TooManyTiles { .. } | Refusal::Scans(_) | Refusal::Poses(_) => "INVALID",
            },
            Self::Store(_) | Self::Answer(_) => "FAILED",
        }
    }

    fn status(&self) -> Status {
        match self {
            Self::Refused(refusal @ (Refusal::TooManyTiles { .. } | Refusal::Scans(_))) => {
                status::invalid(&Violation::new("chunk.scans", refusal))
            }
            Self::Refused(refusal @ Refusal::Poses(_)) => {
                status::invalid(&Violation::new("chunk.poses", refusal))
            }
            Self::Refused(refusal) => status::refused(self.reason(), refusal, &[]),
            Self::Store(error) => status::store(error),
            Self::Answer(_) => {
                tracing::error!(error = %self, "an upload's first answer is lost");
                Status::internal("stored data cannot be read")
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use echofix_proto::v1::{PoseColumns, Scans, SensorMount};

    use super::*;

    /// The field at fault once `count` such chunks were sent.
    fn refused(chunk: &UploadChunk, count: usize) -> Option<String> {
        let mut size = Size::default();
        (0..count).for_each(|_| size.add(chunk));
        size.check(&MappingConfig::default()).err().map(|violation| violation.field)
    }

    #[test]
    fn scans_and_poses_are_counted_over_all_chunks() {
        let scans = Scans { sensor: vec![0; 16_384], ..Scans::default() };
        let scans = UploadChunk { scans: Some(scans), poses: None };
        assert_eq!(refused(&scans, 4), None);
        assert_eq!(refused(&scans, 5).unwrap(), "chunk.scans");
        let poses = PoseColumns { time_offset_us: vec![0; 65_536], ..PoseColumns::default() };
        let poses = UploadChunk { scans: None, poses: Some(poses) };
        assert_eq!(refused(&poses, 4), None);
        assert_eq!(refused(&poses, 5).unwrap(), "chunk.poses");
    }

    #[test]
    fn times_from_the_future_or_far_from_the_reference_are_named() {
        let after = |days: i64| {
            begin(UploadHeader {
                upload_id: Uuid::nil().to_string(),
                contributor: "car-7".to_owned(),
                reference_time_us: now_us() + days * DAY_US,
                mounts: vec![SensorMount::default()],
            })
        };
        assert!(after(-300).is_ok() && after(0).is_ok());
        let violation = after(3).err().unwrap();
        assert_eq!(violation.field, "header.reference_time_us");
        assert!(violation.description.contains("clock"), "{violation}");
        assert!(same_day(&[-DAY_US, 0, DAY_US], "t").is_ok());
        assert_eq!(same_day(&[0, DAY_US + 1], "t").unwrap_err().field, "t[1]");
        assert_eq!(same_day(&[i64::MIN], "t").unwrap_err().field, "t[0]");
    }
}
