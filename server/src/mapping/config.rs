//! What an upload must fulfil.

use crate::store::Policy;
use echofix_core::demand::DemandPolicy;
use echofix_core::drive::segment::SegmentLimits;
use echofix_core::evidence::build::EvidenceLimits;
use echofix_core::gate::{Gate, MAX_RANGE_M};
use echofix_core::tile::Decay;
use echofix_core::vetting;
use serde::{Deserialize, Serialize};

/// The `[mapping]` section of the configuration.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MappingConfig {
    /// Poses with a larger one-sigma error of the position are not mapped from, metres.
    pub max_sigma_position_m: f64,
    /// Poses with a larger one-sigma error of the heading are not mapped from, degrees.
    pub max_sigma_yaw_deg: f64,
    /// Scans taken more slowly are left out, metres per second.
    pub min_speed_mps: f64,
    /// Farther detections are left out, metres; in the file 0 for that of `[radar]`.
    pub max_range_m: f64,
    /// Detections whose radial speed differs more from a stationary target's are left out, metres
    /// per second.
    pub max_doppler_residual_mps: f64,
    /// Poses farther apart in time are not interpolated between, seconds.
    pub max_pose_gap_s: f64,
    /// Faster motion between two poses is a jump, metres per second.
    pub max_speed_mps: f64,
    /// Distinct contributors that must have seen something near a cell for it to be published.
    pub publish_contributors: u8,
    /// Whether uploads are vetted: compared with the map before they count.
    pub vet: bool,
    /// An upload that lies farther beside the map is quarantined, metres.
    pub vet_shift_m: f64,
    /// An upload that is turned farther against the map is quarantined, degrees.
    pub vet_turn_deg: f64,
    /// Days after which unconfirmed evidence weighs half.
    pub half_life_days: f64,
    /// Days after which unconfirmed evidence is not published any more.
    pub expire_days: u16,
    /// Older uploads are refused, days; 0 takes any age.
    pub max_age_days: u16,
    /// Uploads stay revocable, and their contributors' hashes known, for this long after they came, days;
    /// 0 keeps them for ever.
    pub retention_days: u16,
    /// Passes over a place that are enough: further uploads of it are wanted now and then only; 0 wants all.
    pub enough_passes: u16,
    /// Days after the newest upload of such a place from which on another one is wanted.
    pub refresh_days: u16,
    /// Bytes of one upload, at most.
    pub max_upload_bytes: usize,
    /// Detections of one upload, at most.
    pub max_upload_detections: usize,
    /// Tiles of one upload, at most.
    pub max_upload_tiles: usize,
    /// Uploads received at once; further ones are refused for the moment.
    pub uploads_at_once: usize,
    /// Uploads in the journal that may wait to be folded; further ones are refused for the moment.
    pub max_unfolded: u64,
}

impl Default for MappingConfig {
    fn default() -> Self {
        Self {
            max_sigma_position_m: 0.3,
            max_sigma_yaw_deg: 0.5,
            min_speed_mps: 1.0,
            max_range_m: MAX_RANGE_M,
            max_doppler_residual_mps: 0.5,
            max_pose_gap_s: 1.0,
            max_speed_mps: 70.0,
            publish_contributors: 3,
            vet: true,
            vet_shift_m: 0.45,
            vet_turn_deg: 1.0,
            half_life_days: 180.0,
            expire_days: 365,
            max_age_days: 0,
            retention_days: 90,
            enough_passes: 0,
            refresh_days: DemandPolicy::default().refresh_days,
            max_upload_bytes: 16 << 20,
            max_upload_detections: 500_000,
            max_upload_tiles: 4_096,
            uploads_at_once: 16,
            max_unfolded: 10_000,
        }
    }
}

impl MappingConfig {
    /// Which evidence counts, and what of it is published.
    #[must_use]
    pub fn policy(&self) -> Policy {
        let (shift_m, yaw_rad) = (self.vet_shift_m, self.vet_turn_deg.to_radians());
        let limits = vetting::VettingLimits { shift_m, yaw_rad, ..vetting::VettingLimits::default() };
        Policy {
            publish_contributors: self.publish_contributors,
            decay: Some(Decay { half_life_days: self.half_life_days, expire_days: self.expire_days }),
            vetting: self.vet.then_some(limits),
        }
    }

    /// Which places are worth another upload.
    #[must_use]
    pub fn demand(&self) -> DemandPolicy {
        DemandPolicy { enough_passes: self.enough_passes, refresh_days: self.refresh_days }
    }

    /// What poses and detections must fulfil. Sigmas come in single precision, in which one that keeps to its limit may
    /// have been rounded up.
    #[must_use]
    pub fn limits(&self) -> EvidenceLimits {
        let as_sent = |most: f64| most.max(f64::from(most as f32));
        let gate = Gate {
            min_speed_mps: self.min_speed_mps,
            max_range_m: self.max_range_m,
            max_doppler_residual_mps: self.max_doppler_residual_mps,
            ..Gate::default()
        };
        EvidenceLimits {
            gate,
            segments: SegmentLimits {
                max_sigma_position_m: as_sent(self.max_sigma_position_m),
                max_sigma_yaw_rad: as_sent(self.max_sigma_yaw_deg.to_radians()),
                max_pose_gap_s: self.max_pose_gap_s,
                max_speed_mps: self.max_speed_mps,
            },
            max_tiles: self.max_upload_tiles,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: poses and evidence refused for good because their sigma is the limit itself.
    #[test]
    fn a_sigma_at_the_limit_keeps_to_it_in_single_precision() {
        let limits = MappingConfig::default().limits().segments;
        assert!((0.3..0.300_001).contains(&limits.max_sigma_position_m));
        assert!(f64::from(0.3_f32) <= limits.max_sigma_position_m);
        assert!(f64::from(0.5_f32.to_radians()) <= limits.max_sigma_yaw_rad);
    }
}
