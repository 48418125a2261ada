//! The local plane moves along.

use super::*;
use echofix_core::geo::Zone;

/// Drives due east for two minutes at 30 m/s, a perfect fix every second, and gives the largest
/// error.
fn largest_error_m(start: LatLon) -> (f64, Filter) {
    let truth = LocalPlane::around(start).unwrap();
    let mut filter = Filter::new(FilterConfig::default());
    let mut largest_m = 0.0_f64;
    for tick in 0..2400_i64 {
        let pose = Pose2::new(1.5 * tick as f64, 0.0, 0.0);
        filter.push_odometry(T0 + 50_000 * tick, pose).unwrap();
        let (at, yaw_rad) = truth.geodetic(&pose).unwrap();
        if tick % 20 == 0 {
            let fix = FixMeasurement { time_us: T0 + 50_000 * tick, at, yaw_rad, ..fix(0.0, [0.0; 2]) };
            filter.push_fix(&fix).unwrap();
        }
        if let Some(estimate) = filter.pose() {
            let seen = truth.local(estimate.pose.at, estimate.pose.yaw_rad).unwrap();
            largest_m =
                largest_m.max(seen.distance_m(&pose)).max(100.0 * (seen.yaw_rad - pose.yaw_rad).abs());
        }
    }
    (largest_m, filter)
}

#[test]
fn a_zone_border_is_not_noticed() {
    // The borders of zones 31 and 32 and of the world's last and first zone, 1.8 km on.
    for (start, zone) in [(5.97, 32), (179.97, 1)] {
        let start = LatLon { lat_deg: 50.0, lon_deg: start };
        let (largest_m, filter) = largest_error_m(start);
        assert!(largest_m < 0.05, "{largest_m} m from {start:?}");
        let arrived = Zone::of(filter.pose().unwrap().pose.at).unwrap();
        assert_eq!(arrived.number(), zone);
    }
}

#[test]
fn the_equator_is_not_noticed() {
    let mut filter = Filter::new(FilterConfig::default());
    let truth = LocalPlane::around(LatLon { lat_deg: -0.001, lon_deg: 10.0 }).unwrap();
    for second in 0..300_i64 {
        let pose = Pose2::new(0.0, 20.0 * second as f64, FRAC_PI_2);
        filter.push_odometry(T0 + 1_000_000 * second, pose).unwrap();
        let (at, yaw_rad) = truth.geodetic(&pose).unwrap();
        let fix = FixMeasurement { time_us: T0 + 1_000_000 * second, at, yaw_rad, ..fix(0.0, [0.0; 2]) };
        let outcome = filter.push_fix(&fix).unwrap();
        let expected =
            matches!(outcome, FixOutcome::Waiting { .. } | FixOutcome::Started | FixOutcome::Used { .. });
        assert!(expected, "{second}: {outcome:?}");
    }
    assert!(filter.pose().unwrap().pose.at.lat_deg > 0.04);
}

#[test]
fn a_first_fix_on_another_continent_is_left_behind() {
    let mut filter = Filter::new(FilterConfig::default());
    drive(&mut filter, (0.0, 10.0));
    let lost = FixMeasurement { at: LatLon { lat_deg: -33.0, lon_deg: 151.0 }, ..fix(5.0, [0.0; 2]) };
    assert_eq!(filter.push_fix(&lost), Ok(FixOutcome::Waiting { agreeing: 1 }));
    for seconds in [6.0, 7.0, 8.0] {
        filter.push_fix(&fix(seconds, [0.0; 2])).unwrap();
    }
    assert!(error_m(&filter, 10.0)[0].abs() < 0.01);
    let again = FixMeasurement { time_us: at_s(9.0), ..lost };
    assert_eq!(filter.push_fix(&again), Err(Error::FarAway { at: again.at }));
    assert!(error_m(&filter, 10.0)[0].abs() < 0.01);
}
