//! The filter from outside: what is let in, in which order, and what overrules it.

mod disorder;
mod frames;

use std::f64::consts::FRAC_PI_2;

use super::*;
use crate::testing::T0;
use echofix_core::drive::GeoPose;
use echofix_core::geo::Grid;
use echofix_core::odometry;

const START: LatLon = LatLon { lat_deg: 60.0, lon_deg: 10.0 };
const SPEED_MPS: f64 = 10.0;

/// Microseconds into a drive.
fn at_s(seconds: f64) -> i64 {
    T0 + (seconds * 1e6).round() as i64
}

/// Where a vehicle is that drives due true east from the start, moved by some metres.
fn position(seconds: f64, [x_m, y_m]: [f64; 2]) -> LatLon {
    let frame = LocalPlane::around(START).unwrap();
    frame.geodetic(&Pose2::new(SPEED_MPS * seconds + x_m, y_m, 0.0)).unwrap().0
}

/// A fix of that vehicle, off by some metres, 0.1 m and 0.1 degrees claimed.
fn fix(seconds: f64, off_m: [f64; 2]) -> FixMeasurement {
    FixMeasurement {
        time_us: at_s(seconds),
        at: position(seconds, off_m),
        yaw_rad: 0.0,
        covariance: [0.02, 0.0, 0.0, 0.02, 0.0, 3e-6],
        contains_prior: false,
        prior: PriorSource::Own,
    }
}

/// Feeds perfect odometry, twenty poses a second.
fn drive(filter: &mut Filter, (from_s, to_s): (f64, f64)) {
    for tick in (from_s * 20.0) as i64..=(to_s * 20.0) as i64 {
        let seconds = 0.05 * tick as f64;
        // The next drive starts where this one ends.
        let _ = filter.push_odometry(at_s(seconds), Pose2::new(7.0, SPEED_MPS * seconds, FRAC_PI_2));
    }
}

/// A filter some way into the drive that has had three good fixes.
fn started() -> Filter {
    let mut filter = Filter::new(FilterConfig::default());
    drive(&mut filter, (0.0, 10.0));
    for seconds in [6.0, 7.0] {
        assert!(matches!(filter.push_fix(&fix(seconds, [0.0; 2])), Ok(FixOutcome::Waiting { .. })));
        assert_eq!(filter.pose(), None);
    }
    assert_eq!(filter.push_fix(&fix(8.0, [0.0; 2])), Ok(FixOutcome::Started));
    filter
}

/// Metres (east, north) from where the vehicle is.
fn error_m(filter: &Filter, seconds: f64) -> [f64; 2] {
    let grid = Grid::of(START).unwrap();
    let [a, b] =
        [filter.pose().unwrap().pose.at, position(seconds, [0.0; 2])].map(|at| grid.project(at).unwrap());
    [a.x_m - b.x_m, a.y_m - b.y_m]
}

#[test]
fn fixes_that_agree_start_it_and_odometry_carries_it() {
    let mut filter = started();
    let [east, north] = error_m(&filter, 10.0);
    assert!(east.hypot(north) < 0.01, "{east} {north}");
    let estimate = filter.pose().unwrap();
    assert_eq!((estimate.pose.time_us, estimate.contradicting), (at_s(10.0), 0));
    assert!((estimate.fix_age_s - 2.0).abs() < 1e-9);
    drive(&mut filter, (10.05, 40.0));
    let later = filter.pose().unwrap();
    assert!(later.pose.sigma_position_m > 2.0 * estimate.pose.sigma_position_m);
    assert!(error_m(&filter, 40.0)[0].abs() < 0.1);
}

#[test]
fn a_wrong_fix_is_kept_out_and_said_to_be() {
    let mut filter = started();
    let before = filter.pose().unwrap();
    let outcome = filter.push_fix(&fix(9.0, [0.0, 3.0])).unwrap();
    assert!(matches!(outcome, FixOutcome::Gated { nis, agreeing: 1 } if nis > 100.0), "{outcome:?}");
    let after = filter.pose().unwrap();
    assert_eq!(after, FilterEstimate { contradicting: 1, ..before });
    assert!(matches!(filter.push_fix(&fix(9.5, [0.0; 2])), Ok(FixOutcome::Used { nis }) if nis < 3.0));
    assert_eq!(filter.pose().unwrap().contradicting, 0);
}

#[test]
fn a_wrong_first_fix_does_not_start_it() {
    let mut filter = Filter::new(FilterConfig::default());
    drive(&mut filter, (0.0, 10.0));
    let outcomes = [(5.0, [0.0, 5.0]), (6.0, [0.0; 2]), (7.0, [-4.0, 0.0]), (8.0, [0.0; 2]), (9.0, [0.0; 2])]
        .map(|(seconds, off_m)| filter.push_fix(&fix(seconds, off_m)).unwrap());
    // A fix that disagrees starts the count again.
    assert_eq!(outcomes, [1, 1, 1, 1, 2].map(|agreeing| FixOutcome::Waiting { agreeing }));
    drive(&mut filter, (10.05, 11.0));
    assert_eq!(filter.push_fix(&fix(10.0, [0.0; 2])), Ok(FixOutcome::Started));
}

