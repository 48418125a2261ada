use super::*;
use proptest::prelude::*;

/// Fast on a bend, covering 0 to 1 s.
fn bend() -> Trajectory {
    let pose = |i: i64| Pose2::new(500.0 + 2.0 * i as f64, -300.0, 0.04 * i as f64);
    Trajectory::new((0..=10).map(|i| (i * 100_000, pose(i)))).unwrap()
}

/// Detections of which some are far and some move.
fn rows() -> impl Strategy<Value = Vec<(f32, f32, f32)>> {
    let speed = prop_oneof![Just(0.0_f32), Just(0.4), Just(-0.6), Just(20.0)];
    prop::collection::vec((0.0..60.0_f32, -1e3..1e3_f32, speed), 0..40)
}

proptest! {
    #[test]
    fn groups_agree_with_rows_one_by_one(
        rows in rows(), time_us in 0..1_000_000_i64, x in -5.0..5.0, y in -2.0..2.0, yaw in -3.0..3.0,
        doppler: bool,
    ) {
        let (trajectory, gate, mount) = (bend(), Gate::default(), Mount::new(x, y, yaw));
        let (body, v) = (trajectory.at(time_us).unwrap(), trajectory.velocity_at(time_us).unwrap());
        let mut scan = Scan { time_us, ..Scan::default() };
        for (range, azimuth, residual) in rows {
            scan.range_m.push(range);
            scan.azimuth_rad.push(azimuth);
            if doppler {
                let still = static_radial_speed(&mount, v, f64::from(azimuth)) as f32;
                scan.radial_speed_mps.push(still + residual);
            }
        }
        let mut expected = (Dropped::default(), Vec::new());
        for row in 0..scan.len() {
            if f64::from(scan.range_m[row]) > gate.max_range_m {
                expected.0.too_far += 1;
            } else if is_mover(&scan, row, &mount, v, gate.max_doppler_residual_mps) {
                expected.0.moving += 1;
            } else {
                expected.1.push(body.transform(mount.transform(scan.sensor_point(row))));
            }
        }
        let mut found = Vec::new();
        let dropped = for_each_gated_scan([&scan], &[mount], &trajectory, &gate, |scan| {
            assert_eq!(scan.time_us, time_us);
            found.extend(scan.points_on_map(1.0));
        });
        prop_assert_eq!(dropped, Ok(expected.0));
        prop_assert_eq!(found.len(), expected.1.len());
        for (a, b) in found.iter().zip(&expected.1) {
            prop_assert!(a.distance_m((*b).into()) < 1e-4, "{a:?} {b:?}");
        }
    }
}

fn gated_at(speed_mps: Option<f64>) -> (Scan, Dropped) {
    // Ahead: stationary, stationary but far, coming towards the vehicle.
    let mut scan = Scan {
        range_m: vec![10.0, 51.0, 20.0],
        azimuth_rad: vec![0.0; 3],
        radial_speed_mps: vec![-5.0, -5.0, -9.0],
        ..Scan::default()
    };
    let velocity = speed_mps.map(|v| BodyVelocity { forward_mps: v, ..BodyVelocity::default() });
    let dropped = gate_scan(&mut scan, &Mount::IDENTITY, velocity, &Gate::default());
    (scan, dropped)
}

#[test]
fn every_drop_is_counted_by_its_reason() {
    let (scan, dropped) = gated_at(Some(5.0));
    assert_eq!(scan.range_m, [10.0]);
    assert_eq!(dropped, Dropped { too_far: 1, moving: 1, ..Dropped::default() });
    assert_eq!(gated_at(Some(0.9)).1, Dropped { too_slow: 3, ..Dropped::default() });
    assert_eq!(gated_at(None).1, Dropped { without_pose: 3, ..Dropped::default() });
}

#[test]
fn movers_go_and_the_rest_stays() {
    let v = Some(BodyVelocity { forward_mps: 10.0, ..BodyVelocity::default() });
    let mut scan = Scan {
        range_m: vec![20.0, 30.0, 40.0],
        azimuth_rad: vec![0.0; 3],
        radial_speed_mps: vec![-10.1, -2.0, -9.8],
        ..Scan::default()
    };
    assert_eq!(gate_scan(&mut scan, &Mount::IDENTITY, v, &Gate::of_movers(0.5)).moving, 1);
    assert_eq!(scan.range_m, [20.0, 40.0]);
    scan.radial_speed_mps.clear();
    assert_eq!(gate_scan(&mut scan, &Mount::IDENTITY, v, &Gate::of_movers(0.5)).total(), 0);
}

