//! The local plane the filter works in.

use echofix_core::geo::{self, Grid, LatLon, Zone};
use echofix_core::pose::Pose2;

/// How far from its origin a plane is asked for poses, degrees of latitude and of longitude.
const REACH_DEG: f64 = 10.0;

/// A plane of ground metres that touches the globe at its origin: x true east, y true north there.
///
/// It is the UTM grid of the origin's zone, moved, turned and scaled; so it knows no zone border,
/// and its scale is off by less than 2e-5 two kilometres out.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct LocalPlane {
    zone: Zone,
    at: LatLon,
    /// The origin on the grid, facing true east.
    origin: Pose2,
    /// Grid metres a ground metre.
    scale: f64,
}

impl LocalPlane {
    /// The plane around a position.
    ///
    /// # Errors
    /// When the position is outside UTM.
    pub(super) fn around(at: LatLon) -> Result<Self, geo::Error> {
        let grid = Grid::of(at)?;
        let origin = grid.pose_from_geodetic(at, 0.0)?;
        Ok(Self { zone: grid.zone(), at, origin, scale: grid.scale_factor(at)? })
    }

    /// Whether a position lies where the projection can be relied on.
    pub(super) fn reaches(&self, at: LatLon) -> bool {
        let turned_deg = (at.lon_deg - self.at.lon_deg + 180.0).rem_euclid(360.0) - 180.0;
        (at.lat_deg - self.at.lat_deg).abs() <= REACH_DEG && turned_deg.abs() <= REACH_DEG
    }

    /// The pose in the plane of a position and a heading counter-clockwise from true east.
    ///
    /// # Errors
    /// When the projection has no answer there.
    pub(super) fn local(&self, at: LatLon, yaw_rad: f64) -> Result<Pose2, geo::Error> {
        let on_grid = Grid::new(self.zone)?.pose_from_geodetic(at, yaw_rad)?;
        let Pose2 { x_m, y_m, yaw_rad } = self.origin.between(&on_grid);
        Ok(Pose2::new(x_m / self.scale, y_m / self.scale, yaw_rad))
    }

    /// The position and the heading counter-clockwise from true east of a pose in the plane.
    ///
    /// # Errors
    /// When the projection has no answer there.
    pub(super) fn geodetic(&self, pose: &Pose2) -> Result<(LatLon, f64), geo::Error> {
        let on_grid = Pose2::new(self.scale * pose.x_m, self.scale * pose.y_m, pose.yaw_rad);
        Grid::new(self.zone)?.pose_to_geodetic(&self.origin.compose(&on_grid))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn poses_go_to_the_globe_and_back(
            lat_deg in -75.0..75.0_f64, lon_deg in -180.0..180.0_f64,
            x_m in -3e3..3e3, y_m in -3e3..3e3, yaw_rad in -3.1..3.1,
        ) {
            let frame = LocalPlane::around(LatLon { lat_deg, lon_deg }).unwrap();
            let pose = Pose2::new(x_m, y_m, yaw_rad);
            let (at, true_yaw_rad) = frame.geodetic(&pose).unwrap();
            let back = frame.local(at, true_yaw_rad).unwrap();
            prop_assert!(back.distance_m(&pose) < 1e-3 && (back.yaw_rad - yaw_rad).abs() < 1e-9, "{back:?}");
        }

        #[test]
        fn planes_of_two_zones_agree_on_a_way(lat_deg in -70.0..70.0_f64, dx in -2e3..2e3, dy in -2e3..2e3) {
            // Two origins a metre apart on either side of the border of zones 31 and 32.
            let west = LocalPlane::around(LatLon { lat_deg, lon_deg: 5.999_99 }).unwrap();
            let east = LocalPlane::around(LatLon { lat_deg, lon_deg: 6.0 }).unwrap();
            let step = east.local(west.geodetic(&Pose2::IDENTITY).unwrap().0, 0.0).unwrap();
            let (at, yaw_rad) = west.geodetic(&Pose2::new(dx, dy, 0.3)).unwrap();
            let seen = step.between(&east.local(at, yaw_rad).unwrap());
            prop_assert!((seen.x_m - dx).hypot(seen.y_m - dy) < 0.1, "{seen:?}");
            prop_assert!((seen.yaw_rad - 0.3).abs() < 1e-4, "{seen:?}");
        }
    }
}
