//! The vehicle's own velocity from the radial speeds of what stands still.
//!
//! A stationary detection in the direction `d` from a sensor at `p` on the body shows the radial
//! speed `-d . (v + yaw_rate x p)`: linear in (forward, left, yaw rate). One radar alone cannot tell
//! the yaw rate from sliding sideways; radars with levers of several metres can, and so can a body
//! whose origin hardly slides (the rear axle), which is why that is a prior.

use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::odometry::BodyVelocity;
use crate::scan::{Mount, ScanView};

/// How the own velocity is estimated.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EgoConfig {
    /// One-sigma error of a radial speed, what the error of its azimuth does to it included, metres
    /// per second.
    pub sigma_mps: f64,
    /// Detections that differ more from a hypothesis move, or are clutter, metres per second.
    pub inlier_mps: f64,
    /// One-sigma speed of the body's origin to its side, metres per second. The default is for an
    /// origin on the rear axle; infinite where nothing is known.
    pub sigma_left_mps: f64,
    /// One-sigma error of a mount's yaw, radians, as far as it is known: all detections of a radar turn with it.
    pub mount_yaw_rad: f64,
    /// One-sigma error of the azimuth that grows with it, as a fraction.
    pub azimuth_gain: f64,
    /// One-sigma error of the radial speed that grows with it, as a fraction: what stands higher than the radar
    /// is approached more slowly.
    pub speed_gain: f64,
    /// Velocities tried, each through three detections.
    pub hypotheses: usize,
    /// Estimates on fewer stationary detections are none.
    pub min_inliers: usize,
    /// Estimates on a smaller fraction of all detections are none.
    pub min_share: f64,
    /// Seed of the draws.
    pub seed: u64,
}

impl Default for EgoConfig {
    fn default() -> Self {
        Self {
            sigma_mps: 0.15,
            inlier_mps: 0.45,
            sigma_left_mps: 0.02,
            mount_yaw_rad: 0.5_f64.to_radians(),
            azimuth_gain: 0.005,
            speed_gain: 0.003,
            hypotheses: 40,
            min_inliers: 12,
            min_share: 0.4,
            seed: 1,
        }
    }
}

/// The own velocity, and how well it is known.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct EgoVelocity {
    /// Velocity of the body's origin in the body frame.
    pub velocity: BodyVelocity,
    /// Covariance of (forward m/s, left m/s, yaw rate rad/s).
    pub covariance: Matrix3<f64>,
    /// Detections that stand still.
    pub inliers: usize,
    /// Detections with a radial speed.
    pub detections: usize,
}

/// One detection's equation: `row . velocity = towards_mps`.
pub(super) struct Equation {
    /// Index of the radar.
    pub sensor: usize,
    /// By (forward, left, yaw rate) of the body.
    pub row: Vector3<f64>,
    /// By how much the row changes when the detection's direction turns, a radian.
    pub turning: Vector3<f64>,
    /// Direction from the boresight, radians.
    pub azimuth_rad: f64,
    /// Speed towards the sensor, metres per second.
    pub towards_mps: f64,
}

/// What stands still, and the own velocity by it.
pub(super) struct Standing {
    pub velocity: EgoVelocity,
    /// Detections that stand still.
    pub equations: Vec<Equation>,
}

/// Estimates the own velocity from scans of about one time (random sample consensus, then least
/// squares over what agrees). `None` without enough stationary detections, and of scans of a radar that
/// is not mounted.
#[must_use]
pub fn ego_velocity<'a, S>(scans: S, mounts: &[Mount], config: &EgoConfig) -> Option<EgoVelocity>
where
    S: IntoIterator<Item: Into<ScanView<'a>>>,
{
    standing(scans, mounts, config).map(|standing| standing.velocity)
}

