//! May an answer be used?

use echofix_core::align::combine;
use echofix_core::drive::GeoPose;
use echofix_core::geo::LatLon;
use echofix_core::pose::wrap_angle;
use echofix_proto::v1;

use super::{AlertLimits, VehicleConfig};

/// An answer that may be used.
#[derive(Debug, Clone, PartialEq)]
pub struct Fix {
    /// The pose of the body, with the sigmas of `covariance`.
    pub pose: GeoPose,
    /// Covariance of (east m, north m, yaw rad), along the axes of `pose`, *true* east and north: upper
    /// triangle row by row.
    pub covariance: [f64; 6],
    /// Bounds of the error; `None` when the answer had no valid ones and none were required. They leave out what the
    /// service cannot know: a late radar clock, turned mounts, odometry that jumps, a map that is shifted as a whole.
    pub protection: Option<v1::ProtectionLevel>,
    /// Seconds from the pose's time to the newest odometry when the answer was judged.
    pub age_s: f64,
    /// Epoch of the map it rests on.
    pub map_epoch: u64,
    /// True when the prior of the question was combined into the pose.
    pub contains_prior: bool,
}

/// Why an answer is not used.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum Rejection {
    /// The service says not to. Where the status is `PRIOR_OUTSIDE_SEARCH`, the pose believed is off by more than its
    /// sigmas say: a vehicle that gets it again and again should [forget](super::Vehicle::forget_position) that pose, or push
    /// one with honest sigmas.
    #[error("the service says not to use the answer ({}): {reason}", .status.as_str_name())]
    Status {
        /// The status of the answer.
        status: v1::FixStatus,
        /// The reason the service gives.
        reason: String,
    },
    /// The protection levels are missing or must not be relied on.
    #[error(
        "the answer's protection levels are not valid; the map may not be calibrated \
         (`require_valid_protection` = false accepts that, for experiments)"
    )]
    NoProtection,
    /// The error may be larger than the vehicle can use.
    #[error("protection levels {along_m} m along, {cross_m} m across, {yaw_rad} rad exceed the alert limits")]
    AboveAlertLimit {
        /// Along the heading, metres.
        along_m: f64,
        /// Across it, metres.
        cross_m: f64,
        /// Heading, radians.
        yaw_rad: f64,
    },
    /// The answer came too late.
    #[error("the answer is {age_s} s old; at most {max_s} s are allowed")]
    TooOld {
        /// Seconds from the pose's time to the newest odometry.
        age_s: f64,
        /// The vehicle's limit, seconds.
        max_s: f64,
    },
    /// A question of this time or a later one has been answered before.
    #[error("a newer fix is already in use")]
    Superseded,
    /// The answer breaks the contract.
    #[error("the answer is malformed: {0}")]
    Malformed(&'static str),
}

/// Judges an answer that was asked for `asked_us`, with odometry up to `now_us`.
pub(super) fn judge(
    answer: &v1::LocalizeResponse,
    asked_us: i64,
    now_us: i64,
    config: &VehicleConfig,
) -> Result<Fix, Rejection> {
    if answer.status() != v1::FixStatus::Usable {
        return Err(Rejection::Status { status: answer.status(), reason: answer.status_reason.clone() });
    }
    if answer.time_us != asked_us {
        return Err(Rejection::Malformed("it is for another time than was asked for"));
    }
    let age_s = now_us.saturating_sub(asked_us) as f64 * 1e-6;
    if age_s > config.max_fix_age_s {
        return Err(Rejection::TooOld { age_s, max_s: config.max_fix_age_s });
    }
    let protection = protection(answer, config)?;
    let covariance = on_true_axes(answer, covariance(answer)?);
    let pose = pose(answer, &covariance)?;
    let map_epoch = answer.map.as_ref().map_or(0, |map| map.epoch);
    let contains_prior = answer.contains_prior;
    Ok(Fix { pose, covariance, protection, age_s, map_epoch, contains_prior })
}

/// The protection levels, within the limits.
fn protection(
    answer: &v1::LocalizeResponse,
    config: &VehicleConfig,
) -> Result<Option<v1::ProtectionLevel>, Rejection> {
    let Some(level) = answer.protection.filter(|p| p.valid) else {
        return if config.require_valid_protection { Err(Rejection::NoProtection) } else { Ok(None) };
    };
    let v1::ProtectionLevel { along_m, cross_m, yaw_rad, .. } = level;
    if !(along_m >= 0.0 && cross_m >= 0.0 && yaw_rad >= 0.0) {
        return Err(Rejection::Malformed("a protection level is not a length"));
    }
    let AlertLimits { along_m: along, cross_m: cross, yaw_rad: yaw } = config.alert_limits;
    if along_m > along || cross_m > cross || yaw_rad > yaw {
        return Err(Rejection::AboveAlertLimit { along_m, cross_m, yaw_rad });
    }
    Ok(Some(level))
}

fn covariance(answer: &v1::LocalizeResponse) -> Result<[f64; 6], Rejection> {
    let covariance: [f64; 6] = answer
        .covariance
        .as_slice()
        .try_into()
        .map_err(|_| Rejection::Malformed("the covariance does not have six values"))?;
    let [east, _, _, north, _, yaw] = covariance;
    if !covariance.iter().all(|v| v.is_finite()) || east < 0.0 || north < 0.0 || yaw < 0.0 {
        return Err(Rejection::Malformed("the covariance is not one"));
    }
    Ok(covariance)
}

