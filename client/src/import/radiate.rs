//! RADIATE: a spinning radar in the fog of Edinburgh.

use std::path::Path;

use echofix_core::drive::Drive;
use echofix_core::geo::LatLon;
use echofix_core::scan::{Mount, Scan};
use serde::Deserialize;

use super::{DataFolder, Error, LocalFrame, detect, micros, on_the_globe, poses};
use crate::drivelog::Problem;

/// How far the poses stray from GPS/INS, RMS over the fragment, metres.
const SIGMA_POSITION_M: f64 = 0.17;
/// That, over the 46 m of the fragment, radians.
const SIGMA_YAW_RAD: f64 = 0.004;

#[derive(Deserialize)]
struct PointRow {
    scan_id: u64,
    t: f64,
    x_forward_dsk: f64,
    y_left_dsk: f64,
}

#[derive(Deserialize)]
struct GpsRow {
    lat: f64,
    lon: f64,
}

/// Reads the prepared fragment `fog_6_0` of RADIATE: a Navtech CTS350-X, 360 degrees at 4 Hz, 18
/// scans in 4 s of a suburban street in fog.
///
/// - Scans: the points that were moved to the time of their scan (`x_forward_dsk`, `y_left_dsk`);
///   one sensor at the body's origin, which is the radar. The radar measures no radial speed, so
///   movers cannot be recognised; the received power is not a radar cross section and is left out.
/// - `odometry`, `reference` and `truth` are all `poses.csv`: lidar odometry, independent of the
///   radar, fitted as a whole to GPS/INS. Its scale is 1.2 % off GPS; its relative accuracy over
///   the fragment is estimated at 0.1 m and not verified. The sigmas are its RMS distance from GPS.
/// - The local frame has its origin at the first fix of `gps_ins.csv`. The absolute position is as good
///   as that GPS, which is not known.
/// - Time is the host computer's Unix time, whose offset from UTC is not known (the GPS clock of
///   the set is 66 s ahead).
///
/// Source: `marcelsheeny/radiate_sdk`, sample `tiny_foggy` (MIT); the full set is for
/// non-commercial research.
///
/// # Errors
/// Naming the file and the line that cannot be used.
pub fn radiate(folder: impl AsRef<Path>) -> Result<Drive, Error> {
    let folder = DataFolder { path: folder.as_ref(), set: "RADIATE" };
    let frame = LocalFrame::at(first_fix(&folder)?);
    let odometry = poses(&folder, 0)?;
    let truth = on_the_globe(&odometry, &frame, SIGMA_POSITION_M, SIGMA_YAW_RAD);
    Ok(Drive {
        vehicle: "radiate-tiny-foggy".to_owned(),
        mounts: vec![Mount::IDENTITY],
        scans: scans(&folder)?,
        odometry,
        reference: truth.clone(),
        truth,
    })
}

fn first_fix(folder: &DataFolder) -> Result<LatLon, Error> {
    let mut first = None;
    folder.table("gps_ins.csv")?.rows(&["lat", "lon"], |row: GpsRow| {
        if !(row.lat.abs() <= 90.0 && row.lon.abs() <= 180.0) {
            return Err(Problem::NotAPosition { lat_deg: row.lat, lon_deg: row.lon });
        }
        first.get_or_insert(LatLon { lat_deg: row.lat, lon_deg: row.lon });
        Ok(())
    })?;
    first.ok_or_else(|| folder.empty("gps_ins.csv"))
}

