//! What is recorded, and how it is split.

use echofix_core::drive::segment::SegmentLimits;
use echofix_core::evidence::build::EvidenceLimits;
use echofix_core::gate::Gate;

/// What of a drive is sent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum UploadForm {
    /// Cells that were hit, and what was in view: small, and it shows neither when nor along which way the
    /// vehicle drove.
    #[default]
    Evidence,
    /// The scans, and the poses they were taken from.
    Scans,
}

/// What is recorded, and how it is split.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct RecorderConfig {
    /// Which detections pass. The service holds scans, but not evidence, against a limit of the range of its own
    /// (`radar.max_range_m`).
    pub gate: Gate,
    /// What is sent.
    pub form: UploadForm,
    /// Poses less well known than this are not mapped from, metres (one sigma an axis).
    pub max_sigma_position_m: f64,
    /// Poses whose heading is less well known than this are not mapped from, radians.
    pub max_sigma_yaw_rad: f64,
    /// Scans between poses farther apart than this are dropped, seconds.
    pub max_pose_gap_s: f64,
    /// An upload ends after this time, seconds.
    pub cut_after_s: f64,
    /// An upload ends after this distance, metres.
    pub cut_after_m: f64,
    /// Scans may come this much later than the poses that cover them, seconds.
    pub lateness_s: f64,
    /// Nothing is recorded within this distance of where a trip began and where it ended, metres, so
    /// that uploads show neither position. A stop of two minutes ends a trip. 100 m unless set; 0
    /// records all, which is for vehicles whose ends are nobody's secret, such as a survey's.
    pub trim_ends_m: f64,
}

impl Default for RecorderConfig {
    fn default() -> Self {
        Self {
            gate: Gate::default(),
            form: UploadForm::Evidence,
            max_sigma_position_m: 0.3,
            max_sigma_yaw_rad: 0.5_f64.to_radians(),
            max_pose_gap_s: 0.5,
            cut_after_s: 10.0,
            cut_after_m: 100.0,
            lateness_s: 0.5,
            trim_ends_m: 100.0,
        }
    }
}

impl RecorderConfig {
    /// What the poses of a segment must fulfil. Jumps are left to the build of evidence.
    pub(super) fn segments(&self) -> SegmentLimits {
        SegmentLimits {
            max_sigma_position_m: self.max_sigma_position_m,
            max_sigma_yaw_rad: self.max_sigma_yaw_rad,
            max_pose_gap_s: self.max_pose_gap_s,
            max_speed_mps: f64::INFINITY,
        }
    }

    /// The limits for building evidence. Movers are gone already: odometry shows them better than the
    /// differences of absolute poses do.
    pub(super) fn evidence(&self) -> EvidenceLimits {
        EvidenceLimits {
            gate: Gate { max_doppler_residual_mps: f64::INFINITY, ..self.gate },
            segments: SegmentLimits {
                max_speed_mps: SegmentLimits::default().max_speed_mps,
                ..self.segments()
            },
            ..EvidenceLimits::default()
        }
    }
}
