//! `MappingService.Upload`: receive, check, journal, answer.
//!
//! - [`receive`]: the messages, bounded in bytes and detections.
//! - [`evidence`]: what a vehicle gathered itself.

mod evidence;
mod receive;

use std::sync::Arc;
use std::time::{Duration, Instant};

use echofix_core::evidence::Pass;
use echofix_core::evidence::build::{BuildError, BuiltEvidence, build_evidence};
use echofix_core::time::day_of;
use echofix_proto::v1::{DroppedDetections, TileContribution, UploadRequest, UploadResponse};
use prost::Message;
use tokio::sync::Semaphore;
use tokio_stream::Stream;
use tonic::Status;
use uuid::Uuid;

use super::access::Counted;
use super::invalid_field::InvalidField;
use super::{blocking, get_tiles, now_us, status, tile_id};
use crate::export::part;
use crate::feed::{Feed, UploadEvent};
use crate::lanes::Lanes;
use crate::mapping::MappingConfig;
use crate::metrics::{Metrics, OutcomeLabel};
use crate::shares::{Peer, Pool};
use crate::sparse;
use crate::store::{MapStore, Receipt, UploadRecord};
use receive::{ReceivedUpload, UploadBody};

/// When a vehicle that was turned away should come again.
const RETRY: Duration = Duration::from_secs(2);
/// Uploads that are received for each that is worked on.
const RECEIVED_FOR_ONE: usize = 2;

/// Accepts uploads.
#[derive(Clone)]
pub struct MappingApi {
    store: Arc<dyn MapStore>,
    feed: Arc<Feed>,
    metrics: Arc<Metrics>,
    config: Arc<MappingConfig>,
    /// Uploads that are checked and journaled.
    permits: Arc<Semaphore>,
    /// Uploads that are received, at their callers' pace.
    receiving: Arc<Pool>,
    lanes: Lanes,
}

impl MappingApi {
    /// Journals uploads in `store`. Of the places to be received in, one peer may have a share.
    #[must_use]
    pub fn new(
        store: Arc<dyn MapStore>,
        feed: Arc<Feed>,
        metrics: Arc<Metrics>,
        config: MappingConfig,
        (address_share, lanes): (f64, Lanes),
    ) -> Self {
        let permits = Arc::new(Semaphore::new(config.uploads_at_once));
        let receiving = Pool::new(RECEIVED_FOR_ONE * config.uploads_at_once, address_share);
        Self { store, feed, metrics, config: Arc::new(config), permits, receiving, lanes }
    }

    pub(super) fn lanes(&self) -> &Lanes {
        &self.lanes
    }

    /// One upload, from its first message to its answer.
    pub(super) async fn receive(
        &self,
        requests: impl Stream<Item = Result<UploadRequest, Status>> + Unpin,
        peer: Peer,
        caller: &Counted,
    ) -> Result<UploadResponse, Status> {
        let place = self.receiving.take(peer).ok_or_else(|| self.shed("too many uploads at once"))?;
        let progress = *self.store.progress().borrow();
        if progress.journaled.saturating_sub(progress.epoch) > self.config.max_unfolded {
            return Err(self.shed("uploads wait to be folded"));
        }
        let received = receive::all(requests, &self.config, caller).await;
        let received = received.inspect_err(|_| self.count("INVALID"))?;
        let began = Instant::now();
        // Only now: it is held for as long as work takes, whatever the caller does.
        let permit = self.permits.clone().acquire_owned().await.map_err(|_| status::gone())?;
        let (id, this) = (received.id, self.clone());
        // Not tied to this call: once begun, it ends, whether or not the caller waits for it.
        let outcome = blocking(move || {
            let mut outcome = this.validate_and_commit(received);
            if let Ok(response) = &mut outcome {
                this.tell_demand(response);
            }
            drop((permit, place));
            outcome
        })
        .await?;
        self.metrics.commit_seconds.observe(began.elapsed().as_secs_f64());
        self.publish(id, &outcome);
        outcome.map_err(|error| error.status())
    }

