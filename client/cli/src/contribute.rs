//! A drive goes to the map, through the vehicle's own recorder, spool and uploader.

use std::fmt;
use std::path::Path;
use std::time::Duration;

use anyhow::{Context, bail};
use echofix_client::drivelog::{DriveEvent, replay};
use echofix_client::service::ServiceAddress;
use echofix_client::upload::spool::{Spool, SpoolLimits};
use echofix_client::upload::{Recorder, RecorderConfig, Uploader, UploaderOptions};
use echofix_core::drive::Drive;
use echofix_core::gate::Dropped;
use indicatif::ProgressBar;
use serde::Serialize;

/// How long the service may take over the last uploads.
const PATIENCE: Duration = Duration::from_mins(5);

/// Detections that the vehicle left out, by the reason.
#[derive(Debug, Clone, Copy, Default, Serialize)]
pub struct LeftOut {
    /// Movers, by their radial speed.
    pub moving: u64,
    /// Farther than the maximum range.
    pub too_far: u64,
    /// Taken below the minimum speed.
    pub too_slow: u64,
    /// Taken from no pose, or from one that is not known well enough.
    pub without_pose: u64,
}

impl From<Dropped> for LeftOut {
    fn from(dropped: Dropped) -> Self {
        let Dropped { too_slow, too_far, moving, without_pose } = dropped;
        Self { moving, too_far, too_slow, without_pose }
    }
}

impl fmt::Display for LeftOut {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { moving, too_far, too_slow, without_pose } = self;
        write!(
            f,
            "{moving} moving, {too_far} too far, {too_slow} taken too slowly, {without_pose} without a good pose"
        )
    }
}

/// What came of a drive's uploads.
#[derive(Debug, Clone, Default, Serialize)]
pub struct Contributed {
    /// Uploads acknowledged.
    pub uploads: u64,
    /// Of those, uploads that the service already had.
    pub duplicates: u64,
    /// Uploads the service refused for good; they stay in the spool's `refused/`.
    pub refused: u64,
    /// Detections recorded.
    pub detections: u64,
    /// Bytes of the uploads on the wire.
    pub bytes: u64,
    /// Detections left out.
    pub left_out: LeftOut,
}

/// How simulated drives are recorded: to their very ends, for nobody lives there.
#[must_use]
pub fn simulated() -> RecorderConfig {
    RecorderConfig { trim_ends_m: 0.0, ..RecorderConfig::default() }
}

/// Uploads a drive and waits until the service has it.
///
/// # Errors
/// When the drive has no reference poses, or the service does not take the uploads in time.
pub async fn upload(
    drive: &Drive,
    server: &str,
    spool: &Path,
    config: RecorderConfig,
    bar: &ProgressBar,
) -> anyhow::Result<Contributed> {
    if drive.reference.is_empty() {
        bail!(
            "the drive of `{}` has no reference poses; a map can only be made from known poses",
            drive.vehicle
        );
    }
    let spool = Spool::open(spool, SpoolLimits::default()).context("opening the upload spool")?;
    let uploader = Uploader::start(ServiceAddress::at(server).endpoint()?, spool, UploaderOptions::default());
    let mut recorder = Recorder::new(config, &drive.vehicle, drive.mounts.clone())?;
    let mut done = Contributed::default();
    let mut submitted = Vec::new();
    for event in replay(drive) {
        let upload = match event {
            DriveEvent::Odometry(time_us, pose) => {
                recorder.push_odometry(time_us, pose)?;
                None
            }
            DriveEvent::Reference(pose) => recorder.push_pose(*pose)?,
            DriveEvent::Scan(scan) => {
                recorder.push_scan(scan.clone())?;
                None
            }
            DriveEvent::Truth(_) => None,
        };
        submitted.extend(upload);
    }
    done.left_out = recorder.dropped().into();
    submitted.extend(recorder.finish());
    bar.inc_length(submitted.len() as u64);
    for upload in submitted {
        done.detections += upload.detections() as u64;
        done.bytes += upload.bytes() as u64;
        uploader.submit(upload).await?;
        bar.inc(1);
    }
    uploader.flush(PATIENCE).await?;
    let progress = uploader.progress();
    uploader.close().await;
    (done.uploads, done.duplicates, done.refused) = (progress.sent, progress.duplicates, progress.refused);
    if done.uploads == 0 {
        match progress.last_error {
            Some(reason) => bail!("the service refused every upload of `{}`: {reason}", drive.vehicle),
            None => bail!(
                "nothing of the drive of `{}` can be mapped; left out: {}",
                drive.vehicle,
                done.left_out
            ),
        }
    }
    Ok(done)
}
