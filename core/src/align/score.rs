//! The score of a pose: how much weight the map has below the points, with slope and curvature.
//!
//! Weights are interpolated by quadratic B-splines, so that slope and curvature are those of one
//! smooth function and refining takes few steps.

use super::simd::{Isa, Kernel};
use super::view::MapView;
use super::weights::{KNOWN, STEPS};
use crate::geo::CELL_M;
use crate::point::{MapPoint, WeightedPoint};
use crate::pose::Pose2;

/// A score and its derivatives over (east m, north m, yaw rad).
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Slope {
    /// Sum of the points' weights, in units of the logarithm.
    pub value: f64,
    /// First derivatives.
    pub gradient: [f64; 3],
    /// Second derivatives: xx, xy, yy, x-yaw, y-yaw, yaw-yaw.
    pub curvature: [f64; 6],
}

/// A map to score poses on.
#[derive(Clone, Copy)]
pub struct ScoreField<'a> {
    weights: &'a [u8],
    side: usize,
    /// The image's south-west corner.
    corner: MapPoint,
    /// Where the map has been: 1 or 0 for each [`KNOWN`] x [`KNOWN`] cells.
    known: &'a [u8],
    /// A weight w counts as `w * (curve[0] + curve[1] * w)`.
    curve: [f32; 2],
}

impl<'a> ScoreField<'a> {
    /// The cells of a view.
    #[must_use]
    pub fn of(view: &'a MapView) -> Self {
        let square = view.square();
        let (weights, known) = (view.fine().weights, view.known().weights);
        Self { weights, side: square.side, corner: square.corner(), known, curve: [1.0, 0.0] }
    }

    /// The same map with its weights squared: clutter then counts for little. For the last centimetres.
    #[must_use]
    pub fn sharpened(&self) -> Self {
        Self { curve: [0.0, SHARPNESS / STEPS], ..*self }
    }

    /// Scores points seen by a body at `pose` (map metres); `scale` is the map's metres per ground metre.
    #[must_use]
    pub fn slope(&self, points: &[WeightedPoint], pose: &Pose2, scale: f64) -> Slope {
        let per_metre = 1.0 / CELL_M;
        // Centres of cells are at half.
        let x0 = ((pose.x_m - self.corner.x_m) * per_metre - 0.5) as f32;
        let y0 = ((pose.y_m - self.corner.y_m) * per_metre - 0.5) as f32;
        let (s, c) = pose.yaw_rad.sin_cos();
        let (s, c) = ((s * scale * per_metre) as f32, (c * scale * per_metre) as f32);
        let sums = Isa::best().run(Sums { field: self, points, from: [x0, y0], turn: [s, c] });
        let unit = f64::from(STEPS).recip();
        let s = sums.map(|sum| f64::from(sum) * unit);
        let second = per_metre * per_metre;
        Slope {
            value: s[0],
            gradient: [s[1] * per_metre, s[2] * per_metre, s[3]],
            curvature: [
                s[4] * second,
                s[5] * second,
                s[6] * second,
                s[7] * per_metre,
                s[8] * per_metre,
                s[9],
            ],
        }
    }

    /// The 3 x 3 weights around each point of a block; 0 at the image's border and beyond.
    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    fn patches(&self, points: &[WeightedPoint], [x0, y0]: [f32; 2], [s, c]: [f32; 2]) -> Patches {
        let mut p = Patches::default();
        let limit = (self.side - 2) as f32;
        let mut index = [0_u32; LANES];
        let mut local = [[0.0_f32; LANES]; 3];
        for (i, point) in points.iter().enumerate() {
            (local[0][i], local[1][i], local[2][i]) = (point.x_m, point.y_m, point.vote);
        }
        for i in 0..LANES {
            let (rx, ry) = (c * local[0][i] - s * local[1][i], s * local[0][i] + c * local[1][i]);
            let (x, y) = (x0 + rx, y0 + ry);
            let inside = x >= 1.0 && y >= 1.0 && x < limit && y < limit;
            // A point outside gets taps from the corner, and no arm and no weight below.
            let (x, y) = if inside { (x, y) } else { (1.0, 1.0) };
            let (column, row) = ((x + 0.5) as u32, (y + 0.5) as u32);
            (p.fx[i], p.fy[i]) = (x - column as f32, y - row as f32);
            (p.rx[i], p.ry[i]) = (rx, ry);
            p.weight[i] = if inside { local[2][i] } else { 0.0 };
            index[i] = (row - 1) * self.side as u32 + column - 1;
        }
        for i in 0..LANES {
            for (row, taps) in p.taps.iter_mut().enumerate() {
                let from = index[i] as usize + row * self.side;
                let four = self.weights.get(from..from + 4).and_then(|t| t.try_into().ok());
                taps[i] = u32::from_le_bytes(four.unwrap_or_default());
            }
        }
        p
    }

