//! A vehicle that drives a recorded drive again: it asks the service where it is once a second, and
//! uploads what it saw from its reference poses.
//!
//! ```text
//! cargo run -p echofix-client --example vehicle -- http://127.0.0.1:50051 drive.mcap
//! ```

use std::error::Error;
use std::time::Duration;

use echofix_client::drivelog::{self, DriveEvent};
use echofix_client::service::ServiceAddress;
use echofix_client::upload::spool::SpoolLimits;
use echofix_client::upload::{self, Recorder, Spool, Uploader};
use echofix_client::vehicle::{self, Vehicle};
use echofix_client::{LocalizationStream, Localizer, LocalizerOptions};
use tracing::{info, warn};

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    tracing_subscriber::fmt().with_target(false).init();
    let mut arguments = std::env::args().skip(1);
    let (Some(url), Some(path)) = (arguments.next(), arguments.next()) else {
        return Err("usage: vehicle http://host:port drive.mcap".into());
    };
    let drive = drivelog::read(path)?.drive;
    let endpoint = ServiceAddress::at(url).endpoint()?;

    let mut localizer = Localizer::new(endpoint.clone(), LocalizerOptions::default()).stream();
    let mut vehicle = Vehicle::new(vehicle::VehicleConfig::default(), drive.mounts.clone());
    let mut recorder =
        Recorder::new(upload::RecorderConfig::default(), &drive.vehicle, drive.mounts.clone())?;
    let spool = Spool::open(std::env::temp_dir().join("echofix-spool"), SpoolLimits::default())?;
    let uploader = Uploader::start(endpoint, spool, upload::UploaderOptions::default());

    let mut next_question_us = i64::MIN;
    for event in drivelog::replay(&drive) {
        match event {
            DriveEvent::Odometry(time_us, pose) => {
                vehicle.push_odometry(time_us, pose)?;
                recorder.push_odometry(time_us, pose)?;
            }
            DriveEvent::Scan(scan) => {
                // A scan that comes too early or too late is lost, which is no reason to stop.
                let _ = vehicle.push_scan(scan.clone());
                let _ = recorder.push_scan(scan.clone());
            }
            DriveEvent::Reference(pose) => {
                vehicle.push_pose(*pose)?;
                if let Some(upload) = recorder.push_pose(*pose)? {
                    uploader.submit(upload).await?;
                }
            }
            DriveEvent::Truth(_) => {}
        }
        if event.time_us() >= next_question_us {
            next_question_us = event.time_us() + 1_000_000;
            match locate(&mut localizer, &mut vehicle).await {
                Ok(fix) => info!(at = ?fix.pose.at, sigma_m = fix.pose.sigma_position_m, "fix"),
                Err(reason) => info!(%reason, "no fix"),
            }
        }
    }
    let trip = recorder.finish();
    for finding in &trip.findings {
        warn!(%finding, "check the conventions");
    }
    if let Some(upload) = trip.upload {
        uploader.submit(upload).await?;
    }
    if let Err(left) = uploader.flush(Duration::from_secs(30)).await {
        warn!(%left, "not everything was uploaded");
    }
    info!(progress = ?uploader.progress(), position = ?vehicle.position(), "arrived");
    uploader.close().await;
    Ok(())
}

async fn locate(
    localizer: &mut LocalizationStream,
    vehicle: &mut Vehicle,
) -> Result<vehicle::Fix, Box<dyn Error>> {
    let question = vehicle.question()?;
    let answer = localizer.ask(&question).await?;
    Ok(vehicle.accept(&question, &answer)?)
}