    /// Checks a received upload and journals it.
    fn validate_and_commit(&self, received: ReceivedUpload) -> Result<UploadResponse, Error> {
        let ReceivedUpload { id, contributor, day, told, body } = received;
        if let Some(receipt) = self.store.counted(id)? {
            return repeated(receipt);
        }
        let forget_before = self.oldest_day(day)?;
        let contributed = match body {
            UploadBody::Scans(submission) => build_evidence(submission, &self.config.limits())?,
            UploadBody::Evidence(evidence) => evidence.checked(&self.config)?,
        };
        if let Some(finding) = told.refused(contributed.delta.detections) {
            return Err(BuildError::MostlyMoving(finding).into());
        }
        let response = UploadResponse {
            days_behind_map: self.days_behind(day),
            ..response(id, &contributed, &told.dropped)
        };
        let pass = Pass { day, contributor: self.store.contributor(&contributor) };
        let (contribution, answer) = (contributed.delta, response.encode_to_vec());
        let declared = Some(contributed.sigma);
        let record = UploadRecord { id, pass, forget_before, declared, contribution, answer };
        match part!("journal").in_scope(|| self.store.commit(record))? {
            Receipt::Counted { epoch } => {
                tracing::debug!(epoch, "upload counted");
                Ok(UploadResponse { epoch, ..response })
            }
            duplicate @ Receipt::Duplicate { .. } => repeated(duplicate),
        }
    }

    /// Says of each tile when the next upload of it is wanted. It is not journaled: what is repeated is what is wanted by then.
    fn tell_demand(&self, response: &mut UploadResponse) {
        let policy = self.config.demand();
        if policy.enough_passes == 0 {
            return;
        }
        for contribution in &mut response.tiles {
            let id = contribution.tile.as_ref().and_then(|tile| get_tiles::id(tile, "tile").ok());
            // What cannot be read now is wanted.
            let tile = id.and_then(|id| self.store.tile(id).ok().flatten());
            contribution.wanted_from_day =
                u32::from(policy.wanted_from(tile.as_ref().map(|stored| &*stored.tile)));
        }
    }

    /// By how many days an upload is older than the map's newest evidence, where that is long; else 0.
    fn days_behind(&self, day: u16) -> u32 {
        let behind = u32::from(self.store.totals().newest_day.saturating_sub(day));
        if behind >= LONG_BEHIND_DAYS { behind } else { 0 }
    }

    /// The oldest day still taken, 0 without a limit. An upload of an older one is refused.
    fn oldest_day(&self, day: u16) -> Result<u16, Error> {
        let most_days = self.config.max_age_days;
        if most_days == 0 {
            return Ok(0);
        }
        let today = day_of(now_us());
        let age_days = today.saturating_sub(day);
        if age_days > most_days {
            return Err(Error::TooOld { age_days, most_days });
        }
        Ok(today.saturating_sub(most_days))
    }

    fn shed(&self, message: &str) -> Status {
        self.count("SHED");
        status::overloaded(message, RETRY)
    }

    fn count(&self, outcome: &'static str) {
        self.metrics.uploads.get_or_create(&OutcomeLabel { outcome }).inc();
    }

    fn publish(&self, id: Uuid, outcome: &Result<UploadResponse, Error>) {
        let word = match outcome {
            Ok(response) if response.duplicate => "DUPLICATE",
            Ok(_) => "COUNTED",
            Err(error) => error.reason(),
        };
        self.count(word);
        let nothing = UploadResponse::default();
        let response = match outcome {
            Ok(response) => response,
            Err(error) => {
                if let Some(left_out) = sparse::line(word) {
                    // Not which: from an id can be read when it was made.
                    tracing::info!(reason = word, %error, left_out, "upload refused");
                }
                &nothing
            }
        };
        let dropped = response.dropped.unwrap_or_default();
        self.feed.upload(UploadEvent {
            answered_us: now_us(),
            upload_id: id.to_string(),
            outcome: word.to_owned(),
            detections_counted: response.detections_counted,
            detections_dropped: total(&dropped),
            tiles: response.tiles.len(),
            epoch: response.epoch,
        });
    }
}

