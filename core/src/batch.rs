//! Scans and a trajectory become points in one frame (paper, alg. fastGlobalAlign l. 4).

use crate::doppler::is_mover;
use crate::odometry::Trajectory;
use crate::pose::Pose2;
use crate::scan::{Gate, Mount, Scan};

/// Detections that were left out, by the reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Dropped {
    /// Taken below the minimum speed.
    pub too_slow: u64,
    /// Farther than the maximum range.
    pub too_far: u64,
    /// Moving targets.
    pub moving: u64,
    /// Taken outside the trajectory.
    pub without_pose: u64,
}

impl Dropped {
    /// All of them.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.too_slow + self.too_far + self.moving + self.without_pose
    }
}

/// Why scans do not form a batch.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum Error {
    /// A scan names a sensor that is not mounted.
    #[error("scan {scan} names sensor {sensor}, but only {mounts} sensors are mounted")]
    UnknownSensor {
        /// Index of the scan.
        scan: usize,
        /// The sensor it names.
        sensor: usize,
        /// Number of mounts.
        mounts: usize,
    },
    /// The odometry does not cover the reference time.
    #[error("the odometry does not cover the reference time {reference_time_us} us")]
    ReferenceOutsideOdometry {
        /// The reference time.
        reference_time_us: i64,
    },
}

/// Walks over the detections that pass the gate, giving each as a point in the trajectory's frame.
///
/// `scale` is the frame's metres per sensor metre: 1 for odometry, the grid's point scale factor
/// for poses on the map. `visit` gets the index of the scan and the point, metres.
///
/// # Errors
/// When a scan names an unknown sensor.
pub fn for_each_kept(
    scans: &[Scan],
    mounts: &[Mount],
    trajectory: &Trajectory,
    gate: &Gate,
    scale: f64,
    mut visit: impl FnMut(usize, [f64; 2]),
) -> Result<Dropped, Error> {
    let mut dropped = Dropped::default();
    for (index, scan) in scans.iter().enumerate() {
        let mount = mounts.get(scan.sensor).ok_or(Error::UnknownSensor {
            scan: index,
            sensor: scan.sensor,
            mounts: mounts.len(),
        })?;
        let rows = scan.len() as u64;
        let (Some(body), Some(velocity)) =
            (trajectory.at(scan.time_us), trajectory.velocity_at(scan.time_us))
        else {
            dropped.without_pose += rows;
            continue;
        };
        if velocity.speed_mps() < gate.min_speed_mps {
            dropped.too_slow += rows;
            continue;
        }
        for row in 0..scan.len() {
            if f64::from(scan.range_m[row]) > gate.max_range_m {
                dropped.too_far += 1;
            } else if is_mover(scan, row, mount, velocity, gate.max_doppler_residual_mps) {
                dropped.moving += 1;
            } else {
                let [x, y] = mount.transform(scan.sensor_point(row));
                visit(index, body.transform([scale * x, scale * y]));
            }
        }
    }
    Ok(dropped)
}

/// A batch: points in the frame of the body at the reference time.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Batch {
    /// Ground metres, x forward and y left of the body at the reference time.
    pub points: Vec<[f32; 2]>,
    /// Seconds from a point's scan to the reference time, one a point; negative when it came later.
    pub ages_s: Vec<f32>,
    /// Detections that were given.
    pub detections: u64,
    /// Detections that were left out.
    pub dropped: Dropped,
    /// Seconds from the oldest scan to the newest.
    pub duration_s: f64,
    /// Metres travelled between them.
    pub travelled_m: f64,
    /// Speed over ground at the reference time, metres per second.
    pub speed_mps: f64,
}

impl Batch {
    /// Organises scans by odometry (paper, alg. fastGlobalAlign l. 4, in the frame of the newest pose).
    ///
    /// # Errors
    /// When a scan names an unknown sensor or the odometry does not cover the reference time.
    pub fn organise(
        scans: &[Scan],
        mounts: &[Mount],
        odometry: &Trajectory,
        reference_time_us: i64,
        gate: &Gate,
    ) -> Result<Self, Error> {
        let outside = Error::ReferenceOutsideOdometry { reference_time_us };
        let reference = odometry.at(reference_time_us).ok_or(outside)?;
        let to_body = reference.inverse();
        let rows = scans.iter().map(Scan::len).sum();
        let (mut points, mut ages_s) = (Vec::with_capacity(rows), Vec::with_capacity(rows));
        let dropped = for_each_kept(scans, mounts, odometry, gate, 1.0, |scan, point| {
            let [x, y] = to_body.transform(point);
            points.push([x as f32, y as f32]);
            ages_s.push(((reference_time_us - scans[scan].time_us) as f64 * 1e-6) as f32);
        })?;
        let speed_mps = odometry.velocity_at(reference_time_us).map_or(0.0, |v| v.speed_mps());
        let (duration_s, travelled_m) = extent(scans, odometry);
        let detections = scans.iter().map(|s| s.len() as u64).sum();
        Ok(Self { points, ages_s, detections, dropped, duration_s, travelled_m, speed_mps })
    }
}

