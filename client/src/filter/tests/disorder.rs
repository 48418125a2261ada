//! Whatever comes, in whatever order.

use super::*;
use proptest::prelude::*;
use proptest::sample::Index;

/// Ten seconds of fixes, off by up to a few decimetres, some of them by metres.
fn fixes() -> impl Strategy<Value = Vec<FixMeasurement>> {
    let off = prop_oneof![8 => (-0.3..0.3_f64, -0.3..0.3_f64), 1 => (-5.0..5.0_f64, 2.0..5.0_f64)];
    proptest::collection::vec(off, 14).prop_map(|offs| {
        let fixes = offs.into_iter().enumerate();
        fixes.map(|(i, (east, north))| fix(3.0 + 0.5 * i as f64, [east, north])).collect()
    })
}

/// What may happen to a filter.
#[derive(Debug, Clone)]
enum FilterEvent {
    Odometry { after_us: i64, moved: Pose2 },
    Fix { before_us: i64, off: Pose2, covariance: [f64; 6], contains_prior: bool },
    Teleport(LatLon),
}

fn value(size: f64) -> impl Strategy<Value = f64> {
    prop_oneof![900 => -size..size, 50 => Just(0.0), 1 => Just(f64::NAN), 1 => Just(1e300)]
}

fn covariance() -> impl Strategy<Value = [f64; 6]> {
    let ordered = (0.0..0.5_f64, 0.0..0.5_f64, 0.0..0.05_f64, -1.0..1.0_f64);
    let ordered = ordered.prop_map(|(east, north, yaw, c)| {
        [east * east, c * east * north, 0.0, north * north, 0.0, yaw * yaw]
    });
    prop_oneof![30 => ordered, 1 => proptest::array::uniform6(value(1.0))]
}

fn event() -> impl Strategy<Value = FilterEvent> {
    let time =
        prop_oneof![900 => 1_i64..200_000, 20 => 0..60_000_000_i64, 5 => Just(-1), 1 => Just(i64::MAX / 4)];
    let odometry = (time, value(1.0), value(0.1), value(0.1))
        .prop_map(|(after_us, x, y, yaw)| FilterEvent::Odometry { after_us, moved: Pose2::new(x, y, yaw) });
    let past = prop_oneof![30 => 0..2_000_000_i64, 5 => 0..12_000_000_i64, 1 => any::<i64>()];
    let fix = (past, value(0.2), value(0.2), value(0.02), covariance(), proptest::bool::weighted(0.1))
        .prop_map(|(before_us, x, y, yaw, covariance, contains_prior)| FilterEvent::Fix {
            before_us,
            off: Pose2::new(x, y, yaw),
            covariance,
            contains_prior,
        });
    let teleport = (-91.0..91.0_f64, -181.0..181.0_f64)
        .prop_map(|(lat, lon)| FilterEvent::Teleport(LatLon { lat_deg: lat, lon_deg: lon }));
    prop_oneof![200 => odometry, 100 => fix, 1 => teleport]
}

/// Lets an event happen to a vehicle that is where odometry says, seen from an origin.
fn happen(
    filter: &mut Filter,
    event: &FilterEvent,
    (time_us, odometry): &mut (i64, Pose2),
    origin: &mut LatLon,
) {
    match *event {
        FilterEvent::Teleport(at) => *origin = at,
        FilterEvent::Odometry { after_us, moved } => {
            let (next_us, next) = (time_us.saturating_add(after_us), odometry.compose(&moved));
            if !matches!(filter.push_odometry(next_us, next), Err(Error::Odometry(_))) {
                (*time_us, *odometry) = (next_us, next);
            }
        }
        FilterEvent::Fix { before_us, off, covariance, contains_prior } => {
            let seen = odometry.compose(&off);
            let lat_deg = origin.lat_deg + seen.y_m / 111_000.0;
            let at = LatLon { lat_deg, lon_deg: origin.lon_deg + seen.x_m / 55_000.0 };
            let time_us = time_us.saturating_sub(before_us);
            let prior = PriorSource::Own;
            let yaw_rad = seen.yaw_rad;
            let _ =
                filter.push_fix(&FixMeasurement { time_us, at, yaw_rad, covariance, contains_prior, prior });
        }
    }
}

