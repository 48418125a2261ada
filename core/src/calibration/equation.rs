//! One scan's equations on a radar's calibration.

use nalgebra::{Matrix2, SMatrix, SVector, Vector2};

use super::motion::Motion;
use super::solution::{SIZE, Solution};
use crate::doppler::sensor_velocity;
use crate::scan::{Mount, ScanView};

/// The normal equations of one scan: `information * solution = sum`.
#[derive(Debug, Clone, PartialEq)]
pub struct ScanEquations {
    /// Of (late s, yaw rad, forward m, left m, speed scale, azimuth scale).
    pub information: SMatrix<f64, SIZE, SIZE>,
    /// Their right side.
    pub sum: SVector<f64, SIZE>,
}

/// A scan with fewer stationary detections says nothing.
const MIN_STANDING: f64 = 6.0;
/// A scan of which a smaller share stands still says nothing: what is taken for standing may drive.
const MIN_SHARE: f64 = 0.4;
/// How far a radar's velocity may be from what odometry says, one sigma along each of its axes, metres per second.
const NEAR_MPS: f64 = 1.0;
/// Detections that differ more are movers or clutter, metres per second; from the first look at a scan to the last.
const REACH_MPS: [f64; 4] = [2.0, 1.2, 0.8, 0.6];

impl ScanEquations {
    /// The equations of a scan whose radial speeds are as many as its azimuths, made linear at a calibration; `None`
    /// where too little of it stands still.
    #[must_use]
    pub fn of(
        scan: &ScanView<'_>,
        built: &Mount,
        motion: &Motion,
        at: &Solution,
        sigma_mps: f64,
    ) -> Option<Self> {
        let mount = at.mount(built);
        let standing = Standing::of(scan, sensor_velocity(&mount, motion.velocity), sigma_mps);
        let count: f64 = standing.weights.iter().sum();
        if count < MIN_STANDING || count < MIN_SHARE * standing.weights.len() as f64 {
            return None;
        }
        let mut equations = Self { information: SMatrix::zeros(), sum: SVector::zeros() };
        let [scale, azimuth_scale] = at.scales();
        let rows = scan.azimuth_rad.iter().zip(scan.radial_speed_mps).zip(&standing.weights);
        for ((azimuth, radial_speed), weight) in rows.filter(|(_, weight)| **weight > 0.0) {
            let azimuth = f64::from(*azimuth);
            let row = Row::of(azimuth, azimuth_scale, &mount, motion);
            let residual = -f64::from(*radial_speed) - (1.0 + scale) * row.towards_mps;
            // Absolute: what the solution it is linear at explains is put back.
            let target = residual + row.slope.dot(&at.0);
            let weight = weight * sigma_mps.powi(-2);
            equations.information += weight * row.slope * row.slope.transpose();
            equations.sum += weight * target * row.slope;
        }
        Some(equations)
    }
}

/// What a stationary target in one direction shows.
struct Row {
    /// Speed at which it comes closer, metres per second.
    towards_mps: f64,
    /// How that changes with the calibration.
    slope: SVector<f64, SIZE>,
}

impl Row {
    fn of(azimuth: f64, azimuth_scale: f64, mount: &Mount, motion: &Motion) -> Self {
        let (s, c) = (mount.yaw_rad + azimuth * (1.0 + azimuth_scale)).sin_cos();
        let (v, change) = (motion.velocity, motion.change);
        let lever = mount.x_m * s - mount.y_m * c;
        let towards_mps = c * v.forward_mps + s * v.left_mps + lever * v.yaw_rate_radps;
        let growth = c * change.forward_mps + s * change.left_mps + lever * change.yaw_rate_radps;
        let across = c * (v.left_mps + v.yaw_rate_radps * mount.x_m)
            - s * (v.forward_mps - v.yaw_rate_radps * mount.y_m);
        let slope = SVector::from([
            -growth,
            across,
            s * v.yaw_rate_radps,
            -c * v.yaw_rate_radps,
            towards_mps,
            across * azimuth,
        ]);
        Self { towards_mps, slope }
    }
}

/// Which detections of a scan stand still, by the scan itself: a mount that is turned or a clock that is late must not
/// make movers of them.
struct Standing {
    /// From 0 to 1.
    weights: Vec<f64>,
}

impl Standing {
    /// Fits the radar's velocity along its own axes, starting at what odometry says.
    fn of(scan: &ScanView<'_>, [vx, vy]: [f64; 2], sigma_mps: f64) -> Self {
        let rows: Vec<_> = scan
            .azimuth_rad
            .iter()
            .zip(scan.radial_speed_mps)
            .map(|(azimuth, speed)| {
                let (s, c) = f64::from(*azimuth).sin_cos();
                (Vector2::new(c, s), -f64::from(*speed))
            })
            .collect();
        let expected = Vector2::new(vx, vy);
        let mut velocity = expected;
        for reach_mps in REACH_MPS {
            let mut information = Matrix2::from_diagonal_element((sigma_mps / NEAR_MPS).powi(2));
            let mut sum = information * expected;
            for (row, towards_mps) in &rows {
                let weight = biweight((towards_mps - row.dot(&velocity)) / reach_mps);
                information += weight * row * row.transpose();
                sum += weight * *towards_mps * row;
            }
            let Some(inverse) = information.try_inverse() else { break };
            velocity = inverse * sum;
        }
        let [.., last] = REACH_MPS;
        let weights =
            rows.iter().map(|(row, towards)| biweight((towards - row.dot(&velocity)) / last)).collect();
        Self { weights }
    }
}

/// Tukey's weight: 1 at none, 0 from one on.
fn biweight(x: f64) -> f64 {
    (1.0 - x * x).max(0.0).powi(2)
}
