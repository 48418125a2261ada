//! Planar poses.

use std::f64::consts::PI;

use crate::point::{BodyPoint, MapPoint};

/// A rigid pose in the plane: metres and radians, yaw counter-clockwise from the x axis.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Pose2 {
    /// Metres along the frame's x axis (east on the map, forward in the body).
    pub x_m: f64,
    /// Metres along the frame's y axis (north on the map, left in the body).
    pub y_m: f64,
    /// Radians, counter-clockwise from the frame's x axis.
    pub yaw_rad: f64,
}

impl Pose2 {
    /// The pose that moves nothing.
    pub const IDENTITY: Self = Self::new(0.0, 0.0, 0.0);

    /// A pose from metres and radians.
    #[must_use]
    pub const fn new(x_m: f64, y_m: f64, yaw_rad: f64) -> Self {
        Self { x_m, y_m, yaw_rad }
    }

    /// Maps coordinates of this pose's own frame into the frame the pose is given in, whichever two these
    /// are. From the body to the map it is [`Pose2::to_map`].
    #[must_use]
    pub fn transform(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let (s, c) = self.yaw_rad.sin_cos();
        [self.x_m + c * x - s * y, self.y_m + s * x + c * y]
    }

    /// Where a point of the body lies on the map, for the body's pose on it; `scale` is the map's metres per
    /// ground metre.
    #[must_use]
    pub fn to_map(&self, point: BodyPoint, scale: f64) -> MapPoint {
        self.transform([f64::from(point.x_m) * scale, f64::from(point.y_m) * scale]).into()
    }

    /// `self` then `inner`: the pose of `inner`, which is given in the frame of `self`.
    #[must_use]
    pub fn compose(&self, inner: &Self) -> Self {
        let [x_m, y_m] = self.transform([inner.x_m, inner.y_m]);
        Self::new(x_m, y_m, wrap_angle(self.yaw_rad + inner.yaw_rad))
    }

    /// The pose that undoes this one.
    #[must_use]
    pub fn inverse(&self) -> Self {
        let (s, c) = self.yaw_rad.sin_cos();
        Self::new(-c * self.x_m - s * self.y_m, s * self.x_m - c * self.y_m, wrap_angle(-self.yaw_rad))
    }

    /// `other` as seen from this pose: `self.compose(&self.between(&other)) == other`.
    #[must_use]
    pub fn between(&self, other: &Self) -> Self {
        self.inverse().compose(other)
    }

    /// Distance between the origins, metres.
    #[must_use]
    pub fn distance_m(&self, other: &Self) -> f64 {
        (self.x_m - other.x_m).hypot(self.y_m - other.y_m)
    }

    /// Linear interpolation, the yaw along the shorter way; `t` = 0 gives `self`, 1 gives `other`.
    #[must_use]
    pub fn interpolate(&self, other: &Self, t: f64) -> Self {
        Self::new(
            self.x_m + t * (other.x_m - self.x_m),
            self.y_m + t * (other.y_m - self.y_m),
            wrap_angle(self.yaw_rad + t * wrap_angle(other.yaw_rad - self.yaw_rad)),
        )
    }

    /// True when every component is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.x_m.is_finite() && self.y_m.is_finite() && self.yaw_rad.is_finite()
    }
}

/// The angle brought into (-pi, pi].
#[must_use]
pub fn wrap_angle(angle_rad: f64) -> f64 {
    let wrapped = angle_rad.rem_euclid(2.0 * PI);
    if wrapped > PI { wrapped - 2.0 * PI } else { wrapped }
}

/// The direction of an axis, which is its opposite's too, brought into (-pi / 2, pi / 2].
#[must_use]
pub fn wrap_axis(direction_rad: f64) -> f64 {
    let wrapped = direction_rad.rem_euclid(PI);
    if wrapped > 0.5 * PI { wrapped - PI } else { wrapped }
}

/// The weighted mean of shifts and small turns, component by component; no shift without any weight.
#[must_use]
pub fn weighted_mean(shifts: impl IntoIterator<Item = (f64, Pose2)>) -> Pose2 {
    let (mut sum, mut weights) = ([0.0; 3], 0.0);
    for (weight, shift) in shifts {
        for (sum, part) in sum.iter_mut().zip([shift.x_m, shift.y_m, shift.yaw_rad]) {
            *sum += weight * part;
        }
        weights += weight;
    }
    if weights > 0.0 {
        Pose2::new(sum[0] / weights, sum[1] / weights, sum[2] / weights)
    } else {
        Pose2::IDENTITY
    }
}

impl MapPoint {
    /// Where a pose on the map lies.
    #[must_use]
    pub const fn of(pose: &Pose2) -> Self {
        Self::new(pose.x_m, pose.y_m)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn pose() -> impl Strategy<Value = Pose2> {
        (-1e6..1e6, -1e6..1e6, -PI..PI).prop_map(|(x, y, yaw)| Pose2::new(x, y, yaw))
    }

    proptest! {
        #[test]
        fn a_pose_and_its_inverse_cancel(a in pose(), p in [-100.0..100.0, -100.0..100.0]) {
            let back = a.inverse().transform(a.transform(p));
            prop_assert!((back[0] - p[0]).abs() < 1e-6 && (back[1] - p[1]).abs() < 1e-6);
        }

        #[test]
        fn between_is_what_compose_undoes(a in pose(), b in pose()) {
            let again = a.compose(&a.between(&b));
            prop_assert!(again.distance_m(&b) < 1e-6);
            prop_assert!(wrap_angle(again.yaw_rad - b.yaw_rad).abs() < 1e-9);
        }

        #[test]
        fn wrapped_angles_are_in_range_and_equivalent(a in -100.0..100.0_f64) {
            let w = wrap_angle(a);
            prop_assert!(w > -PI && w <= PI);
            prop_assert!((w.sin() - a.sin()).abs() < 1e-9 && (w.cos() - a.cos()).abs() < 1e-9);
            let axis = wrap_axis(a);
            prop_assert!(axis > -0.5 * PI - 1e-12 && axis <= 0.5 * PI);
            prop_assert!((axis.sin() * a.cos() - axis.cos() * a.sin()).abs() < 1e-9);
        }
    }

    #[test]
    fn yaw_is_interpolated_the_short_way() {
        let a = Pose2::new(0.0, 0.0, 3.1);
        let b = Pose2::new(2.0, 0.0, -3.1);
        let mid = a.interpolate(&b, 0.5);
        assert!((mid.yaw_rad.abs() - PI).abs() < 1e-9, "{mid:?}");
        assert!((mid.x_m - 1.0).abs() < 1e-12);
    }
}
