//! Batches of a drive, organised as vehicle and service do it, and what can be wrong with them.

use echofix_core::batch::Batch;
use echofix_core::calibration::CalibrationConfig;
use echofix_core::calibration::clock::clock_of_batch;
use echofix_core::doppler::dedrift::{OdometryBias, dedrifted};
use echofix_core::doppler::ego::EgoConfig;
use echofix_core::drive::Drive;
use echofix_core::gate::{Gate, gate_scan};
use echofix_core::odometry::{OdometryQuality, Trajectory};
use echofix_core::own_error::{MountSigma, own_error};
use echofix_core::pose::Pose2;
use echofix_core::scan::{Mount, Scan};
use echofix_sim::{DeadReckoning, Drift, Growth};

use crate::evaluate::epoch::within;

/// What is wrong with a batch.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Fault {
    /// Nothing.
    None,
    /// The radars measure no radial speeds.
    NoDoppler,
    /// Odometry drifts by the paper's largest level, and nothing corrects it.
    Drift,
    /// Odometry jumps ahead by metres, so many seconds before the end.
    Jump {
        /// Metres.
        ahead_m: f64,
        /// Seconds.
        before_s: f64,
    },
    /// Odometry jumps ahead by metres every so many seconds.
    Jumps {
        /// Metres.
        ahead_m: f64,
        /// Seconds.
        every_s: f64,
    },
    /// The radars' clock is late, milliseconds.
    LateClock(f64),
    /// All mounts are turned, degrees.
    TurnedMounts(f64),
    /// One mount is turned, degrees.
    TurnedMount(f64),
    /// All mounts sit ahead of where they are believed, metres.
    ShiftedMounts(f64),
}

/// Seconds of scans of a batch, and what is wrong with it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct BatchForm {
    /// Seconds.
    pub length_s: f64,
    /// The fault.
    pub fault: Fault,
    /// Whether the vehicle says how good its odometry, mounts and clocks are. One that is silent is taken for the worst.
    pub declared: bool,
}

/// What a vehicle of these worlds can say of its odometry ([`DeadReckoning`]'s defaults, over a batch of 5 s) and of its
/// radars: what a calibration leaves.
fn said() -> (OdometryBias, OdometryQuality, MountSigma) {
    const SECONDS: f64 = 5.0;
    let DeadReckoning { scale, gyro_bias_radps, walk_m, walk_rad } = DeadReckoning::default();
    let velocity_mps = walk_m * (TYPICAL_MPS / SECONDS).sqrt();
    let yaw_rate_radps = gyro_bias_radps.hypot(walk_rad / SECONDS.sqrt());
    let bias = OdometryBias {
        velocity_mps,
        left_mps: velocity_mps,
        yaw_rate_radps,
        scale,
        ..OdometryBias::default()
    };
    let quality = OdometryQuality { velocity_mps, velocity_fraction: scale, yaw_rate_radps };
    let left = CalibrationConfig::default().floors;
    (bias, quality, MountSigma { time_s: left.late_s, position_m: left.forward_m, yaw_rad: left.yaw_rad })
}

/// A speed in town, metres per second.
const TYPICAL_MPS: f64 = 8.0;

/// The batch whose newest scan comes at or before a time, and the time of that scan by the vehicle's clock; `None` where
/// there is nothing to ask with.
///
/// # Errors
/// When scans and odometry do not fit together.
pub fn organised(
    drive: &Drive,
    end_us: i64,
    form: BatchForm,
    seed: u64,
) -> anyhow::Result<Option<(Batch, i64)>> {
    let start_us = end_us - micros(form.length_s);
    let mut scans: Vec<Scan> = part(&drive.scans, start_us, end_us).to_vec();
    spoil_scans(&mut scans, form.fault);
    let (Some(first), Some(last)) = (scans.first(), scans.last()) else { return Ok(None) };
    let (first_us, last_us) = (first.time_us, last.time_us);
    let odometry = within(&drive.odometry, first_us, last_us)?;
    let odometry = spoiled_odometry(odometry, last_us, form.fault, seed)?;
    if odometry.at(last_us).is_none() {
        return Ok(None);
    }
    let mounts = believed_mounts(&drive.mounts, form.fault);
    // As the vehicle gates.
    let gate = Gate::default();
    for scan in &mut scans {
        gate_scan(scan, &mounts[scan.sensor], odometry.velocity_at(scan.time_us), &gate);
    }
    scans.retain(|scan| !scan.is_empty());
    let corrects = form.fault != Fault::Drift;
    let silent = (OdometryBias::default(), OdometryQuality::default(), MountSigma::default());
    let (bias, quality, known) = if form.declared { said() } else { silent };
    let corrected =
        corrects.then(|| dedrifted(&scans, &mounts, &odometry, &EgoConfig::default(), &bias)).flatten();
    let (odometry, quality) = corrected.map_or((odometry, quality), |c| (c.trajectory, c.quality));
    let Some(newest_us) = scans.last().map(|scan| scan.time_us) else { return Ok(None) };
    let batch = Batch::organise(&scans, &mounts, &odometry, newest_us, &gate)?;
    // As the service takes what is said of mounts and clocks.
    let clock = clock_of_batch(scans.iter(), &mounts, &odometry).map_or(0.0, |clock| clock.value);
    let sigma = MountSigma { time_s: clock.hypot(known.time_s), ..known };
    let own_error = own_error(&batch, &odometry, newest_us, &mounts, &vec![sigma; mounts.len()]);
    Ok(Some((Batch { quality, own_error, ..batch }, newest_us)))
}