#[test]
fn fixes_in_a_row_that_agree_overrule_it_in_time() {
    let mut filter = started();
    for second in 0..10 {
        let seconds = 9.0 + f64::from(second);
        drive(&mut filter, (seconds + 1.05, seconds + 2.0));
        let outcome = filter.push_fix(&fix(seconds, [0.0, 3.0])).unwrap();
        assert!(matches!(outcome, FixOutcome::Gated { .. }), "{second}: {outcome:?}");
    }
    assert_eq!(filter.pose().unwrap().contradicting, 10);
    drive(&mut filter, (20.05, 21.0));
    assert!(matches!(filter.push_fix(&fix(19.0, [0.0, 3.0])), Ok(FixOutcome::Reset { .. })));
    let [east, north] = error_m(&filter, 21.0);
    assert!(east.abs() < 0.1 && (north - 3.0).abs() < 0.1, "{east} {north}");
}

#[test]
fn wrong_fixes_that_disagree_never_overrule_it() {
    let mut filter = started();
    for second in 0..20 {
        let seconds = 9.0 + f64::from(second);
        drive(&mut filter, (seconds + 1.05, seconds + 2.0));
        let aside = if second % 2 == 0 { 4.0 } else { -4.0 };
        let outcome = filter.push_fix(&fix(seconds, [0.0, aside])).unwrap();
        assert!(matches!(outcome, FixOutcome::Gated { agreeing: 1 | 2, .. }), "{second}: {outcome:?}");
    }
    assert!(error_m(&filter, 30.0)[1].abs() < 0.5);
}

#[test]
fn a_fix_that_holds_this_filter_s_own_prior_is_not_counted_twice() {
    let mut filter = started();
    let before = filter.pose();
    let own = FixMeasurement { contains_prior: true, ..fix(9.0, [0.0; 2]) };
    assert_eq!(filter.push_fix(&own), Ok(FixOutcome::HoldsOwnPrior));
    assert_eq!(filter.pose(), before);
    let gnss = FixMeasurement { prior: PriorSource::Independent, ..own };
    assert!(matches!(filter.push_fix(&gnss), Ok(FixOutcome::Used { .. })));
}

#[test]
fn what_the_history_does_not_cover_is_refused() {
    assert_eq!(
        Filter::new(FilterConfig::default()).push_fix(&fix(0.0, [0.0; 2])),
        Ok(FixOutcome::AheadOfOdometry)
    );
    let mut filter = started();
    drive(&mut filter, (10.05, 30.0));
    assert_eq!(filter.push_fix(&fix(30.1, [0.0; 2])), Ok(FixOutcome::AheadOfOdometry));
    // Its middle is 10.5 s ago.
    assert!(matches!(filter.push_fix(&fix(22.0, [0.0; 2])), Ok(FixOutcome::TooOld { .. })));
    assert!(matches!(filter.push_fix(&fix(23.0, [0.0; 2])), Ok(FixOutcome::Used { .. })));
    assert_eq!(filter.push_fix(&fix(23.0, [0.0; 2])), Ok(FixOutcome::Duplicate));
}

#[test]
fn what_is_no_fix_is_refused() {
    let mut filter = started();
    let before = filter.pose();
    let good = fix(9.0, [0.0; 2]);
    let heading = filter.push_fix(&FixMeasurement { yaw_rad: f64::NAN, ..good });
    assert!(matches!(heading, Err(Error::NotAHeading { .. })));
    for covariance in [
        [f64::NAN; 6],
        [-1.0, 0.0, 0.0, 1.0, 0.0, 0.1],
        [1.0, 2.0, 0.0, 1.0, 0.0, 0.1],
        [1e9, 0.0, 0.0, 1e9, 0.0, 0.1],
    ] {
        let refused = filter.push_fix(&FixMeasurement { covariance, ..good });
        assert!(matches!(refused, Err(Error::NotACovariance { .. })), "{covariance:?}");
    }
    let nowhere = FixMeasurement { at: LatLon { lat_deg: 89.0, lon_deg: 0.0 }, ..good };
    assert!(matches!(filter.push_fix(&nowhere), Err(Error::OffTheMap(_))));
    assert_eq!(filter.pose(), before);
}

#[test]
fn odometry_that_is_none_is_refused_and_a_jump_starts_over() {
    let mut filter = started();
    let stale = filter.push_odometry(at_s(10.0), Pose2::IDENTITY);
    assert!(matches!(stale, Err(Error::Odometry(odometry::Error::NotIncreasing { .. }))));
    let torn = filter.push_odometry(at_s(10.1), Pose2::new(f64::NAN, 0.0, 0.0));
    assert!(matches!(torn, Err(Error::Odometry(odometry::Error::NotFinite { .. }))));
    assert!(filter.pose().is_some());
    let jump = filter.push_odometry(at_s(10.1), Pose2::new(7.0, 500.0, 0.0));
    assert!(matches!(jump, Err(Error::Jumped { distance_m, .. }) if (distance_m - 400.0).abs() < 1.0));
    assert_eq!(filter.pose(), None);
    assert_eq!(filter.push_fix(&fix(9.0, [0.0; 2])), Ok(FixOutcome::TooOld { oldest_us: at_s(10.1) }));
}

#[test]
fn the_library_s_fix_becomes_a_measurement() {
    let pose = GeoPose { time_us: T0, at: START, yaw_rad: 0.3, ..GeoPose::default() };
    let covariance = [1.0, 0.1, 0.2, 2.0, 0.3, 3.0];
    let vehicle = crate::vehicle::Fix {
        pose,
        covariance,
        protection: None,
        age_s: 0.0,
        map_epoch: 1,
        contains_prior: false,
    };
    let FixMeasurement { time_us, at, yaw_rad, covariance: taken, .. } = FixMeasurement::from(&vehicle);
    assert_eq!((time_us, at, yaw_rad, taken), (T0, START, 0.3, covariance));
}
