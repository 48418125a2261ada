//! A drive becomes uploads, through the vehicle's own recorder.

use std::fmt;
use std::sync::Arc;

use anyhow::bail;
use echofix_client::drivelog::{DriveEvent, replay};
use echofix_client::upload::{Demand, FinishedTrip, PreparedUpload, Recorder, RecorderConfig};
use echofix_core::convention::Finding;
use echofix_core::drive::Drive;
use echofix_core::gate::Dropped;
use serde::Serialize;

use crate::flaws::DriveFlaws;

/// Detections that the vehicle left out, by the reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize)]
pub struct LeftOut {
    /// Movers, by their radial speed.
    pub moving: u64,
    /// Farther than the maximum range.
    pub too_far: u64,
    /// Too low, too high or too steep, by their elevation.
    pub off_height: u64,
    /// Taken below the minimum speed.
    pub too_slow: u64,
    /// Taken from no pose, or from one that is not known well enough.
    pub without_pose: u64,
}

impl From<Dropped> for LeftOut {
    fn from(dropped: Dropped) -> Self {
        let Dropped { too_slow, too_far, off_height, moving, without_pose } = dropped;
        Self { moving, too_far, off_height, too_slow, without_pose }
    }
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { moving, too_far, off_height, too_slow, without_pose } = self;
        write!(
            f,
            "{moving} moving, {too_far} too far, {too_slow} taken too slowly, {without_pose} without a good pose"
        )?;
        if *off_height > 0 { write!(f, ", {off_height} too low or too high") } else { Ok(()) }
    }
}

/// How simulated drives are recorded: to their very ends, since nobody lives there.
#[must_use]
pub fn to_the_ends() -> RecorderConfig {
    RecorderConfig { trim_ends_m: 0.0, ..RecorderConfig::default() }
}

/// The uploads of a drive.
pub struct RecordedDrive {
    /// In order of time.
    pub uploads: Vec<PreparedUpload>,
    /// Detections that are in none of them.
    pub left_out: LeftOut,
    /// What seems to be in another convention than the contract's.
    pub findings: Vec<Finding>,
    /// Measurements that the recorder did not take.
    pub flaws: DriveFlaws,
    /// Uploads that were not made, since the service does not want them now.
    pub not_wanted: u64,
}

/// Records a drive as its vehicle would.
///
/// # Errors
/// When the drive has no reference poses, or no name that the service takes.
pub fn record(drive: &Drive, config: RecorderConfig) -> anyhow::Result<RecordedDrive> {
    record_wanted(drive, config, None)
}

/// The same by a vehicle that keeps to what the service wants, where it knows that.
///
/// # Errors
/// As [`record`].
pub fn record_wanted(
    drive: &Drive,
    config: RecorderConfig,
    demand: Option<&Arc<Demand>>,
) -> anyhow::Result<RecordedDrive> {
    if drive.reference.is_empty() {
        bail!(
            "the drive of `{}` has no reference poses; a map can only be made from known poses",
            drive.vehicle
        );
    }
    let mut recorder = Recorder::new(config, &drive.vehicle, drive.mounts.clone())?;
    if let Some(demand) = demand {
        recorder.keep_to(Arc::clone(demand));
    }
    let (mut uploads, mut flaws) = (Vec::new(), DriveFlaws::default());
    for event in replay(drive) {
        let time_us = event.time_us();
        let (part, taken) = match event {
            DriveEvent::Odometry(_, pose) => ("odometry", recorder.push_odometry(time_us, pose)),
            DriveEvent::Reference(pose) => {
                ("pose", recorder.push_pose(*pose).map(|upload| uploads.extend(upload)))
            }
            DriveEvent::Scan(scan) => ("scan", recorder.push_scan(scan.clone())),
            DriveEvent::Truth(_) => continue,
        };
        if let Err(error) = taken {
            flaws.skip(part, time_us, error.reason(), &error);
        }
    }
    let FinishedTrip { upload, dropped, findings, not_wanted } = recorder.finish();
    uploads.extend(upload);
    Ok(RecordedDrive { uploads, left_out: dropped.into(), findings, flaws, not_wanted })
}