/// Seconds between the oldest and the newest scan, and metres travelled between them.
fn extent(scans: &[Scan], odometry: &Trajectory) -> (f64, f64) {
    let times = || scans.iter().map(|s| s.time_us);
    let (Some(first), Some(last)) = (times().min(), times().max()) else { return (0.0, 0.0) };
    let inside = odometry.iter().filter(|(t, _)| (first..=last).contains(t)).map(|(_, pose)| pose);
    let way: Vec<Pose2> = odometry.at(first).into_iter().chain(inside).chain(odometry.at(last)).collect();
    let travelled_m = way.windows(2).map(|w| w[0].distance_m(&w[1])).sum();
    ((last - first) as f64 * 1e-6, travelled_m)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn straight(speed_mps: f64) -> Trajectory {
        Trajectory::new(
            (0..=100).map(|i| (i * 50_000, Pose2::new(5.0 + speed_mps * i as f64 * 0.05, 7.0, 0.0))),
        )
        .unwrap()
    }

    /// A pole at odometry (30, 10), seen from everywhere.
    fn pole_scan(time_us: i64, odometry: &Trajectory) -> Scan {
        let body = odometry.at(time_us).unwrap();
        let [x, y] = body.inverse().transform([30.0, 10.0]);
        let (range, azimuth) = (x.hypot(y) as f32, y.atan2(x) as f32);
        Scan { time_us, range_m: vec![range, 70.0], azimuth_rad: vec![azimuth, 0.0], ..Scan::default() }
    }

    #[test]
    fn a_pole_seen_many_times_is_one_place_in_the_newest_frame() {
        let odometry = straight(4.0);
        let scans: Vec<_> = (0..100).map(|i| pole_scan(i * 50_000, &odometry)).collect();
        let batch =
            Batch::organise(&scans, &[Mount::IDENTITY], &odometry, 99 * 50_000, &Gate::default()).unwrap();
        let end = odometry.at(99 * 50_000).unwrap();
        assert_eq!(batch.points.len(), 100);
        assert_eq!(batch.dropped, Dropped { too_far: 100, ..Dropped::default() });
        for [x, y] in &batch.points {
            assert!((f64::from(*x) - (30.0 - end.x_m)).abs() < 1e-4 && (f64::from(*y) - 3.0).abs() < 1e-4);
        }
        for (i, age_s) in batch.ages_s.iter().enumerate() {
            assert!((age_s - (99 - i) as f32 * 0.05).abs() < 1e-6, "point {i} is {age_s} s old");
        }
        assert_eq!(batch.ages_s.len(), batch.points.len());
        assert!((batch.duration_s - 4.95).abs() < 1e-9 && (batch.travelled_m - 19.8).abs() < 1e-9);
        assert!((batch.speed_mps - 4.0).abs() < 1e-9);
    }

    #[test]
    fn slow_scans_and_scans_without_pose_are_left_out_and_counted() {
        let odometry = straight(0.5);
        let mut scans = vec![pole_scan(1_000_000, &odometry)];
        scans.push(Scan { time_us: 99_000_000, ..scans[0].clone() });
        let batch =
            Batch::organise(&scans, &[Mount::IDENTITY], &odometry, 1_000_000, &Gate::default()).unwrap();
        assert!(batch.points.is_empty());
        assert_eq!(batch.dropped, Dropped { too_slow: 2, without_pose: 2, ..Dropped::default() });
        assert_eq!(batch.dropped.total(), batch.detections);
    }

    #[test]
    fn unknown_sensors_and_uncovered_times_are_errors() {
        let odometry = straight(4.0);
        let mut scan = pole_scan(1_000_000, &odometry);
        scan.sensor = 3;
        let organise =
            |scans: &[Scan], t| Batch::organise(scans, &[Mount::IDENTITY], &odometry, t, &Gate::default());
        assert!(matches!(organise(&[scan], 0), Err(Error::UnknownSensor { sensor: 3, .. })));
        assert!(matches!(organise(&[], -5), Err(Error::ReferenceOutsideOdometry { .. })));
    }
}
