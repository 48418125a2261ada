//! What passes with a declared sigma add up to.

use super::{Offset, PoseSigma};

/// Sums over the passes whose poses have a declared sigma; all of whole numbers, so that they do not depend on the
/// order. A weight is a pass's [information](PoseSigma::information).
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct DeclaredSums {
    /// Passes.
    pub passes: u32,
    /// Sum of their shifts, millimetres east and north.
    pub shift_mm: [i64; 2],
    /// Sum of their turns, microradians.
    pub yaw_urad: i64,
    /// Sum of their weights: of the position, and of the heading.
    pub information: [u64; 2],
    /// Sum of their shifts, each times its weight.
    pub weighted_shift: [i64; 2],
    /// Sum of their turns, each times its weight.
    pub weighted_yaw: i64,
    /// Sum of their squared shifts, both axes together, and of their squared turns in 1024 square microradians; each
    /// times its weight.
    pub squares: [u64; 2],
}

impl DeclaredSums {
    /// One pass.
    pub(super) fn of(offset: Offset, sigma: PoseSigma) -> Self {
        let (position, yaw) = sigma.information();
        let [east, north, turn] = [offset.east_mm, offset.north_mm, offset.yaw_urad].map(i64::from);
        let square = |value: i64| value.unsigned_abs().saturating_mul(value.unsigned_abs());
        let by = |value: i64, weight: u64| value.saturating_mul(weight as i64);
        Self {
            passes: 1,
            shift_mm: [east, north],
            yaw_urad: turn,
            information: [position, yaw],
            weighted_shift: [by(east, position), by(north, position)],
            weighted_yaw: by(turn, yaw),
            squares: [
                square(east).saturating_add(square(north)).saturating_mul(position),
                square(turn).saturating_div(1024).saturating_mul(yaw),
            ],
        }
    }

    /// Adds what another one counted.
    pub(super) fn merge(&mut self, other: &Self) {
        self.passes = self.passes.saturating_add(other.passes);
        self.yaw_urad = self.yaw_urad.saturating_add(other.yaw_urad);
        self.weighted_yaw = self.weighted_yaw.saturating_add(other.weighted_yaw);
        for axis in 0..2 {
            self.shift_mm[axis] = self.shift_mm[axis].saturating_add(other.shift_mm[axis]);
            self.information[axis] = self.information[axis].saturating_add(other.information[axis]);
            self.weighted_shift[axis] = self.weighted_shift[axis].saturating_add(other.weighted_shift[axis]);
            self.squares[axis] = self.squares[axis].saturating_add(other.squares[axis]);
        }
    }
}