fn part(scans: &[Scan], start_us: i64, end_us: i64) -> &[Scan] {
    let from = scans.partition_point(|s| s.time_us <= start_us);
    let to = scans.partition_point(|s| s.time_us <= end_us);
    &scans[from..to]
}

fn spoil_scans(scans: &mut [Scan], fault: Fault) {
    for scan in scans {
        match fault {
            Fault::NoDoppler => scan.radial_speed_mps = Vec::new(),
            Fault::LateClock(ms) => scan.time_us += micros(1e-3 * ms),
            _ => (),
        }
    }
}

fn spoiled_odometry(
    odometry: Trajectory,
    end_us: i64,
    fault: Fault,
    seed: u64,
) -> anyhow::Result<Trajectory> {
    let jumped = |ahead_m: f64, jumps: &dyn Fn(i64) -> u32| {
        // Each jump puts all that follows so much ahead of where it was.
        let mut pose = odometry.first().map(|(_, pose)| pose).unwrap_or_default();
        let (mut before, mut done) = (odometry.first(), None);
        let poses = odometry.iter().map(|(time_us, true_pose)| {
            let step = before.map(|(_, before)| before.between(&true_pose)).unwrap_or_default();
            let count = jumps(time_us);
            let new = count - done.unwrap_or(count);
            pose = pose.compose(&step).compose(&Pose2::new(f64::from(new) * ahead_m, 0.0, 0.0));
            (before, done) = (Some((time_us, true_pose)), Some(count));
            (time_us, pose)
        });
        Trajectory::new(poses.collect::<Vec<_>>())
    };
    Ok(match fault {
        Fault::Drift => Drift::over_5_s(Drift::PAPER_LEVELS[2], Growth::Quadratic).apply(&odometry, seed)?,
        Fault::Jump { ahead_m, before_s } => {
            jumped(ahead_m, &|time_us| u32::from(time_us > end_us - micros(before_s)))?
        }
        Fault::Jumps { ahead_m, every_s } => {
            jumped(ahead_m, &|time_us| (time_us / micros(every_s)).rem_euclid(1 << 20) as u32)?
        }
        _ => odometry,
    })
}

fn believed_mounts(mounts: &[Mount], fault: Fault) -> Vec<Mount> {
    let believed = |(sensor, mount): (usize, &Mount)| match fault {
        Fault::TurnedMounts(deg) => Mount::new(mount.x_m, mount.y_m, mount.yaw_rad + deg.to_radians()),
        Fault::TurnedMount(deg) if sensor == 0 => {
            Mount::new(mount.x_m, mount.y_m, mount.yaw_rad + deg.to_radians())
        }
        Fault::ShiftedMounts(metres) => Mount::new(mount.x_m - metres, mount.y_m, mount.yaw_rad),
        _ => *mount,
    };
    mounts.iter().enumerate().map(believed).collect()
}

fn micros(seconds: f64) -> i64 {
    (seconds * 1e6).round() as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    fn straight() -> Trajectory {
        let pose = |k: i64| (k * 20_000, Pose2::new(0.16 * k as f64, 0.0, 0.0));
        Trajectory::new((0..=500).map(pose)).unwrap()
    }

    /// Catches: a jump that is undone, and one at the wrong time.
    #[test]
    fn a_jump_puts_all_that_follows_ahead() {
        let end_us = 10_000_000;
        let fault = Fault::Jump { ahead_m: 5.0, before_s: 0.5 };
        let jumped = spoiled_odometry(straight(), end_us, fault, 0).unwrap();
        let off = |us: i64| jumped.at(us).unwrap().x_m - straight().at(us).unwrap().x_m;
        assert!(off(9_400_000).abs() < 1e-9 && (off(9_600_000) - 5.0).abs() < 1e-9);
        assert!((off(10_000_000) - 5.0).abs() < 1e-9);
        let often = spoiled_odometry(straight(), end_us, Fault::Jumps { ahead_m: 3.0, every_s: 4.0 }, 0);
        let off = often.unwrap().at(end_us).unwrap().x_m - straight().at(end_us).unwrap().x_m;
        assert!((off - 6.0).abs() < 1e-9, "{off}");
    }

    #[test]
    fn only_the_fault_named_is_there() {
        let mounts = [Mount::new(3.0, 0.0, 0.0), Mount::new(2.0, 1.0, 0.5)];
        assert_eq!(believed_mounts(&mounts, Fault::None), mounts);
        let one = believed_mounts(&mounts, Fault::TurnedMount(2.0));
        assert!((one[0].yaw_rad - 2_f64.to_radians()).abs() < 1e-12 && one[1] == mounts[1]);
        let mut scans = vec![Scan { time_us: 5, radial_speed_mps: vec![1.0], ..Scan::default() }];
        spoil_scans(&mut scans, Fault::LateClock(20.0));
        assert_eq!((scans[0].time_us, scans[0].radial_speed_mps.len()), (20_005, 1));
    }
}