fn scans(folder: &DataFolder) -> Result<Vec<Scan>, Error> {
    let columns = ["scan_id", "t", "x_forward_dsk", "y_left_dsk"];
    let mut scans: Vec<(u64, Scan)> = Vec::new();
    folder.table("scans.csv")?.rows(&columns, |row: PointRow| {
        if scans.last().is_none_or(|(id, _)| *id != row.scan_id) {
            scans.push((row.scan_id, Scan { time_us: micros(row.t)?, ..Scan::default() }));
        }
        scans.last_mut().map_or(Ok(()), |(_, scan)| detect(scan, row.x_forward_dsk, row.y_left_dsk))
    })?;
    Ok(scans.into_iter().map(|(_, scan)| scan).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::data_dir;
    use std::fs;

    const SCANS: &str = "scan_id,t,t_point,x_forward,y_left,x_forward_dsk,y_left_dsk,power\n\
        1,100.5,100.4,3.1,4.1,3.0,4.0,99\n\
        1,100.5,100.4,0.1,-2.1,0.0,-2.0,98\n\
        2,100.75,100.7,1,0,1,0,97\n";
    const POSES: &str = "t,x_east,y_north,heading\n100.4,0,0,0\n100.8,4,100,0.1\n";
    const GPS: &str = "t,lat,lon\n100.4,55.89,-3.32\n100.5,0,0\n";

    fn folder(poses: &str) -> tempfile::TempDir {
        let dir = tempfile::tempdir().unwrap();
        for (name, text) in [("scans.csv", SCANS), ("poses.csv", poses), ("gps_ins.csv", GPS)] {
            fs::write(dir.path().join(name), text).unwrap();
        }
        dir
    }

    #[test]
    fn points_become_ranges_and_azimuths_on_the_globe() {
        let drive = radiate(folder(POSES).path()).unwrap();
        assert_eq!(drive.scans.len(), 2);
        assert_eq!(drive.scans[0].time_us, 100_500_000);
        assert_eq!(drive.scans[0].range_m, [5.0, 2.0]);
        assert!((drive.scans[0].azimuth_rad[1] + std::f32::consts::FRAC_PI_2).abs() < 1e-6);
        assert!(drive.scans.iter().all(|s| s.validate().is_ok() && s.radial_speed_mps.is_empty()));
        assert!((drive.truth[0].at.lat_deg - 55.89).abs() < 1e-9);
        let north_m = (drive.truth[1].at.lat_deg - 55.89) * 111_351.0;
        assert!((north_m - 100.0).abs() < 0.05, "{north_m}");
    }

    #[test]
    fn what_is_missing_or_broken_is_named() {
        let dir = folder("t,x_east,y_north,heading\n100.4,0,0,0\n100.3,4,0,0.1\n");
        assert!(radiate(dir.path()).unwrap_err().to_string().contains("in order of time"));
        fs::write(dir.path().join("poses.csv"), "t,x_east,y_north,heading\n1e300,0,0,0\n").unwrap();
        let message = radiate(dir.path()).unwrap_err().to_string();
        assert!(message.contains("poses.csv line 2"), "{message}");
        fs::remove_file(dir.path().join("gps_ins.csv")).unwrap();
        assert!(matches!(radiate(dir.path()), Err(Error::Missing { .. })));
    }

    #[test]
    #[ignore = "needs ECHOFIX_DATA_DIR"]
    fn the_real_fragment_reads_as_its_readme_says() {
        let drive = radiate(data_dir("radiate_tiny_foggy")).unwrap();
        assert_eq!((drive.scans.len(), drive.odometry.len()), (18, 103));
        assert_eq!(drive.scans.iter().map(Scan::len).sum::<usize>(), 26_565);
        let (first, last) = (&drive.scans[0], &drive.scans[17]);
        assert!(((last.time_us - first.time_us) as f64 * 1e-6 - 4.19).abs() < 0.01);
        for scan in &drive.scans {
            assert!(scan.validate().is_ok());
            assert!(drive.odometry.at(scan.time_us).is_some(), "poses cover all scans");
            let speed_mps = drive.odometry.velocity_at(scan.time_us).unwrap().speed_mps();
            assert!((9.0..11.5).contains(&speed_mps), "{speed_mps}");
        }
        let pose = drive.truth[0];
        assert!((pose.at.lat_deg - 55.8923).abs() < 1e-3 && (pose.at.lon_deg + 3.3217).abs() < 1e-3);
    }

    #[derive(Deserialize)]
    struct GpsLocal {
        lat: f64,
        lon: f64,
        x_east: f64,
        y_north: f64,
    }

    #[test]
    #[ignore = "needs ECHOFIX_DATA_DIR"]
    fn our_local_frame_is_the_one_of_the_data() {
        let dir = data_dir("radiate_tiny_foggy");
        let folder = DataFolder { path: &dir, set: "RADIATE" };
        let frame = LocalFrame::at(first_fix(&folder).unwrap());
        let check = |row: GpsLocal| {
            let (at, _) = frame.to_geodetic(&echofix_core::pose::Pose2::new(row.x_east, row.y_north, 0.0));
            let north_m = (at.lat_deg - row.lat) * 111_351.0;
            let east_m = (at.lon_deg - row.lon) * 62_500.0;
            // Eight to nine decimals of a degree are in the file.
            assert!(north_m.hypot(east_m) < 0.01, "{north_m} {east_m}");
            Ok(())
        };
        folder.table("gps_ins.csv").unwrap().rows(&["lat", "lon", "x_east", "y_north"], check).unwrap();
    }
}