    /// Writes the weight of each point at its nearest cell, below 0 where the map has not been: nothing can be
    /// said of what was seen there.
    pub fn weigh<'p>(
        &self,
        points: impl Iterator<Item = &'p WeightedPoint>,
        pose: &Pose2,
        scale: f64,
        out: &mut Vec<f32>,
    ) {
        let known_side = self.side / KNOWN;
        out.clear();
        self.nearest(points, pose, scale, |cells| {
            // Without a branch on where the map has been, which cannot be predicted.
            out.extend(cells.iter().map(|&NearestCell { column, row, inside }| {
                let [column, row] = [column, row].map(|i| i as usize);
                let known = self.known.get(row / KNOWN * known_side + column / KNOWN).copied();
                let weight = f32::from(self.weights[row * self.side + column]);
                if inside & (known.unwrap_or(0) == 1) { weight } else { UNKNOWN }
            }));
        });
    }

    /// Only the score, each point at its nearest cell: for comparing far poses.
    #[must_use]
    pub fn value<'p>(
        &self,
        points: impl IntoIterator<Item = &'p WeightedPoint>,
        pose: &Pose2,
        scale: f64,
    ) -> f64 {
        let mut sum = 0_u32;
        self.nearest(points.into_iter(), pose, scale, |cells| {
            for &NearestCell { column, row, inside } in cells {
                let weight = self.weights[row as usize * self.side + column as usize];
                sum += if inside { u32::from(weight) } else { 0 };
            }
        });
        f64::from(sum) / f64::from(STEPS)
    }

    /// Calls with the points' nearest cells, some at a time, in the points' order.
    fn nearest<'p>(
        &self,
        points: impl Iterator<Item = &'p WeightedPoint>,
        pose: &Pose2,
        scale: f64,
        each: impl FnMut(&[NearestCell]),
    ) {
        let per_metre = 1.0 / CELL_M;
        let x0 = ((pose.x_m - self.corner.x_m) * per_metre) as f32;
        let y0 = ((pose.y_m - self.corner.y_m) * per_metre) as f32;
        let (s, c) = pose.yaw_rad.sin_cos();
        let (s, c) = ((s * scale * per_metre) as f32, (c * scale * per_metre) as f32);
        Isa::best().run(NearestCells { points, from: [x0, y0], turn: [s, c], side: self.side as f32, each });
    }
}

/// The cell of the image that a point lies in; the first one for a point beyond the image.
#[derive(Clone, Copy, Default)]
struct NearestCell {
    column: u32,
    row: u32,
    inside: bool,
}

/// Points whose nearest cells are asked for; otherwise as [`Sums`].
struct NearestCells<P, E> {
    points: P,
    from: [f32; 2],
    turn: [f32; 2],
    side: f32,
    each: E,
}

impl<'p, P: Iterator<Item = &'p WeightedPoint>, E: FnMut(&[NearestCell])> Kernel for NearestCells<P, E> {
    type Out = ();

    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    fn run(mut self) {
        let ([x0, y0], [s, c]) = (self.from, self.turn);
        loop {
            // Side by side, so that the loop between the others is vectorised.
            let (mut px, mut py, mut count) = ([0.0_f32; LANES], [0.0_f32; LANES], 0);
            for ((x, y), point) in px.iter_mut().zip(&mut py).zip(self.points.by_ref()) {
                (*x, *y) = (point.x_m, point.y_m);
                count += 1;
            }
            let mut cells = [NearestCell::default(); LANES];
            for (i, cell) in cells.iter_mut().enumerate() {
                let (x, y) = (x0 + c * px[i] - s * py[i], y0 + s * px[i] + c * py[i]);
                let inside = x >= 0.0 && y >= 0.0 && x < self.side && y < self.side;
                let index = |v: f32| if inside { v as i32 as u32 } else { 0 };
                *cell = NearestCell { column: index(x), row: index(y), inside };
            }
            (self.each)(&cells[..count]);
            if count < LANES {
                break;
            }
        }
    }
}

/// The weight of a point where the map has not been.
pub(super) const UNKNOWN: f32 = -1.0;

/// Points to be summed up: the position of the body, cells, and sine and cosine times cells a metre.
struct Sums<'a> {
    field: &'a ScoreField<'a>,
    points: &'a [WeightedPoint],
    from: [f32; 2],
    turn: [f32; 2],
}

