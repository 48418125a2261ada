//! The gate: which detections are mapped and localized with (paper, Sec. "Mapping").
//!
//! - [`Gate`]: the limits. [`Dropped`]: what was dropped, by reason.
//! - [`gate_scan`]: the gate of the vehicle, on a scan that stays one.
//! - [`for_each_gated_scan`]: the gate of everything that goes on with points: batches and evidence.
//!
//! Both apply the same rules in the same order, and differ in one detail, their precision. On the vehicle
//! rows are judged in double precision; points are made eight at a time in single precision, and their
//! rows are judged in it, too. A row whose residual lies within a rounding of the limit may pass one and
//! not the other, so neither can stand in for the other without changing what is uploaded or mapped.

use wide::f32x8;

use crate::doppler::{sensor_velocity, static_radial_speed};
use crate::odometry::{BodyVelocity, Trajectory};
use crate::point::{MapPoint, SensorPoint};
use crate::pose::Pose2;
use crate::scan::{Mount, Scan, ScanView};

/// Which detections pass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gate {
    /// Scans taken slower than this are dropped, metres per second: clutter is intense at rest.
    pub min_speed_mps: f64,
    /// Detections farther than this are dropped, metres: they are mostly clutter.
    pub max_range_m: f64,
    /// Detections whose radial speed differs more than this from a stationary target's are
    /// dropped as movers, metres per second.
    pub max_doppler_residual_mps: f64,
}

impl Default for Gate {
    fn default() -> Self {
        Self { min_speed_mps: 1.0, max_range_m: 50.0, max_doppler_residual_mps: 0.5 }
    }
}

impl Gate {
    /// One that drops movers and nothing else.
    #[must_use]
    pub fn of_movers(max_doppler_residual_mps: f64) -> Self {
        Self { min_speed_mps: 0.0, max_range_m: f64::INFINITY, max_doppler_residual_mps }
    }

    /// The velocity of the body at the time of a scan of so many rows, where the scan passes as a whole;
    /// else its rows are counted as dropped.
    fn pass_scan(
        &self,
        velocity: Option<BodyVelocity>,
        rows: usize,
        dropped: &mut Dropped,
    ) -> Option<BodyVelocity> {
        let Some(velocity) = velocity else {
            dropped.without_pose += rows as u64;
            return None;
        };
        if velocity.speed_mps() < self.min_speed_mps {
            dropped.too_slow += rows as u64;
            return None;
        }
        Some(velocity)
    }
}

/// Detections that were dropped, by the reason.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Dropped {
    /// Taken below the minimum speed.
    pub too_slow: u64,
    /// Farther than the maximum range.
    pub too_far: u64,
    /// Movers.
    pub moving: u64,
    /// Taken outside the trajectory.
    pub without_pose: u64,
}

impl Dropped {
    /// Dropped detections, whatever the reason.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.too_slow + self.too_far + self.moving + self.without_pose
    }

    /// Adds the counts of another one.
    pub fn add(&mut self, other: &Self) {
        self.too_slow += other.too_slow;
        self.too_far += other.too_far;
        self.moving += other.moving;
        self.without_pose += other.without_pose;
    }
}

/// A scan names a sensor that is not mounted.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("scan {scan} names sensor {sensor}, but only {mounts} sensors are mounted")]
pub struct UnknownSensor {
    /// Index of the scan.
    pub scan: usize,
    /// The sensor it names.
    pub sensor: usize,
    /// Number of mounts.
    pub mounts: usize,
}

/// Drops the rows of a scan that do not pass, in double precision.
///
/// `velocity` is the body's at the time of the scan; without it all rows are dropped, for want of a pose.
pub fn gate_scan(scan: &mut Scan, mount: &Mount, velocity: Option<BodyVelocity>, gate: &Gate) -> Dropped {
    let mut dropped = Dropped::default();
    let Some(velocity) = gate.pass_scan(velocity, scan.len(), &mut dropped) else {
        scan.retain(|_, _| false);
        return dropped;
    };
    scan.retain(|scan, row| {
        let far = f64::from(scan.range_m[row]) > gate.max_range_m;
        let moving = !far && is_mover(scan, row, mount, velocity, gate.max_doppler_residual_mps);
        dropped.too_far += u64::from(far);
        dropped.moving += u64::from(moving);
        !far && !moving
    });
    dropped
}

