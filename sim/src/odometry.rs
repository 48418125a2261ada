//! What a vehicle's odometry says: the true trajectory with bias and drift.

use echofix_core::odometry::Trajectory;
use echofix_core::pose::Pose2;
use rand_chacha::ChaCha8Rng;

use crate::error::Error;
use crate::rng::{Purpose, normal, stream};

/// How odometry errs.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum OdometryModel {
    /// Not at all.
    Perfect,
    /// Integrated speed and yaw rate with small biases: what cars have.
    DeadReckoning(DeadReckoning),
    /// The paper's models of drift, drawn anew for every stretch of the drift's horizon.
    Drift(Drift),
}

impl Default for OdometryModel {
    fn default() -> Self {
        Self::DeadReckoning(DeadReckoning::default())
    }
}

/// One-sigma errors of integrated speed and yaw rate; biases are drawn once a drive.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DeadReckoning {
    /// Fraction by which distances are wrong.
    pub scale: f64,
    /// Constant error of the yaw rate, radians per second.
    pub gyro_bias_radps: f64,
    /// Random walk of the position, metres per square root of a metre driven.
    pub walk_m: f64,
    /// Random walk of the yaw, radians per square root of a second.
    pub walk_rad: f64,
}

impl Default for DeadReckoning {
    fn default() -> Self {
        Self {
            scale: 0.005,
            gyro_bias_radps: 0.02_f64.to_radians(),
            walk_m: 0.005,
            walk_rad: 0.02_f64.to_radians(),
        }
    }
}

/// Drift of known size at the end of a horizon (paper, Sec. "Sensitivity to Odometric Drift").
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Drift {
    /// One-sigma error of the position along each axis at the end of the horizon, metres.
    pub sigma_position_m: f64,
    /// One-sigma error of the yaw at the end of the horizon, radians; it grows linearly.
    pub sigma_yaw_rad: f64,
    /// Seconds.
    pub horizon_s: f64,
    /// How the error of the position grows.
    pub growth: Growth,
}

/// How an error grows with time.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Growth {
    /// A biased speed is integrated.
    Linear,
    /// A biased acceleration is integrated twice.
    Quadratic,
}

impl Drift {
    /// The paper's (position, heading) levels at the end of 5 s: metres and degrees.
    pub const PAPER_LEVELS: [(f64, f64); 3] = [(0.1, 0.25), (0.2, 0.5), (0.4, 1.0)];

    /// One of the paper's levels: metres and degrees at the end of 5 s.
    #[must_use]
    pub fn over_5_s((sigma_position_m, sigma_yaw_deg): (f64, f64), growth: Growth) -> Self {
        Self { sigma_position_m, sigma_yaw_rad: sigma_yaw_deg.to_radians(), horizon_s: 5.0, growth }
    }

    /// A trajectory with one draw of the drift, zero at its first pose: what a batch sees.
    ///
    /// # Errors
    /// When the drift is not finite.
    pub fn apply(&self, trajectory: &Trajectory, seed: u64) -> Result<Trajectory, Error> {
        let mut rng = stream(seed, Purpose::Odometry, 0, 1);
        let end = self.draw(&mut rng);
        let Some((start_us, start)) = trajectory.first() else { return Ok(Trajectory::default()) };
        let drifted = |(time_us, pose): (i64, Pose2)| {
            (
                time_us,
                start.compose(&self.drifted(&end, (time_us - start_us) as f64 * 1e-6, &start.between(&pose))),
            )
        };
        Ok(Trajectory::new(trajectory.iter().map(drifted))?)
    }

    /// The errors at the end of the horizon.
    fn draw(&self, rng: &mut ChaCha8Rng) -> Pose2 {
        let mut axis = || normal(rng, self.sigma_position_m);
        Pose2::new(axis(), axis(), normal(rng, self.sigma_yaw_rad))
    }

    /// A pose relative to the start of the drift, with the error it has some time after that.
    fn drifted(&self, end: &Pose2, time_s: f64, pose: &Pose2) -> Pose2 {
        let t = time_s / self.horizon_s;
        let grown = match self.growth {
            Growth::Linear => t,
            Growth::Quadratic => t * t,
        };
        Pose2::new(pose.x_m + grown * end.x_m, pose.y_m + grown * end.y_m, pose.yaw_rad + t * end.yaw_rad)
    }
}

impl OdometryModel {
    /// The odometry of a true trajectory, in a frame of its own that starts at the identity.
    ///
    /// # Errors
    /// When a parameter of the model is not finite.
    pub fn observe(&self, truth: &[(i64, Pose2)], rng: &mut ChaCha8Rng) -> Result<Trajectory, Error> {
        let Some(&(_, start)) = truth.first() else { return Ok(Trajectory::default()) };
        let poses: Vec<(i64, Pose2)> = match self {
            Self::Perfect => truth.iter().map(|(t, pose)| (*t, start.between(pose))).collect(),
            Self::DeadReckoning(errors) => reckon(errors, truth, rng),
            Self::Drift(drift) => stretches(drift, truth, rng),
        };
        Ok(Trajectory::new(poses)?)
    }
}