/// What a level radar that moves at (vx, vy) measures of standing points: the line of sight, its length, and the part of the
/// motion along it, in three dimensions.
fn seen_in_space(points: &[[f64; 3]], [vx, vy]: [f64; 2]) -> Scan {
    let mut scan = Scan::default();
    for [x, y, z] in points {
        let slant = (x * x + y * y + z * z).sqrt();
        scan.range_m.push(slant as f32);
        scan.azimuth_rad.push(y.atan2(*x) as f32);
        scan.elevation_rad.push((z / slant).asin() as f32);
        scan.radial_speed_mps.push((-(vx * x + vy * y) / slant) as f32);
    }
    scan
}

proptest! {
    /// Catches a cosine that is missing, doubled or on the wrong side, in either gate: what stands still in space is no
    /// mover, lies where it does along the ground, and shows the radial speed of the plane.
    #[test]
    fn what_stands_still_in_space_stands_still_on_the_ground(
        points in prop::collection::vec((-30.0..30.0_f64, -30.0..30.0_f64, -1.9..3.9_f64), 1..40),
        vx in 2.0..30.0_f64, yaw in -3.0..3.0_f64,
    ) {
        let points: Vec<[f64; 3]> =
            points.into_iter().map(|(x, y, z)| [x, y, z]).filter(|[x, y, _]| x.hypot(*y) > 3.0).collect();
        let mount = Mount::new(2.0, 0.5, yaw);
        let v = BodyVelocity { forward_mps: vx, ..BodyVelocity::default() };
        let scan = seen_in_space(&points, sensor_velocity(&mount, v));
        let mut ground = scan.clone();
        let dropped = gate_scan(&mut ground, &mount, Some(v), &Gate::default());
        prop_assert_eq!(dropped.total(), 0);
        prop_assert!(ground.elevation_rad.is_empty());
        for (row, [x, y, _]) in points.iter().enumerate() {
            prop_assert!((f64::from(ground.range_m[row]) - x.hypot(*y)).abs() < 1e-4);
            let still = static_radial_speed(&mount, v, f64::from(ground.azimuth_rad[row]));
            prop_assert!((f64::from(ground.radial_speed_mps[row]) - still).abs() < 1e-3);
        }
        let straight = |i: i64| (i * 100_000, Pose2::new(vx * 0.1 * i as f64, 0.0, 0.0));
        let trajectory = Trajectory::new((0..=1).map(straight)).unwrap();
        let mut found = Vec::new();
        let all = Gate::default();
        let dropped = for_each_gated_scan([&scan], &[mount], &trajectory, &all, |scan| found.extend(scan.points_on_map(1.0)));
        prop_assert_eq!(dropped.unwrap().total(), 0);
        for (point, [x, y, _]) in found.iter().zip(&points) {
            prop_assert!(point.distance_m(mount.transform([*x, *y]).into()) < 1e-3);
        }
    }
}

/// Catches a bridge, a reflection in the road and a steep return that are mapped, and one counted as a mover.
#[test]
fn what_is_too_low_too_high_or_too_steep_goes() {
    let v = BodyVelocity { forward_mps: 10.0, ..BodyVelocity::default() };
    let points = [[20.0, 0.0, 0.5], [20.0, 0.0, 5.0], [20.0, 0.0, -2.5], [1.0, 0.0, 3.0]];
    let scan = seen_in_space(&points, [10.0, 0.0]);
    let mut gated = scan.clone();
    let expected = Dropped { off_height: 3, ..Dropped::default() };
    assert_eq!(gate_scan(&mut gated, &Mount::IDENTITY, Some(v), &Gate::default()), expected);
    assert!((gated.range_m[0] - 20.0).abs() < 1e-4 && gated.len() == 1);
    let trajectory = Trajectory::new([(0, Pose2::IDENTITY), (100_000, Pose2::new(1.0, 0.0, 0.0))]).unwrap();
    let dropped = for_each_gated_scan([&scan], &[Mount::IDENTITY], &trajectory, &Gate::default(), |_| ());
    assert_eq!(dropped, Ok(expected));
}

/// Catches a limit of the range that is held against the slant range.
#[test]
fn the_limit_of_the_range_is_along_the_ground() {
    let v = BodyVelocity { forward_mps: 10.0, ..BodyVelocity::default() };
    let mut scan = seen_in_space(&[[49.99, 0.0, 3.9], [50.01, 0.0, 0.0]], [10.0, 0.0]);
    let dropped = gate_scan(&mut scan, &Mount::IDENTITY, Some(v), &Gate::default());
    assert_eq!(dropped, Dropped { too_far: 1, ..Dropped::default() });
}