/// The same, with what the estimate rests on.
pub(super) fn standing<'a, S>(scans: S, mounts: &[Mount], config: &EgoConfig) -> Option<Standing>
where
    S: IntoIterator<Item: Into<ScanView<'a>>>,
{
    let mut equations = Vec::new();
    for scan in scans.into_iter().map(Into::into) {
        let mount = mounts.get(scan.sensor)?;
        equations.extend(equations_of(&scan, mount));
    }
    if equations.len() < config.min_inliers.max(3) {
        return None;
    }
    let mut velocity = consensus(&equations, config)?;
    let mut fit = None;
    // What agrees with the first fit is more than what agreed with three detections.
    for _ in 0..2 {
        let inliers = equations.iter().filter(|e| e.residual(&velocity).abs() <= config.inlier_mps);
        fit = Fit::of(inliers, config);
        velocity = fit.as_ref()?.velocity;
    }
    let fit = fit?;
    let least = (config.min_share * equations.len() as f64).max(config.min_inliers as f64);
    let found = EgoVelocity {
        velocity: BodyVelocity { forward_mps: velocity.x, left_mps: velocity.y, yaw_rate_radps: velocity.z },
        covariance: fit.covariance,
        inliers: fit.inliers,
        detections: equations.len(),
    };
    equations.retain(|e| e.residual(&velocity).abs() <= config.inlier_mps);
    (fit.inliers as f64 >= least).then_some(Standing { velocity: found, equations })
}

fn equations_of<'a>(scan: &ScanView<'a>, mount: &Mount) -> impl Iterator<Item = Equation> + use<'a> {
    let (Mount { x_m, y_m, yaw_rad }, sensor) = (*mount, scan.sensor);
    let measured = scan.azimuth_rad.iter().zip(scan.radial_speed_mps);
    measured.map(move |(azimuth, radial_speed)| {
        let (s, c) = (yaw_rad + f64::from(*azimuth)).sin_cos();
        Equation {
            sensor,
            row: Vector3::new(c, s, x_m * s - y_m * c),
            turning: Vector3::new(-s, c, x_m * c + y_m * s),
            azimuth_rad: f64::from(*azimuth),
            towards_mps: -f64::from(*radial_speed),
        }
    })
}

impl Equation {
    pub(super) fn residual(&self, velocity: &Vector3<f64>) -> f64 {
        self.towards_mps - self.row.dot(velocity)
    }
}

/// The velocity through three detections that most others agree with.
fn consensus(equations: &[Equation], config: &EgoConfig) -> Option<Vector3<f64>> {
    let mut rng = ChaCha8Rng::seed_from_u64(config.seed);
    let mut best = (0, None);
    for _ in 0..config.hypotheses {
        let three = [0; 3].map(|_: i32| &equations[rng.random_range(0..equations.len())]);
        let Some(fit) = Fit::of(three, config) else { continue };
        let agrees = |e: &&Equation| e.residual(&fit.velocity).abs() <= config.inlier_mps;
        let count = equations.iter().filter(agrees).count();
        if count > best.0 {
            best = (count, Some(fit.velocity));
        }
    }
    best.1
}

/// Least squares over some equations and the prior of the speed sideways.
struct Fit {
    velocity: Vector3<f64>,
    covariance: Matrix3<f64>,
    inliers: usize,
}

