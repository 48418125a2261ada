//! The batch's occupancy grid (`toOGM` of fastGlobalAlign l. 4).

use super::{Prior, Search};
use crate::batch::Batch;
use crate::geo::CELL_M;
use crate::window::Frame;

/// Points of a batch within the search's extent: ground metres in the body's frame.
#[must_use]
pub fn points_in_reach(batch: &Batch, search: &Search) -> Vec<[f64; 2]> {
    let reach = search.extent_m;
    let inside = |p: &[f64; 2]| p[0].hypot(p[1]) <= reach;
    batch.points.iter().map(|p| p.map(f64::from)).filter(inside).collect()
}

/// An image of a batch, redrawn for every heading.
#[derive(Default)]
pub struct Raster {
    image: Vec<f32>,
    /// Cells that are not 0: what must be wiped before the next drawing.
    touched: Vec<u32>,
    /// Evidence by number of hits, from 0.
    evidence: Vec<f32>,
}

impl Raster {
    /// Draws the batch at the prior, turned by `turn_rad`, as evidence with the prior belief
    /// subtracted: 0 where nothing was seen, and within `lag` cells of the border.
    pub fn draw(
        &mut self,
        frame: Frame,
        batch: &Batch,
        prior: &Prior,
        turn_rad: f64,
        search: &Search,
        lag: usize,
    ) {
        self.clear(frame.side);
        let [x0, y0] = frame.to_cells([prior.pose.x_m, prior.pose.y_m]);
        let (s, c) = (prior.pose.yaw_rad + turn_rad).sin_cos();
        let cells_per_metre = prior.scale / CELL_M;
        let (s, c) = (s * cells_per_metre, c * cells_per_metre);
        let reach_sq = (search.extent_m * search.extent_m) as f32;
        let inside = lag as f64..(frame.side - lag) as f64;
        for [px, py] in batch.points.iter().filter(|[x, y]| x * x + y * y <= reach_sq) {
            let (px, py) = (f64::from(*px), f64::from(*py));
            let (x, y) = (x0 + c * px - s * py, y0 + s * px + c * py);
            if inside.contains(&x) && inside.contains(&y) {
                let index = y as usize * frame.side + x as usize;
                if self.image[index] == 0.0 {
                    self.touched.push(index as u32);
                }
                self.image[index] += 1.0;
            }
        }
        self.weigh(search);
    }

    /// The image, row-major, frame side by frame side.
    pub fn image(&self) -> &[f32] {
        &self.image
    }

    /// Occupied cells of the last drawing.
    pub fn cells(&self) -> usize {
        self.touched.len()
    }

    fn clear(&mut self, side: usize) {
        if self.image.len() == side * side {
            for index in self.touched.drain(..) {
                self.image[index as usize] = 0.0;
            }
        } else {
            self.touched.clear();
            self.image = vec![0.0; side * side];
        }
    }

    /// Counts become evidence (eq. binary-bayes).
    fn weigh(&mut self, search: &Search) {
        for index in &self.touched {
            let value = &mut self.image[*index as usize];
            let hits = *value as usize;
            while self.evidence.len() <= hits {
                self.evidence.push(search.model.evidence(self.evidence.len() as u32) as f32);
            }
            *value = self.evidence[hits];
        }
    }
}
