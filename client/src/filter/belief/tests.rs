//! The filter's algebra, against what can be said without it.

use super::*;
use crate::filter::config::{FixNoise, OdometryNoise};
use proptest::prelude::*;

fn config() -> FilterConfig {
    FilterConfig::default()
}

/// A fix with the same sigma along both axes.
fn fix(pose: Pose2, sigma_m: f64, sigma_rad: f64, config: &FilterConfig) -> LocalFix {
    let covariance = Matrix3::from_diagonal(&Vector3::new(sigma_m, sigma_m, sigma_rad).map(|s| s * s));
    LocalFix::new(0, (pose, &covariance), &Pose2::IDENTITY, &config.fixes)
}

fn step(time_s: f64, x_m: f64, yaw_rad: f64) -> OdometryStep {
    OdometryStep { time_s, moved: Pose2::new(x_m, 0.0, yaw_rad) }
}

fn sigma_x_m(belief: &Belief) -> f64 {
    belief.pose_covariance()[(0, 0)].sqrt()
}

/// Drives and takes a perfect fix after each step.
fn followed(count: usize, odometry: &OdometryStep, truth: &Pose2, config: &FilterConfig) -> (Belief, Pose2) {
    let mut pose = Pose2::IDENTITY;
    let mut belief = Belief::from_fix(&fix(pose, 0.13, 0.002, config), config);
    for _ in 0..count {
        pose = pose.compose(truth);
        belief = belief.carried(odometry, config).unwrap();
        belief = belief.corrected(&belief.innovation(&fix(pose, 0.13, 0.002, config)).unwrap());
    }
    (belief, pose)
}

#[test]
fn a_first_fix_is_believed_as_far_as_it_says() {
    let pose = Pose2::new(5.0, -3.0, 2.0);
    let belief = Belief::from_fix(&fix(pose, 0.3, 0.01, &config()), &config());
    assert!(belief.pose().distance_m(&pose) < 1e-9);
    assert!((sigma_x_m(&belief) - 0.3).abs() < 1e-3, "{}", sigma_x_m(&belief));
    assert!((belief.pose_covariance()[(2, 2)].sqrt() - 0.01).abs() < 1e-4);
}

#[test]
fn scale_and_yaw_rate_are_learnt() {
    // Odometry drives 1 % too far and turns 0.02 degrees a second too much.
    let rate_radps = 0.02_f64.to_radians();
    let odometry = step(1.0, 10.1, 0.05 + rate_radps);
    let (belief, pose) = followed(300, &odometry, &Pose2::new(10.0, 0.0, 0.05), &config());
    let (scale, scale_sigma) = belief.scale();
    assert!((scale - 0.01 / 1.01).abs() < 2.0 * scale_sigma && scale_sigma < 0.002, "{scale} {scale_sigma}");
    let (rate, rate_sigma) = belief.yaw_rate_radps();
    assert!((rate - rate_radps).abs() < 2.0 * rate_sigma && rate_sigma < 1e-4, "{rate} {rate_sigma}");
    assert!(belief.pose().distance_m(&pose) < 0.05, "{:?}", belief.pose());
}

#[test]
fn fixes_of_one_batch_are_no_more_than_one() {
    let sigma_m = |interval_s: f64| {
        let still =
            FilterConfig { odometry: OdometryNoise { walk_m: 0.0, ..OdometryNoise::default() }, ..config() };
        let none = FilterConfig { fixes: FixNoise { map_m: 0.0, ..FixNoise::default() }, ..still };
        let (belief, _) = followed(4, &step(interval_s, 0.0, 0.0), &Pose2::IDENTITY, &none);
        sigma_x_m(&belief)
    };
    assert!(sigma_m(0.01) > 0.95 * 0.13, "{}", sigma_m(0.01));
    assert!((sigma_m(1000.0) - 0.13 / 5_f64.sqrt()).abs() < 0.01, "{}", sigma_m(1000.0));
}

#[test]
fn the_map_s_own_error_is_not_averaged_away() {
    // For hours at one position.
    let (belief, _) = followed(2000, &step(10.0, 0.0, 0.0), &Pose2::IDENTITY, &config());
    assert!(sigma_x_m(&belief) > 0.98 * config().fixes.map_m, "{}", sigma_x_m(&belief));
}