impl Fit {
    fn of<'a>(equations: impl IntoIterator<Item = &'a Equation>, config: &EgoConfig) -> Option<Self> {
        /// No car turns faster; it only keeps three detections of one radar solvable. Radians per second.
        const MAX_YAW_RATE: f64 = 2.0;
        let weight = config.sigma_mps.powi(-2);
        let mut information =
            Matrix3::from_diagonal(&Vector3::new(0.0, config.sigma_left_mps.powi(-2), MAX_YAW_RATE.powi(-2)));
        let (mut sum, mut squares, mut inliers) = (Vector3::zeros(), 0.0, 0_usize);
        for Equation { row, towards_mps, .. } in equations {
            information += weight * row * row.transpose();
            sum += weight * *towards_mps * row;
            squares += weight * towards_mps * towards_mps;
            inliers += 1;
        }
        let inverse = information.cholesky()?.inverse();
        let velocity = inverse * sum;
        // The residuals show errors larger than stated; smaller ones are luck.
        let spread = (squares - velocity.dot(&sum)) / inliers.saturating_sub(3).max(1) as f64;
        Some(Self { velocity, covariance: inverse * spread.max(1.0), inliers })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doppler::static_radial_speed;
    use crate::scan::Scan;
    use proptest::prelude::*;

    /// Ahead, and at both corners of the nose.
    fn mounts() -> [Mount; 3] {
        [Mount::new(3.6, 0.0, 0.0), Mount::new(3.4, 0.7, 0.8), Mount::new(3.4, -0.7, -0.8)]
    }

    /// A scan of each radar: `still` stationary detections of small error each, then movers.
    fn scans(v: BodyVelocity, still: usize, movers: usize, rng: &mut ChaCha8Rng) -> Vec<Scan> {
        let scan = |(sensor, mount): (usize, &Mount)| {
            let mut scan = Scan { sensor, ..Scan::default() };
            for row in 0..still + movers {
                let azimuth = rng.random_range(-0.8..0.8_f64);
                let error =
                    if row < still { rng.random_range(-0.1..0.1) } else { rng.random_range(3.0..9.0) };
                scan.range_m.push(20.0);
                scan.azimuth_rad.push(azimuth as f32);
                scan.radial_speed_mps.push((static_radial_speed(mount, v, azimuth) + error) as f32);
            }
            scan
        };
        mounts().iter().enumerate().map(scan).collect()
    }

    proptest! {
        #[test]
        fn the_velocity_is_found_among_movers_within_its_covariance(
            forward_mps in 1.0..30.0_f64, yaw_rate_radps in -0.6..0.6_f64, seed: u64,
        ) {
            let v = BodyVelocity { forward_mps, yaw_rate_radps, ..BodyVelocity::default() };
            let scans = scans(v, 20, 10, &mut ChaCha8Rng::seed_from_u64(seed));
            let found = ego_velocity(&scans, &mounts(), &EgoConfig::default()).unwrap();
            let off = Vector3::new(
                found.velocity.forward_mps - forward_mps,
                found.velocity.left_mps,
                found.velocity.yaw_rate_radps - yaw_rate_radps,
            );
            prop_assert!(found.inliers >= 60 && found.detections == 90, "{found:?}");
            // Errors within +-0.1 have a sigma of 0.06, less than half of what is assumed.
            let sigmas = off.dot(&(found.covariance.cholesky().unwrap().inverse() * off)).sqrt();
            prop_assert!(sigmas < 3.0, "{off:?} is {sigmas} sigma off");
        }
    }

    #[test]
    fn the_same_scans_give_the_same_velocity() {
        let v = BodyVelocity { forward_mps: 8.0, ..BodyVelocity::default() };
        let scans = scans(v, 20, 15, &mut ChaCha8Rng::seed_from_u64(3));
        let found = || ego_velocity(&scans, &mounts(), &EgoConfig::default());
        assert!(found().is_some());
        assert_eq!(found(), found());
    }

    #[test]
    fn too_little_that_stands_still_is_no_velocity() {
        let v = BodyVelocity { forward_mps: 8.0, ..BodyVelocity::default() };
        let config = EgoConfig::default();
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        assert_eq!(ego_velocity(&scans(v, 3, 0, &mut rng), &mounts(), &config), None);
        let mut silent = scans(v, 20, 0, &mut rng);
        for scan in &mut silent {
            scan.radial_speed_mps.clear();
        }
        assert_eq!(ego_velocity(&silent, &mounts(), &config), None);
        let unknown = Scan { sensor: 9, ..scans(v, 20, 0, &mut rng)[0].clone() };
        assert_eq!(ego_velocity([&unknown], &mounts(), &config), None);
    }
}
