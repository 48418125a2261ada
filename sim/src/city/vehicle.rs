//! A car as radar sees it: corners, bumpers, wheel arches; and what it hides.

use std::f64::consts::{FRAC_PI_2, FRAC_PI_4, PI};

use echofix_core::pose::Pose2;

use super::structure::{Look, Reflector, ReflectorKind};
use crate::plane::LineSegment;

/// A car of some size somewhere.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Car {
    /// Its middle, city metres, and where it heads.
    pub pose: Pose2,
    /// Length along the heading, metres.
    pub length_m: f64,
    /// Width across the heading, metres.
    pub width_m: f64,
}

impl Car {
    /// The points that reflect, each facing outwards.
    #[must_use]
    pub fn reflectors(&self) -> [Reflector; 14] {
        let (l, w) = (0.5 * self.length_m, 0.5 * self.width_m);
        let look = |probability, rcs_dbsm, edge_rad| Look {
            kind: ReflectorKind::Vehicle,
            probability,
            rcs_dbsm,
            edge_rad,
        };
        let (corner, bumper) = (look(0.3, 5.0, 1.3), look(0.35, 9.0, 1.0));
        let (arch, flank) = (look(0.2, 2.0, 1.2), look(0.12, 5.0, 0.8));
        let (axle, rim) = (0.6 * l, w - 0.05);
        let (front_left, rear_left) = (FRAC_PI_4, 3.0 * FRAC_PI_4);
        [
            corner.at(&self.pose, [l, w], front_left),
            corner.at(&self.pose, [l, -w], -front_left),
            corner.at(&self.pose, [-l, w], rear_left),
            corner.at(&self.pose, [-l, -w], -rear_left),
            bumper.at(&self.pose, [l, 0.4 * w], 0.0),
            bumper.at(&self.pose, [l, -0.4 * w], 0.0),
            bumper.at(&self.pose, [-l, 0.4 * w], PI),
            bumper.at(&self.pose, [-l, -0.4 * w], PI),
            arch.at(&self.pose, [axle, rim], FRAC_PI_2),
            arch.at(&self.pose, [axle, -rim], -FRAC_PI_2),
            arch.at(&self.pose, [-axle, rim], FRAC_PI_2),
            arch.at(&self.pose, [-axle, -rim], -FRAC_PI_2),
            flank.at(&self.pose, [0.1 * l, w], FRAC_PI_2),
            flank.at(&self.pose, [0.1 * l, -w], -FRAC_PI_2),
        ]
    }

    /// What it hides: the diagonals of its outline, short of the corners that are seen themselves.
    #[must_use]
    pub fn diagonals(&self) -> [LineSegment; 2] {
        let (l, w) = (0.5 * self.length_m - 0.3, 0.5 * self.width_m - 0.15);
        let across = |sign: f64| LineSegment {
            a: self.pose.transform([l, sign * w]),
            b: self.pose.transform([-l, -sign * w]),
        };
        [across(1.0), across(-1.0)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plane::{add, direction};

    #[test]
    fn a_car_shows_its_near_side_and_hides_its_far_side() {
        let car = Car { pose: Pose2::new(3.0, 4.0, 0.3), length_m: 4.5, width_m: 1.8 };
        let eye = car.pose.transform([0.0, 20.0]);
        let seen = |r: &Reflector| {
            let hidden = car.diagonals().iter().any(|d| d.crossing(eye, r.at).is_some());
            !hidden && r.aspect(direction(r.at, eye)) > 0.0
        };
        let left = |r: &&Reflector| car.pose.inverse().transform(r.at)[1] > 0.6;
        let all = car.reflectors();
        assert_eq!(all.iter().filter(|r| seen(r)).filter(left).count(), 5);
        assert_eq!(all.iter().filter(|r| seen(r)).count(), 5);
    }

    #[test]
    fn a_car_hides_what_stands_behind_it() {
        let car = Car { pose: Pose2::new(0.0, 0.0, 0.0), length_m: 4.5, width_m: 1.8 };
        let behind = add([0.0, 0.0], -5.0, [0.0, 1.0]);
        assert!(car.diagonals().iter().any(|d| d.crossing([0.5, 5.0], behind).is_some()));
    }
}
