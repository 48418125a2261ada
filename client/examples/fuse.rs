//! A vehicle that drives recorded drives again and fuses the service's fixes with its odometry; where
//! a log holds the truth, it says how far off that was.
//!
//! ```text
//! cargo run -p echofix-client --example fuse -- http://127.0.0.1:50051 drive.mcap...
//! ```

#[path = "filter/compare.rs"]
mod compare;

use std::error::Error;
use std::io::Write;

use compare::Comparison;
use echofix_client::drivelog::{self, DriveEvent};
use echofix_client::filter::FilterConfig;
use echofix_client::service::ServiceAddress;
use echofix_client::vehicle::{self, Fix, Vehicle};
use echofix_client::{Localizer, LocalizerOptions};
use echofix_core::drive::{Drive, GeoPose};

#[tokio::main]
async fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let url = arguments.next().ok_or("usage: fuse http://host:port drive.mcap...")?;
    let localizer = Localizer::new(ServiceAddress::at(url).endpoint()?, LocalizerOptions::default());
    let mut drives = Vec::new();
    for path in arguments {
        drives.push(fused(&drivelog::read(path)?.drive, &localizer).await?);
    }
    write!(std::io::stdout(), "{}", Comparison::pooled(drives).table())?;
    Ok(())
}

/// Drives, asking once a second.
async fn fused(drive: &Drive, localizer: &Localizer) -> Result<Comparison, Box<dyn Error>> {
    let mut vehicle = Vehicle::new(vehicle::VehicleConfig::default(), drive.mounts.clone());
    let mut comparison = Comparison::new(FilterConfig::default());
    let mut next_question_us = i64::MIN;
    for event in drivelog::replay(drive) {
        match event {
            DriveEvent::Odometry(time_us, pose) => {
                vehicle.push_odometry(time_us, pose)?;
                comparison.push_odometry(time_us, pose)?;
                if let Ok(at) = drive.truth.binary_search_by_key(&time_us, |truth| truth.time_us) {
                    comparison.judge(&drive.truth[at], &pose)?;
                }
            }
            DriveEvent::Scan(scan) => {
                // A scan that comes too early or too late is lost, which is no reason to stop.
                let _ = vehicle.push_scan(scan.clone());
            }
            // As a receiver without corrections would know it, so that the fixes have to be good.
            DriveEvent::Reference(pose) => {
                let (sigma_position_m, sigma_yaw_rad) = (2.0, 3_f64.to_radians());
                vehicle.push_pose(GeoPose { sigma_position_m, sigma_yaw_rad, ..*pose })?;
            }
            DriveEvent::Truth(_) => {}
        }
        if event.time_us() >= next_question_us {
            next_question_us = event.time_us() + 1_000_000;
            if let Ok(fix) = locate(localizer, &mut vehicle).await {
                let odometry = drive.odometry.at(fix.pose.time_us).ok_or("a fix beyond odometry")?;
                comparison.push_fix(&(&fix).into(), odometry)?;
            }
        }
    }
    Ok(comparison)
}

async fn locate(localizer: &Localizer, vehicle: &mut Vehicle) -> Result<Fix, Box<dyn Error>> {
    let question = vehicle.question()?;
    let answer = localizer.ask(&question).await?;
    Ok(vehicle.accept(&question, &answer)?)
}