fn reckon(errors: &DeadReckoning, truth: &[(i64, Pose2)], rng: &mut ChaCha8Rng) -> Vec<(i64, Pose2)> {
    let scale = 1.0 + normal(rng, errors.scale);
    let bias_radps = normal(rng, errors.gyro_bias_radps);
    let mut pose = Pose2::IDENTITY;
    let mut poses = vec![(truth[0].0, pose)];
    for pair in truth.windows(2) {
        let dt_s = (pair[1].0 - pair[0].0) as f64 * 1e-6;
        let step = pair[0].1.between(&pair[1].1);
        let walk_m = errors.walk_m * step.x_m.hypot(step.y_m).sqrt();
        pose = pose.compose(&Pose2::new(
            scale * step.x_m + normal(rng, walk_m),
            scale * step.y_m + normal(rng, walk_m),
            step.yaw_rad + bias_radps * dt_s + normal(rng, errors.walk_rad * dt_s.sqrt()),
        ));
        poses.push((pair[1].0, pose));
    }
    poses
}

fn stretches(drift: &Drift, truth: &[(i64, Pose2)], rng: &mut ChaCha8Rng) -> Vec<(i64, Pose2)> {
    let (mut start_us, mut true_start) = truth[0];
    let mut start = Pose2::IDENTITY;
    let mut end = drift.draw(rng);
    let mut poses = Vec::with_capacity(truth.len());
    for (time_us, true_pose) in truth {
        let time_s = (time_us - start_us) as f64 * 1e-6;
        let pose = start.compose(&drift.drifted(&end, time_s, &true_start.between(true_pose)));
        poses.push((*time_us, pose));
        if time_s >= drift.horizon_s {
            (start_us, true_start, start, end) = (*time_us, *true_pose, pose, drift.draw(rng));
        }
    }
    poses
}

#[cfg(test)]
mod tests {
    use super::*;

    fn straight(seconds: i64) -> Vec<(i64, Pose2)> {
        (0..=seconds * 20).map(|k| (k * 50_000, Pose2::new(8.0 * k as f64 * 0.05, 3.0, 0.0))).collect()
    }

    fn rms(values: impl Iterator<Item = f64>) -> f64 {
        let (count, sum) = values.fold((0.0, 0.0), |(n, s), v| (n + 1.0, s + v * v));
        (sum / count).sqrt()
    }

    #[test]
    fn drift_has_the_size_asked_for_at_the_end_and_grows_as_asked() {
        let truth = Trajectory::new(straight(5)).unwrap();
        for (growth, half) in [(Growth::Linear, 0.5), (Growth::Quadratic, 0.25)] {
            let drift = Drift::over_5_s(Drift::PAPER_LEVELS[1], growth);
            let all: Vec<_> = (0..600).map(|seed| drift.apply(&truth, seed).unwrap()).collect();
            let error = |t: &Trajectory, us: i64| truth.at(us).unwrap().y_m - t.at(us).unwrap().y_m;
            let end = rms(all.iter().map(|t| error(t, 5_000_000)));
            assert!((end - 0.2).abs() < 0.02, "{end}");
            let mid = rms(all.iter().map(|t| error(t, 2_500_000)));
            assert!((mid / end - half).abs() < 1e-6, "{mid} {end}");
            let yaw = rms(all.iter().map(|t| t.at(5_000_000).unwrap().yaw_rad)).to_degrees();
            assert!((yaw - 0.5).abs() < 0.05, "{yaw}");
        }
    }

    #[test]
    fn every_stretch_of_a_drive_drifts_anew() {
        let truth = straight(3000);
        let model = OdometryModel::Drift(Drift::over_5_s((0.2, 0.0), Growth::Quadratic));
        let mut rng = stream(4, Purpose::Odometry, 0, 0);
        let odometry = model.observe(&truth, &mut rng).unwrap();
        let step =
            |k: i64| odometry.at(k * 5_000_000).unwrap().between(&odometry.at((k + 1) * 5_000_000).unwrap());
        let along = rms((0..599).map(|k| step(k).x_m - 40.0));
        assert!((along - 0.2).abs() < 0.02, "{along}");
    }

    #[test]
    fn dead_reckoning_errs_by_scale_and_gyro_bias() {
        let truth = straight(20);
        let errors = DeadReckoning { walk_m: 0.0, walk_rad: 0.0, ..DeadReckoning::default() };
        let ends: Vec<_> = (0..400)
            .map(|seed| {
                let mut rng = stream(seed, Purpose::Odometry, 0, 0);
                OdometryModel::DeadReckoning(errors).observe(&truth, &mut rng).unwrap().last().unwrap().1
            })
            .collect();
        let along = rms(ends.iter().map(|e| e.x_m - 160.0));
        assert!((along - 0.8).abs() < 0.1, "{along}");
        let yaw = rms(ends.iter().map(|e| e.yaw_rad)).to_degrees();
        assert!((yaw - 0.4).abs() < 0.05, "{yaw}");
    }

    #[test]
    fn perfect_odometry_is_the_truth_from_the_start() {
        let truth = straight(2);
        let mut rng = stream(1, Purpose::Odometry, 0, 0);
        let odometry = OdometryModel::Perfect.observe(&truth, &mut rng).unwrap();
        assert_eq!(odometry.first(), Some((0, Pose2::IDENTITY)));
        assert!((odometry.last().unwrap().1.x_m - 16.0).abs() < 1e-9);
    }
}
