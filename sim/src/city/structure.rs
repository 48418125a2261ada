//! What the town is made of: walls that block and points that reflect.

use echofix_core::pose::Pose2;

use crate::plane::{LineSegment, Point, dot};

/// What a reflector belongs to.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub enum ReflectorKind {
    /// Rough face of a building.
    Wall,
    /// Corner of a building, a door or a window: a strong reflector.
    Corner,
    /// Lamp, traffic light or sign.
    Pole,
    /// Trunk of a tree.
    Tree,
    /// Post of a fence.
    Fence,
    /// Kerb, drain, bin.
    Kerb,
    /// Parked or moving vehicle.
    Vehicle,
}

/// A point that sends radar back.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Reflector {
    /// Position in the city, ground metres.
    pub at: Point,
    /// Unit vector it faces; `None` when it is seen alike from all sides.
    pub facing: Option<Point>,
    /// Cosine of the angle from `facing` beyond which it is not seen.
    pub edge_cos: f64,
    /// Chance of a detection per scan, seen from its front at close range.
    pub probability: f64,
    /// Mean radar cross section, decibel square metres.
    pub rcs_dbsm: f64,
    /// What it belongs to.
    pub kind: ReflectorKind,
}

impl Reflector {
    /// How well it is seen in the direction of a unit vector from it: 0 not at all, 1 from the front.
    #[must_use]
    pub fn aspect(&self, towards: Point) -> f64 {
        let Some(facing) = self.facing else { return 1.0 };
        ((dot(facing, towards) - self.edge_cos) / (1.0 - self.edge_cos)).max(0.0)
    }

    /// True when a car in between always hides it.
    #[must_use]
    pub fn is_low(&self) -> bool {
        matches!(self.kind, ReflectorKind::Kerb | ReflectorKind::Vehicle)
    }
}

/// Strength and width of a kind of reflector; [`Look::at`] puts one in its position.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Look {
    pub kind: ReflectorKind,
    pub probability: f64,
    pub rcs_dbsm: f64,
    /// Half width of the angle from which it is seen, radians; more than pi for all sides.
    pub edge_rad: f64,
}

impl Look {
    /// A reflector at (x, y) of a frame, facing a yaw of that frame.
    pub fn at(&self, frame: &Pose2, position: Point, facing_rad: f64) -> Reflector {
        let (s, c) = (frame.yaw_rad + facing_rad).sin_cos();
        Reflector {
            at: frame.transform(position),
            facing: (self.edge_rad <= std::f64::consts::PI).then_some([c, s]),
            edge_cos: self.edge_rad.cos(),
            probability: self.probability,
            rcs_dbsm: self.rcs_dbsm,
            kind: self.kind,
        }
    }
}

/// Everything that stands in the town on every day, in city metres.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Structure {
    /// Building walls, which hide what lies behind.
    pub walls: Vec<LineSegment>,
    /// Points that reflect.
    pub reflectors: Vec<Reflector>,
}

impl Structure {
    /// Walls along a line of points of a frame.
    pub(crate) fn wall(&mut self, frame: &Pose2, points: &[Point]) {
        self.walls.extend(
            points.windows(2).map(|w| LineSegment { a: frame.transform(w[0]), b: frame.transform(w[1]) }),
        );
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_directed_reflector_is_not_seen_from_behind() {
        let look = Look { kind: ReflectorKind::Corner, probability: 0.5, rcs_dbsm: 0.0, edge_rad: 1.0 };
        let frame = Pose2::new(10.0, 5.0, std::f64::consts::FRAC_PI_2);
        let corner = look.at(&frame, [2.0, 0.0], 0.0);
        assert!((corner.at[0] - 10.0).abs() < 1e-9 && (corner.at[1] - 7.0).abs() < 1e-9);
        assert!((corner.aspect([0.0, 1.0]) - 1.0).abs() < 1e-9);
        assert!(corner.aspect([0.0, -1.0]).abs() < 1e-9);
        assert!(corner.aspect([1.0, 0.0]).abs() < 1e-9);
    }
}
