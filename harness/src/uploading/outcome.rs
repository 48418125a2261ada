//! What came of a drive's uploads.

use std::collections::{BTreeSet, HashSet};
use std::path::Path;

use anyhow::bail;
use echofix_client::upload::UploadEvent;
use indicatif::ProgressBar;
use serde::Serialize;

use super::Ended;
use crate::flaws::DriveFlaws;
use crate::recording::LeftOut;

/// The user has had enough.
#[derive(Debug, thiserror::Error)]
#[error("interrupted: {0}")]
pub struct Interrupted(String);

/// An error that came once or more often.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct RepeatedError {
    /// In words.
    pub message: String,
    /// How often.
    pub count: u64,
}

/// What came of uploads of earlier runs, which lay in the spool.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Spooled {
    /// Uploads found.
    pub found: u64,
    /// Of those, acknowledged.
    pub acknowledged: u64,
    /// Of those, refused for good, or damaged on the disk.
    pub lost: u64,
}

/// What is served of the tiles that a drive's uploads lie in.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct Publication {
    /// The tiles.
    pub tiles: u64,
    /// Of those, tiles around which nothing is served yet, because too few contributors have seen the same there.
    pub waiting: u64,
    /// The most contributors that have, in one of those.
    pub contributors: u32,
    /// Contributors that are needed.
    pub needed: u32,
}

/// What came of a drive's uploads.
#[derive(Debug, Clone, PartialEq, Default, Serialize)]
pub struct UploadedDrive {
    /// Uploads that the drive was cut into.
    pub recorded: u64,
    /// Uploads acknowledged.
    pub uploads: u64,
    /// Of those, uploads that the service already had: the drive, or this part of it, was mapped before.
    pub duplicates: u64,
    /// Uploads the service refused for good; they stay in the spool's `refused/`.
    pub refused: u64,
    /// Uploads that could not be sent yet; they stay in the spool.
    pub waiting: u64,
    /// Uploads that were not made, since the service does not want them now.
    pub not_wanted: u64,
    /// Detections recorded.
    pub detections: u64,
    /// The most days by which an upload is older than the map's newest evidence, where that is long.
    pub days_behind_map: u32,
    /// Bytes of the uploads on the wire.
    pub bytes: u64,
    /// What lay in the spool before.
    pub spooled: Spooled,
    /// Errors on the way, each once.
    pub errors: Vec<RepeatedError>,
    /// Detections left out.
    pub left_out: LeftOut,
    /// What seems to be in another convention than the contract's, in words.
    pub findings: Vec<String>,
    /// Records that could not be used.
    pub flaws: DriveFlaws,
    /// What of it is served; none where the service did not fold it in time, or does not tell.
    pub served: Option<Publication>,
    /// The tiles of its acknowledged uploads: EPSG code, x and y.
    #[serde(skip)]
    pub tiles: BTreeSet<(u32, i32, i32)>,
    /// The epoch from which on the map shows all of them.
    #[serde(skip)]
    pub epoch: u64,
    /// Ids of its uploads that were acknowledged.
    #[serde(skip)]
    pub(super) settled: HashSet<String>,
}

impl UploadedDrive {
    /// Counts what became of an upload; `own` are the ids of this drive's.
    pub(super) fn count(&mut self, event: UploadEvent, own: &HashSet<String>, bar: &ProgressBar) {
        match event {
            // What lay in the spool and was recorded again meanwhile is sent twice, and is one upload.
            UploadEvent::Acknowledged(answer) if self.settled.contains(&answer.upload_id) => {}
            UploadEvent::Acknowledged(answer) if own.contains(&answer.upload_id) => {
                let tiles = answer.tiles.iter().filter_map(|contribution| contribution.tile);
                self.tiles.extend(tiles.map(|tile| (tile.epsg, tile.x, tile.y)));
                self.epoch = self.epoch.max(answer.epoch);
                self.settled.insert(answer.upload_id);
                self.uploads += 1;
                self.duplicates += u64::from(answer.duplicate);
                self.days_behind_map = self.days_behind_map.max(answer.days_behind_map);
                bar.inc(1);
            }
            UploadEvent::Acknowledged(_) => self.spooled.acknowledged += 1,
            UploadEvent::Refused { id, reason } => {
                if own.contains(&id.to_string()) {
                    self.refused += 1;
                    bar.inc(1);
                } else {
                    self.spooled.lost += 1;
                }
                self.error(&reason, bar);
            }
            UploadEvent::Damaged { id } => {
                self.spooled.lost += 1;
                self.error(&format!("the spool's file of upload {id} is damaged"), bar);
            }
            UploadEvent::Delayed { error, .. } => self.error(&error, bar),
        }
    }

