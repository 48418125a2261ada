//! A vehicle's request, as the service takes it.

use echofix_core::align::Prior;
use echofix_core::batch::Batch;
use echofix_core::calibration::clock::clock_of_batch;
use echofix_core::drive::GeoPose;
use echofix_core::gate::Gate;
use echofix_core::geo::{self, Grid, LatLon};
use echofix_core::own_error::{MountSigma, own_error};
use echofix_proto::v1::LocalizeRequest;
use echofix_server::grpc::decode;

/// Where the vehicle believes to be.
pub fn believed(request: &LocalizeRequest) -> GeoPose {
    let prior = request.prior.clone().unwrap_or_default();
    let pose = prior.pose.unwrap_or_default();
    GeoPose {
        time_us: request.batch.as_ref().map_or(0, |batch| batch.reference_time_us),
        at: LatLon { lat_deg: pose.latitude_deg, lon_deg: pose.longitude_deg },
        yaw_rad: pose.yaw_rad,
        sigma_position_m: prior.sigma_position_m,
        sigma_yaw_rad: prior.sigma_yaw_rad,
    }
}

/// A believed pose as a prior on a grid.
///
/// # Errors
/// When it is off the grid.
pub fn prior_on(grid: &Grid, believed: &GeoPose) -> Result<Prior, geo::Error> {
    Ok(Prior {
        pose: grid.pose_from_geodetic(believed.at, believed.yaw_rad)?,
        sigma_position_m: believed.sigma_position_m,
        sigma_yaw_rad: believed.sigma_yaw_rad,
        scale: grid.scale_factor(believed.at)?,
    })
}

/// The batch, with what the vehicle declares of its odometry, mounts and clocks, as `server/src/grpc/localize.rs` makes it.
///
/// # Errors
/// When a field breaks a rule.
pub fn batch(request: &LocalizeRequest, gate: &Gate) -> anyhow::Result<Batch> {
    let sent = decode::batch(request.batch.clone(), "batch")?;
    let decode::DecodedBatch { reference_time_us, mounts, mount_sigmas, scans, odometry, .. } = &sent;
    let mut batch = Batch::organise(scans.iter(), mounts, odometry, *reference_time_us, gate)?;
    batch.quality = sent.quality;
    batch.findings.extend(sent.told.mostly_moving(batch.points.len() as u64));
    // A clock that is off as the batch itself shows is no better known than by how much it is off.
    let late_s = clock_of_batch(scans.iter(), mounts, odometry).map_or(0.0, |clock| clock.value);
    let known = |sigma: &MountSigma| MountSigma { time_s: late_s.hypot(sigma.time_s), ..*sigma };
    let sigmas: Vec<_> = mount_sigmas.iter().map(known).collect();
    batch.own_error = own_error(&batch, odometry, *reference_time_us, mounts, &sigmas);
    Ok(batch)
}
