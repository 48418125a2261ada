use proptest::prelude::*;

use super::*;

fn scan_columns() -> v1::Scans {
    v1::Scans {
        sensor: vec![0, 1],
        time_offset_us: vec![-50, 0],
        detection_count: vec![2, 1],
        range_m: vec![1.0, 2.0, 3.0],
        azimuth_rad: vec![0.1, 0.2, 0.3],
        radial_speed_mps: vec![-1.0, -2.0, -3.0],
        rcs_dbsm: vec![],
        ..v1::Scans::default()
    }
}

fn pose_columns() -> v1::PoseColumns {
    v1::PoseColumns {
        time_offset_us: vec![0, 10],
        latitude_deg: vec![30.0; 2],
        longitude_deg: vec![-97.0; 2],
        yaw_rad: vec![0.0; 2],
        sigma_position_m: vec![0.1; 2],
        sigma_yaw_rad: vec![0.001; 2],
    }
}

#[test]
fn columns_are_split_into_scans() {
    let scans = scans(scan_columns(), 1_000, 2, "s").unwrap().split();
    assert_eq!(scans[0].range_m, [1.0, 2.0]);
    assert_eq!((scans[1].sensor, scans[1].time_us), (1, 1_000));
    assert_eq!(scans[1].radial_speed_mps, [-3.0]);
    assert!(scans[1].rcs_dbsm.is_empty());
}

/// Catches a column that goes to another scan's detections, or nowhere.
#[test]
fn elevations_and_times_stay_with_their_detections() {
    let mut columns = scan_columns();
    columns.elevation_rad = vec![0.1, -0.2, 0.3];
    columns.detection_time_offset_us = vec![0, 250_000, -7];
    let scans = scans(columns, 1_000, 2, "s").unwrap().split();
    assert_eq!((&scans[0].elevation_rad[..], &scans[1].elevation_rad[..]), (&[0.1, -0.2][..], &[0.3][..]));
    assert_eq!(scans[0].detection_time_offset_us, [0, 250_000]);
    assert_eq!(scans[1].detection_time_offset_us, [-7]);
}

#[test]
fn scans_without_detections_are_left_out() {
    let mut columns = scan_columns();
    columns.sensor.insert(1, 0);
    columns.time_offset_us.insert(1, -20);
    columns.detection_count.insert(1, 0);
    let split = |columns| scans(columns, 1_000, 2, "s").unwrap().split();
    assert_eq!(split(columns), split(scan_columns()));
    let empty = v1::Scans {
        sensor: vec![0],
        time_offset_us: vec![0],
        detection_count: vec![0],
        ..v1::Scans::default()
    };
    assert_eq!(split(empty), []);
}

/// The field a change of the columns is refused for.
fn refused(change: impl FnOnce(&mut v1::Scans)) -> String {
    let mut columns = scan_columns();
    change(&mut columns);
    scans(columns, 1_000, 2, "s").unwrap_err().field
}

#[test]
fn broken_scans_are_named() {
    assert_eq!(refused(|c| *c = v1::Scans::default()), "s.sensor");
    assert_eq!(refused(|c| c.time_offset_us.truncate(1)), "s.time_offset_us");
    assert_eq!(refused(|c| c.detection_count.push(0)), "s.detection_count");
    assert_eq!(refused(|c| c.detection_count[0] = 3), "s.detection_count");
    assert_eq!(refused(|c| c.detection_count = vec![u32::MAX; 2]), "s.detection_count");
    assert_eq!(refused(|c| c.sensor[1] = 2), "s.sensor[1]");
    assert_eq!(refused(|c| c.time_offset_us[0] = i64::MIN), "s.time_offset_us[0]");
    assert_eq!(refused(|c| c.time_offset_us[0] = i64::MAX), "s.time_offset_us[0]");
    assert_eq!(refused(|c| c.range_m[1] = f32::NAN), "s.range_m");
    assert_eq!(refused(|c| c.range_m[1] = -1.0), "s.range_m");
    assert_eq!(refused(|c| c.azimuth_rad[2] = f32::MAX), "s.azimuth_rad[2]");
    assert_eq!(refused(|c| c.azimuth_rad.truncate(2)), "s.azimuth_rad");
    assert_eq!(refused(|c| c.radial_speed_mps[0] = f32::INFINITY), "s.radial_speed_mps");
    assert_eq!(refused(|c| c.rcs_dbsm.push(1.0)), "s.rcs_dbsm");
    assert_eq!(refused(|c| c.elevation_rad = vec![0.0, 20.0, 0.0]), "s.elevation_rad");
    assert_eq!(refused(|c| c.elevation_rad.push(0.0)), "s.elevation_rad");
    assert_eq!(refused(|c| c.detection_time_offset_us.push(1)), "s.detection_time_offset_us");
    assert_eq!(refused(|c| c.sensor = vec![0; MAX_SCANS + 1]), "s.sensor");
}