    /// Tells an error when it comes for the first time, even where no bar is seen.
    fn error(&mut self, message: &str, bar: &ProgressBar) {
        if let Some(error) = self.errors.iter_mut().find(|error| error.message == message) {
            error.count += 1;
        } else {
            bar.suspend(|| eprintln!("{message}"));
            self.errors.push(RepeatedError { message: message.to_owned(), count: 1 });
        }
    }

    /// Why nothing of the drive is on the map.
    pub(super) fn why_nothing(&self) -> String {
        let mut told = vec![format!("left out: {}", self.left_out)];
        told.extend(self.findings.iter().cloned());
        told.extend(self.flaws.lines());
        told.join("; ")
    }

    /// Whether that is a success.
    pub(super) fn judge(&mut self, ended: Ended, vehicle: &str, spool: &Path) -> anyhow::Result<()> {
        self.waiting = self.recorded.saturating_sub(self.uploads + self.refused);
        let (acknowledged, recorded) = (self.uploads, self.recorded);
        let often = self.errors.iter().max_by_key(|error| error.count);
        let last =
            often.map_or_else(String::new, |error| format!("; {} times: {}", error.count, error.message));
        let stay = format!(
            "{acknowledged} of {recorded} uploads of `{vehicle}` are acknowledged; what is not stays in {} and is sent by the next run",
            spool.display()
        );
        match ended {
            Ended::Interrupted => Err(Interrupted(stay).into()),
            Ended::GivenUp => bail!("the service acknowledged nothing for too long: {stay}{last}"),
            Ended::Sent if self.uploads == 0 && recorded > 0 => {
                bail!("the service refused every upload of `{vehicle}`{last}")
            }
            Ended::Sent => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_proto::v1::UploadResponse;
    use uuid::Uuid;

    /// Catches: what lay in the spool counted as the drive's own, a bar that counts what is not acknowledged, and an error that is
    /// told a hundred times.
    #[test]
    fn own_uploads_are_counted_apart_and_errors_once() {
        let (mine, other) = (Uuid::from_u128(1), Uuid::from_u128(2));
        let own = HashSet::from([mine.to_string()]);
        let acknowledged = |id: Uuid, duplicate| {
            UploadEvent::Acknowledged(UploadResponse {
                upload_id: id.to_string(),
                duplicate,
                ..UploadResponse::default()
            })
        };
        let bar = ProgressBar::hidden();
        let mut done = UploadedDrive { recorded: 1, ..UploadedDrive::default() };
        for _ in 0..3 {
            done.count(UploadEvent::Delayed { id: mine, error: "nobody listens".to_owned() }, &own, &bar);
        }
        assert_eq!(bar.position(), 0);
        done.count(acknowledged(other, false), &own, &bar);
        let gone = done.judge(Ended::GivenUp, "car", Path::new("spool")).unwrap_err().to_string();
        assert!(gone.contains("0 of 1") && gone.contains("3 times: nobody listens"), "{gone}");
        done.count(acknowledged(mine, true), &own, &bar);
        done.judge(Ended::Sent, "car", Path::new("spool")).unwrap();
        assert_eq!((done.uploads, done.duplicates, done.waiting, bar.position()), (1, 1, 0, 1));
        assert_eq!(done.spooled, Spooled { found: 0, acknowledged: 1, lost: 0 });
        let refused = UploadEvent::Refused { id: other, reason: "TOO_OLD".to_owned() };
        done.count(refused, &own, &bar);
        assert_eq!((done.spooled.lost, done.refused, done.errors.len()), (1, 0, 2));
    }
}
