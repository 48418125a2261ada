//! The vehicle's own gates: what never leaves it.

use echofix_core::batch::Dropped;
use echofix_core::doppler;
use echofix_core::odometry::BodyVelocity;
use echofix_core::scan::{Gate, Mount, Scan};

/// Leaves in `scan` what maps and localizes: taken fast enough, near enough, not moving.
///
/// `velocity` is the body's at the time of the scan; `None` drops everything, for want of a pose.
pub(crate) fn apply(
    scan: &mut Scan,
    mount: &Mount,
    velocity: Option<BodyVelocity>,
    gate: &Gate,
    dropped: &mut Dropped,
) {
    let all = scan.len() as u64;
    let Some(velocity) = velocity else {
        dropped.without_pose += all;
        return scan.retain(|_, _| false);
    };
    if velocity.speed_mps() < gate.min_speed_mps {
        dropped.too_slow += all;
        return scan.retain(|_, _| false);
    }
    scan.retain(|scan, row| f64::from(scan.range_m[row]) <= gate.max_range_m);
    dropped.too_far += all - scan.len() as u64;
    dropped.moving += doppler::drop_movers(scan, mount, velocity, gate.max_doppler_residual_mps) as u64;
}

#[cfg(test)]
mod tests {
    use super::*;

    fn apply_at(speed_mps: Option<f64>) -> (Scan, Dropped) {
        // Ahead: stationary, stationary but far, coming towards the vehicle.
        let mut scan = Scan {
            range_m: vec![10.0, 51.0, 20.0],
            azimuth_rad: vec![0.0; 3],
            radial_speed_mps: vec![-5.0, -5.0, -9.0],
            ..Scan::default()
        };
        let velocity = speed_mps.map(|v| BodyVelocity { forward_mps: v, ..BodyVelocity::default() });
        let mut dropped = Dropped::default();
        apply(&mut scan, &Mount::IDENTITY, velocity, &Gate::default(), &mut dropped);
        (scan, dropped)
    }

    #[test]
    fn every_loss_is_counted_by_its_reason() {
        let (scan, dropped) = apply_at(Some(5.0));
        assert_eq!(scan.range_m, [10.0]);
        assert_eq!(dropped, Dropped { too_far: 1, moving: 1, ..Dropped::default() });
        assert_eq!(apply_at(Some(0.9)).1, Dropped { too_slow: 3, ..Dropped::default() });
        assert_eq!(apply_at(None).1, Dropped { without_pose: 3, ..Dropped::default() });
    }
}
