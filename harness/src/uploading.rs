//! A drive goes to the map, through the vehicle's own recorder, spool and uploader.

use std::path::Path;
use std::time::Duration;

use anyhow::{Context, bail};
use echofix_client::service::{ServiceAddress, ServiceEndpoint};
use echofix_client::upload::spool::{Spool, SpoolLimits};
use echofix_client::upload::{RecorderConfig, Uploader, UploaderOptions};
use echofix_core::drive::Drive;
use indicatif::ProgressBar;
use serde::Serialize;

use crate::recording::{LeftOut, RecordedDrive, record};

/// How long the service may take over the last uploads.
const PATIENCE: Duration = Duration::from_mins(5);

/// What came of a drive's uploads.
#[derive(Debug, Clone, Default, Serialize)]
pub struct UploadedDrive {
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
    /// What seems to be in another convention than the contract's, in words.
    pub findings: Vec<String>,
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
) -> anyhow::Result<UploadedDrive> {
    upload_to(drive, ServiceAddress::at(server).endpoint()?, spool, config, bar).await
}

/// The same as somebody whom the service knows.
///
/// # Errors
/// When the drive has no reference poses, or the service does not take the uploads in time.
pub async fn upload_to(
    drive: &Drive,
    service: ServiceEndpoint,
    spool: &Path,
    config: RecorderConfig,
    bar: &ProgressBar,
) -> anyhow::Result<UploadedDrive> {
    let RecordedDrive { uploads, left_out, findings } = record(drive, config)?;
    let findings: Vec<String> = findings.iter().map(ToString::to_string).collect();
    let spool = Spool::open(spool, SpoolLimits::default()).context("opening the upload spool")?;
    let uploader = Uploader::start(service, spool, UploaderOptions::default());
    let mut done = UploadedDrive { left_out, findings, ..UploadedDrive::default() };
    bar.inc_length(uploads.len() as u64);
    for upload in uploads {
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
                "nothing of the drive of `{}` can be mapped; left out: {}. {}",
                drive.vehicle,
                done.left_out,
                done.findings.join("; ")
            ),
        }
    }
    Ok(done)
}
