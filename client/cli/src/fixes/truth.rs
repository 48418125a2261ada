//! Known poses, interpolated.

use echofix_core::drive::GeoPose;
use echofix_core::geo::Grid;
use echofix_core::odometry::Trajectory;

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
}
