//! What radial speeds say of the vehicle's own motion.
//!
//! - here: the radial speed of a stationary target, by which the [gate](crate::gate) knows movers.
//! - [`ego`]: the vehicle's own velocity.
//! - [`mod@dedrift`]: odometry, corrected by it.

pub mod dedrift;
pub mod ego;

use crate::odometry::BodyVelocity;
use crate::scan::Mount;

/// The radial speed a stationary target would show at an azimuth, metres per second, positive away
/// from the sensor.
///
/// `mount` is where the sensor sits on the body, `v` the body's velocity, `azimuth_rad` counts
/// counter-clockwise from the boresight.
#[must_use]
pub fn static_radial_speed(mount: &Mount, v: BodyVelocity, azimuth_rad: f64) -> f64 {
    let [vx, vy] = sensor_velocity(mount, v);
    let (s, c) = azimuth_rad.sin_cos();
    -(vx * c + vy * s)
}

/// Velocity of a sensor along its own axes (boresight, left of it), metres per second.
#[must_use]
pub fn sensor_velocity(mount: &Mount, v: BodyVelocity) -> [f64; 2] {
    // The lever arm turns the yaw rate into a velocity of the sensor.
    let vx = v.forward_mps - v.yaw_rate_radps * mount.y_m;
    let vy = v.left_mps + v.yaw_rate_radps * mount.x_m;
    let (s, c) = mount.yaw_rad.sin_cos();
    [c * vx + s * vy, c * vy - s * vx]
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_6};

    #[test]
    fn what_lies_ahead_comes_closer() {
        let v = BodyVelocity { forward_mps: 10.0, ..BodyVelocity::default() };
        let mount = Mount::new(3.0, 0.0, 0.0);
        assert!((static_radial_speed(&mount, v, 0.0) + 10.0).abs() < 1e-12);
        assert!(static_radial_speed(&mount, v, FRAC_PI_2).abs() < 1e-12);
        let outward = Mount::new(3.0, 0.8, FRAC_PI_6);
        assert!((static_radial_speed(&outward, v, -FRAC_PI_6) + 10.0).abs() < 1e-12);
    }

    #[test]
    fn turning_on_the_spot_moves_a_sensor_at_the_nose() {
        let v = BodyVelocity { yaw_rate_radps: 0.5, ..BodyVelocity::default() };
        let nose = Mount::new(3.0, 0.0, 0.0);
        assert!((static_radial_speed(&nose, v, FRAC_PI_2) + 1.5).abs() < 1e-12);
    }
}
