//! What a vehicle needs, and how its odometry drifts.

use echofix_core::doppler::dedrift::OdometryBias;
use echofix_core::gate::Gate;
use echofix_core::odometry::OdometryQuality;

use super::VehicleCalibration;

/// How a [`Vehicle`](super::Vehicle) collects, asks and judges.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct VehicleConfig {
    /// Length of the sliding window, seconds: what a batch spans (paper, Sec. "Test procedure").
    pub window_s: f64,
    /// Which detections pass. Beyond the service's own limit of the range (`radar.max_range_m`) they are sent for
    /// nothing.
    pub gate: Gate,
    /// Scans between odometry poses farther apart than this are dropped, seconds: their position
    /// would be a guess.
    pub max_odometry_gap_s: f64,
    /// How odometry drifts.
    pub drift: DriftModel,
    /// How odometry may err within a batch, for the radars' radial speeds to correct it; `None` to
    /// leave it as it is. Radars that measure no radial speed correct nothing.
    pub odometry_bias: Option<OdometryBias>,
    /// How good the odometry is by itself; radial speeds that correct it make it better. The default is the worst that
    /// is usual: state it, and answers get better.
    pub odometry_quality: OdometryQuality,
    /// How well mounts and clocks of the radars are known, and what becomes of what the drive says of them.
    pub calibration: VehicleCalibration,
    /// A prior is never called better known than this, metres: the search must reach past a fix
    /// that was overconfident.
    pub min_prior_sigma_position_m: f64,
    /// The same for the heading, radians.
    pub min_prior_sigma_yaw_rad: f64,
    /// Probability, per answer, that an error exceeds its protection level unnoticed; 0 asks for
    /// the service's default.
    pub integrity_risk: f64,
    /// The largest protection levels the vehicle can use.
    pub alert_limits: AlertLimits,
    /// Whether an answer must carry valid protection levels. Switching this off trusts the status
    /// alone: for experiments with a map that is not calibrated, not for driving.
    pub require_valid_protection: bool,
    /// An answer that is for a time longer ago than this is not used, seconds.
    pub max_fix_age_s: f64,
}

impl Default for VehicleConfig {
    fn default() -> Self {
        Self {
            window_s: 5.0,
            gate: Gate::default(),
            max_odometry_gap_s: 0.5,
            drift: DriftModel::default(),
            odometry_bias: Some(OdometryBias::default()),
            odometry_quality: OdometryQuality::default(),
            calibration: VehicleCalibration::default(),
            min_prior_sigma_position_m: 0.5,
            min_prior_sigma_yaw_rad: 1_f64.to_radians(),
            integrity_risk: 0.0,
            alert_limits: AlertLimits::default(),
            require_valid_protection: true,
            max_fix_age_s: 5.0,
        }
    }
}

/// The largest protection levels a vehicle can use; infinite where it sets no limit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct AlertLimits {
    /// Along the heading, metres.
    pub along_m: f64,
    /// Across it, metres.
    pub cross_m: f64,
    /// Heading, radians.
    pub yaw_rad: f64,
}

impl Default for AlertLimits {
    /// No limits.
    fn default() -> Self {
        Self { along_m: f64::INFINITY, cross_m: f64::INFINITY, yaw_rad: f64::INFINITY }
    }
}

impl AlertLimits {
    /// The horizontal limit that is sent, metres: it compares the joint level, which stays
    /// within this whenever each level stays within its own limit, and the vehicle itself checks
    /// each; 0 without any.
    pub(super) fn on_the_wire_m(&self) -> f64 {
        let horizontal = self.along_m.hypot(self.cross_m);
        if horizontal.is_finite() { horizontal } else { 0.0 }
    }
}

/// How what is known of a pose fades while odometry carries it.
///
/// After `d` metres and `t` seconds, with one-sigma errors `p0` (metres) and `h0` (radians) at the
/// start:
///
/// - position: `sqrt(p0^2 + (position_per_m * d)^2 + (h0 * d)^2)`, since a heading error swings
///   the whole way;
/// - heading: `sqrt(h0^2 + (yaw_rad_per_m * d)^2 + (yaw_rad_per_s * t)^2)`.
///
/// The terms grow linearly, as a scale error and a gyro bias make them: pessimistic over a long way,
/// which is the side to err on.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriftModel {
    /// Metres of error a metre travelled.
    pub position_per_m: f64,
    /// Radians of error a metre travelled.
    pub yaw_rad_per_m: f64,
    /// Radians of error a second.
    pub yaw_rad_per_s: f64,
}

impl Default for DriftModel {
    /// Wheel odometry with an automotive gyro: 2 %, 0.006 degrees a metre, 0.006 degrees a second.
    fn default() -> Self {
        Self { position_per_m: 0.02, yaw_rad_per_m: 1e-4, yaw_rad_per_s: 1e-4 }
    }
}

impl DriftModel {
    /// One-sigma error of the position after a way, metres, from the errors at its start.
    #[must_use]
    pub fn position_m(&self, position_m: f64, yaw_rad: f64, travelled_m: f64) -> f64 {
        position_m.hypot(self.position_per_m * travelled_m).hypot(yaw_rad * travelled_m)
    }

    /// One-sigma error of the heading after a way, radians, from the error at its start.
    #[must_use]
    pub fn yaw_rad(&self, yaw_rad: f64, travelled_m: f64, elapsed_s: f64) -> f64 {
        yaw_rad.hypot(self.yaw_rad_per_m * travelled_m).hypot(self.yaw_rad_per_s * elapsed_s)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn knowledge_fades_with_the_way_and_never_sharpens() {
        let drift = DriftModel::default();
        assert!((drift.position_m(0.3, 0.01, 0.0) - 0.3).abs() < 1e-12);
        assert!((drift.yaw_rad(0.01, 0.0, 0.0) - 0.01).abs() < 1e-12);
        // 2 m of scale error and 1 m of heading error over 100 m.
        let far_m = drift.position_m(0.3, 0.01, 100.0);
        assert!((far_m - (0.09_f64 + 4.0 + 1.0).sqrt()).abs() < 1e-9, "{far_m}");
        assert!(drift.yaw_rad(0.01, 100.0, 10.0) > drift.yaw_rad(0.01, 10.0, 1.0));
    }

    #[test]
    fn the_service_is_told_the_limit_that_leaves_the_choice_to_the_vehicle() {
        assert!(AlertLimits::default().on_the_wire_m().abs() < f64::EPSILON);
        let limits = AlertLimits { along_m: 3.0, cross_m: 1.0, yaw_rad: 0.1 };
        assert!((limits.on_the_wire_m() - 10_f64.sqrt()).abs() < 1e-12);
    }
}
