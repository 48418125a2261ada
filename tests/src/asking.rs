//! A drive asks where it is; errors against the truth, percentiles.

use echofix_client::drivelog::{DriveEvent, replay};
use echofix_client::vehicle::{Vehicle, VehicleConfig};
use echofix_core::drive::{Drive, GeoPose};
use echofix_core::geo::Grid;
use echofix_core::odometry::Trajectory;
use echofix_core::pose::{Pose2, wrap_angle};
use echofix_proto::v1::{GeodeticPose, LocalizeRequest, Prior};
use echofix_sim::rng::normal;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// One-sigma error of a rough pose: metres along each axis, and radians.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Sigma {
    /// Metres.
    pub position_m: f64,
    /// Radians.
    pub yaw_rad: f64,
}

impl Sigma {
    /// What the paper's priors have (Sec. "Test procedure"): 2 m and 3 degrees.
    pub const PAPER: Self = Self { position_m: 2.0, yaw_rad: 3.0 * std::f64::consts::PI / 180.0 };
}

/// A question, and the pose that would be the right answer.
#[derive(Debug, Clone)]
pub struct Case {
    /// The question.
    pub request: LocalizeRequest,
    /// The truth at the time asked for.
    pub truth: GeoPose,
}

/// The questions of a drive, one every so many seconds, from priors drawn around the truth.
pub fn cases(drive: &Drive, every_s: f64, sigma: Sigma, seed: u64) -> Vec<Case> {
    let truth = Truth::of(drive);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut vehicle = Vehicle::new(VehicleConfig::default(), drive.mounts.clone());
    let begin_us = drive.scans.first().expect("the drive has scans").time_us;
    let (mut cases, mut next_us) = (Vec::new(), begin_us + 5_000_000);
    for event in replay(drive) {
        match event {
            DriveEvent::Scan(scan) => vehicle.push_scan(scan.clone()).expect("a simulated scan is sound"),
            DriveEvent::Odometry(now_us, pose) => {
                vehicle.push_odometry(now_us, pose).expect("odometry is in order");
                if now_us < next_us {
                    continue;
                }
                next_us = now_us + (every_s * 1e6) as i64;
                cases.extend(
                    truth.at(now_us).and_then(|now| case(&mut vehicle, now, &truth, sigma, &mut rng)),
                );
            }
            DriveEvent::Reference(_) | DriveEvent::Truth(_) => {}
        }
    }
    cases
}

/// A question now, unless the vehicle stands.
fn case(
    vehicle: &mut Vehicle,
    now: GeoPose,
    truth: &Truth,
    sigma: Sigma,
    rng: &mut ChaCha8Rng,
) -> Option<Case> {
    vehicle.forget_position();
    vehicle.push_pose(now).expect("the truth is a pose");
    let question = vehicle.question().ok()?;
    let truth_then = truth.at(question.time_us())?;
    let prior = truth.rough(&truth_then, sigma, rng);
    Some(Case { request: LocalizeRequest { prior: Some(prior), ..question.request }, truth: truth_then })
}

/// Where the vehicle of a drive really was.
pub struct Truth {
    grid: Grid,
    poses: Trajectory,
}

impl Truth {
    /// The truth of a simulated drive.
    pub fn of(drive: &Drive) -> Self {
        let first = drive.truth.first().expect("the drive has truth");
        let grid = Grid::of(first.at).expect("the drive is on the map");
        let on_grid =
            |p: &GeoPose| (p.time_us, grid.pose_from_geodetic(p.at, p.yaw_rad).expect("on the map"));
        let poses = Trajectory::new(drive.truth.iter().map(on_grid)).expect("truth is in order");
        Self { grid, poses }
    }

    /// The pose at a time of the drive.
    pub fn at(&self, time_us: i64) -> Option<GeoPose> {
        let (at, yaw_rad) = self.grid.pose_to_geodetic(&self.poses.at(time_us)?).expect("on the map");
        Some(GeoPose { time_us, at, yaw_rad, ..GeoPose::default() })
    }

    /// A prior drawn around a pose.
    pub fn rough(&self, pose: &GeoPose, sigma: Sigma, rng: &mut ChaCha8Rng) -> Prior {
        let GeoPose { at, yaw_rad, .. } = self.off(pose, sigma, rng);
        Prior {
            pose: Some(GeodeticPose { latitude_deg: at.lat_deg, longitude_deg: at.lon_deg, yaw_rad }),
            sigma_position_m: sigma.position_m,
            sigma_yaw_rad: sigma.yaw_rad,
            ..Prior::default()
        }
    }