/// True when a row shows a radial speed that no stationary target would; false where the scan has no radial
/// speeds.
fn is_mover(scan: &Scan, row: usize, mount: &Mount, v: BodyVelocity, max_residual_mps: f64) -> bool {
    let Some(&measured) = scan.radial_speed_mps.get(row) else { return false };
    let expected = static_radial_speed(mount, v, f64::from(scan.azimuth_rad[row]));
    (f64::from(measured) - expected).abs() > max_residual_mps
}

/// What the gate leaves of a scan.
#[derive(Debug, Clone, Copy)]
pub struct GatedScan<'a> {
    /// Index into the list of mounts.
    pub sensor: usize,
    /// Time of the scan, microseconds since the Unix epoch (UTC).
    pub time_us: i64,
    /// The body at that time, in the trajectory's frame.
    pub body: Pose2,
    /// Where the radar sits on it.
    pub mount: &'a Mount,
    /// Its points, in the radar's frame.
    pub points: &'a [SensorPoint],
}

impl GatedScan<'_> {
    /// The radar in the trajectory's frame; `scale` is the frame's metres per sensor metre: 1 for
    /// odometry, the grid's point scale factor for poses on the map.
    #[must_use]
    pub fn sensor(&self, scale: f64) -> Pose2 {
        let Mount { x_m, y_m, yaw_rad } = *self.mount;
        self.body.compose(&Pose2::new(scale * x_m, scale * y_m, yaw_rad))
    }

    /// The points on the map, where the trajectory is of poses on it; `scale` as for [`GatedScan::sensor`].
    pub fn points_on_map(&self, scale: f64) -> impl Iterator<Item = MapPoint> + '_ {
        let sensor = self.sensor(scale);
        let (s, c) = sensor.yaw_rad.sin_cos();
        let (s, c) = (scale * s, scale * c);
        self.points.iter().map(move |point| {
            let (x, y) = (f64::from(point.x_m), f64::from(point.y_m));
            MapPoint::new(sensor.x_m + c * x - s * y, sensor.y_m + s * x + c * y)
        })
    }
}

/// Gives the points of every scan that passes, in single precision, and counts the rows that do not.
///
/// # Errors
/// When a scan names an unknown sensor.
pub fn for_each_gated_scan<'a, S>(
    scans: S,
    mounts: &[Mount],
    trajectory: &Trajectory,
    gate: &Gate,
    mut visit: impl FnMut(GatedScan<'_>),
) -> Result<Dropped, UnknownSensor>
where
    S: IntoIterator<Item: Into<ScanView<'a>>>,
{
    let mut dropped = Dropped::default();
    let mut points = Vec::new();
    for (index, scan) in scans.into_iter().map(Into::into).enumerate() {
        let mount = mounts.get(scan.sensor).ok_or(UnknownSensor {
            scan: index,
            sensor: scan.sensor,
            mounts: mounts.len(),
        })?;
        let body = trajectory.at(scan.time_us);
        let velocity = body.and(trajectory.velocity_at(scan.time_us));
        let velocity = gate.pass_scan(velocity, scan.range_m.len(), &mut dropped);
        let (Some(body), Some(velocity)) = (body, velocity) else { continue };
        let points = RowGate::new(gate, mount, velocity, &scan).apply(&scan, &mut points, &mut dropped);
        visit(GatedScan { sensor: scan.sensor, time_us: scan.time_us, body, mount, points });
    }
    Ok(dropped)
}

/// Detections that are looked at together.
const LANES: usize = 8;

/// The gate for the rows of one scan, in single precision.
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
        buffer: &'b mut Vec<SensorPoint>,
        dropped: &mut Dropped,
    ) -> &'b [SensorPoint] {
        let rows = scan.range_m.len();
        // Room for a last group that is not full.
        buffer.resize(rows + LANES, SensorPoint::default());
        let mut passed = 0;
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
                buffer[passed] = SensorPoint { x_m: x[lane], y_m: y[lane] };
                passed += (pass >> lane & 1) as usize;
            }
        }
        &buffer[..passed]
    }

    /// Lanes whose radial speed no stationary target would show; [`is_mover`] for eight rows.
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
}
