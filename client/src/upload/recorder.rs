//! Splits a drive into uploads.

use std::sync::Arc;

use echofix_core::convention::{Finding, Inspection};
use echofix_core::drive::GeoPose;
use echofix_core::drive::segment::usable_segments;
use echofix_core::evidence::build::{BuiltEvidence, Chunk, RawUpload, build_evidence};
use echofix_core::gate::Dropped;
use echofix_core::geo::{self, MetresPerDegree, TileId, Zone, ground_distance_m};
use echofix_core::odometry::{self, Trajectory};
use echofix_core::pose::Pose2;
use echofix_core::scan::slices::slices;
use echofix_core::scan::{self, Mount, Scan};
use echofix_core::time::{DAY_US, day_of};

use super::{Demand, PreparedUpload, RecorderConfig, UploadForm, segment};

/// A vehicle that stays near one position this long has arrived, as far as [`RecorderConfig::trim_ends_m`] goes.
const ARRIVED_AFTER_US: i64 = 120_000_000;

/// Why a measurement is not recorded.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// The service would refuse the name.
    #[error("`{0}` cannot name a contributor; use 1 to 64 characters that stay the same for a vehicle")]
    Contributor(String),
    /// A scan's columns cannot be used.
    #[error(transparent)]
    Scan(#[from] scan::Error),
    /// An odometry pose cannot be used.
    #[error(transparent)]
    Odometry(#[from] odometry::Error),
    /// A scan of a radar the vehicle does not have.
    #[error("a scan names sensor {sensor}, but the vehicle has {mounts}; sensors count from 0")]
    UnknownSensor {
        /// The sensor named.
        sensor: usize,
        /// Sensors there are.
        mounts: usize,
    },
    /// A measurement that comes after the upload of its time has ended.
    #[error("the measurement at {time_us} us came after the drive was cut at {cut_us} us")]
    TooLate {
        /// The measurement's time.
        time_us: i64,
        /// When the last upload ended.
        cut_us: i64,
    },
    /// A pose that is not finite, or whose errors are negative.
    #[error("the pose at {time_us} us is not finite or its sigma is negative; leave such poses out")]
    NotAPose {
        /// The pose's time.
        time_us: i64,
    },
    /// A pose that is not on the map.
    #[error(transparent)]
    OffTheMap(#[from] geo::Error),
}

impl Error {
    /// The kind of error as one word, the same in every version.
    #[must_use]
    pub fn reason(&self) -> &'static str {
        match self {
            Self::Contributor(_) => "contributor",
            Self::Scan(error) => error.reason(),
            Self::Odometry(error) => error.reason(),
            Self::NotAPose { .. } => "not_finite",
            Self::UnknownSensor { .. } => "unknown_sensor",
            Self::TooLate { .. } => "too_late",
            Self::OffTheMap(_) => "off_the_map",
        }
    }
}

/// Turns one trip into uploads; no clock, no files.
#[derive(Debug, Clone)]
pub struct Recorder {
    config: RecorderConfig,
    contributor: String,
    mounts: Vec<Mount>,
    /// Poses since the last upload ended (the first with that end), and the metres travelled until each.
    poses: Vec<(GeoPose, f64)>,
    /// Scans since the last upload ended, oldest first.
    scans: Vec<Scan>,
    odometry: Trajectory,
    /// Where the trip began, until it is left behind.
    start: Option<GeoPose>,
    dropped: Dropped,
    /// Of what was left out, what the last upload told.
    told: Dropped,
    inspection: Inspection,
    /// Parts that the trip was cut into so far.
    parts: u64,
    /// What the service wants, where the vehicle keeps to it.
    demand: Option<Arc<Demand>>,
    not_wanted: u64,
}

/// What is known at the end of a trip.
#[derive(Debug, Clone, PartialEq)]
pub struct FinishedTrip {
    /// What was left to upload.
    pub upload: Option<PreparedUpload>,
    /// Detections left out of the whole trip, by the reason.
    pub dropped: Dropped,
    /// What seems to be in another convention than the contract's; show it to whoever installed the vehicle.
    pub findings: Vec<Finding>,
    /// Uploads that were not made, since the service does not want them now.
    pub not_wanted: u64,
}

impl Recorder {
    /// A recorder for one trip of a vehicle under a stable pseudonym.
    ///
    /// # Errors
    /// When the pseudonym has not 1 to 64 characters.
    pub fn new(config: RecorderConfig, contributor: &str, mounts: Vec<Mount>) -> Result<Self, Error> {
        if !(1..=64).contains(&contributor.chars().count()) {
            return Err(Error::Contributor(contributor.to_owned()));
        }
        Ok(Self {
            config,
            contributor: contributor.to_owned(),
            mounts,
            poses: Vec::new(),
            scans: Vec::new(),
            odometry: Trajectory::default(),
            start: None,
            dropped: Dropped::default(),
            told: Dropped::default(),
            inspection: Inspection::default(),
            parts: 0,
            demand: None,
            not_wanted: 0,
        })
    }

    /// Makes no upload of places that the service knows well, until the days on which it wants them again.
    pub fn keep_to(&mut self, demand: Arc<Demand>) {
        self.demand = Some(demand);
    }

    /// Takes a scan, in any order within the allowed lateness.
    ///
    /// # Errors
    /// When the scan is malformed, of an unknown radar or too late.
    pub fn push_scan(&mut self, mut scan: Scan) -> Result<(), Error> {
        scan.validate()?;
        // Not sent: do not hold it.
        scan.rcs_dbsm = Vec::new();
        let (sensor, time_us) = (scan.sensor, scan.time_us);
        if sensor >= self.mounts.len() {
            return Err(Error::UnknownSensor { sensor, mounts: self.mounts.len() });
        }
        if let Some(&(GeoPose { time_us: cut_us, .. }, _)) = self.poses.first()
            && time_us < cut_us
        {
            self.dropped.without_pose += scan.len() as u64;
            return Err(Error::TooLate { time_us, cut_us });
        }
        let cut_us = self.poses.first().map_or(i64::MIN, |(pose, _)| pose.time_us);
        for slice in slices(&(&scan).into()) {
            if slice.time_us < cut_us {
                count_lost(&mut self.dropped, &slice);
                continue;
            }
            let at = self.scans.partition_point(|s| s.time_us <= slice.time_us);
            self.scans.insert(at, slice);
        }
        self.forget_scans_without_poses();
        Ok(())
    }

    /// Takes an odometry pose. Optional: where odometry covers a scan, the velocity that distinguishes
    /// movers from structure is taken from it, for absolute poses jitter.
    ///
    /// # Errors
    /// When the time does not increase or the pose is not finite.
    pub fn push_odometry(&mut self, time_us: i64, pose: Pose2) -> Result<(), Error> {
        self.odometry.push(time_us, pose)?;
        self.inspection.roll(time_us, &pose);
        Ok(())
    }

    /// Takes the next reference pose; returns an upload when one is complete.
    ///
    /// # Errors
    /// When the pose is not newer than the last one, not a pose or not on the map.
    pub fn push_pose(&mut self, pose: GeoPose) -> Result<Option<PreparedUpload>, Error> {
        check(&pose)?;
        self.append(pose)?;
        if self.config.segments().allows(&pose) {
            self.inspection.pass(&pose);
        }
        if let Some(start) = self.start {
            if ground_m(&start, &pose) < self.config.trim_ends_m {
                self.forget_before(self.poses.len() - 1);
                return Ok(None);
            }
            self.start = None;
        }
        let horizon_us = pose.time_us.saturating_sub((self.config.lateness_s * 1e6) as i64);
        let cut = self.last_pose_to_record(horizon_us);
        let ((first, from_m), (last, to_m)) = (self.poses[0], self.poses[cut]);
        if pose.time_us - last.time_us > ARRIVED_AFTER_US + (self.config.lateness_s * 1e6) as i64 {
            let upload = self.cut_at(cut);
            self.forget_before(self.poses.len() - 1);
            self.start = Some(pose);
            return Ok(upload);
        }
        let long_s = (last.time_us - first.time_us) as f64 * 1e-6;
        let complete = long_s >= self.config.cut_after_s || to_m - from_m >= self.config.cut_after_m;
        Ok(if complete { self.cut_at(cut) } else { None })
    }

    /// Ends the trip; returns what is left of it, and what was left out or is wrong in the whole trip. That is
    /// known only now: what the last upload leaves out is gated when it is made.
    #[must_use]
    pub fn finish(mut self) -> FinishedTrip {
        let never_left = self.start.is_some_and(|_| self.config.trim_ends_m > 0.0);
        let last = if self.poses.is_empty() || never_left {
            None
        } else {
            let cut = self.last_pose_to_record(i64::MAX);
            self.cut_at(cut)
        };
        // Beyond the last pose, or of a trip that never left where it began.
        for scan in &self.scans {
            count_lost(&mut self.dropped, scan);
        }
        let (dropped, findings) = (self.dropped, self.inspection.findings());
        FinishedTrip { upload: last, dropped, findings, not_wanted: self.not_wanted }
    }

    /// What seems to be in another convention than the contract's, so far.
    #[must_use]
    pub fn findings(&self) -> Vec<Finding> {
        self.inspection.findings()
    }

    /// Detections left out since the beginning, by the reason.
    #[must_use]
    pub fn dropped(&self) -> Dropped {
        self.dropped
    }

    fn append(&mut self, pose: GeoPose) -> Result<(), Error> {
        let Some((last, until_m)) = self.poses.last() else {
            self.start = Some(pose);
            self.poses.push((pose, 0.0));
            return Ok(());
        };
        let (time_us, cut_us) = (pose.time_us, last.time_us);
        if time_us <= cut_us {
            return Err(Error::TooLate { time_us, cut_us });
        }
        let travelled_m = until_m + ground_m(last, &pose);
        self.poses.push((pose, travelled_m));
        Ok(())
    }

    /// The newest pose up to a time that is not near the end of the trip as far as it is known.
    fn last_pose_to_record(&self, horizon_us: i64) -> usize {
        let Some((end, _)) = self.poses.last() else { return 0 };
        let far = |pose: &GeoPose| ground_m(pose, end) >= self.config.trim_ends_m;
        self.poses.iter().rposition(|(pose, _)| pose.time_us <= horizon_us && far(pose)).unwrap_or(0)
    }

    /// Makes an upload of everything up to a pose, with which the next one begins.
    fn cut_at(&mut self, cut: usize) -> Option<PreparedUpload> {
        let poses: Vec<GeoPose> = self.poses[..=cut].iter().map(|(pose, _)| *pose).collect();
        let (first_us, last_us) = (poses.first()?.time_us, poses.last()?.time_us);
        let mut raw = RawUpload { mounts: self.mounts.clone(), chunks: Vec::new() };
        for segment in usable_segments(&poses, &self.config.segments()) {
            let scans = take_within(&mut self.scans, segment);
            let (mounts, config) = (&self.mounts, &self.config);
            let (dropped, inspection) = (&mut self.dropped, &mut self.inspection);
            let scans = segment::gated(segment, &scans, mounts, &self.odometry, config, dropped, inspection);
            raw.chunks.push(Chunk { poses: segment.to_vec(), scans });
        }
        let number = self.parts;
        self.parts += 1;
        let mut upload = if self.is_misread() { self.withheld(&raw) } else { self.upload_of(raw, first_us) };
        self.forget_before(cut);
        self.scans.retain(|scan| scan.time_us > last_us || count_lost(&mut self.dropped, scan));
        if let Some(upload) = &mut upload {
            // What is told of it is no part of what it is.
            upload.identify(number);
            upload.tell(&self.dropped.since(&self.told), &self.inspection.findings());
        }
        self.told = self.dropped;
        upload
    }

    /// Is something of the whole trip in another convention, whatever a part of it shows? Movers are told, and left to the service.
    fn is_misread(&self) -> bool {
        self.inspection.findings().iter().any(|finding| !matches!(finding, Finding::Moving { .. }))
    }

    /// Counts the detections of a part that is not sent.
    fn withheld(&mut self, raw: &RawUpload) -> Option<PreparedUpload> {
        raw.chunks.iter().flat_map(|chunk| &chunk.scans).for_each(|scan| {
            count_lost(&mut self.dropped, scan);
        });
        None
    }

    /// The upload in the form that is sent; `None` when nothing is left to map.
    fn upload_of(&mut self, raw: RawUpload, first_us: i64) -> Option<PreparedUpload> {
        let mut upload = match self.config.form {
            UploadForm::Scans => PreparedUpload::start(&self.contributor, &self.mounts, first_us),
            // Evidence shows the day only.
            UploadForm::Evidence => {
                PreparedUpload::start(&self.contributor, &[], first_us - first_us.rem_euclid(DAY_US))
            }
        };
        if self.config.form == UploadForm::Scans {
            for Chunk { poses, scans } in &raw.chunks {
                upload.add(poses, scans);
            }
            let way = raw.chunks.iter().flat_map(|chunk| &chunk.poses);
            let tiles = way.filter_map(|pose| Some((TileId::at(pose.at).ok()?, 1)));
            return (upload.detections() > 0 && self.is_wanted(tiles, first_us)).then_some(upload);
        }
        let poses = raw.chunks.iter().flat_map(|chunk| &chunk.poses);
        let sigmas = poses
            .fold([0.0_f64; 2], |[p, y], pose| [p.max(pose.sigma_position_m), y.max(pose.sigma_yaw_rad)]);
        match build_evidence(raw, &self.config.evidence()) {
            Ok(BuiltEvidence { delta, dropped, .. }) => {
                self.dropped.add(&dropped);
                upload.add_evidence(&delta, sigmas);
                let tiles = delta.tiles.iter().map(|(id, evidence)| (*id, evidence.detections()));
                self.is_wanted(tiles, first_us).then_some(upload)
            }
            // Poses were checked as they came: what fails here has nothing to map.
            Err(reason) => {
                tracing::debug!(%reason, "a part of the drive maps nothing");
                None
            }
        }
    }

    /// Is an upload wanted on its day? Counted, if not.
    fn is_wanted(&mut self, tiles: impl Iterator<Item = (TileId, u64)>, first_us: i64) -> bool {
        let wanted = self.demand.as_ref().is_none_or(|demand| demand.wants(tiles, day_of(first_us)));
        self.not_wanted += u64::from(!wanted);
        wanted
    }

    /// Forgets poses before one, and what came before it.
    fn forget_before(&mut self, cut: usize) {
        self.poses.drain(..cut);
        let Some(&(GeoPose { time_us, .. }, _)) = self.poses.first() else { return };
        self.scans.retain(|scan| scan.time_us >= time_us || count_lost(&mut self.dropped, scan));
        self.odometry.trim_before(time_us);
    }

    /// Without reference poses no upload ends: scans must not pile up.
    fn forget_scans_without_poses(&mut self) {
        let Some(newest_us) = self.scans.last().map(|s| s.time_us) else { return };
        let patience_us = ((self.config.cut_after_s + self.config.lateness_s) * 1e6) as i64;
        let covered_us = self.poses.last().map_or(i64::MIN, |(pose, _)| pose.time_us);
        let oldest_us = newest_us.saturating_sub(patience_us);
        if self.scans.first().is_some_and(|s| s.time_us < oldest_us && s.time_us > covered_us) {
            self.scans.retain(|scan| scan.time_us >= oldest_us || count_lost(&mut self.dropped, scan));
            self.odometry.trim_before(oldest_us);
        }
    }
}

/// Counts a scan's detections as lost; always false, for use in `retain`.
fn count_lost(dropped: &mut Dropped, scan: &Scan) -> bool {
    dropped.without_pose += scan.len() as u64;
    false
}

/// Takes the scans within a segment's time out of the others.
fn take_within(scans: &mut Vec<Scan>, segment: &[GeoPose]) -> Vec<Scan> {
    let (Some(first), Some(last)) = (segment.first(), segment.last()) else { return Vec::new() };
    let from = scans.partition_point(|s| s.time_us < first.time_us);
    let to = scans.partition_point(|s| s.time_us <= last.time_us);
    scans.drain(from..to.max(from)).collect()
}

/// Metres between two poses that are near each other.
fn ground_m(a: &GeoPose, b: &GeoPose) -> f64 {
    ground_distance_m(a.at, b.at, MetresPerDegree::SPHERE)
}

fn check(pose: &GeoPose) -> Result<(), Error> {
    Zone::of(pose.at)?;
    let sigma = |s: f64| s.is_finite() && s >= 0.0;
    let fine = pose.yaw_rad.is_finite() && sigma(pose.sigma_position_m) && sigma(pose.sigma_yaw_rad);
    if fine { Ok(()) } else { Err(Error::NotAPose { time_us: pose.time_us }) }
}

#[cfg(test)]
mod tests;
