//! Values for this crate's tests.

pub(crate) mod decode;
pub(crate) mod service;

use echofix_core::drive::{Drive, GeoPose};
use echofix_core::geo::LatLon;
use echofix_core::odometry::Trajectory;
use echofix_core::pose::Pose2;
use echofix_core::scan::{Mount, Scan};
use echofix_proto::v1;
use proptest::collection::vec;
use proptest::prelude::*;

use crate::upload::PreparedUpload;

/// Microseconds since the Unix epoch around which tests drive.
pub(crate) const T0: i64 = 1_700_000_000_000_000;

fn column(len: usize) -> impl Strategy<Value = Vec<f32>> {
    vec(-1e3_f32..1e3, len)
}

fn optional(len: usize) -> impl Strategy<Value = Vec<f32>> {
    prop_oneof![Just(Vec::new()), column(len)]
}

fn any_scan(sensors: usize) -> impl Strategy<Value = Scan> {
    (0..sensors, 0..20_usize).prop_flat_map(|(sensor, n)| {
        let elevations = prop_oneof![Just(Vec::new()), vec(-1.5_f32..1.5, n)];
        let times = prop_oneof![Just(Vec::new()), vec(-300_000..300_000_i32, n)];
        (vec(0.0_f32..200.0, n), column(n), optional(n), optional(n), elevations, times).prop_map(
            move |(range_m, azimuth_rad, radial_speed_mps, rcs_dbsm, elevation_rad, times)| Scan {
                sensor,
                time_us: 0,
                range_m,
                azimuth_rad,
                radial_speed_mps,
                elevation_rad,
                detection_time_offset_us: times,
                rcs_dbsm,
            },
        )
    })
}

fn any_pose() -> impl Strategy<Value = Pose2> {
    (-1e5..1e5, -1e5..1e5, -3.1..3.1).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
}

fn any_geo_poses() -> impl Strategy<Value = Vec<GeoPose>> {
    let one = (-80.0..84.0, -180.0..180.0, -3.1..3.1, 0.0..5.0, 0.0..0.1);
    vec(one, 0..10).prop_map(|poses| {
        let pose = |(i, (lat_deg, lon_deg, yaw_rad, sigma_position_m, sigma_yaw_rad))| GeoPose {
            time_us: T0 + 100_000 * i as i64,
            at: LatLon { lat_deg, lon_deg },
            yaw_rad,
            sigma_position_m,
            sigma_yaw_rad,
        };
        poses.into_iter().enumerate().map(pose).collect()
    })
}

/// Any drive that a log can hold: times increase, columns fit.
pub(crate) fn any_drive() -> impl Strategy<Value = Drive> {
    let scans = vec((any_scan(3), 1_i64..100_000), 0..20);
    let odometry = vec((any_pose(), 1_i64..50_000), 0..20);
    let parts =
        ("[a-zA-Z \",é]{0,12}", vec(any_pose(), 3), scans, odometry, any_geo_poses(), any_geo_poses());
    parts.prop_map(|(vehicle, mounts, scans, odometry, reference, truth)| {
        let mut time_us = T0;
        let mut later = |step: i64| {
            time_us += step;
            time_us
        };
        let scans = scans.into_iter().map(|(scan, step)| Scan { time_us: later(step), ..scan }).collect();
        let mut time_us = T0;
        let poses = odometry.into_iter().map(|(pose, step)| {
            time_us += step;
            (time_us, pose)
        });
        let odometry = Trajectory::new(poses).unwrap();
        Drive { vehicle, mounts, scans, odometry, reference, truth }
    })
}

/// An answer that may be used.
pub(crate) fn usable_answer(time_us: i64) -> v1::LocalizeResponse {
    v1::LocalizeResponse {
        status: v1::FixStatus::Usable as i32,
        time_us,
        pose: Some(v1::GeodeticPose { latitude_deg: 30.0, longitude_deg: -97.0, yaw_rad: 0.0 }),
        covariance: vec![0.01, 0.0, 0.0, 0.01, 0.0, 1e-5],
        protection: Some(v1::ProtectionLevel {
            along_m: 1.0,
            cross_m: 0.8,
            yaw_rad: 0.02,
            integrity_risk: 1e-3,
            valid: true,
        }),
        ..v1::LocalizeResponse::default()
    }
}

/// An upload of some detections under a fresh id.
pub(crate) fn upload(detections: usize) -> PreparedUpload {
    let mut upload = PreparedUpload::start("test-car", &[Mount::IDENTITY], T0);
    let pose = |time_us| GeoPose { time_us, ..GeoPose::default() };
    let scan = Scan {
        time_us: T0 + 50_000,
        range_m: vec![10.0; detections],
        azimuth_rad: vec![0.5; detections],
        ..Scan::default()
    };
    upload.add(&[pose(T0), pose(T0 + 100_000)], &[scan]);
    upload
}
