//! Where odometry jumps: a reset, a merge of two sources, wheels that slip. No car does.

use super::Trajectory;
use crate::pose::{Pose2, wrap_angle};

/// No car accelerates more, metres per second squared.
const MAX_ACCELERATION_MPS2: f64 = 12.0;
/// No car's yaw rate changes faster, radians per second squared.
const MAX_YAW_ACCELERATION_RADPS2: f64 = 6.0;
/// Velocities are compared over such times, or over one step where those are longer, microseconds.
const WINDOW_US: i64 = 100_000;
/// What the poses at a window's ends may err: metres and radians.
const POSE_ERROR: (f64, f64) = (0.1, 0.01);

/// The end of the last step between two times that no car can make, microseconds since the Unix epoch; `None` where
/// all can be driven. What was seen before that time lies elsewhere by an unknown way.
///
/// Steps of a quarter of a metre are found at ten poses a second and more, those of 3 m at two.
#[must_use]
pub fn last_jump(odometry: &Trajectory, from_us: i64, to_us: i64) -> Option<i64> {
    let end_us =
        odometry.iter().map(|(time_us, _)| time_us).find(|time_us| *time_us >= to_us).unwrap_or(to_us);
    let asked = from_us.saturating_sub(WINDOW_US)..=end_us;
    let poses: Vec<(i64, Pose2)> = odometry.iter().filter(|(time_us, _)| asked.contains(time_us)).collect();
    let breaks = (1..poses.len().saturating_sub(1)).rev().find(|middle| is_break(&poses, *middle))?;
    // Of the steps around the break the one that stands out is the jump.
    let first = from_before(&poses, breaks);
    let last = until_after(&poses, breaks);
    let usual = usual_speed(&poses);
    let off = |step: usize| {
        let (from, to) = (&poses[step], &poses[step + 1]);
        let dt_s = (to.0 - from.0) as f64 * 1e-6;
        let moved = from.1.between(&to.1);
        (moved.x_m.hypot(moved.y_m) / dt_s - usual).abs() * dt_s + moved.yaw_rad.abs()
    };
    let jump = (first..last).max_by(|a, b| off(*a).total_cmp(&off(*b)))?;
    let after_us = poses[jump + 1].0;
    (after_us > from_us).then_some(after_us)
}

/// Index of the pose from which the time before `middle` counts.
fn from_before(poses: &[(i64, Pose2)], middle: usize) -> usize {
    poses[..middle].partition_point(|(time_us, _)| *time_us < poses[middle].0 - WINDOW_US).min(middle - 1)
}

/// Index of the pose until which the time after `middle` counts.
fn until_after(poses: &[(i64, Pose2)], middle: usize) -> usize {
    let until_us = poses[middle].0 + WINDOW_US;
    poses.partition_point(|(time_us, _)| *time_us <= until_us).saturating_sub(1).max(middle + 1)
}

/// Whether velocity or yaw rate change too fast at a pose.
fn is_break(poses: &[(i64, Pose2)], middle: usize) -> bool {
    let (a, b, c) = (&poses[from_before(poses, middle)], &poses[middle], &poses[until_after(poses, middle)]);
    let (before_s, after_s) = ((b.0 - a.0) as f64 * 1e-6, (c.0 - b.0) as f64 * 1e-6);
    let (before, after) = (a.1.between(&b.1), b.1.between(&c.1));
    let turn = (wrap_angle(after.yaw_rad) / after_s - wrap_angle(before.yaw_rad) / before_s).abs();
    // Both in the frame of the pose between them, each turned to the middle of its step.
    let velocity = |step: &Pose2, turned_rad: f64, dt_s: f64| {
        let (s, c) = turned_rad.sin_cos();
        [(c * step.x_m + s * step.y_m) / dt_s, (c * step.y_m - s * step.x_m) / dt_s]
    };
    let [v, w] = [velocity(&before, before.yaw_rad, before_s), velocity(&after, 0.0, after_s)];
    let change = (w[0] - v[0]).hypot(w[1] - v[1]);
    let apart_s = 0.5 * (before_s + after_s);
    let shorter_s = before_s.min(after_s);
    change > MAX_ACCELERATION_MPS2 * apart_s + POSE_ERROR.0 / shorter_s
        || turn > MAX_YAW_ACCELERATION_RADPS2 * apart_s + POSE_ERROR.1 / shorter_s
}

