//! A known pose that odometry carries on.

use echofix_core::drive::GeoPose;
use echofix_core::geo::{self, Grid, LatLon};
use echofix_core::pose::Pose2;

use super::DriftModel;

/// Since when something is known, and how well it was then.
#[derive(Debug, Clone, Copy, PartialEq)]
struct Origin {
    time_us: i64,
    travelled_m: f64,
    sigma_position_m: f64,
    sigma_yaw_rad: f64,
}

/// A geodetic pose tied to the odometry pose of the same time.
///
/// Position and heading remember separately since when they are known: improving one must not make
/// the other's drift start over.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Anchor {
    pose: GeoPose,
    odometry: Pose2,
    position: Origin,
    heading: Origin,
}

impl Anchor {
    /// Knows a pose at the time of an odometry pose, `travelled_m` metres into the drive.
    pub(super) fn new(pose: GeoPose, (odometry, travelled_m): (Pose2, f64)) -> Self {
        let GeoPose { time_us, sigma_position_m, sigma_yaw_rad, .. } = pose;
        let origin = Origin { time_us, travelled_m, sigma_position_m, sigma_yaw_rad };
        Self { pose, odometry, position: origin, heading: origin }
    }

    /// The pose at another time, its sigmas grown by the way since each part became known.
    pub(super) fn carried(
        &self,
        time_us: i64,
        (odometry, travelled_m): (Pose2, f64),
        drift: &DriftModel,
    ) -> Result<GeoPose, geo::Error> {
        let moved = self.odometry.between(&odometry);
        let (at, yaw_rad) = displaced(self.pose.at, self.pose.yaw_rad, &moved)?;
        let way_m = |from: &Origin| (travelled_m - from.travelled_m).abs();
        let Origin { sigma_position_m, sigma_yaw_rad, .. } = self.position;
        let sigma_position_m = drift.position_m(sigma_position_m, sigma_yaw_rad, way_m(&self.position));
        let elapsed_s = (time_us - self.heading.time_us).abs() as f64 * 1e-6;
        let sigma_yaw_rad = drift.yaw_rad(self.heading.sigma_yaw_rad, way_m(&self.heading), elapsed_s);
        Ok(GeoPose { time_us, at, yaw_rad, sigma_position_m, sigma_yaw_rad })
    }

    /// With another pose: of it and the pose carried to its time, the better known position and the
    /// better known heading.
    pub(super) fn improved(
        &self,
        other: GeoPose,
        odometry: (Pose2, f64),
        drift: &DriftModel,
    ) -> Result<Self, geo::Error> {
        let mut best = self.carried(other.time_us, odometry, drift)?;
        let nearer = other.sigma_position_m < best.sigma_position_m;
        let straighter = other.sigma_yaw_rad < best.sigma_yaw_rad;
        if nearer {
            (best.at, best.sigma_position_m) = (other.at, other.sigma_position_m);
        }
        if straighter {
            (best.yaw_rad, best.sigma_yaw_rad) = (other.yaw_rad, other.sigma_yaw_rad);
        }
        let fresh = Self::new(best, odometry);
        let position = if nearer { fresh.position } else { self.position };
        let heading = if straighter { fresh.heading } else { self.heading };
        Ok(Self { position, heading, ..fresh })
    }
}

/// The position and true heading after a motion given in ground metres of the body's own frame.
fn displaced(at: LatLon, yaw_rad: f64, moved: &Pose2) -> Result<(LatLon, f64), geo::Error> {
    let grid = Grid::of(at)?;
    let scale = grid.scale_factor(at)?;
    let moved = Pose2::new(scale * moved.x_m, scale * moved.y_m, moved.yaw_rad);
    grid.pose_to_geodetic(&grid.pose_from_geodetic(at, yaw_rad)?.compose(&moved))
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::FRAC_PI_2;

    #[test]
    fn a_fix_is_carried_in_true_metres_along_the_true_heading() {
        // North along a meridian far from the zone's central one, where the grid is both turned
        // and stretched. 1 degree of latitude at 60 degrees north is 111 412 m (WGS-84).
        let pose = GeoPose {
            time_us: 0,
            at: LatLon { lat_deg: 60.0, lon_deg: 11.5 },
            yaw_rad: FRAC_PI_2,
            ..GeoPose::default()
        };
        let start = Pose2::new(5.0, 5.0, 0.3);
        let anchor = Anchor::new(pose, (start, 10.0));
        let now = start.compose(&Pose2::new(1000.0, 0.0, 0.0));
        let carried = anchor.carried(1, (now, 1010.0), &DriftModel::default()).unwrap();
        let north_m = (carried.at.lat_deg - 60.0) * 111_412.0;
        let east_m = (carried.at.lon_deg - 11.5) * 55_800.0;
        assert!((north_m - 1000.0).abs() < 0.2 && east_m.abs() < 0.05, "{north_m} {east_m}");
        assert!((carried.yaw_rad - FRAC_PI_2).abs() < 1e-5);
    }

    fn known(time_us: i64, yaw_rad: f64, sigma_position_m: f64, sigma_yaw_rad: f64) -> GeoPose {
        GeoPose { time_us, yaw_rad, sigma_position_m, sigma_yaw_rad, ..GeoPose::default() }
    }

    #[test]
    fn the_better_known_part_of_each_pose_is_kept() {
        let here = (Pose2::IDENTITY, 0.0);
        let anchor = Anchor::new(known(0, 0.1, 2.0, 0.01), here);
        let best = anchor.improved(known(0, 0.2, 1.0, 0.05), here, &DriftModel::default()).unwrap();
        assert_eq!((best.pose.sigma_position_m, best.pose.sigma_yaw_rad), (1.0, 0.01));
        assert!((best.pose.yaw_rad - 0.1).abs() < 1e-9);
    }

    #[test]
    fn poor_poses_do_not_stop_the_drift() {
        let drift = DriftModel::default();
        let anchor = Anchor::new(known(0, 0.0, 0.1, 0.001), (Pose2::IDENTITY, 0.0));
        let mut helped = anchor;
        for i in 1..=1000_i64 {
            let here = (Pose2::new(i as f64, 0.0, 0.0), i as f64);
            helped = helped.improved(known(i * 100_000, 0.0, 100.0, 1.0), here, &drift).unwrap();
        }
        let end = (Pose2::new(1000.0, 0.0, 0.0), 1000.0);
        let alone = anchor.carried(100_000_000, end, &drift).unwrap();
        let helped = helped.carried(100_000_000, end, &drift).unwrap();
        assert!(
            (helped.sigma_position_m - alone.sigma_position_m).abs() < 1e-9 && alone.sigma_position_m > 20.0
        );
        assert!((helped.sigma_yaw_rad - alone.sigma_yaw_rad).abs() < 1e-12);
    }
}