    /// A pose drawn around another, as GNSS would give it.
    pub fn off(&self, pose: &GeoPose, sigma: Sigma, rng: &mut ChaCha8Rng) -> GeoPose {
        let exact = self.grid.pose_from_geodetic(pose.at, pose.yaw_rad).expect("on the map");
        let drawn = Pose2::new(
            exact.x_m + normal(rng, sigma.position_m),
            exact.y_m + normal(rng, sigma.position_m),
            exact.yaw_rad + normal(rng, sigma.yaw_rad),
        );
        let (at, yaw_rad) = self.grid.pose_to_geodetic(&drawn).expect("on the map");
        let Sigma { position_m: sigma_position_m, yaw_rad: sigma_yaw_rad } = sigma;
        GeoPose { time_us: pose.time_us, at, yaw_rad, sigma_position_m, sigma_yaw_rad }
    }
}

/// How far a pose is from the truth.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Error {
    /// Along the true heading, metres.
    pub along_m: f64,
    /// Across it, to the left, metres.
    pub cross_m: f64,
    /// Of the heading, radians.
    pub yaw_rad: f64,
}

impl Error {
    /// The error of a pose. Over some metres the globe is a plane.
    pub fn of(pose: &GeodeticPose, truth: &GeoPose) -> Self {
        // Metres of a degree on the WGS-84 ellipsoid at this latitude.
        let lat = truth.at.lat_deg.to_radians();
        let w = 1.0 - 6.694_379_990_14e-3 * lat.sin().powi(2);
        let per_degree = |radius_m: f64| radius_m * 1_f64.to_radians();
        let north_m = (pose.latitude_deg - truth.at.lat_deg) * per_degree(6_335_439.327 / w.powf(1.5));
        let east_m = (pose.longitude_deg - truth.at.lon_deg) * per_degree(6_378_137.0 / w.sqrt() * lat.cos());
        let (s, c) = truth.yaw_rad.sin_cos();
        Self {
            along_m: c * east_m + s * north_m,
            cross_m: c * north_m - s * east_m,
            yaw_rad: wrap_angle(pose.yaw_rad - truth.yaw_rad),
        }
    }

    /// Horizontal, metres.
    pub fn horizontal_m(&self) -> f64 {
        self.along_m.hypot(self.cross_m)
    }
}

/// The value that `share` of a sample is not above, by the nearest rank.
pub fn percentile(sample: impl IntoIterator<Item = f64>, share: f64) -> f64 {
    let mut sample: Vec<f64> = sample.into_iter().collect();
    assert!(!sample.is_empty(), "a percentile of nothing");
    sample.sort_by(f64::total_cmp);
    sample[((share * sample.len() as f64).ceil() as usize).clamp(1, sample.len()) - 1]
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::geo::LatLon;

    #[test]
    fn an_error_is_metres_along_and_across_the_heading() {
        let truth =
            GeoPose { at: LatLon { lat_deg: 51.0, lon_deg: 6.0 }, yaw_rad: 0.6, ..GeoPose::default() };
        let grid = Grid::of(truth.at).unwrap();
        let scale = grid.scale_factor(truth.at).unwrap();
        let exact = grid.pose_from_geodetic(truth.at, truth.yaw_rad).unwrap();
        let (at, yaw_rad) =
            grid.pose_to_geodetic(&exact.compose(&Pose2::new(3.0 * scale, scale, 0.1))).unwrap();
        let pose = GeodeticPose { latitude_deg: at.lat_deg, longitude_deg: at.lon_deg, yaw_rad };
        let Error { along_m, cross_m, yaw_rad } = Error::of(&pose, &truth);
        assert!((along_m - 3.0).abs() < 1e-4 && (cross_m - 1.0).abs() < 1e-4 && (yaw_rad - 0.1).abs() < 1e-6);
    }

    #[test]
    fn a_percentile_is_a_nearest_rank() {
        for (share, expected) in [(0.0, 1.0), (0.5, 100.0), (0.95, 190.0), (1.0, 200.0)] {
            assert!((percentile((1..=200).map(f64::from), share) - expected).abs() < f64::EPSILON, "{share}");
        }
    }
}
