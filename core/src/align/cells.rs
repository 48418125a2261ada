//! Where the points of a batch fall on an image, under a hypothesis.

use super::Prior;
use super::simd::{Isa, Kernel};
use super::view::Shown;
use crate::geo::CELL_M;
use crate::pose::Pose2;

/// Where points fall on an image.
#[derive(Clone, Copy)]
pub struct Placing<'a> {
    /// Onto what.
    pub image: Shown<'a>,
    /// Where the body is believed to be.
    pub prior: &'a Prior,
    /// Points farther from the body are left out, ground metres.
    pub reach_m: f64,
    /// Points within so many pixels of the image's border are left out.
    pub lag: usize,
}

impl Placing<'_> {
    /// Writes for each point the index of its pixel, under a correction of the prior, moved south-west by
    /// the lag along both axes: where the strips of its shifts begin.
    ///
    /// Points are ground metres in the body's frame. Every engine counts those that are written and no
    /// others.
    pub fn places(&self, isa: Isa, at: Pose2, points: impl Iterator<Item = [f32; 2]>, out: &mut Vec<u32>) {
        let Self { image, prior, reach_m, lag } = *self;
        let per_metre = 1.0 / (CELL_M * image.cells as f64);
        let origin = image.frame.to_metres([0.0, 0.0]);
        let (s, c) = (prior.pose.yaw_rad + at.yaw_rad).sin_cos();
        let pixels = |metres: f64| (metres * per_metre) as f32;
        out.clear();
        isa.run(Place {
            points,
            first: [pixels(prior.pose.x_m + at.x_m - origin[0]), pixels(prior.pose.y_m + at.y_m - origin[1])],
            turn: [pixels(c * prior.scale), pixels(s * prior.scale)],
            reach_sq: (reach_m * reach_m) as f32,
            within: [lag as f32, (image.side - lag) as f32],
            side: image.side as u32,
            out,
        });
    }
}

/// Points that are placed side by side.
const LANES: usize = 16;

/// [`Placing::places`], compiled for an instruction set.
struct Place<'a, P> {
    points: P,
    /// The body, pixels.
    first: [f32; 2],
    /// Cosine and sine of its heading, pixels a metre.
    turn: [f32; 2],
    reach_sq: f32,
    /// From where to where pixels count, along both axes.
    within: [f32; 2],
    side: u32,
    out: &'a mut Vec<u32>,
}

impl<P: Iterator<Item = [f32; 2]>> Kernel for Place<'_, P> {
    type Out = ();

    #[expect(clippy::inline_always, reason = "only what is inlined is compiled for an instruction set")]
    #[inline(always)]
    fn run(mut self) {
        let ([x0, y0], [c, s], [low, high]) = (self.first, self.turn, self.within);
        let lag = low as u32;
        loop {
            // Side by side, so that all but the first and the last loop is vectorised.
            let (mut px, mut py, mut count) = ([0.0_f32; LANES], [0.0_f32; LANES], 0);
            for ([x, y], point) in px.iter_mut().zip(&mut py).map(|(x, y)| [x, y]).zip(self.points.by_ref()) {
                [*x, *y] = point;
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

/// Which pixels of an image were met before.
#[derive(Default)]
pub struct Once {
    met: Vec<u64>,
}

impl Once {
    /// Keeps the first of each index: a batch's occupied cells from the cells of its points.
    pub fn retain(&mut self, places: &mut Vec<u32>) {
        let words = places.iter().max().map_or(0, |last| *last as usize / 64 + 1);
        if self.met.len() < words {
            self.met.resize(words, 0);
        }
        // Without a branch on what cannot be foreseen, which a closure of `Vec::retain` is.
        let mut kept = 0;
        for i in 0..places.len() {
            let place = places[i];
            let (word, bit) = (&mut self.met[place as usize / 64], 1_u64 << (place % 64));
            let first = *word & bit == 0;
            *word |= bit;
            places[kept] = place;
            kept += usize::from(first);
        }
        places.truncate(kept);
        for place in places.iter() {
            self.met[*place as usize / 64] = 0;
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
        fn each_cell_is_kept_once(places in prop::collection::vec(0..500_u32, 0..200)) {
            let mut once = Once::default();
            for _ in 0..2 {
                let mut kept = places.clone();
                once.retain(&mut kept);
                prop_assert_eq!(kept.iter().collect::<BTreeSet<_>>().len(), kept.len());
                prop_assert_eq!(kept.iter().collect::<BTreeSet<_>>(), places.iter().collect::<BTreeSet<_>>());
            }
        }
    }
}
