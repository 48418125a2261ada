//! comma2k19: the front radar of a production car.

use std::path::Path;

use echofix_core::drive::Drive;
use echofix_core::geo::LatLon;
use echofix_core::scan::{Mount, Scan};
use serde::Deserialize;

use super::{DataFolder, Error, LocalFrame, detect, micros, on_the_globe, poses};
use crate::drivelog::Problem;

/// 19th Avenue, San Francisco: near where the drive was, for want of the true position.
const NOMINAL_ORIGIN: LatLon = LatLon { lat_deg: 37.7349, lon_deg: -122.4751 };
/// 2018-08-02 00:00 UTC, the date in the drive's name, microseconds since the Unix epoch.
const NOMINAL_START_US: i64 = 1_533_168_000_000_000;
/// The publication claims less than a metre.
const SIGMA_POSITION_M: f64 = 0.5;
/// The camera's heading is off the course by this much on average.
const SIGMA_YAW_RAD: f64 = 0.016;

#[derive(Deserialize)]
struct TrackRow {
    scan_id: u64,
    t: f64,
    x_forward: f64,
    y_left: f64,
    v_rel: f32,
}

/// Reads the prepared minute of comma2k19: the front radar of a Toyota RAV4, 20 Hz, 1 km of 19th
/// Avenue in San Francisco.
///
/// - The radar reports *tracks* of objects, some eight a cycle and mostly cars; about one is
///   stationary. Far too sparse to localize by: this tests the reading, and the rejection of
///   movers. The speed of a track becomes the radial speed (positive away), as the data treat it.
/// - `odometry`, `reference` and `truth` are all `poses.csv`, of the *camera*: the radar sits about 2 m
///   ahead of it, and both that lever arm and the angle between the two are unknown. The mount is
///   left at the origin. The sigmas are guesses: 0.5 m, and the mean angle of 0.016 rad between the
///   camera's heading and the course.
/// - The absolute position is *nominal* (37.7349, -122.4751): the data are metres from the first pose.
/// - The date is *nominal* too: the device's seconds are counted from 2018-08-02 00:00 UTC.
///
/// Source: `commaai/comma2k19`, `Example_1` (MIT).
///
/// # Errors
/// Naming the file and the line that cannot be used.
pub fn comma2k19(folder: impl AsRef<Path>) -> Result<Drive, Error> {
    let folder = DataFolder { path: folder.as_ref(), set: "comma2k19" };
    let odometry = poses(&folder, NOMINAL_START_US)?;
    let frame = LocalFrame::at(NOMINAL_ORIGIN);
    let truth = on_the_globe(&odometry, &frame, SIGMA_POSITION_M, SIGMA_YAW_RAD);
    Ok(Drive {
        vehicle: "comma2k19-example".to_owned(),
        mounts: vec![Mount::IDENTITY],
        scans: scans(&folder)?,
        odometry,
        reference: truth.clone(),
        truth,
    })
}

/// One scan a cycle, at the time of the cycle's first message.
fn scans(folder: &DataFolder) -> Result<Vec<Scan>, Error> {
    let columns = ["scan_id", "t", "x_forward", "y_left", "v_rel"];
    let mut scans: Vec<(u64, Scan)> = Vec::new();
    folder.table("scans.csv")?.rows(&columns, |row: TrackRow| {
        if !row.v_rel.is_finite() {
            return Err(Problem::NotFinite);
        }
        if scans.last().is_none_or(|(id, _)| *id != row.scan_id) {
            let time_us = NOMINAL_START_US + micros(row.t)?;
            scans.push((row.scan_id, Scan { time_us, ..Scan::default() }));
        }
        let Some((_, scan)) = scans.last_mut() else { return Ok(()) };
        detect(scan, row.x_forward, row.y_left)?;
        scan.radial_speed_mps.push(row.v_rel);
        Ok(())
    })?;
    Ok(scans.into_iter().map(|(_, scan)| scan).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::data_dir;
    use echofix_core::gate::{Gate, gate_scan};
    use std::fs;

    #[test]
    fn tracks_become_detections_with_radial_speed() {
        let dir = tempfile::tempdir().unwrap();
        let scans = "scan_id,t,x_forward,y_left,v_rel,track,new_track,ego_speed,stationary\n\
            0,10.5,30.0,-40.0,-7.5,528,0,7.9,1\n0,10.6,10,0,3,529,0,7.9,0\n1,10.7,10,0,3,529,0,7.9,0\n";
        fs::write(dir.path().join("scans.csv"), scans).unwrap();
        fs::write(dir.path().join("poses.csv"), "t,x_east,y_north,heading\n10,0,0,1.5\n11,0,8,1.5\n")
            .unwrap();
        let drive = comma2k19(dir.path()).unwrap();
        assert_eq!(drive.scans.len(), 2);
        assert_eq!(drive.scans[0].time_us, NOMINAL_START_US + 10_500_000);
        assert_eq!((drive.scans[0].range_m[0], drive.scans[0].radial_speed_mps[0]), (50.0, -7.5));
        assert!((drive.truth[0].at.lat_deg - 37.7349).abs() < 1e-9);
        fs::write(dir.path().join("scans.csv"), "scan_id,t,x_forward,y_left,v_rel\n0,1,1,1,NaN\n").unwrap();
        let message = comma2k19(dir.path()).unwrap_err().to_string();
        assert!(message.contains("scans.csv line 2"), "{message}");
    }

    #[test]
    #[ignore = "needs ECHOFIX_DATA_DIR"]
    fn the_real_minute_reads_as_its_readme_says_and_movers_are_told() {
        let drive = comma2k19(data_dir("comma2k19_example")).unwrap();
        assert_eq!((drive.scans.len(), drive.odometry.len()), (1200, 1200));
        assert!((drive.odometry.travelled_m() - 1011.0).abs() < 2.0, "{}", drive.odometry.travelled_m());
        let (mut all, mut stationary) = (0, 0);
        for scan in &drive.scans {
            assert!(scan.validate().is_ok());
            let Some(velocity) = drive.odometry.velocity_at(scan.time_us) else { continue };
            let mut kept = scan.clone();
            gate_scan(&mut kept, &drive.mounts[0], Some(velocity), &Gate::of_movers(1.0));
            all += scan.len();
            stationary += kept.len();
        }
        let per_cycle = |n: usize| n as f64 / 1200.0;
        assert!((per_cycle(all) - 8.4).abs() < 0.1, "{}", per_cycle(all));
        assert!((per_cycle(stationary) - 1.3).abs() < 0.3, "{}", per_cycle(stationary));
    }
}