fn is_sound(estimate: &FilterEstimate) -> bool {
    let FilterEstimate { pose, covariance: [xx, xy, xt, yy, yt, tt], fix_age_s, odometry_scale, .. } =
        *estimate;
    let covariance = nalgebra::Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt);
    let numbers = [pose.yaw_rad, pose.sigma_position_m, pose.sigma_yaw_rad, fix_age_s, odometry_scale.0];
    numbers.iter().chain(covariance.iter()).all(|v| v.is_finite())
        && pose.at.lat_deg.abs() <= 90.0
        && pose.at.lon_deg.abs() <= 180.0
        && covariance.cholesky().is_some()
}

proptest! {
    #[test]
    fn the_order_of_arrival_does_not_matter(
        fixes in fixes(),
        picks in proptest::collection::vec(any::<Index>(), 14),
    ) {
        let mut shuffled = fixes.clone();
        for (i, pick) in picks.iter().enumerate() {
            shuffled.swap(i, pick.index(14));
        }
        let arrived = |fixes: &[FixMeasurement]| {
            let mut filter = Filter::new(FilterConfig::default());
            drive(&mut filter, (0.0, 10.0));
            for fix in fixes {
                filter.push_fix(fix).unwrap();
            }
            filter.pose()
        };
        match (arrived(&fixes), arrived(&shuffled)) {
            (Some(a), Some(b)) => {
                let grid = Grid::of(START).unwrap();
                let [p, q] = [a, b].map(|e| grid.project(e.pose.at).unwrap());
                prop_assert!(p.distance_m(q) < 1e-5, "{a:?} {b:?}");
                prop_assert!((a.pose.sigma_position_m - b.pose.sigma_position_m).abs() < 1e-6);
                prop_assert_eq!(a.contradicting, b.contradicting);
            }
            (a, b) => prop_assert!(a.is_none() && b.is_none(), "{:?} {:?}", a, b),
        }
    }

    #[test]
    fn waiting_for_fixes_changes_nothing(fixes in fixes(), late_s in 0.0..3.0_f64) {
        // Fixes late by seconds, while odometry runs on, end where prompt ones do.
        let arrived = |late_s: f64| {
            let mut filter = Filter::new(FilterConfig::default());
            for tick in 0..=260_i64 {
                let seconds = 0.05 * tick as f64;
                drive(&mut filter, (seconds, seconds));
                for fix in &fixes {
                    let due_us = fix.time_us + at_s(late_s) - T0;
                    if due_us <= at_s(seconds) && due_us > at_s(seconds - 0.05) {
                        filter.push_fix(fix).unwrap();
                    }
                }
            }
            filter.pose()
        };
        let sigma_m = |e: Option<FilterEstimate>| e.map_or(0.0, |e| e.pose.sigma_position_m);
        let (prompt, late) = (arrived(0.0), arrived(late_s));
        prop_assert_eq!(prompt.is_some(), late.is_some());
        prop_assert!((sigma_m(prompt) - sigma_m(late)).abs() < 1e-6, "{prompt:?} {late:?}");
    }

    #[test]
    fn no_order_of_events_breaks_it(
        events in proptest::collection::vec(event(), 1..300),
        lat_deg in -79.0..83.0_f64, lon_deg in -180.0..180.0_f64,
    ) {
        let mut filter = Filter::new(FilterConfig::default());
        let mut vehicle = (T0, Pose2::IDENTITY);
        let mut origin = LatLon { lat_deg, lon_deg };
        for event in events {
            happen(&mut filter, &event, &mut vehicle, &mut origin);
            if let Some(estimate) = filter.pose() {
                prop_assert!(is_sound(&estimate), "{estimate:?}");
            }
        }
    }
}