#[test]
fn broken_poses_are_named() {
    let refused = |change: fn(&mut v1::PoseColumns)| {
        let mut columns = pose_columns();
        change(&mut columns);
        geo_poses(&columns, 1_000, "p").unwrap_err().field
    };
    assert_eq!(geo_poses(&pose_columns(), 1_000, "p").unwrap().len(), 2);
    assert_eq!(refused(|c| c.latitude_deg[1] = 91.0), "p.latitude_deg[1]");
    assert_eq!(refused(|c| c.longitude_deg[0] = f64::NAN), "p.longitude_deg[0]");
    assert_eq!(refused(|c| c.yaw_rad[0] = 1e308), "p.yaw_rad[0]");
    assert_eq!(refused(|c| c.yaw_rad.clear()), "p.yaw_rad");
    assert_eq!(refused(|c| c.time_offset_us[1] = 0), "p.time_offset_us[1]");
    assert_eq!(refused(|c| c.sigma_position_m[0] = -0.1), "p.sigma_position_m[0]");
    assert_eq!(refused(|c| c.sigma_yaw_rad[1] = f32::NAN), "p.sigma_yaw_rad[1]");
}

#[test]
fn a_batch_needs_all_its_parts() {
    let odometry = v1::Odometry {
        time_offset_us: vec![-100, 0],
        x_m: vec![0.0, 1.0],
        y_m: vec![0.0; 2],
        yaw_rad: vec![0.0; 2],
        ..v1::Odometry::default()
    };
    let whole = v1::Batch {
        reference_time_us: 1_000,
        mounts: vec![v1::SensorMount::default(); 2],
        scans: Some(scan_columns()),
        odometry: Some(odometry),
        ..v1::Batch::default()
    };
    let refused = |change: fn(&mut v1::Batch)| {
        let mut part = whole.clone();
        change(&mut part);
        batch(Some(part), "batch").unwrap_err().field
    };
    assert_eq!(batch(Some(whole.clone()), "batch").unwrap().scans.iter().count(), 2);
    assert_eq!(batch(None, "batch").unwrap_err().field, "batch");
    assert_eq!(refused(|b| b.reference_time_us = -1), "batch.reference_time_us");
    assert_eq!(refused(|b| b.mounts.clear()), "batch.mounts");
    assert_eq!(refused(|b| b.mounts[1].x_m = f32::NAN), "batch.mounts[1]");
    assert_eq!(refused(|b| b.scans = None), "batch.scans");
    assert_eq!(refused(|b| b.odometry = None), "batch.odometry");
    assert_eq!(refused(|b| b.odometry.as_mut().unwrap().x_m[1] = 1e308), "batch.odometry.x_m[1]");
    let backwards: fn(&mut v1::Batch) = |b| b.odometry.as_mut().unwrap().time_offset_us[1] = -200;
    assert_eq!(refused(backwards), "batch.odometry.time_offset_us");
}

proptest! {
    #[test]
    fn any_columns_are_refused_or_sound(
        sensor: Vec<u32>, time_offset_us: Vec<i64>, detection_count: Vec<u32>,
        range_m: Vec<f32>, azimuth_rad: Vec<f32>, radial_speed_mps: Vec<f32>, reference: i64,
    ) {
        let columns = v1::Scans {
            sensor, time_offset_us, detection_count, range_m, azimuth_rad, radial_speed_mps, ..v1::Scans::default()
        };
        if let Ok(scans) = scans(columns, reference, 3, "s") {
            prop_assert!(scans.split().iter().all(|scan| scan.validate().is_ok() && scan.sensor < 3));
        }
    }
}
