//! Any drive asked both ways is the same batch, and no delta does harm.

use super::*;
use proptest::collection::vec;
use proptest::prelude::*;
use prost::Message;

/// One scan as rows: sensor, microseconds since the last one, ranges.
type Row = (u32, i64, Vec<f32>);

fn batch_of(
    rows: &[(i64, &Row)],
    poses: &[(i64, [f64; 3])],
    reference_time_us: i64,
    optional: bool,
) -> v1::Batch {
    let mut scans = v1::Scans::default();
    for (time_us, (sensor, _, ranges)) in rows {
        scans.sensor.push(*sensor);
        scans.time_offset_us.push(time_us - reference_time_us);
        scans.detection_count.push(ranges.len() as u32);
        scans.range_m.extend(ranges);
        scans.azimuth_rad.extend(ranges.iter().map(|range| range * 0.01));
        if optional {
            scans.elevation_rad.extend(ranges.iter().map(|range| range * 0.001));
        }
    }
    let mut odometry = v1::Odometry { sigma_velocity_mps: Some(0.1), ..v1::Odometry::default() };
    for (time_us, [x_m, y_m, yaw_rad]) in poses {
        odometry.time_offset_us.push(time_us - reference_time_us);
        odometry.x_m.push(*x_m);
        odometry.y_m.push(*y_m);
        odometry.yaw_rad.push(*yaw_rad);
    }
    let (scans, odometry) = (Some(scans), Some(odometry));
    let mounts = vec![v1::SensorMount { x_m: 1.0, ..v1::SensorMount::default() }];
    v1::Batch { reference_time_us, mounts, scans, odometry, ..v1::Batch::default() }
}

fn any_row() -> impl Strategy<Value = Row> {
    // Steps back and none at all: scans out of order, and twice.
    (0_u32..3, -20_000_i64..100_000, vec(0.0_f32..50.0, 0..6))
}

proptest! {
    /// Catches a delta of which the service makes another batch than the vehicle asked of: in one bit of a column, by a scan
    /// out of order, twice or without detections, or by odometry that was corrected or put into another frame.
    #[test]
    fn a_drive_asked_both_ways_is_the_same_batch(
        rows in vec(any_row(), 1..40),
        poses in vec((1_i64..50_000, [-1e4..1e4, -1e4..1e4, -3.1..3.1_f64]), 1..40),
        windows in vec((0_usize..40, 0_usize..40, any::<bool>(), any::<bool>(), -5.0..5.0_f64), 1..8),
    ) {
        let mut time_us = 1_700_000_000_000_000;
        let timed: Vec<_> = rows.iter().map(|row| { time_us += row.1; (time_us, row) }).collect();
        let mut at_us = 1_700_000_000_000_000;
        let way: Vec<_> = poses.iter().map(|(step, pose)| { at_us += step; (at_us, *pose) }).collect();
        let mut kept: Option<v1::Batch> = None;
        for (number, (from, to, grid, optional, moved)) in (0_u64..).zip(windows) {
            let part = |len: usize| { let a = from.min(len); a..to.clamp(a, len) };
            let moved = |(time_us, [x, y, yaw]): &(i64, [f64; 3])| {
                let pose = [x + moved.round(), *y, *yaw];
                (*time_us, if grid { on_grid(pose) } else { pose })
            };
            let poses: Vec<_> = way[part(way.len())].iter().map(moved).collect();
            let batch = batch_of(&timed[part(timed.len())], &poses, time_us - number as i64, optional);
            if let Some(base) = &kept
                && let Some(delta) = between(number, base, &batch)
            {
                let sent = v1::BatchDelta::decode(&delta.encode_to_vec()[..]).unwrap();
                let made = applied(base, sent).unwrap();
                prop_assert_eq!(made.encode_to_vec(), batch.encode_to_vec());
            }
            kept = Some(batch);
        }
    }

    /// Catches a panic, or rows from beyond the base, by a delta that somebody made up.
    #[test]
    fn a_delta_that_does_not_fit_is_refused(
        numbers in [0_u32..6, 0_u32..6, 0_u32..6, 0_u32..6],
        huge in any::<[bool; 4]>(),
        reference_time_us in any::<i64>(),
        packed in vec(any::<i64>(), 0..5),
    ) {
        let row = (0, 10, vec![1.0, 2.0]);
        let base = batch_of(&[(5, &row), (6, &row)], &[(4, [0.0; 3]), (7, [1.0; 3])], 7, true);
        let [scans_from, scans_kept, poses_from, poses_kept] =
            std::array::from_fn(|i| if huge[i] { u32::MAX - numbers[i] } else { numbers[i] });
        let fits = u64::from(scans_from) + u64::from(scans_kept) <= 2
            && u64::from(poses_from) + u64::from(poses_kept) <= 2;
        let packed = v1::PackedPoses { time_offset: packed.clone(), x: packed, ..v1::PackedPoses::default() };
        let delta = v1::BatchDelta {
            reference_time_us, scans_from, scans_kept, poses_from, poses_kept,
            packed: Some(packed), ..v1::BatchDelta::default()
        };
        let made = applied(&base, delta);
        prop_assert!(fits || made.is_err());
        if let Ok(made) = made {
            prop_assert_eq!(made.scans.unwrap().range_m.len(), 2 * scans_kept as usize);
        }
    }
}

/// Catches deltas that carry what the base has: three seconds of four are kept, and so are the mounts.
#[test]
fn a_delta_carries_only_what_is_new() {
    let row = (0, 0, vec![1.0_f32; 100]);
    let rows: Vec<_> = (0..50).map(|i| (100_000 * i, &row)).collect();
    let poses: Vec<_> = (0..50).map(|i| (100_000 * i, on_grid([i as f64 * 0.83, 0.1, 0.001]))).collect();
    let base = batch_of(&rows[..40], &poses[..40], 3_900_000, false);
    let moved: Vec<_> =
        poses[10..].iter().map(|(t, [x, y, yaw])| (*t, on_grid([x * 1.01, *y, *yaw]))).collect();
    for (poses, kept) in [(&poses[10..], 30), (&moved[..], 0)] {
        let batch = batch_of(&rows[10..], poses, 4_900_000, false);
        let delta = between(7, &base, &batch).unwrap();
        assert_eq!((delta.base, delta.scans_from, delta.scans_kept, delta.poses_kept), (7, 10, 30, kept));
        assert!(delta.mounts.is_empty());
        let (less, whole) = (delta.encoded_len(), batch.encoded_len());
        assert!(4 * less < whole + 600, "{less} of {whole} bytes");
    }
    // A late scan among those that are kept: what follows it is sent again.
    let mut late = rows[10..].to_vec();
    late.insert(25, (3_450_000, &row));
    let batch = batch_of(&late, &poses[10..], 4_900_000, false);
    let delta = between(7, &base, &batch).unwrap();
    assert_eq!(delta.scans_kept, 25);
    assert_eq!(applied(&base, delta).unwrap(), batch);
}