/// The service gives a covariance along the grid's axes, which lie up to some degrees off the true ones.
fn on_true_axes(answer: &v1::LocalizeResponse, [xx, xy, xt, yy, yt, tt]: [f64; 6]) -> [f64; 6] {
    let yaws = answer.utm.zip(answer.pose).map(|(utm, pose)| [utm.yaw_rad, pose.yaw_rad]);
    let convergence_rad = yaws.map_or(0.0, |[grid, geodetic]| wrap_angle(grid - geodetic));
    let on_grid = [[xx, xy, xt], [xy, yy, yt], [xt, yt, tt]];
    let [[xx, xy, xt], [_, yy, yt], [_, _, tt]] = combine::turned(&on_grid, -convergence_rad);
    [xx, xy, xt, yy, yt, tt]
}

fn pose(answer: &v1::LocalizeResponse, covariance: &[f64; 6]) -> Result<GeoPose, Rejection> {
    let pose = answer.pose.ok_or(Rejection::Malformed("it has no pose"))?;
    let v1::GeodeticPose { latitude_deg, longitude_deg, yaw_rad } = pose;
    if !(latitude_deg.abs() <= 90.0 && longitude_deg.abs() <= 180.0 && yaw_rad.is_finite()) {
        return Err(Rejection::Malformed("its pose is not on the globe"));
    }
    let [east, between, _, north, _, yaw] = *covariance;
    // The larger axis of the error ellipse.
    let largest = 0.5 * (east + north) + (0.5 * (east - north)).hypot(between);
    Ok(GeoPose {
        time_us: answer.time_us,
        at: LatLon { lat_deg: latitude_deg, lon_deg: longitude_deg },
        yaw_rad,
        sigma_position_m: largest.sqrt(),
        sigma_yaw_rad: yaw.sqrt(),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{T0, usable_answer};

    fn verdict(answer: &v1::LocalizeResponse, config: &VehicleConfig) -> Result<Fix, Rejection> {
        judge(answer, T0, T0 + 1_000_000, config)
    }

    #[test]
    fn a_good_answer_is_used_and_its_sigma_is_the_larger_axis() {
        let mut answer = usable_answer(T0);
        answer.covariance = vec![0.5, 0.4, 0.0, 0.5, 0.0, 1e-4];
        let fix = verdict(&answer, &VehicleConfig::default()).unwrap();
        assert!((fix.pose.sigma_position_m - 0.9_f64.sqrt()).abs() < 1e-12);
        assert!((fix.pose.sigma_yaw_rad - 0.01).abs() < 1e-12);
        assert!((fix.age_s - 1.0).abs() < 1e-9);
    }

    /// Catches a covariance that is taken as it comes, or turned the wrong way.
    #[test]
    fn the_covariance_is_turned_from_the_grids_axes_to_the_poses() {
        let mut answer = usable_answer(T0);
        // The long axis lies along the vehicle.
        let (yaw_rad, convergence_rad) = (0.7_f64, 0.045);
        let (s, c) = (yaw_rad + convergence_rad).sin_cos();
        let (long, short) = (0.25, 0.0025);
        let on_grid = [long * c * c + short * s * s, (long - short) * s * c, long * s * s + short * c * c];
        answer.covariance = vec![on_grid[0], on_grid[1], 0.0, on_grid[2], 0.0, 1e-5];
        answer.pose.as_mut().unwrap().yaw_rad = yaw_rad;
        answer.utm = Some(v1::UtmPose { yaw_rad: yaw_rad + convergence_rad, ..v1::UtmPose::default() });
        let [xx, xy, _, yy, _, tt] = verdict(&answer, &VehicleConfig::default()).unwrap().covariance;
        let (s, c) = yaw_rad.sin_cos();
        let across = xx * s * s - 2.0 * xy * s * c + yy * c * c;
        assert!((across - short).abs() < 1e-12 && (tt - 1e-5).abs() < 1e-15, "{across}");
    }

    #[test]
    fn no_status_but_usable_is_used() {
        for status in 0..=9 {
            let answer = v1::LocalizeResponse { status, ..usable_answer(T0) };
            let used = verdict(&answer, &VehicleConfig::default()).is_ok();
            assert_eq!(used, status == v1::FixStatus::Usable as i32, "{status}");
        }
        assert!(verdict(&v1::LocalizeResponse::default(), &VehicleConfig::default()).is_err());
    }

    #[test]
    fn protection_must_be_valid_and_within_the_limits() {
        let mut answer = usable_answer(T0);
        let limits = AlertLimits { cross_m: 0.5, ..AlertLimits::default() };
        let strict = VehicleConfig { alert_limits: limits, ..VehicleConfig::default() };
        assert!(matches!(verdict(&answer, &strict), Err(Rejection::AboveAlertLimit { .. })));
        answer.protection.as_mut().unwrap().valid = false;
        assert_eq!(verdict(&answer, &VehicleConfig::default()), Err(Rejection::NoProtection));
        let lenient = VehicleConfig { require_valid_protection: false, ..VehicleConfig::default() };
        assert_eq!(verdict(&answer, &lenient).unwrap().protection, None);
    }

    #[test]
    fn old_and_malformed_answers_are_not_used() {
        let answer = usable_answer(T0);
        let late = judge(&answer, T0, T0 + 6_000_000, &VehicleConfig::default());
        assert!(matches!(late, Err(Rejection::TooOld { .. })));
        let breaks: [fn(&mut v1::LocalizeResponse); 6] = [
            |a| a.time_us += 1,
            |a| a.pose = None,
            |a| a.pose.as_mut().unwrap().latitude_deg = f64::NAN,
            |a| a.covariance.truncate(5),
            |a| a.covariance[0] = -1.0,
            |a| a.protection.as_mut().unwrap().cross_m = f64::NAN,
        ];
        for break_it in breaks {
            let mut answer = usable_answer(T0);
            break_it(&mut answer);
            assert!(matches!(verdict(&answer, &VehicleConfig::default()), Err(Rejection::Malformed(_))));
        }
    }
}
