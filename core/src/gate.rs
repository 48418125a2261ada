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
//!
//! # Elevations
//!
//! The map is a plane and the body moves in it. Where a radar measures elevations, a detection at the slant range
//! `r` and the elevation `e` lies `r cos e` away along the ground and `r sin e` above the radar. What stands still
//! shows `cos e` times the radial speed that it would show on the ground, for only that part of the motion
//! is along the line of sight: residuals are compared as measured, so that steep rows do not gain noise, and what is left is
//! on the ground: range times, radial speed divided by `cos e`.

use wide::f32x8;

use crate::doppler::{sensor_velocity, static_radial_speed};
use crate::odometry::{BodyVelocity, Trajectory};
use crate::point::{MapPoint, SensorPoint};
use crate::pose::Pose2;
use crate::scan::slices::{at_once, slices};
use crate::scan::{Mount, Scan, ScanView};

/// How far detections count unless it is set: the default of every limit of the range, of the vehicle and of the
/// service, and of the search's extent. Metres.
pub const MAX_RANGE_M: f64 = 50.0;

/// Cosine of the steepest elevation that passes: beyond 60 degrees the range along the ground is no longer measured, and a radial
/// speed says less than half of the motion.
const STEEPEST_COS: f64 = 0.5;

/// Which detections pass.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Gate {
    /// Scans taken slower than this are dropped, metres per second: clutter is intense at rest.
    pub min_speed_mps: f64,
    /// Detections farther than this along the ground are dropped, metres: they are mostly clutter.
    pub max_range_m: f64,
    /// Detections lower than this against their radar are dropped, metres: what appears below the road is
    /// a reflection in it. Like [`Gate::max_height_m`] it is for detections with an elevation; others have no height.
    pub min_height_m: f64,
    /// Detections higher than this above their radar are dropped, metres. The default is what a road leaves clear for
    /// lorries: bridges and gantries are above.
    pub max_height_m: f64,
    /// Detections whose radial speed differs more than this from a stationary target's are
    /// dropped as movers, metres per second.
    pub max_doppler_residual_mps: f64,
}

impl Default for Gate {
    fn default() -> Self {
        Self {
            min_speed_mps: 1.0,
            max_range_m: MAX_RANGE_M,
            min_height_m: -2.0,
            max_height_m: 4.0,
            max_doppler_residual_mps: 0.5,
        }
    }
}

impl Gate {
    /// One that drops movers and nothing else.
    #[must_use]
    pub fn of_movers(max_doppler_residual_mps: f64) -> Self {
        Self {
            min_speed_mps: 0.0,
            max_range_m: f64::INFINITY,
            min_height_m: f64::NEG_INFINITY,
            max_height_m: f64::INFINITY,
            max_doppler_residual_mps,
        }
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
    /// Too low, too high or too steep.
    pub off_height: u64,
    /// Movers.
    pub moving: u64,
    /// Taken outside the trajectory.
    pub without_pose: u64,
}

impl Dropped {
    /// Dropped detections, whatever the reason.
    #[must_use]
    pub fn total(&self) -> u64 {
        self.too_slow + self.too_far + self.off_height + self.moving + self.without_pose
    }

    /// What was dropped since an earlier count.
    #[must_use]
    pub fn since(&self, earlier: &Self) -> Self {
        Self {
            too_slow: self.too_slow.saturating_sub(earlier.too_slow),
            too_far: self.too_far.saturating_sub(earlier.too_far),
            off_height: self.off_height.saturating_sub(earlier.off_height),
            moving: self.moving.saturating_sub(earlier.moving),
            without_pose: self.without_pose.saturating_sub(earlier.without_pose),
        }
    }