/// The answer, without what only the journal knows.
fn response(id: Uuid, contributed: &BuiltEvidence, before: &DroppedDetections) -> UploadResponse {
    let BuiltEvidence { delta: contribution, dropped, .. } = contributed;
    let tile = |(id, evidence): (&_, &echofix_core::evidence::TileEvidence)| TileContribution {
        tile: Some(tile_id(*id)),
        cells: evidence.cells.len() as u32,
        detections: evidence.cells.iter().map(|cell| cell.hits).sum(),
        wanted_from_day: 0,
    };
    UploadResponse {
        upload_id: id.to_string(),
        detections_counted: contribution.detections,
        dropped: Some(DroppedDetections {
            too_slow: dropped.too_slow.saturating_add(before.too_slow),
            too_far: dropped.too_far.saturating_add(before.too_far),
            moving: dropped.moving.saturating_add(before.moving),
            without_pose: dropped.without_pose.saturating_add(before.without_pose),
            off_height: dropped.off_height.saturating_add(before.off_height),
        }),
        tiles: contribution.tiles.iter().map(tile).collect(),
        ..UploadResponse::default()
    }
}

/// Detections that were left out, whatever the reason. A vehicle may have said any number.
fn total(dropped: &DroppedDetections) -> u64 {
    let DroppedDetections { too_slow, too_far, moving, without_pose, off_height } = *dropped;
    [too_far, moving, without_pose, off_height].into_iter().fold(too_slow, u64::saturating_add)
}

/// The answer that was given the first time.
fn repeated(receipt: Receipt) -> Result<UploadResponse, Error> {
    let (Receipt::Duplicate { epoch, .. } | Receipt::Counted { epoch }) = receipt;
    let answer = if let Receipt::Duplicate { answer, .. } = receipt { answer } else { Vec::new() };
    let first = UploadResponse::decode(&answer[..])?;
    Ok(UploadResponse { duplicate: true, epoch, ..first })
}

/// An upload that is older than the map's newest evidence by so many days is told so.
const LONG_BEHIND_DAYS: u32 = 30;

/// Why an upload was not counted.
#[derive(Debug, thiserror::Error)]
enum Error {
    #[error(transparent)]
    Refused(#[from] BuildError),
    #[error("{0}")]
    Evidence(String),
    #[error("the upload is {age_days} days old; at most {most_days} days are taken")]
    TooOld { age_days: u16, most_days: u16 },
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
                BuildError::PoseTooUncertain { .. } => "POSE_TOO_UNCERTAIN",
                BuildError::TooSlow { .. } => "TOO_SLOW",
                BuildError::NoDetections { .. } => "NO_DETECTIONS",
                BuildError::MostlyMoving(_) => "MOSTLY_MOVING",
                BuildError::WrongConvention(_) => "WRONG_CONVENTION",
                BuildError::Outside(_) => "OUTSIDE_UTM",
                BuildError::TooManyTiles { .. } | BuildError::Scans(_) | BuildError::Poses(_) => "INVALID",
            },
            Self::Evidence(_) => "INVALID",
            Self::TooOld { .. } => "TOO_OLD",
            Self::Store(_) | Self::Answer(_) => "FAILED",
        }
    }

    fn status(&self) -> Status {
        match self {
            Self::Refused(refusal @ (BuildError::TooManyTiles { .. } | BuildError::Scans(_))) => {
                status::invalid(&InvalidField::new("chunk.scans", refusal))
            }
            Self::Refused(refusal @ BuildError::Poses(_)) => {
                status::invalid(&InvalidField::new("chunk.poses", refusal))
            }
            Self::Refused(refusal) => status::refused(self.reason(), refusal, &[]),
            Self::Evidence(why) => status::invalid(&InvalidField::new("evidence.contribution", why)),
            Self::TooOld { .. } => status::refused(self.reason(), self, &[]),
            Self::Store(error) => status::store(error),
            Self::Answer(_) => {
                tracing::error!(error = %self, "an upload's first answer is lost");
                status::failed("stored data cannot be read")
            }
        }
    }
}
