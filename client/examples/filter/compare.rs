//! The last fix carried on by odometry, and the filter, against the truth.

use echofix_client::filter::{self, Filter, FilterConfig, FilterEstimate, FixMeasurement, FixOutcome};
use echofix_core::drive::GeoPose;
use echofix_core::geo::{self, Grid, LatLon};
use echofix_core::pose::{Pose2, wrap_angle};
use nalgebra::{Matrix3, Vector3};

/// Errors at one time, metres and radians.
#[derive(Debug, Clone, Copy)]
pub struct Sample {
    pub raw_m: f64,
    pub raw_rad: f64,
    pub filtered_m: f64,
    pub filtered_rad: f64,
    /// Normalised estimation error squared of the pose; 3 on average where the covariance is honest.
    pub nees: f64,
}

/// A filter beside the plainest thing one can do with fixes.
#[derive(Debug)]
pub struct Comparison {
    filter: Filter,
    /// The newest fix, and odometry at its time.
    newest: Option<(FixMeasurement, Pose2)>,
    pub samples: Vec<Sample>,
    pub used: usize,
    pub gated: usize,
    pub resets: usize,
}

impl Comparison {
    pub fn new(config: FilterConfig) -> Self {
        let (filter, samples) = (Filter::new(config), Vec::new());
        Self { filter, newest: None, samples, used: 0, gated: 0, resets: 0 }
    }

    pub fn push_odometry(&mut self, time_us: i64, pose: Pose2) -> Result<(), filter::Error> {
        self.filter.push_odometry(time_us, pose)
    }

    /// A fix, and odometry at its time.
    pub fn push_fix(&mut self, fix: &FixMeasurement, odometry: Pose2) -> Result<(), filter::Error> {
        if self.newest.is_none_or(|(newest, _)| fix.time_us > newest.time_us) {
            self.newest = Some((*fix, odometry));
        }
        match self.filter.push_fix(fix)? {
            FixOutcome::Used { .. } => self.used += 1,
            FixOutcome::Gated { .. } => self.gated += 1,
            FixOutcome::Reset { .. } => self.resets += 1,
            _ => {}
        }
        Ok(())
    }

    /// Compares with the truth at the time of the newest odometry pose.
    pub fn judge(&mut self, truth: &GeoPose, odometry: &Pose2) -> Result<(), geo::Error> {
        let (Some(estimate), Some((fix, then))) = (self.filter.pose(), self.newest) else { return Ok(()) };
        let (at, yaw_rad) = carried((fix.at, fix.yaw_rad), &then.between(odometry))?;
        let raw = error(at, yaw_rad, truth)?;
        let filtered = error(estimate.pose.at, estimate.pose.yaw_rad, truth)?;
        self.samples.push(Sample {
            raw_m: raw.x.hypot(raw.y),
            raw_rad: raw.z.abs(),
            filtered_m: filtered.x.hypot(filtered.y),
            filtered_rad: filtered.z.abs(),
            nees: nees(&filtered, &estimate),
        });
        Ok(())
    }

    /// What several drives showed.
    pub fn pooled(drives: Vec<Self>) -> Self {
        let mut all = Self::new(FilterConfig::default());
        for drive in drives {
            all.samples.extend(drive.samples);
            (all.used, all.gated, all.resets) =
                (all.used + drive.used, all.gated + drive.gated, all.resets + drive.resets);
        }
        all
    }

    /// The value below which a fraction of the samples lies; NaN without any.
    pub fn percentile(&self, fraction: f64, of: impl Fn(&Sample) -> f64) -> f64 {
        let mut values: Vec<f64> = self.samples.iter().map(of).collect();
        values.sort_by(f64::total_cmp);
        let last = values.len().saturating_sub(1) as f64;
        values.get((fraction * last).round() as usize).copied().unwrap_or(f64::NAN)
    }

    pub fn mean_nees(&self) -> f64 {
        self.samples.iter().map(|sample| sample.nees).sum::<f64>() / self.samples.len() as f64
    }

    /// For people.
    pub fn table(&self) -> String {
        let row = |name: &str, of: &dyn Fn(&Sample) -> f64| {
            let [p50, p95, p99] = [0.5, 0.95, 0.99].map(|fraction| self.percentile(fraction, of));
            format!("{name:<36}{p50:>8.2}{p95:>8.2}{p99:>8.2}\n")
        };
        [
            format!("{:<36}{:>8}{:>8}{:>8}\n", "", "50 %", "95 %", "99 %"),
            row("position, last fix + odometry   cm", &|s| 100.0 * s.raw_m),
            row("position, filter                cm", &|s| 100.0 * s.filtered_m),
            row("heading, last fix + odometry   deg", &|s| s.raw_rad.to_degrees()),
            row("heading, filter                deg", &|s| s.filtered_rad.to_degrees()),
            format!("fixes: {} used, {} gated, {} resets; ", self.used, self.gated, self.resets),
            format!("mean NEES {:.2} (3 is honest)\n", self.mean_nees()),
        ]
        .concat()
    }
}

/// A position and true heading after a motion in ground metres of the body's frame.
fn carried((at, yaw_rad): (LatLon, f64), moved: &Pose2) -> Result<(LatLon, f64), geo::Error> {
    let grid = Grid::of(at)?;
    let scale = grid.scale_factor(at)?;
    let moved = Pose2::new(scale * moved.x_m, scale * moved.y_m, moved.yaw_rad);
    grid.pose_to_geodetic(&grid.pose_from_geodetic(at, yaw_rad)?.compose(&moved))
}

/// (true east m, true north m, yaw rad) from the truth.
fn error(at: LatLon, yaw_rad: f64, truth: &GeoPose) -> Result<Vector3<f64>, geo::Error> {
    let grid = Grid::of(truth.at)?;
    let scale = grid.scale_factor(truth.at)?;
    let off = grid.pose_from_geodetic(truth.at, 0.0)?.between(&grid.pose_from_geodetic(at, yaw_rad)?);
    Ok(Vector3::new(off.x_m / scale, off.y_m / scale, wrap_angle(yaw_rad - truth.yaw_rad)))
}

fn nees(error: &Vector3<f64>, estimate: &FilterEstimate) -> f64 {
    let [xx, xy, xt, yy, yt, tt] = estimate.covariance;
    let covariance = Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt);
    covariance.try_inverse().map_or(f64::INFINITY, |inverse| error.dot(&(inverse * error)))
}
