//! By how much vetting moved the passes over a tile; the mean is the map's own offset.

use crate::geo::{TILE_M, TileId, Zone};
use crate::point::MapPoint;
use crate::pose::{Pose2, weighted_mean};

/// The sum of the offsets by which vetting moved passes over a tile, at its centre. Sums are of integers:
/// they come out the same in any order.
///
/// A pass that was moved by an offset says that the map errs by it; the mean of all passes counts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Datum {
    /// Passes that were counted, those that were not moved included.
    pub passes: u32,
    /// Sum of the shifts, millimetres east and north.
    pub shift_mm: [i64; 2],
    /// Sum of the turns, microradians.
    pub yaw_urad: i64,
}

/// A shift and a turn, in whole millimetres and microradians: sums of them are exact and do not depend on
/// their order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, PartialOrd, Ord)]
pub struct Offset {
    /// Millimetres east.
    pub east_mm: i32,
    /// Millimetres north.
    pub north_mm: i32,
    /// Microradians, counter-clockwise.
    pub yaw_urad: i32,
}

impl Offset {
    /// From metres and radians, rounded.
    #[must_use]
    pub fn of(pose: &Pose2) -> Self {
        let whole = |value: f64, unit: f64| (value * unit).round() as i32;
        Self {
            east_mm: whole(pose.x_m, 1e3),
            north_mm: whole(pose.y_m, 1e3),
            yaw_urad: whole(pose.yaw_rad, 1e6),
        }
    }

    /// As metres and radians.
    #[must_use]
    pub fn pose(&self) -> Pose2 {
        Pose2::new(
            f64::from(self.east_mm) * 1e-3,
            f64::from(self.north_mm) * 1e-3,
            f64::from(self.yaw_urad) * 1e-6,
        )
    }

    /// Length of the shift, metres.
    #[must_use]
    pub fn shift_m(&self) -> f64 {
        f64::from(self.east_mm).hypot(f64::from(self.north_mm)) * 1e-3
    }
}

impl Datum {
    /// Counts one more pass, moved by `offset` at the tile's centre.
    pub fn add(&mut self, offset: Offset) {
        let one = Self {
            passes: 1,
            shift_mm: [offset.east_mm.into(), offset.north_mm.into()],
            yaw_urad: offset.yaw_urad.into(),
        };
        self.merge(&one);
    }

    /// Adds what another one counted.
    pub fn merge(&mut self, other: &Self) {
        self.passes = self.passes.saturating_add(other.passes);
        for axis in 0..2 {
            self.shift_mm[axis] = self.shift_mm[axis].saturating_add(other.shift_mm[axis]);
        }
        self.yaw_urad = self.yaw_urad.saturating_add(other.yaw_urad);
    }

    /// The mean offset: metres east and north, radians; `None` without any pass.
    #[must_use]
    pub fn mean(&self) -> Option<Pose2> {
        let mean = |sum: i64, unit: f64| sum as f64 * unit / f64::from(self.passes);
        let [east, north] = self.shift_mm;
        (self.passes > 0).then(|| Pose2::new(mean(east, 1e-3), mean(north, 1e-3), mean(self.yaw_urad, 1e-6)))
    }
}

