//! Which pixels of an image the points of a batch fall on, under a hypothesis.

use super::Prior;
use super::simd::{Isa, Kernel};
use super::view::ImageView;
use crate::geo::CELL_M;
use crate::point::BodyPoint;
use crate::pose::Pose2;
use crate::window::MapSquare;

/// From points in the body's frame to the pixels of an image.
#[derive(Clone, Copy)]
pub struct Projection<'a> {
    /// Where the image lies.
    pub square: MapSquare,
    /// Map cells along a pixel's side.
    pub cells: usize,
    /// Pixels along the image's side.
    pub side: usize,
    /// The pose of the body, before a correction.
    pub prior: &'a Prior,
    /// Points farther from the body are left out, ground metres.
    pub reach_m: f64,
    /// Points within so many pixels of the image's border are left out.
    pub lag: usize,
}

impl<'a> Projection<'a> {
    /// Onto an image.
    #[must_use]
    pub fn onto(image: &ImageView, prior: &'a Prior, reach_m: f64, lag: usize) -> Self {
        Self { square: image.square, cells: image.cells, side: image.side, prior, reach_m, lag }
    }

    /// Onto an image of a square whose pixels are cells.
    #[must_use]
    pub fn of_cells(square: MapSquare, prior: &'a Prior, reach_m: f64, lag: usize) -> Self {
        Self { square, cells: 1, side: square.side, prior, reach_m, lag }
    }

    /// Writes for each point the index of its pixel, under a correction of the prior, moved south-west by
    /// the lag along both axes: where the strips of its shifts begin.
    ///
    /// Every engine counts those that are written and no others.
    pub fn pixel_indices(
        &self,
        isa: Isa,
        correction: Pose2,
        points: impl Iterator<Item = BodyPoint>,
        out: &mut Vec<u32>,
    ) {
        let Self { square, cells, side, prior, reach_m, lag } = *self;
        let per_metre = 1.0 / (CELL_M * cells as f64);
        let corner = square.corner();
        let (s, c) = (prior.pose.yaw_rad + correction.yaw_rad).sin_cos();
        let pixels = |metres: f64| (metres * per_metre) as f32;
        out.clear();
        isa.run(PixelIndices {
            points,
            body: [
                pixels(prior.pose.x_m + correction.x_m - corner.x_m),
                pixels(prior.pose.y_m + correction.y_m - corner.y_m),
            ],
            turn: [pixels(c * prior.scale), pixels(s * prior.scale)],
            reach_sq: (reach_m * reach_m) as f32,
            within: [lag as f32, (side - lag) as f32],
            side: side as u32,
            out,
        });
    }
}

/// Points that are projected side by side.
const LANES: usize = 16;

/// [`Projection::pixel_indices`], compiled for an instruction set.
struct PixelIndices<'a, P> {
    points: P,
    /// The body's position, pixels.
    body: [f32; 2],
    /// Cosine and sine of its heading, pixels a metre.
    turn: [f32; 2],
    reach_sq: f32,
    /// From where to where pixels count, along both axes.
    within: [f32; 2],
    side: u32,
    out: &'a mut Vec<u32>,
}

impl<P: Iterator<Item = BodyPoint>> Kernel for PixelIndices<'_, P> {
    type Out = ();

    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    fn run(mut self) {
        let ([x0, y0], [c, s], [low, high]) = (self.body, self.turn, self.within);
        let lag = low as u32;
        loop {
            // Side by side, so that all but the first and the last loop is vectorised.
            let (mut px, mut py, mut count) = ([0.0_f32; LANES], [0.0_f32; LANES], 0);
            for ((x, y), point) in px.iter_mut().zip(&mut py).zip(self.points.by_ref()) {
                (*x, *y) = (point.x_m, point.y_m);
                count += 1;
            }
            let (mut index, mut inside) = ([0_u32; LANES], [false; LANES]);
            for i in 0..LANES {
                let (x, y) = (x0 + c * px[i] - s * py[i], y0 + s * px[i] + c * py[i]);
                let near = px[i] * px[i] + py[i] * py[i] <= self.reach_sq;
                inside[i] = near && x >= low && x < high && y >= low && y < high;
                let (column, row) = (x as i32 as u32, y as i32 as u32);
                index[i] =
                    row.wrapping_sub(lag).wrapping_mul(self.side).wrapping_add(column).wrapping_sub(lag);
            }
            // Where the next one goes depends on the last one, but no branch does.
            let (mut kept, mut len) = ([0_u32; LANES], 0);
            for (index, inside) in index[..count].iter().zip(&inside) {
                kept[len % LANES] = *index;
                len += usize::from(*inside);
            }
            self.out.extend_from_slice(&kept[..len]);
            if count < LANES {
                break;
            }
        }
    }
}

/// Drops repeated pixels from a list, with a bit for each pixel that is in the list already.
#[derive(Default)]
pub struct DistinctPixels {
    seen: Vec<u64>,
}

impl DistinctPixels {
    /// Leaves the first of each index: a batch's occupied cells from the cells of its points.
    pub fn retain(&mut self, pixels: &mut Vec<u32>) {
        let words = pixels.iter().max().map_or(0, |last| *last as usize / 64 + 1);
        if self.seen.len() < words {
            self.seen.resize(words, 0);
        }
        // Without a branch on what cannot be predicted, which a closure of `Vec::retain` is.
        let mut kept = 0;
        for i in 0..pixels.len() {
            let pixel = pixels[i];
            let (word, bit) = (&mut self.seen[pixel as usize / 64], 1_u64 << (pixel % 64));
            let first = *word & bit == 0;
            *word |= bit;
            pixels[kept] = pixel;
            kept += usize::from(first);
        }
        pixels.truncate(kept);
        for pixel in pixels.iter() {
            self.seen[*pixel as usize / 64] = 0;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeSet;

    proptest! {
        #[test]
        fn each_pixel_stays_once(pixels in prop::collection::vec(0..500_u32, 0..200)) {
            let mut distinct = DistinctPixels::default();
            for _ in 0..2 {
                let mut kept = pixels.clone();
                distinct.retain(&mut kept);
                prop_assert_eq!(kept.iter().collect::<BTreeSet<_>>().len(), kept.len());
                prop_assert_eq!(kept.iter().collect::<BTreeSet<_>>(), pixels.iter().collect::<BTreeSet<_>>());
            }
        }
    }
}
