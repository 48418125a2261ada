//! How far an upload lies beside the map.

use crate::datum::Offset;
use crate::point::MapPoint;
use crate::pose::{Pose2, weighted_mean};

/// Distance at which a part of an upload counts half, metres.
const REACH_M: f64 = 40.0;
/// A turn is not carried farther than this from the middle of the part that it was measured in, metres.
const ARM_M: f64 = 60.0;

/// What is to be added to an upload's positions so that they lie on the map: an offset for each of its parts,
/// blended in between.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Offsets {
    parts: Vec<PartOffset>,
}

/// An offset around a position, and its weight among others.
#[derive(Debug, Clone, Copy, PartialEq)]
struct PartOffset {
    middle: MapPoint,
    offset: Offset,
    weight: f64,
}

impl Offsets {
    /// Adds an offset measured around a position; it turns about that position. `weight` is its weight among
    /// others.
    pub fn push(&mut self, middle: MapPoint, offset: Offset, weight: f64) {
        self.parts.push(PartOffset { middle, offset, weight });
    }

    /// True when nothing was measured, and nothing moves.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.parts.is_empty()
    }

    /// Number of parts that were measured.
    #[must_use]
    pub fn len(&self) -> usize {
        self.parts.len()
    }

    /// The offset at a position: how it shifts what is there, and how it turns it. Continuous.
    #[must_use]
    pub fn at(&self, position: MapPoint) -> Pose2 {
        weighted_mean(self.parts.iter().map(|part| {
            let (dx, dy) = (position.x_m - part.middle.x_m, position.y_m - part.middle.y_m);
            let squared = dx * dx + dy * dy;
            let nearness = 1.0 / (1.0 + squared / (REACH_M * REACH_M));
            let arm = ARM_M / squared.sqrt().max(ARM_M);
            let by = part.offset.pose();
            // Turns are small: less than a degree.
            let (east, north) = (by.x_m - by.yaw_rad * dy * arm, by.y_m + by.yaw_rad * dx * arm);
            (part.weight * nearness * nearness, Pose2::new(east, north, by.yaw_rad))
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn offsets() -> impl Strategy<Value = Offsets> {
        let part = (
            -200.0..200.0_f64,
            -200.0..200.0_f64,
            -500..500_i32,
            -500..500_i32,
            -9000..9000_i32,
            0.1..5.0_f64,
        );
        prop::collection::vec(part, 1..5).prop_map(|parts| {
            let mut offsets = Offsets::default();
            for (x, y, east_mm, north_mm, yaw_urad, weight) in parts {
                offsets.push(MapPoint::new(x, y), Offset { east_mm, north_mm, yaw_urad }, weight);
            }
            offsets
        })
    }

    proptest! {
        /// Catches: parts that end where the next begins (a nearest part, say), which would tear walls apart.
        #[test]
        fn the_offset_is_continuous(offsets in offsets(), x in -300.0..300.0_f64, y in -300.0..300.0_f64) {
            let (a, b) = (offsets.at(MapPoint::new(x, y)), offsets.at(MapPoint::new(x + 0.01, y - 0.01)));
            prop_assert!(a.distance_m(&b) < 2e-3, "{a:?} {b:?}");
        }

        /// Catches: weights that do not sum to one.
        #[test]
        fn parts_that_agree_are_one(x in -300.0..300.0_f64, y in -300.0..300.0_f64, count in 1..5_i32) {
            let offset = Offset { east_mm: 120, north_mm: -80, yaw_urad: 0 };
            let mut offsets = Offsets::default();
            for i in 0..count {
                offsets.push(MapPoint::new(f64::from(50 * i), 0.0), offset, f64::from(i + 1));
            }
            prop_assert_eq!(Offset::of(&offsets.at(MapPoint::new(x, y))), offset);
        }
    }

    #[test]
    fn a_turn_is_about_the_middle_of_its_part() {
        let mut offsets = Offsets::default();
        offsets.push(MapPoint::new(100.0, 50.0), Offset { east_mm: 0, north_mm: 0, yaw_urad: 10_000 }, 1.0);
        let at = offsets.at(MapPoint::new(110.0, 50.0));
        assert!(at.x_m.abs() < 1e-9 && (at.y_m - 0.1).abs() < 1e-9 && (at.yaw_rad - 0.01).abs() < 1e-9);
        assert_eq!(Offsets::default().at(MapPoint::new(1.0, 2.0)), Pose2::IDENTITY);
    }
}