    /// Adds the counts of another one.
    pub fn add(&mut self, other: &Self) {
        self.too_slow += other.too_slow;
        self.too_far += other.too_far;
        self.off_height += other.off_height;
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

/// Drops the rows of a scan that do not pass, in double precision, and brings the others to the ground: after it the scan has no
/// elevations.
///
/// All rows are taken for the scan's time; cut a scan that took its time into [`slices`](crate::scan::slices) first.
/// `velocity` is the body's at the time of the scan; without it all rows are dropped, for want of a pose.
pub fn gate_scan(scan: &mut Scan, mount: &Mount, velocity: Option<BodyVelocity>, gate: &Gate) -> Dropped {
    let mut dropped = Dropped::default();
    let Some(velocity) = gate.pass_scan(velocity, scan.len(), &mut dropped) else {
        scan.retain(|_, _| false);
        return dropped;
    };
    scan.retain(|scan, row| {
        let slant_m = f64::from(scan.range_m[row]);
        let (sin, cos) = scan.elevation_rad.get(row).map_or((0.0, 1.0), |e| f64::from(*e).sin_cos());
        let far = slant_m * cos > gate.max_range_m;
        let off_height = !far
            && (cos < STEEPEST_COS || !(gate.min_height_m..=gate.max_height_m).contains(&(slant_m * sin)));
        let moving =
            !far && !off_height && is_mover(scan, row, mount, velocity, gate.max_doppler_residual_mps);
        dropped.too_far += u64::from(far);
        dropped.off_height += u64::from(off_height);
        dropped.moving += u64::from(moving);
        !far && !off_height && !moving
    });
    bring_to_ground(scan);
    dropped
}

/// Brings ranges and radial speeds to the ground; the elevations, which must not be steep, are gone then.
fn bring_to_ground(scan: &mut Scan) {
    for (row, elevation) in std::mem::take(&mut scan.elevation_rad).into_iter().enumerate() {
        let cos = elevation.cos();
        scan.range_m[row] *= cos;
        if let Some(radial_speed) = scan.radial_speed_mps.get_mut(row) {
            *radial_speed /= cos;
        }
    }
}

/// True when a row shows a radial speed that no stationary target would; false where the scan has no radial
/// speeds.
fn is_mover(scan: &Scan, row: usize, mount: &Mount, v: BodyVelocity, max_residual_mps: f64) -> bool {
    let Some(&measured) = scan.radial_speed_mps.get(row) else { return false };
    let along_ground = scan.elevation_rad.get(row).map_or(1.0, |elevation| f64::from(*elevation).cos());
    let expected = along_ground * static_radial_speed(mount, v, f64::from(scan.azimuth_rad[row]));
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

/// Gives the points of every scan that passes, in single precision and on the ground, and counts the rows that do not. A
/// scan that took its time comes as its [`slices`].
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
        let mut pass = |scan: &ScanView<'_>| {
            let body = trajectory.at(scan.time_us);
            let velocity = body.and(trajectory.velocity_at(scan.time_us));
            let velocity = gate.pass_scan(velocity, scan.range_m.len(), &mut dropped);
            let (Some(body), Some(velocity)) = (body, velocity) else { return };
            let points = RowGate::new(gate, mount, velocity, scan).apply(scan, &mut points, &mut dropped);
            visit(GatedScan { sensor: scan.sensor, time_us: scan.time_us, body, mount, points });
        };
        if at_once(&scan) {
            pass(&scan);
        } else {
            for slice in &slices(&scan) {
                pass(&slice.into());
            }
        }
    }
    Ok(dropped)
}

/// Detections that are looked at together.
const LANES: usize = 8;

/// The gate for the rows of one scan, in single precision.
struct RowGate {
    max_range_m: f32x8,
    /// The lowest and the highest against the radar.
    height_m: [f32x8; 2],
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
            height_m: [gate.min_height_m, gate.max_height_m].map(splat),
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
            let (slant, azimuth) = (lanes(scan.range_m), lanes(scan.azimuth_rad));
            let (s, c) = azimuth.sin_cos();
            let (rise, level) = match scan.elevation_rad {
                [] => (f32x8::ZERO, f32x8::ONE),
                elevations => lanes(elevations).sin_cos(),
            };
            let range = slant * level;
            let given = u32::MAX >> (32 - LANES.min(rows - from));
            let far = range.simd_gt(self.max_range_m).to_bitmask() & given;
            let off_height = match scan.elevation_rad {
                [] => 0,
                _ => self.off_height(slant * rise, level) & given & !far,
            };
            let moving = match scan.radial_speed_mps {
                [] => 0,
                speeds => self.moving(lanes(speeds), level * s, level * c) & given & !far & !off_height,
            };
            dropped.too_far += u64::from(far.count_ones());
            dropped.off_height += u64::from(off_height.count_ones());
            dropped.moving += u64::from(moving.count_ones());
            let (x, y) = ((range * c).to_array(), (range * s).to_array());
            let pass = given & !far & !off_height & !moving;
            // Written in any case, and overwritten by the next one unless it passed: no branches.
            for lane in 0..LANES {
                buffer[passed] = SensorPoint { x_m: x[lane], y_m: y[lane] };
                passed += (pass >> lane & 1) as usize;
            }
        }
        &buffer[..passed]
    }

    /// Lanes that are too low, too high or too steep.
    fn off_height(&self, height: f32x8, level: f32x8) -> u32 {
        let [lowest, highest] = self.height_m;
        let steep = level.simd_lt(f32x8::splat(STEEPEST_COS as f32)).to_bitmask();
        height.simd_lt(lowest).to_bitmask() | height.simd_gt(highest).to_bitmask() | steep
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
mod tests;