#[test]
fn what_is_too_vague_is_given_up() {
    let belief = Belief::from_fix(&fix(Pose2::IDENTITY, 0.1, 0.01, &config()), &config());
    assert!(belief.carried(&step(60.0, 500.0, 0.0), &config()).is_some());
    assert_eq!(belief.carried(&step(3600.0, 30_000.0, 0.0), &config()), None);
}

#[test]
fn headings_are_compared_the_short_way() {
    let belief = Belief::from_fix(&fix(Pose2::new(0.0, 0.0, 3.13), 0.1, 0.02, &config()), &config());
    let belief = belief.carried(&step(60.0, 0.0, 0.0), &config()).unwrap();
    let innovation = belief.innovation(&fix(Pose2::new(0.0, 0.0, -3.13), 0.1, 0.02, &config())).unwrap();
    assert!(innovation.nis < 2.0, "{}", innovation.nis);
    assert!(belief.corrected(&innovation).pose().yaw_rad.abs() > 3.13);
}

fn any_pose() -> impl Strategy<Value = Pose2> {
    (-50.0..50.0, -50.0..50.0, -3.1..3.1).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
}

proptest! {
    #[test]
    fn the_transition_is_the_derivative(start in any_pose(), moved in any_pose(), time_s in 0.01..2.0_f64) {
        // Odometry that never errs by itself, so that covariance is what the transition makes of it.
        let odometry = OdometryNoise {
            walk_m: 0.0, walk_rad: 0.0, scale_time_s: f64::INFINITY, yaw_rate_time_s: f64::INFINITY,
            ..OdometryNoise::default()
        };
        let config = FilterConfig { odometry, ..config() };
        let belief = Belief::from_fix(&fix(start, 0.1, 0.01, &config), &config);
        let way = OdometryStep { time_s, moved };
        let carried = belief.carried(&way, &config).unwrap();
        let mut expected = Matrix3::zeros();
        let root = belief.covariance.cholesky().unwrap().l();
        for column in root.column_iter() {
            let [a, b] = [-1e-4, 1e-4].map(|shift| {
                let mean = belief.mean + shift * column;
                Belief { mean, ..belief }.carried(&way, &config).unwrap().pose()
            });
            let slope = Vector3::new(b.x_m - a.x_m, b.y_m - a.y_m, wrap_angle(b.yaw_rad - a.yaw_rad)) / 2e-4;
            expected += slope * slope.transpose();
        }
        let error = carried.pose_covariance() - expected;
        prop_assert!(error.norm() < 1e-6 * (1.0 + expected.norm()), "{error}");
    }

    #[test]
    fn another_plane_changes_nothing_but_the_coordinates(
        start in any_pose(), seen in any_pose(), origin in any_pose(),
        sigma_m in 0.05..1.0_f64, lever in -0.9..0.9_f64,
    ) {
        let config = config();
        let covariance = Matrix3::new(sigma_m, 0.0, 0.0, 0.0, 0.5, lever * 0.007, 0.0, lever * 0.007, 1e-4);
        let local = |pose| LocalFix::new(0, (pose, &covariance), &Pose2::IDENTITY, &config.fixes);
        let first = Belief::from_fix(&local(start), &config);
        let (here, there) = (local(seen), local(seen).moved_to(&origin));
        let a = first.carried(&step(1.0, 8.0, 0.1), &config).unwrap();
        let b = first.moved_to(&origin).carried(&step(1.0, 8.0, 0.1), &config).unwrap();
        let (a_innovation, b_innovation) = (a.innovation(&here).unwrap(), b.innovation(&there).unwrap());
        prop_assert!((a_innovation.nis - b_innovation.nis).abs() < 1e-6 * (1.0 + a_innovation.nis));
        let (a, b) = (a.corrected(&a_innovation), b.corrected(&b_innovation));
        prop_assert!(origin.compose(&a.pose()).distance_m(&b.pose()) < 1e-6);
        prop_assert!((a.pose_covariance().determinant() / b.pose_covariance().determinant() - 1.0).abs() < 1e-6);
    }
}
