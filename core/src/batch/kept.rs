//! Which detections are kept, and where their radar saw them.

use wide::f32x8;

use super::{Dropped, Error};
use crate::doppler::sensor_velocity;
use crate::odometry::{BodyVelocity, Trajectory};
use crate::pose::Pose2;
use crate::scan::{Gate, Mount, ScanView};

/// What the gate leaves of a scan.
#[derive(Debug, Clone, Copy)]
pub struct KeptScan<'a> {
    /// Time of the scan, microseconds since the Unix epoch (UTC).
    pub time_us: i64,
    /// The body at that time, in the trajectory's frame.
    pub body: Pose2,
    /// The radar's place on it.
    pub mount: &'a Mount,
    /// Metres along the radar's boresight and left of it.
    pub points: &'a [[f32; 2]],
}

impl KeptScan<'_> {
    /// The radar in the trajectory's frame; `scale` is the frame's metres per sensor metre: 1 for
    /// odometry, the grid's point scale factor for poses on the map.
    #[must_use]
    pub fn sensor(&self, scale: f64) -> Pose2 {
        let Mount { x_m, y_m, yaw_rad } = *self.mount;
        self.body.compose(&Pose2::new(scale * x_m, scale * y_m, yaw_rad))
    }

    /// The points in the trajectory's frame, metres; `scale` as for [`KeptScan::sensor`].
    pub fn placed(&self, scale: f64) -> impl Iterator<Item = [f64; 2]> + '_ {
        let sensor = self.sensor(scale);
        let (s, c) = sensor.yaw_rad.sin_cos();
        let (s, c) = (scale * s, scale * c);
        self.points.iter().map(move |point| {
            let [x, y] = point.map(f64::from);
            [sensor.x_m + c * x - s * y, sensor.y_m + s * x + c * y]
        })
    }
}

/// Walks over scans and gives what passes the gate, scan by scan.
///
/// # Errors
/// When a scan names an unknown sensor.
pub fn for_each_scan<'a, S>(
    scans: S,
    mounts: &[Mount],
    trajectory: &Trajectory,
    gate: &Gate,
    mut visit: impl FnMut(KeptScan<'_>),
) -> Result<Dropped, Error>
where
    S: IntoIterator<Item: Into<ScanView<'a>>>,
{
    let mut dropped = Dropped::default();
    let mut points = Vec::new();
    for (index, scan) in scans.into_iter().map(Into::into).enumerate() {
        let mount = mounts.get(scan.sensor).ok_or(Error::UnknownSensor {
            scan: index,
            sensor: scan.sensor,
            mounts: mounts.len(),
        })?;
        let rows = scan.range_m.len() as u64;
        let (Some(body), Some(velocity)) =
            (trajectory.at(scan.time_us), trajectory.velocity_at(scan.time_us))
        else {
            dropped.without_pose += rows;
            continue;
        };
        if velocity.speed_mps() < gate.min_speed_mps {
            dropped.too_slow += rows;
            continue;
        }
        let points = RowGate::new(gate, mount, velocity, &scan).apply(&scan, &mut points, &mut dropped);
        visit(KeptScan { time_us: scan.time_us, body, mount, points });
    }
    Ok(dropped)
}

/// Detections that are looked at together.
const LANES: usize = 8;

/// The gate for the rows of one scan.
struct RowGate {
    max_range_m: f32x8,
    /// Of the sensor along its own axes; 0 where radial speeds are not measured.
    velocity_mps: [f32x8; 2],
    max_residual_mps: f32x8,
}

impl RowGate {
    fn new(gate: &Gate, mount: &Mount, velocity: BodyVelocity, scan: &ScanView<'_>) -> Self {
        let splat = |value: f64| f32x8::splat(value as f32);
        let measured = !scan.radial_speed_mps.is_empty();
        let velocity_mps = if measured { sensor_velocity(mount, velocity) } else { [0.0; 2] };
        Self {
            max_range_m: splat(gate.max_range_m),
            velocity_mps: velocity_mps.map(splat),
            max_residual_mps: splat(gate.max_doppler_residual_mps),
        }
    }

    /// The rows that pass, as points on the sensor's axes, in `buffer`; counts the others.
    fn apply<'b>(
        &self,
        scan: &ScanView<'_>,
        buffer: &'b mut Vec<[f32; 2]>,
        dropped: &mut Dropped,
    ) -> &'b [[f32; 2]] {
        let rows = scan.range_m.len();
        // Room for a last group that is not full.
        buffer.resize(rows + LANES, [0.0; 2]);
        let mut kept = 0;
        for from in (0..rows).step_by(LANES) {
            let lanes = |column: &[f32]| group(column, from);
            let (range, azimuth) = (lanes(scan.range_m), lanes(scan.azimuth_rad));
            let (s, c) = azimuth.sin_cos();
            let given = u32::MAX >> (32 - LANES.min(rows - from));
            let far = range.simd_gt(self.max_range_m).to_bitmask() & given;
            let moving = match scan.radial_speed_mps {
                [] => 0,
                speeds => self.moving(lanes(speeds), s, c) & given & !far,
            };
            dropped.too_far += u64::from(far.count_ones());
            dropped.moving += u64::from(moving.count_ones());
            let (x, y) = ((range * c).to_array(), (range * s).to_array());
            let pass = given & !far & !moving;
            // Written in any case, and overwritten by the next one unless it passed: no branches.
            for lane in 0..LANES {
                buffer[kept] = [x[lane], y[lane]];
                kept += (pass >> lane & 1) as usize;
            }
        }
        &buffer[..kept]
    }

    /// Lanes whose radial speed no stationary target would show (see
    /// [`is_mover`](crate::doppler::is_mover)).
    fn moving(&self, measured: f32x8, s: f32x8, c: f32x8) -> u32 {
        let [vx, vy] = self.velocity_mps;
        let residual = measured + vx * c + vy * s;
        residual.abs().simd_gt(self.max_residual_mps).to_bitmask()
    }
}

/// Rows from `from` on, as many as there are; the other lanes are 0.
fn group(column: &[f32], from: usize) -> f32x8 {
    let rest = &column[from..];
    if let Some(full) = rest.first_chunk::<LANES>() {
        return f32x8::from(*full);
    }
    let mut lanes = [0.0; LANES];
    lanes[..rest.len()].copy_from_slice(rest);
    f32x8::from(lanes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::doppler::{is_mover, static_radial_speed};
    use crate::scan::Scan;
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
            let dropped = for_each_scan([&scan], &[mount], &trajectory, &gate, |kept| {
                assert_eq!(kept.time_us, time_us);
                found.extend(kept.placed(1.0));
            });
            prop_assert_eq!(dropped, Ok(expected.0));
            prop_assert_eq!(found.len(), expected.1.len());
            for (a, b) in found.iter().zip(&expected.1) {
                prop_assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-4, "{a:?} {b:?}");
            }
        }
    }
}
