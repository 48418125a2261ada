//! The segments of a drive that can be mapped from.
//!
//! The vehicle takes [`usable_segments`] of a drive before it uploads; the build of evidence splits them
//! further ([`split_segments`]), so that each lies near the same zones and has one scale factor.

use super::GeoPose;
use crate::geo::{self, MetresPerDegree, Zone, ground_distance_m, zones_near};

/// How far from a zone's border the map is held in the neighbouring zone too, metres.
const ZONE_MARGIN_M: f64 = 512.0;
/// A segment is projected with one scale factor, which changes by less than 2e-5 over this length:
/// a millimetre at the farthest detection.
const SEGMENT_M: f64 = 2_000.0;

/// What the poses of a drive segment must fulfil.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SegmentLimits {
    /// Poses with a larger one-sigma error of the position are not mapped from, metres.
    pub max_sigma_position_m: f64,
    /// Poses with a larger one-sigma error of the heading are not mapped from, radians.
    pub max_sigma_yaw_rad: f64,
    /// Poses farther apart in time are not interpolated between, seconds.
    pub max_pose_gap_s: f64,
    /// Faster motion between two poses is a jump, metres per second. Infinite on the vehicle, which leaves
    /// jumps to the build of evidence: to split there, too, would drop scans that are uploaded today.
    pub max_speed_mps: f64,
}

impl Default for SegmentLimits {
    fn default() -> Self {
        Self {
            max_sigma_position_m: 0.3,
            max_sigma_yaw_rad: 0.5_f64.to_radians(),
            max_pose_gap_s: 1.0,
            max_speed_mps: 70.0,
        }
    }
}

impl SegmentLimits {
    /// Is a pose known well enough to map from?
    #[must_use]
    pub fn allows(&self, pose: &GeoPose) -> bool {
        pose.sigma_position_m <= self.max_sigma_position_m && pose.sigma_yaw_rad <= self.max_sigma_yaw_rad
    }

    /// Is the motion between two poses known, and one that a vehicle can make?
    fn connects(&self, pose: &GeoPose, next: &GeoPose) -> bool {
        let gap_s = (next.time_us - pose.time_us) as f64 * 1e-6;
        let torn = gap_s > self.max_pose_gap_s
            || ground_distance_m(pose.at, next.at, MetresPerDegree::WGS84) > self.max_speed_mps * gap_s;
        !torn
    }
}

/// Poses known well enough, without gaps or jumps, near the same zones.
#[derive(Debug, Clone, PartialEq)]
pub struct DriveSegment<'a> {
    /// The zone the poses belong to, then those whose border is near.
    pub zones: Vec<Zone>,
    /// At least two.
    pub poses: &'a [GeoPose],
}

/// Splits poses, oldest first, where one is not known well enough, at gaps and at jumps. Single poses are left
/// out: nothing can be interpolated on them.
pub fn usable_segments<'a>(
    poses: &'a [GeoPose],
    limits: &SegmentLimits,
) -> impl Iterator<Item = &'a [GeoPose]> {
    runs(poses, *limits).filter(|run| run.len() > 1)
}

/// Splits poses, oldest first, as [`usable_segments`] does, and moreover where other zones come near and
/// where the scale factor would change.
///
/// # Errors
/// When a pose that is known well enough, be it a single one, lies outside UTM.
pub fn split_segments<'a>(
    poses: &'a [GeoPose],
    limits: &SegmentLimits,
) -> Result<Vec<DriveSegment<'a>>, geo::Error> {
    let mut segments = Vec::new();
    for run in runs(poses, *limits) {
        let (mut from, mut zones) = (0, zones_near(run[0].at, ZONE_MARGIN_M)?);
        for (index, pose) in run.iter().enumerate().skip(1) {
            let next = zones_near(pose.at, ZONE_MARGIN_M)?;
            let long = ground_distance_m(run[from].at, pose.at, MetresPerDegree::WGS84) > SEGMENT_M;
            if long || next != zones {
                // The next segment shares this pose, so that no scan falls between them.
                segments.push(DriveSegment { zones, poses: &run[from..=index] });
                (from, zones) = (index, next);
            }
        }
        segments.push(DriveSegment { zones, poses: &run[from..] });
    }
    segments.retain(|segment| segment.poses.len() > 1);
    Ok(segments)
}

