//! The uploads of a drive, as a vehicle cuts and sends them.

use echofix_client::upload::RecorderConfig;
use echofix_core::datum::PoseSigma;
use echofix_core::drive::segment::usable_segments;
use echofix_core::drive::{Drive, GeoPose};
use echofix_core::evidence::{EvidenceAccumulator, EvidenceDelta, Pass, SENT_STEPS};
use echofix_core::gate::{Gate, MAX_RANGE_M};
use echofix_core::geo::{Grid, Zone};
use echofix_core::odometry::Trajectory;
use echofix_core::pose::Pose2;
use echofix_core::scan::Scan;
use echofix_core::time::DAY_US;

use crate::evaluate::map::{Movers, declared, gated, mapped_from, on_grid};

/// One upload, as it reaches the service.
#[derive(Debug, Clone)]
pub struct VehicleUpload {
    /// Its contributor and its day.
    pub pass: Pass,
    /// Its evidence delta.
    pub delta: EvidenceDelta,
    /// What its contributor declares of its poses.
    pub sigma: PoseSigma,
}

/// How a vehicle makes uploads of its drives.
#[derive(Debug, Clone, Copy)]
pub struct SentForm {
    /// Number of the contributor.
    pub contributor: u64,
    /// Largest standard deviation of a reference pose, metres. Less certain poses add nothing to an upload.
    pub max_sigma_m: f64,
    /// Largest range of a detection, metres. Farther ones are dropped.
    pub max_range_m: f64,
    /// Steps of a cell in which the positions of hits are sent.
    pub steps: u32,
}

impl SentForm {
    /// The uploads that vehicles send to the service.
    pub fn of(contributor: u64) -> Self {
        Self { contributor, max_sigma_m: 0.3, max_range_m: MAX_RANGE_M, steps: SENT_STEPS }
    }
}

/// The uploads of a drive from its reference poses, in order and without movers.
///
/// # Errors
/// When its scans and poses do not fit together.
pub fn cut(drive: &Drive, zone: Zone, form: SentForm) -> anyhow::Result<Vec<VehicleUpload>> {
    cut_wrong(drive, zone, form, |_, _, pose| pose)
}

/// The uploads of a drive from wrong poses. `wrong` makes a pose wrong, from the upload's number, the pose in its middle and the
/// pose itself.
///
/// # Errors
/// When its scans and poses do not fit together.
pub fn cut_wrong(
    drive: &Drive,
    zone: Zone,
    form: SentForm,
    wrong: impl Fn(usize, Pose2, Pose2) -> Pose2,
) -> anyhow::Result<Vec<VehicleUpload>> {
    let grid = Grid::new(zone)?;
    let scans = gated(drive, Movers::Excluded);
    let mut uploads = Vec::new();
    for poses in usable_segments(&drive.reference, &mapped_from(form.max_sigma_m)) {
        for part in parts(&grid, poses, &RecorderConfig::default())? {
            let poses: Vec<_> = on_grid(&grid, part)?.iter().collect();
            let (number, middle) = (uploads.len(), poses[poses.len() / 2].1);
            let poses = poses.into_iter().map(|(time_us, pose)| (time_us, wrong(number, middle, pose)));
            let trajectory = Trajectory::new(poses)?;
            uploads.extend(upload(&grid, drive, &scans, (part, &trajectory), form)?);
        }
    }
    Ok(uploads)
}

/// The poses of each upload. The pose at a cut belongs to both uploads.
fn parts<'a>(
    grid: &Grid,
    poses: &'a [GeoPose],
    config: &RecorderConfig,
) -> anyhow::Result<Vec<&'a [GeoPose]>> {
    let cut_after_us = (config.cut_after_s * 1e6) as i64;
    let (mut parts, mut from, mut way_m) = (Vec::new(), 0, 0.0);
    let mut before = grid.project(poses[0].at)?;
    for (index, pose) in poses.iter().enumerate().skip(1) {
        let at = grid.project(pose.at)?;
        way_m += at.distance_m(before);
        before = at;
        let full = pose.time_us - poses[from].time_us >= cut_after_us || way_m >= config.cut_after_m;
        if full || index + 1 == poses.len() {
            parts.push(&poses[from..=index]);
            (from, way_m) = (index, 0.0);
        }
    }
    Ok(parts)
}

/// The upload of some poses; `None` where it would have no detections, for example because the vehicle stood.
fn upload(
    grid: &Grid,
    drive: &Drive,
    scans: &[Scan],
    (poses, trajectory): (&[GeoPose], &Trajectory),
    SentForm { contributor, max_range_m, steps, .. }: SentForm,
) -> anyhow::Result<Option<VehicleUpload>> {
    let at = |time_us: i64| scans.partition_point(|s| s.time_us < time_us);
    let (from, to) = (at(poses[0].time_us), at(poses[poses.len() - 1].time_us));
    let scale = grid.scale_factor(poses[0].at)?;
    // Movers are dropped already: odometry shows them better than absolute poses would.
    let gate = Gate { max_range_m, ..Movers::Included.gate() };
    let mut accumulator = EvidenceAccumulator::with_steps(steps);
    let (placed, _) =
        accumulator.add(grid.zone(), &scans[from..to], &drive.mounts, trajectory, scale, &gate)?;
    let delta = accumulator.finish(placed);
    let day = u16::try_from(poses[0].time_us.div_euclid(DAY_US))?;
    let sigma = declared(poses);
    Ok((delta.detections > 0).then_some(VehicleUpload { pass: Pass { day, contributor }, delta, sigma }))
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::geo::LatLon;

    /// Catches: a cut that loses the poses at its edge, and one by time alone.
    #[test]
    fn parts_follow_each_other_and_are_short_in_time_and_way() {
        let grid = Grid::of(LatLon { lat_deg: 30.0, lon_deg: -97.0 }).unwrap();
        let pose = |k: i64| GeoPose {
            time_us: k * 100_000,
            // At rest, then at 20 m/s.
            at: LatLon { lat_deg: 30.0 + (k - 200).max(0) as f64 * 1.8e-5, lon_deg: -97.0 },
            ..GeoPose::default()
        };
        let poses: Vec<_> = (0..=400).map(pose).collect();
        let parts = parts(&grid, &poses, &RecorderConfig::default()).unwrap();
        let lengths: Vec<_> = parts.iter().map(|part| part.len()).collect();
        assert_eq!(lengths, [101, 101, 52, 52, 52, 48]);
        // The first pose of each is the last one of the part before.
        assert_eq!(lengths.iter().sum::<usize>(), poses.len() + parts.len() - 1);
        assert!(parts.windows(2).all(|two| two[0].last() == two[1].first()));
    }
}
