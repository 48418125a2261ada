//! Clock and lever arm of radars without radial speeds, from the vehicle's own fixes.

use std::collections::VecDeque;

use echofix_core::calibration::fixes::{FixCalibration, FixSeen, SharedCalibration};
use echofix_core::calibration::{CalibrationConfig, Estimated, RadarCalibration};
use echofix_core::drive::GeoPose;
use echofix_core::geo::{self, Grid, Zone};
use echofix_core::odometry::BodyVelocity;
use echofix_core::pose::Pose2;

/// What was taken from the stamps of a batch and added to its mounts, on top of how the vehicle was built.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub(super) struct Applied {
    pub late_s: f64,
    pub forward_m: f64,
    pub left_m: f64,
}

/// Estimates from fixes while driving.
#[derive(Debug, Clone)]
pub(super) struct FixCalibrator {
    evidence: FixCalibration,
    /// Of the estimate: what a turn of the boresight may be, of which fixes say nothing.
    unknown_yaw_rad: f64,
    plane: Option<GroundPlane>,
    /// Since when stamps are corrected by how much, oldest first.
    late: VecDeque<(i64, f64)>,
    fixes: usize,
    driven_s: f64,
    last_us: Option<i64>,
}

/// Corrections of the clock that are remembered: a batch's, should each fix bring another.
const MAX_REMEMBERED: usize = 64;
/// Fixes farther apart than this do not say that it was driven between them, microseconds.
const LONGEST_US: i64 = 3_500_000;

impl FixCalibrator {
    pub(super) fn new(config: &CalibrationConfig) -> Self {
        Self {
            evidence: FixCalibration::new(config),
            unknown_yaw_rad: config.prior.yaw_rad,
            plane: None,
            late: VecDeque::new(),
            fixes: 0,
            driven_s: 0.0,
            last_us: None,
        }
    }

    /// By how much the stamps between two times were corrected on average: a batch may hold scans from before and after a
    /// change.
    pub(super) fn late_over(&self, from_us: i64, to_us: i64) -> f64 {
        let to_us = to_us.max(from_us.saturating_add(1));
        let mut sum = 0.0;
        for (index, (since_us, late_s)) in self.late.iter().enumerate() {
            let until_us = self.late.get(index + 1).map_or(i64::MAX, |(next_us, _)| *next_us);
            let shared_us = until_us.min(to_us).saturating_sub((*since_us).max(from_us));
            sum += late_s * shared_us.max(0) as f64;
        }
        sum / (to_us - from_us) as f64
    }

    /// From now on stamps are corrected by so much.
    pub(super) fn apply_late(&mut self, since_us: i64, late_s: f64) {
        if self.late.len() == MAX_REMEMBERED {
            self.late.pop_front();
        }
        self.late.push_back((since_us, late_s));
    }

    /// Takes a fix; what all fixes say of each radar, once they say something.
    pub(super) fn add(
        &mut self,
        fix: &GeoPose,
        (odometry, velocity): (Pose2, BodyVelocity),
        applied: &Applied,
    ) -> Option<RadarCalibration> {
        let on_plane = self.plane.and_then(|plane| plane.pose(fix).ok()).or_else(|| {
            self.plane = GroundPlane::around(fix).ok();
            self.plane?.pose(fix).ok()
        })?;
        // What was corrected already is put back: evidence of before and after a change is of one fault.
        let Applied { late_s, forward_m, left_m } = *applied;
        let put_back = Pose2::new(
            forward_m - velocity.forward_mps * late_s,
            left_m - velocity.left_mps * late_s,
            -velocity.yaw_rate_radps * late_s,
        );
        let GeoPose { time_us, sigma_position_m, sigma_yaw_rad, .. } = *fix;
        let fix = on_plane.compose(&put_back);
        self.evidence.add(FixSeen { time_us, fix, sigma_position_m, sigma_yaw_rad, odometry, velocity });
        self.fixes += 1;
        let since_us = self.last_us.replace(time_us).map_or(i64::MAX, |last_us| time_us - last_us);
        if since_us <= LONGEST_US {
            self.driven_s += since_us as f64 * 1e-6;
        }
        self.evidence.shared().map(|shared| self.of_each_radar(&shared))
    }

    fn of_each_radar(&self, shared: &SharedCalibration) -> RadarCalibration {
        let SharedCalibration { late_s, forward_m, left_m } = *shared;
        let yaw_rad = Estimated { value: 0.0, sigma: self.unknown_yaw_rad };
        RadarCalibration { late_s, yaw_rad, forward_m, left_m, scans: self.fixes, driven_s: self.driven_s }
    }
}

/// Ground metres in which poses from one fix to the next can be compared.
#[derive(Debug, Clone, Copy)]
struct GroundPlane {
    zone: Zone,
    scale: f64,
}

impl GroundPlane {
    fn around(fix: &GeoPose) -> Result<Self, geo::Error> {
        let grid = Grid::of(fix.at)?;
        Ok(Self { zone: grid.zone(), scale: grid.scale_factor(fix.at)? })
    }

    fn pose(&self, fix: &GeoPose) -> Result<Pose2, geo::Error> {
        let pose = Grid::new(self.zone)?.pose_from_geodetic(fix.at, fix.yaw_rad)?;
        Ok(Pose2::new(pose.x_m / self.scale, pose.y_m / self.scale, pose.yaw_rad))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches a batch across a change that counts as all before or all after it.
    #[test]
    fn a_batch_across_a_change_was_corrected_by_its_shares() {
        let mut fixes = FixCalibrator::new(&CalibrationConfig::default());
        assert!(fixes.late_over(0, 5_000_000).abs() < 1e-12);
        fixes.apply_late(1_000_000, 0.02);
        fixes.apply_late(4_000_000, 0.05);
        assert!((fixes.late_over(0, 5_000_000) - (3.0 * 0.02 + 0.05) / 5.0).abs() < 1e-9);
        assert!((fixes.late_over(6_000_000, 7_000_000) - 0.05).abs() < 1e-12);
    }
}
