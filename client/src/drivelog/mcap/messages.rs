//! Between the values of a drive and the messages of its log.

use echofix_core::drive::GeoPose;
use echofix_core::geo::LatLon;
use echofix_core::pose::{Pose2, wrap_angle};
use echofix_core::scan::Scan;
use std::f64::consts::FRAC_PI_2;

/// Generated from `proto/echofix/log/v1/drive.proto`.
#[allow(missing_docs, clippy::pedantic)]
pub(super) mod log {
    tonic::include_proto!("echofix.log.v1");
}

/// Generated from `proto/foxglove/location_fix.proto`.
#[allow(missing_docs, clippy::pedantic)]
pub(super) mod foxglove {
    tonic::include_proto!("foxglove");
}

pub(super) fn scan(scan: &Scan) -> log::RadarScan {
    log::RadarScan {
        time_us: scan.time_us,
        sensor: scan.sensor as u32,
        range_m: scan.range_m.clone(),
        azimuth_rad: scan.azimuth_rad.clone(),
        radial_speed_mps: scan.radial_speed_mps.clone(),
        rcs_dbsm: scan.rcs_dbsm.clone(),
        elevation_rad: scan.elevation_rad.clone(),
        detection_time_offset_us: scan.detection_time_offset_us.clone(),
    }
}

pub(super) fn scan_from(message: log::RadarScan) -> Scan {
    Scan {
        sensor: message.sensor as usize,
        time_us: message.time_us,
        range_m: message.range_m,
        azimuth_rad: message.azimuth_rad,
        radial_speed_mps: message.radial_speed_mps,
        rcs_dbsm: message.rcs_dbsm,
        elevation_rad: message.elevation_rad,
        detection_time_offset_us: message.detection_time_offset_us,
    }
}

pub(super) fn odometry(time_us: i64, pose: Pose2) -> log::OdometryPose {
    log::OdometryPose { time_us, x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad }
}

pub(super) fn odometry_from(message: &log::OdometryPose) -> (i64, Pose2) {
    (message.time_us, Pose2::new(message.x_m, message.y_m, message.yaw_rad))
}

pub(super) fn geodetic(pose: &GeoPose) -> log::GeodeticPose {
    log::GeodeticPose {
        time_us: pose.time_us,
        latitude_deg: pose.at.lat_deg,
        longitude_deg: pose.at.lon_deg,
        yaw_rad: pose.yaw_rad,
        sigma_position_m: pose.sigma_position_m,
        sigma_yaw_rad: pose.sigma_yaw_rad,
    }
}

pub(super) fn geodetic_from(message: &log::GeodeticPose) -> GeoPose {
    GeoPose {
        time_us: message.time_us,
        at: LatLon { lat_deg: message.latitude_deg, lon_deg: message.longitude_deg },
        yaw_rad: message.yaw_rad,
        sigma_position_m: message.sigma_position_m,
        sigma_yaw_rad: message.sigma_yaw_rad,
    }
}

pub(super) fn location_fix(pose: &GeoPose) -> foxglove::LocationFix {
    let variance = pose.sigma_position_m * pose.sigma_position_m;
    foxglove::LocationFix {
        timestamp: Some(prost_types::Timestamp {
            seconds: pose.time_us.div_euclid(1_000_000),
            nanos: (pose.time_us.rem_euclid(1_000_000) * 1000) as i32,
        }),
        frame_id: "body".into(),
        latitude: pose.at.lat_deg,
        longitude: pose.at.lon_deg,
        altitude: 0.0,
        position_covariance: vec![variance, 0.0, 0.0, 0.0, variance, 0.0, 0.0, 0.0, 0.0],
        position_covariance_type: foxglove::location_fix::PositionCovarianceType::Approximated as i32,
        heading: Some(wrap_angle(FRAC_PI_2 - pose.yaw_rad)),
    }
}