/// The median speed, metres per second.
fn usual_speed(poses: &[(i64, Pose2)]) -> f64 {
    let speed =
        |pair: &[(i64, Pose2)]| pair[0].1.distance_m(&pair[1].1) / ((pair[1].0 - pair[0].0) as f64 * 1e-6);
    let mut speeds: Vec<f64> = poses.windows(2).map(speed).collect();
    let middle = speeds.len() / 2;
    if speeds.is_empty() { 0.0 } else { *speeds.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Five seconds of a bend with brakes: a pose every `step_us`, with errors of some millimetres, and a jump.
    fn way(step_us: i64, braking_mps2: f64, jump: Option<(i64, Pose2)>) -> Trajectory {
        let pose = |i: i64| {
            let t = (i * step_us) as f64 * 1e-6;
            let way_m =
                12.0 * t - 0.5 * braking_mps2 * t.min(2.0).powi(2) - braking_mps2 * 2.0 * (t - 2.0).max(0.0);
            let turned = way_m / 30.0;
            let error = 0.005 * ((i * 7919 % 13) as f64 / 6.0 - 1.0);
            let pose = Pose2::new(30.0 * turned.sin() + error, 30.0 * (1.0 - turned.cos()) - error, turned);
            match jump {
                Some((at_us, by)) if i * step_us >= at_us => by.compose(&pose),
                _ => pose,
            }
        };
        Trajectory::new((0..=5_000_000 / step_us).map(|i| (i * step_us, pose(i)))).unwrap()
    }

    proptest! {
        /// Catches bends, brakes and noise that are taken for jumps.
        #[test]
        fn what_a_car_can_drive_is_no_jump(hertz in 2..100_i64, braking_mps2 in 0.0..5.0_f64) {
            prop_assert_eq!(last_jump(&way(1_000_000 / hertz, braking_mps2, None), 0, 5_000_000), None);
        }

        /// Catches jumps that are overlooked, or found where they are not: what was seen before them must go, and
        /// what was seen after them must stay.
        #[test]
        fn a_jump_is_found_where_it_is(
            hertz in 10..100_i64, at_us in 400_000..4_700_000_i64, east in 0.4..5.0_f64, north in -5.0..5.0_f64,
        ) {
            let jump = Some((at_us, Pose2::new(east, north, 0.0)));
            let found = last_jump(&way(1_000_000 / hertz, 1.0, jump), 0, 5_000_000);
            let found = found.expect("it is found");
            let late = found - at_us;
            prop_assert!((0..=1_000_000 / hertz).contains(&late), "{late} us late");
        }
    }

    /// Catches a jump that the newest scans alone could tell: most of the batch fits where the body no longer is.
    #[test]
    fn a_metre_shortly_before_the_end_is_found() {
        let at_us = 4_800_000;
        for hertz in [10, 20, 50, 100] {
            let jump = Some((at_us, Pose2::new(1.0, 0.0, 0.0)));
            let found = last_jump(&way(1_000_000 / hertz, 1.0, jump), 0, 5_000_000);
            let late = found.expect("it is found") - at_us;
            assert!((0..=1_000_000 / hertz).contains(&late), "{hertz}/s: {late} us late");
        }
    }

    #[test]
    fn a_turn_on_the_spot_is_a_jump() {
        let jump = Some((3_000_000, Pose2::new(0.0, 0.0, 0.2)));
        assert!(last_jump(&way(20_000, 0.0, jump), 0, 5_000_000).is_some());
    }

    #[test]
    fn what_lies_before_the_batch_does_not_matter() {
        let jump = Some((1_000_000, Pose2::new(4.0, 0.0, 0.0)));
        assert_eq!(last_jump(&way(20_000, 0.0, jump), 2_000_000, 5_000_000), None);
    }
}
