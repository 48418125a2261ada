//! Values that would make no sense.

use super::{Config, Error};
use crate::mapping::MappingConfig;

impl Config {
    pub(super) fn check(&self) -> Result<(), Error> {
        let Self { store, locating, limits, .. } = self;
        let positive = "must be above 0";
        let within = |value: f64, most: f64| value > 0.0 && value <= most;
        let rules = [
            ("store.cache_mib", store.cache_mib > 0, positive),
            ("store.segment_mib", (1..=1024).contains(&store.segment_mib), "must lie within 1 and 1024"),
            ("locating.threads", locating.threads <= 1024, "must be at most 1024"),
            ("locating.queue", locating.queue <= 4096, "must be at most 4096"),
            (
                "locating.tile_cache_mib",
                (1..=1 << 20).contains(&locating.tile_cache_mib),
                "must lie within 1 and 1048576",
            ),
            (
                "locating.confirm_share",
                (0.0..=1.0).contains(&locating.confirm_share),
                "must lie within 0 and 1",
            ),
            (
                "locating.wide_search_m",
                (0.0..=100.0).contains(&locating.wide_search_m),
                "must lie within 0 and 100",
            ),
            (
                "locating.min_speed_mps",
                locating.min_speed_mps.is_finite() && locating.min_speed_mps >= 0.0,
                "must be finite and not negative",
            ),
            (
                "radar.max_range_m",
                (1.0..=300.0).contains(&self.radar.max_range_m),
                "must lie within 1 and 300",
            ),
            (
                "locating.max_range_m",
                (0.0..=300.0).contains(&locating.max_range_m),
                "must lie within 0 and 300; 0 takes radar.max_range_m",
            ),
            (
                "locating.max_doppler_residual_mps",
                within(locating.max_doppler_residual_mps, f64::MAX),
                "must be finite and above 0",
            ),
            ("locating.min_detections", locating.min_detections > 0, positive),
            (
                "locating.max_sigma_position_m",
                within(locating.max_sigma_position_m, 20.0),
                "must be above 0 and at most 20",
            ),
            (
                "locating.max_sigma_yaw_deg",
                within(locating.max_sigma_yaw_deg, 45.0),
                "must be above 0 and at most 45",
            ),
            (
                "locating.integrity_risk",
                locating.integrity_risk > 0.0 && locating.integrity_risk < 1.0,
                "must lie between 0 and 1",
            ),
            ("limits.connections", limits.connections > 0, positive),
            ("limits.streams_per_connection", limits.streams_per_connection > 0, positive),
            (
                "limits.message_bytes",
                (1024..=64 << 20).contains(&limits.message_bytes),
                "must lie within 1024 and 67108864",
            ),
            ("limits.header_bytes", limits.header_bytes >= 1024, "must be at least 1024"),
            (
                "limits.reads_at_once",
                (1..=4096).contains(&limits.reads_at_once),
                "must lie within 1 and 4096",
            ),
            ("limits.handshake_s", limits.handshake_s > 0, positive),
            ("limits.keepalive_s", limits.keepalive_s > 0, positive),
            ("limits.keepalive_timeout_s", limits.keepalive_timeout_s > 0, positive),
            ("limits.request_s", limits.request_s > 0, positive),
            ("limits.stall_s", limits.stall_s > 0, positive),
        ];
        match rules.into_iter().chain(mapping(&self.mapping)).find(|(_, holds, _)| !holds) {
            Some((key, _, rule)) => Err(Error::OutOfRange { key, rule }),
            None => Ok(()),
        }
    }
}

/// Rules of the section on mapping.
fn mapping(mapping: &MappingConfig) -> impl Iterator<Item = (&'static str, bool, &'static str)> + use<> {
    let positive = "must be above 0";
    let within = |value: f64, most: f64| value > 0.0 && value <= most;
    let rules = [
        ("mapping.max_sigma_position_m", mapping.max_sigma_position_m > 0.0, positive),
        ("mapping.max_sigma_yaw_deg", mapping.max_sigma_yaw_deg > 0.0, positive),
        ("mapping.min_speed_mps", mapping.min_speed_mps >= 0.0, "must not be negative"),
        (
            "mapping.max_range_m",
            (0.0..=500.0).contains(&mapping.max_range_m),
            "must lie within 0 and 500; 0 takes radar.max_range_m",
        ),
        ("mapping.max_doppler_residual_mps", mapping.max_doppler_residual_mps > 0.0, positive),
        ("mapping.max_pose_gap_s", mapping.max_pose_gap_s > 0.0, positive),
        ("mapping.max_speed_mps", mapping.max_speed_mps > mapping.min_speed_mps, "must exceed min_speed_mps"),
        ("mapping.publish_contributors", mapping.publish_contributors > 0, positive),
        ("mapping.vet_shift_m", within(mapping.vet_shift_m, 5.0), "must lie within 0 and 5"),
        ("mapping.vet_turn_deg", within(mapping.vet_turn_deg, 3.0), "must lie within 0 and 3"),
        ("mapping.half_life_days", within(mapping.half_life_days, 1e5), "must lie within 0 and 100000"),
        ("mapping.expire_days", mapping.expire_days > 0, positive),
        ages(mapping),
        ("mapping.max_upload_bytes", mapping.max_upload_bytes >= 1024, "must be at least 1024"),
        ("mapping.max_upload_detections", mapping.max_upload_detections > 0, positive),
        ("mapping.max_upload_tiles", mapping.max_upload_tiles > 0, positive),
        (
            "mapping.uploads_at_once",
            (1..=256).contains(&mapping.uploads_at_once),
            "must lie within 1 and 256",
        ),
        ("mapping.max_unfolded", mapping.max_unfolded > 0, positive),
    ];
    rules.into_iter()
}

/// Ids are forgotten with what is compacted: what comes again must be refused for its age by then.
fn ages(mapping: &MappingConfig) -> (&'static str, bool, &'static str) {
    let holds = mapping.retention_days == 0 || mapping.max_age_days < mapping.retention_days;
    let rule = "must be less than mapping.retention_days: an upload sent again after that would count twice";
    ("mapping.max_age_days", holds, rule)
}
