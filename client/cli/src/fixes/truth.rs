//! Known poses, interpolated.

use echofix_core::drive::GeoPose;
use echofix_core::geo::{self, Grid, LatLon};
use echofix_core::odometry::Trajectory;
use echofix_proto::v1::GeodeticPose;

/// Known poses, interpolated on the grid.
pub(super) struct Truth {
    pub(super) grid: Grid,
    poses: Trajectory,
    sigmas: (f64, f64),
}

impl Truth {
    pub(super) fn new(poses: &[GeoPose]) -> anyhow::Result<Option<Self>> {
        let Some(first) = poses.first() else { return Ok(None) };
        let grid = Grid::of(first.at)?;
        let on_grid = |p: &GeoPose| Ok((p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad)?));
        let placed: Vec<_> = poses.iter().map(on_grid).collect::<anyhow::Result<_>>()?;
        let sigmas = (first.sigma_position_m, first.sigma_yaw_rad);
        Ok(Some(Self { poses: Trajectory::new(placed)?, grid, sigmas }))
    }

    pub(super) fn at(&self, time_us: i64) -> Option<GeoPose> {
        let pose = self.poses.at(time_us)?;
        let (at, yaw_rad) = self.grid.pose_to_geodetic(&pose).ok()?;
        let (sigma_position_m, sigma_yaw_rad) = self.sigmas;
        Some(GeoPose { time_us, at, yaw_rad, sigma_position_m, sigma_yaw_rad })
    }

    /// Error of an answer along and across the true heading, ground metres, and of its heading,
    /// radians.
    pub(super) fn error(&self, answer: &GeodeticPose, truth: &GeoPose) -> Result<[f64; 3], geo::Error> {
        let at = LatLon { lat_deg: answer.latitude_deg, lon_deg: answer.longitude_deg };
        let answered = self.grid.pose_from_geodetic(at, answer.yaw_rad)?;
        let off = self.grid.pose_from_geodetic(truth.at, truth.yaw_rad)?.between(&answered);
        let scale = self.grid.scale_factor(truth.at)?;
        Ok([off.x_m / scale, off.y_m / scale, off.yaw_rad])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn errors_are_split_along_and_across_the_heading() {
        let at = LatLon { lat_deg: 60.0, lon_deg: 10.0 };
        let pose = GeoPose { at, yaw_rad: std::f64::consts::FRAC_PI_2, ..GeoPose::default() };
        let truth = Truth::new(&[pose]).unwrap().unwrap();
        // One metre north of a vehicle heading north, half a metre east: at 60 degrees a degree of
        // latitude is 111 412 m, one of longitude 55 800 m.
        let answer = GeodeticPose {
            latitude_deg: 60.0 + 1.0 / 111_412.0,
            longitude_deg: 10.0 + 0.5 / 55_800.0,
            yaw_rad: pose.yaw_rad + 0.01,
        };
        let [along, cross, yaw] = truth.error(&answer, &pose).unwrap();
        assert!((along - 1.0).abs() < 1e-4 && (cross + 0.5).abs() < 1e-4, "{along} {cross}");
        assert!((yaw - 0.01).abs() < 1e-6);
    }
}
