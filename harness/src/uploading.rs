//! A drive goes to the map, through the vehicle's own recorder, spool and uploader.

mod outcome;

use std::collections::HashSet;
use std::path::Path;
use std::sync::Arc;
use std::time::Duration;

use anyhow::{Context, bail};
use echofix_client::service::{ServiceAddress, ServiceEndpoint};
use echofix_client::upload::spool::{Spool, SpoolLimits};
use echofix_client::upload::{
    Demand, PreparedUpload, RecorderConfig, UploadEvent, Uploader, UploaderOptions,
};
use echofix_core::drive::Drive;
use indicatif::ProgressBar;
use tokio::sync::{mpsc, watch};
use tokio::time::Instant;

pub use outcome::{Interrupted, Publication, RepeatedError, Spooled, UploadedDrive};

use crate::recording::{RecordedDrive, record_wanted};

/// How long the service may acknowledge nothing before it is given up.
pub const PATIENCE: Duration = Duration::from_mins(1);

/// Uploads a drive and waits until the service has it, or has acknowledged nothing for as long as `patience`. The bar counts
/// acknowledgements.
///
/// # Errors
/// When the drive has no reference poses, nothing of it can be mapped, the service takes none of it, or not all in time. What it
/// has not taken stays in the spool.
pub async fn upload(
    drive: &Drive,
    server: &str,
    spool: &Path,
    config: RecorderConfig,
    patience: Duration,
    bar: &ProgressBar,
) -> anyhow::Result<UploadedDrive> {
    let (_, nobody) = watch::channel(false);
    let service = ServiceAddress::at(server).endpoint()?;
    upload_to(drive, service, spool, (config, None), (patience, nobody), bar).await
}

/// The same as somebody whom the service knows, and only what is wanted, where it is known what that is. Once the user interrupts it, it says how far it came.
///
/// # Errors
/// As [`upload`].
pub async fn upload_to(
    drive: &Drive,
    service: ServiceEndpoint,
    spool: &Path,
    (config, wanted): (RecorderConfig, Option<Arc<Demand>>),
    (patience, mut interrupted): (Duration, watch::Receiver<bool>),
    bar: &ProgressBar,
) -> anyhow::Result<UploadedDrive> {
    let RecordedDrive { uploads, left_out, findings, flaws, not_wanted } =
        record_wanted(drive, config, wanted.as_ref())?;
    let findings: Vec<String> = findings.iter().map(ToString::to_string).collect();
    let mut done = UploadedDrive { not_wanted, left_out, findings, flaws, ..UploadedDrive::default() };
    if uploads.is_empty() && not_wanted == 0 {
        bail!("nothing of the drive of `{}` can be mapped; {}", drive.vehicle, done.why_nothing());
    }
    let opened = Spool::open(spool, SpoolLimits::default()).context("opening the upload spool")?;
    done.spooled.found = opened.len() as u64;
    let (tell, mut events) = mpsc::unbounded_channel();
    // A receiver that has gone away has heard enough.
    let observer = move |event| drop(tell.send(event));
    let uploader = Uploader::start_observed(service, opened, UploaderOptions::default(), observer);
    bar.inc_length(uploads.len() as u64);
    let own = submit(uploads, &uploader, &mut done).await?;
    let mut heard = Instant::now();
    let ended = loop {
        if uploader.progress().waiting == 0 {
            break Ended::Sent;
        }
        tokio::select! {
            // Off where nobody can interrupt.
            Ok(_) = interrupted.wait_for(|interrupted| *interrupted) => break Ended::Interrupted,
            () = tokio::time::sleep_until(heard + patience) => break Ended::GivenUp,
            event = events.recv() => {
                let Some(event) = event else { break Ended::GivenUp };
                heard = if matches!(event, UploadEvent::Delayed { .. }) { heard } else { Instant::now() };
                done.count(event, &own, bar);
            }
        }
    };
    uploader.close().await;
    // The last are told after the spool is empty.
    while let Ok(event) = events.try_recv() {
        done.count(event, &own, bar);
    }
    done.judge(ended, &drive.vehicle, spool)?;
    Ok(done)
}

/// Puts uploads into the spool; returns their ids.
async fn submit(
    uploads: Vec<PreparedUpload>,
    uploader: &Uploader,
    done: &mut UploadedDrive,
) -> anyhow::Result<HashSet<String>> {
    let mut own = HashSet::new();
    for upload in uploads {
        done.recorded += 1;
        done.detections += upload.detections() as u64;
        done.bytes += upload.bytes() as u64;
        own.insert(upload.id().to_string());
        uploader.submit(upload).await?;
    }
    Ok(own)
}

/// Why nothing more is waited for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Ended {
    /// The spool is empty.
    Sent,
    /// The service acknowledged nothing for too long.
    GivenUp,
    /// The user has had enough.
    Interrupted,
}