/// Poses that are known well enough and connected, none of them empty.
fn runs(poses: &[GeoPose], limits: SegmentLimits) -> impl Iterator<Item = &[GeoPose]> {
    poses
        .split(move |pose| !limits.allows(pose))
        .flat_map(move |run| run.chunk_by(move |pose, next| limits.connects(pose, next)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::LatLon;

    /// Northbound at 10 m/s, a pose every 100 ms.
    fn way(poses: usize, lon_deg: f64) -> Vec<GeoPose> {
        let pose = |i: usize| GeoPose {
            time_us: i as i64 * 100_000,
            at: LatLon { lat_deg: 51.0 + i as f64 / 111_132.0, lon_deg },
            sigma_position_m: 0.1,
            ..GeoPose::default()
        };
        (0..poses).map(pose).collect()
    }

    fn lengths(poses: &[GeoPose]) -> Vec<usize> {
        let segments = split_segments(poses, &SegmentLimits::default()).unwrap();
        segments.iter().map(|segment| segment.poses.len()).collect()
    }

    #[test]
    fn an_uncertain_pose_a_gap_and_a_jump_cut() {
        let good = way(30, 7.0);
        assert_eq!(lengths(&good), [30]);
        let mut poses = good.clone();
        poses[10].sigma_position_m = 0.5;
        assert_eq!(lengths(&poses), [10, 19]);
        poses[20].sigma_yaw_rad = 0.1;
        assert_eq!(lengths(&poses), [10, 9, 9]);
        let mut poses = good.clone();
        poses[15..].iter_mut().for_each(|pose| pose.time_us += 2_000_000);
        assert_eq!(lengths(&poses), [15, 15]);
        let mut poses = good;
        poses[15..].iter_mut().for_each(|pose| pose.at.lon_deg += 0.001);
        assert_eq!(lengths(&poses), [15, 15]);
    }

    #[test]
    fn a_zone_border_and_a_long_way_cut_at_a_shared_pose() {
        let poses = way(4_500, 7.0);
        let segments = split_segments(&poses, &SegmentLimits::default()).unwrap();
        assert_eq!(segments.len(), 3);
        for pair in segments.windows(2) {
            assert_eq!(pair[0].poses.last(), pair[1].poses.first());
        }
        let east = |pose: GeoPose| GeoPose {
            at: LatLon { lat_deg: 51.0, lon_deg: 5.9 + (pose.at.lat_deg - 51.0) * 2.0 },
            ..pose
        };
        let eastbound: Vec<_> = way(10_000, 0.0).into_iter().map(east).collect();
        let segments = split_segments(&eastbound, &SegmentLimits::default()).unwrap();
        let zones: Vec<Vec<u16>> =
            segments.iter().map(|s| s.zones.iter().map(|z| z.epsg()).collect()).collect();
        assert!(zones.contains(&vec![32631, 32632]) && zones.contains(&vec![32632, 32631]), "{zones:?}");
    }

    #[test]
    fn doubtful_poses_and_gaps_split_a_drive() {
        let pose = |time_ms: i64, sigma_position_m, sigma_yaw_rad| GeoPose {
            time_us: time_ms * 1000,
            sigma_position_m,
            sigma_yaw_rad,
            ..GeoPose::default()
        };
        let poses = [
            pose(0, 0.1, 0.001),
            pose(100, 0.1, 0.001),
            pose(200, 0.9, 0.001), // doubtful position
            pose(300, 0.1, 0.001), // alone
            pose(400, 0.1, 0.1),   // doubtful heading
            pose(500, 0.1, 0.001),
            pose(600, 0.1, 0.001),
            pose(9600, 0.1, 0.001), // after a gap
            pose(9700, 0.1, 0.001),
        ];
        let limits =
            SegmentLimits { max_pose_gap_s: 0.5, max_speed_mps: f64::INFINITY, ..SegmentLimits::default() };
        let lengths: Vec<_> =
            usable_segments(&poses, &limits).map(|run| (run[0].time_us / 1000, run.len())).collect();
        assert_eq!(lengths, [(0, 2), (500, 2), (9600, 2)]);
    }
}