impl Kernel for Sums<'_> {
    type Out = [f32; TERMS];

    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    fn run(self) -> [f32; TERMS] {
        let mut sums = [[0.0_f32; LANES]; TERMS];
        for block in self.points.chunks(LANES) {
            self.field.patches(block, self.from, self.turn).add_terms(self.field.curve, &mut sums);
        }
        sums.map(|lanes| lanes.iter().sum())
    }
}

/// A squared weight counts for this much: `0.11 log(1 + s / k)^2` is close to `log(1 + s / 10 k)` over the
/// weights that occur.
const SHARPNESS: f32 = 0.11;
/// Points that are scored side by side.
const LANES: usize = 16;
/// Weight, its slopes over (x, y, turn), its curvatures over (xx, xy, yy, x-turn, y-turn, turn-turn).
const TERMS: usize = 10;

/// A block of points, each with the weights around it.
#[derive(Default)]
struct Patches {
    /// By row, the bytes of three neighbouring cells, and a fourth that is not used.
    taps: [[u32; LANES]; 3],
    /// Where the point lies, cells from the middle one's centre.
    fx: [f32; LANES],
    fy: [f32; LANES],
    /// Where it lies, cells from the body.
    rx: [f32; LANES],
    ry: [f32; LANES],
    /// What it counts for; 0 outside the image.
    weight: [f32; LANES],
}

impl Patches {
    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    #[expect(clippy::needless_range_loop, reason = "lanes of several arrays side by side")]
    fn add_terms(&self, [plain, square]: [f32; 2], sums: &mut [[f32; LANES]; TERMS]) {
        for i in 0..LANES {
            let ((bx, dx), (by, dy)) = (spline(self.fx[i]), spline(self.fy[i]));
            let tap = |row: usize, shift: u32| {
                let weight = ((self.taps[row][i] >> shift) & 255) as f32;
                weight * (plain + square * weight)
            };
            let column = |shift: u32| [0, 1, 2].map(|row: usize| tap(row, shift));
            let columns = [column(0), column(8), column(16)];
            let blend = |b: &[f32; 3], v: [f32; 3]| b[0] * v[0] + b[1] * v[1] + b[2] * v[2];
            let value = columns.map(|c| blend(&by, c));
            let slope = columns.map(|c| blend(&dy, c));
            let curve = columns.map(|c| c[0] - 2.0 * c[1] + c[2]);
            let (w, x, xx) = (blend(&bx, value), blend(&dx, value), value[0] - 2.0 * value[1] + value[2]);
            let (y, xy, yy) = (blend(&bx, slope), blend(&dx, slope), blend(&bx, curve));
            let (rx, ry, k) = (self.rx[i], self.ry[i], self.weight[i]);
            let (hx, hy) = (xy * rx - xx * ry, yy * rx - xy * ry);
            let turn = [y * rx - x * ry, hy * rx - hx * ry - x * rx - y * ry];
            let terms = [w, x, y, turn[0], xx, xy, yy, hx, hy, turn[1]];
            for t in 0..TERMS {
                sums[t][i] += k * terms[t];
            }
        }
    }
}

/// Taps of the quadratic B-spline, and of its slope, at `f` in [-1/2, 1/2] from the middle sample.
#[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
#[inline(always)]
fn spline(f: f32) -> ([f32; 3], [f32; 3]) {
    let (low, high) = (0.5 - f, 0.5 + f);
    ([0.5 * low * low, 0.75 - f * f, 0.5 * high * high], [-low, -2.0 * f, high])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches an instruction set that sums in another order or contracts products: its poses would differ
    /// from one machine to the next.
    #[test]
    fn every_instruction_set_gives_the_same_bits() {
        const SIDE: usize = 96;
        let image: Vec<u8> = (0..SIDE * SIDE + 64).map(|i| (i * i * 31 + i * 7) as u8).collect();
        let field = ScoreField {
            weights: &image,
            side: SIDE,
            corner: MapPoint::default(),
            known: &[],
            curve: [0.3, 0.004],
        };
        let spread = |i: usize, step: f32| (i as f32 * step).fract() * 11.0 - 5.5;
        for count in [0, 1, 15, 16, 17, 700] {
            // Some of them beyond the border.
            let point = |i| WeightedPoint::new(spread(i, 0.618), spread(i, 0.317), 1.0 / (1 + i % 3) as f32);
            let points: Vec<_> = (0..count).map(point).collect();
            let sums = || Sums { field: &field, points: &points, from: [47.3, 48.1], turn: [3.1, 9.5] };
            let bits = |isa: Isa| isa.run(sums()).map(f32::to_bits);
            let plain = bits(Isa::PLAIN);
            assert!(count < 15 || plain[0] != 0, "{count} points see something");
            for isa in Isa::available() {
                assert_eq!(bits(isa), plain, "{isa:?}, {count} points");
            }
        }
    }
}
