//! The values of the contract's columns, as the service reads them.

use echofix_core::drive::GeoPose;
use echofix_core::geo::LatLon;
use echofix_core::odometry::Trajectory;
use echofix_core::pose::Pose2;
use echofix_core::scan::Scan;
use echofix_proto::v1;

/// The geometry of scans.
pub(crate) fn scans(message: &v1::Scans, reference_time_us: i64) -> Vec<Scan> {
    let mut from = 0;
    let rows = message.sensor.iter().zip(&message.time_offset_us).zip(&message.detection_count);
    let scan = |((sensor, offset_us), count): ((&u32, &i64), &u32)| {
        let rows = from..from + *count as usize;
        from = rows.end;
        Scan {
            sensor: *sensor as usize,
            time_us: reference_time_us + offset_us,
            range_m: message.range_m[rows.clone()].to_vec(),
            azimuth_rad: message.azimuth_rad[rows.clone()].to_vec(),
            elevation_rad: message.elevation_rad.get(rows.clone()).unwrap_or_default().to_vec(),
            detection_time_offset_us: message.detection_time_offset_us.get(rows).unwrap_or_default().to_vec(),
            ..Scan::default()
        }
    };
    rows.map(scan).collect()
}

pub(crate) fn odometry(message: &v1::Odometry, reference_time_us: i64) -> Trajectory {
    let pose = |row: usize| {
        let time_us = reference_time_us + message.time_offset_us[row];
        (time_us, Pose2::new(message.x_m[row], message.y_m[row], message.yaw_rad[row]))
    };
    Trajectory::new((0..message.time_offset_us.len()).map(pose)).unwrap()
}

pub(crate) fn poses(message: &v1::PoseColumns, reference_time_us: i64) -> Vec<GeoPose> {
    let pose = |row: usize| GeoPose {
        time_us: reference_time_us + message.time_offset_us[row],
        at: LatLon { lat_deg: message.latitude_deg[row], lon_deg: message.longitude_deg[row] },
        yaw_rad: message.yaw_rad[row],
        sigma_position_m: f64::from(message.sigma_position_m[row]),
        sigma_yaw_rad: f64::from(message.sigma_yaw_rad[row]),
    };
    (0..message.time_offset_us.len()).map(pose).collect()
}
