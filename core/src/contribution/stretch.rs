//! The poses of an upload, cut into stretches that can be mapped from.

use crate::drive::GeoPose;
use crate::geo::{self, LatLon, Zone, zones_near};

use super::Limits;

/// How far from a zone's border the map is kept in the neighbouring zone too, metres.
const ZONE_MARGIN_M: f64 = 512.0;
/// A stretch is laid out with one scale factor, which changes by less than 2e-5 over this way:
/// a millimetre at the farthest detection.
const STRETCH_M: f64 = 2_000.0;

/// Poses known well enough, without gaps or jumps, near the same zones.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Stretch {
    /// The zone the poses belong to, then those whose border is near.
    pub(super) zones: Vec<Zone>,
    /// At least one.
    pub(super) poses: Vec<GeoPose>,
}

/// What became of the poses.
#[derive(Debug, Default)]
pub(super) struct Cut {
    pub(super) stretches: Vec<Stretch>,
    /// Poses not known well enough.
    pub(super) uncertain: usize,
}

/// Cuts poses, oldest first.
pub(super) fn cut(poses: &[GeoPose], limits: &Limits) -> Result<Cut, geo::Error> {
    let mut cut = Cut::default();
    let mut open: Option<Stretch> = None;
    for pose in poses {
        if !certain(pose, limits) {
            cut.uncertain += 1;
            cut.stretches.extend(open.take());
            continue;
        }
        let zones = zones_near(pose.at, ZONE_MARGIN_M)?;
        let begin = |zones| Stretch { zones, poses: vec![*pose] };
        open = Some(match open.take() {
            None => begin(zones),
            Some(stretch) if torn(&stretch, pose, limits) => {
                cut.stretches.push(stretch);
                begin(zones)
            }
            Some(mut stretch) => {
                stretch.poses.push(*pose);
                let long = ground_distance_m(stretch.poses[0].at, pose.at) > STRETCH_M;
                if long || stretch.zones != zones {
                    // The next stretch shares this pose, so that no scan falls between them.
                    cut.stretches.push(stretch);
                    begin(zones)
                } else {
                    stretch
                }
            }
        });
    }
    cut.stretches.extend(open);
    Ok(cut)
}

fn certain(pose: &GeoPose, limits: &Limits) -> bool {
    pose.sigma_position_m <= limits.max_sigma_position_m && pose.sigma_yaw_rad <= limits.max_sigma_yaw_rad
}

/// Is the way to the next pose unknown, or one that no vehicle drives?
fn torn(stretch: &Stretch, next: &GeoPose, limits: &Limits) -> bool {
    let Some(last) = stretch.poses.last() else { return true };
    let gap_s = (next.time_us - last.time_us) as f64 * 1e-6;
    gap_s > limits.max_pose_gap_s || ground_distance_m(last.at, next.at) > limits.max_speed_mps * gap_s
}

/// Metres between near positions.
fn ground_distance_m(a: LatLon, b: LatLon) -> f64 {
    let east_deg = (b.lon_deg - a.lon_deg + 180.0).rem_euclid(360.0) - 180.0;
    let east_m = east_deg * 111_320.0 * a.lat_deg.to_radians().cos();
    east_m.hypot((b.lat_deg - a.lat_deg) * 111_132.0)
}

#[cfg(test)]
mod tests {
    use super::*;

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
        let cut = cut(poses, &Limits::default()).unwrap();
        cut.stretches.iter().map(|stretch| stretch.poses.len()).collect()
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
        let cut = cut(&poses, &Limits::default()).unwrap();
        assert_eq!(cut.stretches.len(), 3);
        for pair in cut.stretches.windows(2) {
            assert_eq!(pair[0].poses.last(), pair[1].poses.first());
        }
        let east = |pose: GeoPose| GeoPose {
            at: LatLon { lat_deg: 51.0, lon_deg: 5.9 + (pose.at.lat_deg - 51.0) * 2.0 },
            ..pose
        };
        let eastbound: Vec<_> = way(10_000, 0.0).into_iter().map(east).collect();
        let cut = super::cut(&eastbound, &Limits::default()).unwrap();
        let zones: Vec<Vec<u16>> =
            cut.stretches.iter().map(|s| s.zones.iter().map(|z| z.epsg()).collect()).collect();
        assert!(zones.contains(&vec![32631, 32632]) && zones.contains(&vec![32632, 32631]), "{zones:?}");
    }
}
