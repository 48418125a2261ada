//! By how much vetting moved the passes over a tile; the mean is the map's own offset.
//!
//! - [`Datum`]: the sums. [`DeclaredSums`]: those of the passes whose poses have a declared sigma ([`PoseSigma`]).
//! - [`mean_offset`]: the mean between the tiles' centres.
//! - [`Datum::variance`]: how far the mean itself may err.

mod declared;
mod sigma;
#[cfg(test)]
mod tests;

pub use declared::DeclaredSums;
pub use sigma::PoseSigma;

use crate::geo::{TILE_M, TileId, Zone};
use crate::point::MapPoint;
use crate::pose::{Pose2, weighted_mean};

/// The sum of the offsets by which vetting moved passes over a tile, at its centre. Sums are of integers:
/// they come out the same in any order.
///
/// A pass that was moved by an offset says that the map errs by it; the mean of all passes counts, each by how well its
/// poses are known. The errors of one contributor on one day are alike, so all it uploads then is one pass.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Datum {
    /// Passes that were counted, those that were not moved included.
    pub passes: u32,
    /// Sum of the shifts, millimetres east and north.
    pub shift_mm: [i64; 2],
    /// Sum of the turns, microradians.
    pub yaw_urad: i64,
    /// Of those passes, what the ones with a declared sigma add up to.
    pub declared: DeclaredSums,
}

/// Steps of information to one per square metre.
const INFORMATION_STEPS: u64 = 256;
/// What was declared counts as much as the scatter of this many degrees of freedom.
const DECLARATION_DOF: f64 = 2.0;

/// How far a map may err as a whole.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct MapVariance {
    /// Along each axis, square metres.
    pub position_m2: f64,
    /// Of the heading, square radians.
    pub yaw_rad2: f64,
}

impl MapVariance {
    /// The mean of some; `None` of none.
    pub(crate) fn mean(some: impl Iterator<Item = Self>) -> Option<Self> {
        let add = |(sum, count): (Self, f64), one: Self| {
            let position_m2 = sum.position_m2 + one.position_m2;
            (Self { position_m2, yaw_rad2: sum.yaw_rad2 + one.yaw_rad2 }, count + 1.0)
        };
        let (sum, count) = some.fold((Self::default(), 0.0), add);
        (count > 0.0).then(|| Self { position_m2: sum.position_m2 / count, yaw_rad2: sum.yaw_rad2 / count })
    }
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
    /// Counts one more pass, moved by `offset` at the tile's centre, with poses known to `sigma`.
    pub fn add(&mut self, offset: Offset, sigma: PoseSigma) {
        let declared =
            if sigma.is_silent() { DeclaredSums::default() } else { DeclaredSums::of(offset, sigma) };
        let one = Self {
            passes: 1,
            shift_mm: [offset.east_mm.into(), offset.north_mm.into()],
            yaw_urad: offset.yaw_urad.into(),
            declared,
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
        self.declared.merge(&other.declared);
    }

    /// The mean offset, each pass by its information: metres east and north, radians; `None` without any pass.
    #[must_use]
    pub fn mean(&self) -> Option<Pose2> {
        if self.declared.passes == 0 {
            let mean = |sum: i64, unit: f64| sum as f64 * unit / f64::from(self.passes);
            let [east, north] = self.shift_mm;
            return (self.passes > 0)
                .then(|| Pose2::new(mean(east, 1e-3), mean(north, 1e-3), mean(self.yaw_urad, 1e-6)));
        }
        let Weighed { information: [position, yaw], shift_mm: [east, north], yaw_urad } = self.weighed();
        Some(Pose2::new(east / position * 1e-3, north / position * 1e-3, yaw_urad / yaw * 1e-6))
    }

    /// How far the mean may err, by what the passes declared or, where they scatter by more than that, by their scatter;
    /// `None` without any pass. What no number of passes averages out is not in it.
    ///
    /// The scatter scales the declared variance (Birge's ratio). What was declared counts for some degrees of freedom in
    /// it, since the scatter of few passes says little.
    #[must_use]
    pub fn variance(&self) -> Option<MapVariance> {
        if self.passes == 0 {
            return None;
        }
        let Weighed { information: [position, yaw], shift_mm: [east, north], yaw_urad } = self.weighed();
        // Of passes without a declaration only the sum is known: they are taken as one that does not scatter.
        let silent = self.silent();
        let (passes, [weight, weight_yaw]) = (f64::from(silent.passes).max(1.0), silent_weight());
        let square = |value: f64| value * value;
        let of_sum = silent.shift_mm.map(|sum| square(sum as f64)).iter().sum::<f64>();
        let squares = self.declared.squares[0] as f64 + weight * of_sum / passes;
        let squares_yaw =
            self.declared.squares[1] as f64 * 1024.0 + weight_yaw * square(silent.yaw_urad as f64) / passes;
        let free = f64::from(self.declared.passes + silent.passes.min(1)) - 1.0;
        let scatter = (squares - (square(east) + square(north)) / position) * 1e-6 / INFORMATION_STEPS as f64;
        let scatter_yaw = (squares_yaw - square(yaw_urad) / yaw) * 1e-12;
        let ratio = |scatter: f64, free: f64| {
            ((scatter.max(0.0) + DECLARATION_DOF) / (free + DECLARATION_DOF)).max(1.0)
        };
        Some(MapVariance {
            position_m2: ratio(scatter, 2.0 * free) * INFORMATION_STEPS as f64 / position,
            yaw_rad2: ratio(scatter_yaw, free) / yaw,
        })
    }

    /// The passes without a declaration.
    fn silent(&self) -> Silent {
        let [east, north] = self.shift_mm;
        let [declared_east, declared_north] = self.declared.shift_mm;
        Silent {
            passes: self.passes.saturating_sub(self.declared.passes),
            shift_mm: [east.saturating_sub(declared_east), north.saturating_sub(declared_north)],
            yaw_urad: self.yaw_urad.saturating_sub(self.declared.yaw_urad),
        }
    }

    /// Sums over all passes, each times its weight.
    fn weighed(&self) -> Weighed {
        let (silent, declared) = (self.silent(), &self.declared);
        let [weight, weight_yaw] = silent_weight();
        let passes = f64::from(silent.passes);
        let shift =
            |axis: usize| declared.weighted_shift[axis] as f64 + weight * silent.shift_mm[axis] as f64;
        Weighed {
            information: [
                declared.information[0] as f64 + weight * passes,
                declared.information[1] as f64 + weight_yaw * passes,
            ],
            shift_mm: [shift(0), shift(1)],
            yaw_urad: declared.weighted_yaw as f64 + weight_yaw * silent.yaw_urad as f64,
        }
    }
}

/// The passes without a declaration, summed up.
struct Silent {
    passes: u32,
    shift_mm: [i64; 2],
    yaw_urad: i64,
}

/// What each of them counts for.
fn silent_weight() -> [f64; 2] {
    let (position, yaw) = PoseSigma::default().information();
    [position as f64, yaw as f64]
}

/// Sums over all passes, each times its weight.
struct Weighed {
    information: [f64; 2],
    shift_mm: [f64; 2],
    yaw_urad: f64,
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