/// The mean offset at a position, interpolated between the centres of the four tiles around it; tiles without
/// a datum are left out. Zero where there is none at all.
///
/// What lies at `position` on the map is really at `position` less this.
#[must_use]
pub fn mean_offset(zone: Zone, position: MapPoint, datum: impl Fn(TileId) -> Datum) -> Pose2 {
    let [u, v] = [position.x_m, position.y_m].map(|c| c / TILE_M - 0.5);
    let (column, row) = (u.floor(), v.floor());
    let (fx, fy) = (u - column, v - row);
    let corners = [(0, 0), (1, 0), (0, 1), (1, 1)].into_iter().filter_map(|(dx, dy)| {
        let id = TileId { zone, x: column as i32 + dx, y: row as i32 + dy };
        let weight = [1.0 - fx, fx][dx as usize] * [1.0 - fy, fy][dy as usize];
        Some((weight, datum(id).mean()?))
    });
    weighted_mean(corners)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    fn offset() -> impl Strategy<Value = Offset> {
        (-500..500_i32, -500..500_i32, -9000..9000_i32).prop_map(|(east_mm, north_mm, yaw_urad)| Offset {
            east_mm,
            north_mm,
            yaw_urad,
        })
    }

    fn id() -> TileId {
        TileId { zone: Zone::from_epsg(32614).expect("a zone"), y: 100, x: 200 }
    }

    fn summed(offsets: &[Offset]) -> Datum {
        let mut datum = Datum::default();
        for offset in offsets {
            datum.add(*offset);
        }
        datum
    }

    proptest! {
        /// Catches: floating-point sums, and a merge that forgets a part.
        #[test]
        fn the_order_and_the_grouping_do_not_matter(mut offsets in prop::collection::vec(offset(), 0..20), cut in 0..20_usize) {
            let forward = summed(&offsets);
            offsets.reverse();
            let cut = cut.min(offsets.len());
            let mut merged = summed(&offsets[..cut]);
            merged.merge(&summed(&offsets[cut..]));
            prop_assert_eq!(forward, merged);
        }

        #[test]
        fn the_mean_is_the_mean(offsets in prop::collection::vec(offset(), 1..20)) {
            let mean = summed(&offsets).mean().expect("there are some");
            let n = offsets.len() as f64;
            let by_hand = |part: fn(&Offset) -> i32| offsets.iter().map(|o| f64::from(part(o))).sum::<f64>() / n;
            prop_assert!((mean.x_m * 1e3 - by_hand(|o| o.east_mm)).abs() < 1e-6);
            prop_assert!((mean.y_m * 1e3 - by_hand(|o| o.north_mm)).abs() < 1e-6);
            prop_assert!((mean.yaw_rad * 1e6 - by_hand(|o| o.yaw_urad)).abs() < 1e-6);
        }

        /// Catches: the nearest tile's mean instead of an interpolation, and wrong neighbours.
        #[test]
        fn the_interpolation_is_continuous_and_meets_the_centres(
            offsets in prop::collection::vec(offset(), 25), x in 1.0..3.99_f64, y in 1.0..3.99_f64,
        ) {
            let tiles: BTreeMap<(i32, i32), Datum> =
                (0..25).map(|i| ((i / 5, i % 5), summed(&offsets[i as usize..=i as usize]))).collect();
            let datum = |at: TileId| tiles.get(&(at.y - 100, at.x - 200)).copied().unwrap_or_default();
            let position = |x: f64, y: f64| MapPoint::new((200.0 + x) * TILE_M, (100.0 + y) * TILE_M);
            let at = |x, y| mean_offset(id().zone, position(x, y), datum);
            let (a, b) = (at(x, y), at(x + 1e-4, y + 1e-4));
            prop_assert!(a.distance_m(&b) < 1e-3, "{:?} {:?}", a, b);
            let centre = at(x.floor() + 0.5, y.floor() + 0.5);
            let own = tiles[&(y as i32, x as i32)].mean().expect("it has one");
            prop_assert!(centre.distance_m(&own) < 1e-6);
        }
    }

    #[test]
    fn tiles_without_a_datum_are_left_out() {
        let mut datum = Datum::default();
        datum.add(Offset { east_mm: 100, north_mm: 0, yaw_urad: 0 });
        let MapPoint { x_m: x, y_m: y } = id().origin();
        let at = |x, y| {
            mean_offset(
                id().zone,
                MapPoint::new(x, y),
                |at| if at == id() { datum } else { Datum::default() },
            )
        };
        assert!((at(x + 40.0, y + 40.0).x_m - 0.1).abs() < 1e-9);
        assert_eq!(at(x + 500.0, y), Pose2::IDENTITY);
        assert_eq!(Datum::default().mean(), None);
    }
}
