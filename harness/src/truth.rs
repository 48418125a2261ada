//! Known poses, interpolated, and how far an answer is from them.

use echofix_core::drive::{Drive, GeoPose};
use echofix_core::geo::{self, Grid, LatLon};
use echofix_core::odometry::Trajectory;
use echofix_proto::v1::{GeodeticPose, Prior};
use rand_chacha::ChaCha8Rng;

use crate::prior::PriorSigma;

/// Known poses farther apart than this are not interpolated between, microseconds: where a vehicle was meanwhile is not known.
const MAX_GAP_US: i64 = 2_500_000;

/// Known poses, interpolated on the grid of the zone they begin in.
pub struct Truth {
    grid: Grid,
    poses: Trajectory,
    sigmas: (f64, f64),
}

impl Truth {
    /// Of a drive: its truth, or where it has none its reference poses; `None` without either.
    ///
    /// # Errors
    /// When the poses are not in order of time, or off the grid.
    pub fn of(drive: &Drive) -> anyhow::Result<Option<Self>> {
        Self::new(if drive.truth.is_empty() { &drive.reference } else { &drive.truth })
    }

    /// Of poses in order of time; `None` without any.
    ///
    /// # Errors
    /// When they are not in order, or off the grid.
    pub fn new(poses: &[GeoPose]) -> anyhow::Result<Option<Self>> {
        let Some(first) = poses.first() else { return Ok(None) };
        let grid = Grid::of(first.at)?;
        let on_grid = |p: &GeoPose| Ok((p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad)?));
        let on_grid: Vec<_> = poses.iter().map(on_grid).collect::<anyhow::Result<_>>()?;
        let sigmas = (first.sigma_position_m, first.sigma_yaw_rad);
        Ok(Some(Self { poses: Trajectory::new(on_grid)?, grid, sigmas }))
    }

    /// The pose at a time; `None` before the first and after the last one, and in a hole between them.
    pub fn at(&self, time_us: i64) -> Option<GeoPose> {
        if self.poses.len() > 1 {
            self.poses.velocity_within(time_us, MAX_GAP_US)?;
        }
        let pose = self.poses.at(time_us)?;
        let (at, yaw_rad) = self.grid.pose_to_geodetic(&pose).ok()?;
        let (sigma_position_m, sigma_yaw_rad) = self.sigmas;
        Some(GeoPose { time_us, at, yaw_rad, sigma_position_m, sigma_yaw_rad })
    }

    /// A pose drawn around another, as GNSS would give it.
    ///
    /// # Errors
    /// When it is off the grid.
    pub fn drawn_around(
        &self,
        pose: &GeoPose,
        sigma: PriorSigma,
        rng: &mut ChaCha8Rng,
    ) -> Result<GeoPose, geo::Error> {
        let exact = self.grid.pose_from_geodetic(pose.at, pose.yaw_rad)?;
        let (at, yaw_rad) = self.grid.pose_to_geodetic(&sigma.drawn_around(&exact, rng))?;
        let PriorSigma { position_m: sigma_position_m, yaw_rad: sigma_yaw_rad } = sigma;
        Ok(GeoPose { time_us: pose.time_us, at, yaw_rad, sigma_position_m, sigma_yaw_rad })
    }

    /// The error of an answered pose.
    ///
    /// # Errors
    /// When one of the poses is off the grid.
    pub fn error(&self, answer: &GeodeticPose, truth: &GeoPose) -> Result<AnswerError, geo::Error> {
        AnswerError::on(&self.grid, answer, truth)
    }
}

/// A drawn pose as the prior of a request.
pub fn as_prior(pose: &GeoPose) -> Prior {
    let LatLon { lat_deg, lon_deg } = pose.at;
    Prior {
        pose: Some(GeodeticPose { latitude_deg: lat_deg, longitude_deg: lon_deg, yaw_rad: pose.yaw_rad }),
        sigma_position_m: pose.sigma_position_m,
        sigma_yaw_rad: pose.sigma_yaw_rad,
        ..Prior::default()
    }
}

/// How far a pose is from the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AnswerError {
    /// Along the true heading, ground metres.
    pub along_m: f64,
    /// Across it, to the left, ground metres.
    pub cross_m: f64,
    /// Of the heading, radians.
    pub yaw_rad: f64,
}

impl AnswerError {
    /// The error of a pose, on the grid of the zone that the truth lies in.
    ///
    /// # Errors
    /// When one of the poses is off the grid.
    pub fn of(answer: &GeodeticPose, truth: &GeoPose) -> Result<Self, geo::Error> {
        Self::on(&Grid::of(truth.at)?, answer, truth)
    }

    fn on(grid: &Grid, answer: &GeodeticPose, truth: &GeoPose) -> Result<Self, geo::Error> {
        let at = LatLon { lat_deg: answer.latitude_deg, lon_deg: answer.longitude_deg };
        let answered = grid.pose_from_geodetic(at, answer.yaw_rad)?;
        let off = grid.pose_from_geodetic(truth.at, truth.yaw_rad)?.between(&answered);
        let scale = grid.scale_factor(truth.at)?;
        Ok(Self { along_m: off.x_m / scale, cross_m: off.y_m / scale, yaw_rad: off.yaw_rad })
    }

    /// Horizontal, metres.
    #[must_use]
    pub fn horizontal_m(&self) -> f64 {
        self.along_m.hypot(self.cross_m)
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
        let error = truth.error(&answer, &pose).unwrap();
        assert!((error.along_m - 1.0).abs() < 1e-4 && (error.cross_m + 0.5).abs() < 1e-4, "{error:?}");
        assert!((error.yaw_rad - 0.01).abs() < 1e-6);
        assert_eq!(AnswerError::of(&answer, &pose).unwrap(), error);
    }
}
