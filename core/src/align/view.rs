//! The weights around a prior, assembled from prepared tiles into one image.
//!
//! Assembling is copying rows: nothing is computed for a place that another request has prepared.

use std::sync::Arc;

use super::weights::{COARSE, TileWeights, mean};
use crate::datum::mean_offset;
use crate::geo::{CELLS_PER_TILE, TileId};
use crate::pose::Pose2;
use crate::window::Frame;

/// Bytes beyond the last row, so that a strip that starts in the image can be read whole.
const PADDING: usize = 64;

/// One of a view's images.
#[derive(Clone, Copy)]
pub struct Shown<'a> {
    /// Where it lies.
    pub frame: Frame,
    /// Map cells along a pixel's side.
    pub cells: usize,
    /// Pixels along a side.
    pub side: usize,
    /// Weights, row-major, and some zeros beyond the last row.
    pub image: &'a [u8],
}

/// Which square, and which tiles of it: what was computed from one need not be computed again.
#[derive(Clone)]
pub struct Square {
    /// Where it lies.
    pub frame: Frame,
    /// The tiles that exist in it.
    pub tiles: Vec<Arc<TileWeights>>,
}

impl Square {
    /// Writes down which square it is, in the place of the last one.
    pub fn note(slot: &mut Option<Self>, frame: Frame, tiles: &[Arc<TileWeights>]) {
        let square = slot.get_or_insert_with(|| Self { frame, tiles: Vec::new() });
        square.frame = frame;
        square.tiles.clear();
        square.tiles.extend_from_slice(tiles);
    }

    /// True when these are the same tiles of the same square.
    #[must_use]
    pub fn is(&self, frame: Frame, tiles: &[Arc<TileWeights>]) -> bool {
        let same = |(a, b): (&Arc<_>, &Arc<_>)| Arc::ptr_eq(a, b);
        self.frame == frame && self.tiles.len() == tiles.len() && self.tiles.iter().zip(tiles).all(same)
    }
}

/// A square of the map as weights; reused from request to request.
#[derive(Default)]
pub struct MapView {
    square: Option<Square>,
    fine: Vec<u8>,
    coarse: Vec<u8>,
}

impl MapView {
    /// Shows a square; tiles that are not given are empty.
    pub fn show(&mut self, frame: Frame, tiles: &[Arc<TileWeights>]) {
        if self.square.as_ref().is_some_and(|shown| shown.is(frame, tiles)) {
            return;
        }
        Square::note(&mut self.square, frame, tiles);
        let coarse_side = frame.side / COARSE;
        // Tiles that are all there overwrite everything.
        let whole = frame.tiles().count() == tiles.len();
        reset(&mut self.fine, frame.side * frame.side + PADDING, whole);
        reset(&mut self.coarse, coarse_side * coarse_side + PADDING, whole);
        for tile in tiles {
            let first = tile.id.first_cell();
            let at = [first.x - frame.origin.x, first.y - frame.origin.y];
            paste(tile.fine(), CELLS_PER_TILE as i64, &mut self.fine, frame.side as i64, at);
            let coarse = COARSE as i64;
            let at = at.map(|c| c.div_euclid(coarse));
            paste(tile.coarse(), CELLS_PER_TILE as i64 / coarse, &mut self.coarse, coarse_side as i64, at);
        }
    }

    /// What is shown.
    ///
    /// # Panics
    /// Before the first [`MapView::show`].
    #[must_use]
    pub fn square(&self) -> &Square {
        self.square.as_ref().expect("a view is asked after it was shown")
    }

    /// Where it lies.
    #[must_use]
    pub fn frame(&self) -> Frame {
        self.square().frame
    }

    /// Weights of cells.
    #[must_use]
    pub fn fine(&self) -> Shown<'_> {
        let frame = self.frame();
        Shown { frame, cells: 1, side: frame.side, image: &self.fine }
    }

    /// Mean weights of [`COARSE`] x [`COARSE`] cells.
    #[must_use]
    pub fn coarse(&self) -> Shown<'_> {
        let frame = self.frame();
        Shown { frame, cells: COARSE, side: frame.side / COARSE, image: &self.coarse }
    }

    /// The tile below a place (map metres), if the map has it.
    #[must_use]
    pub fn tile_below(&self, place: [f64; 2]) -> Option<&TileWeights> {
        let id = TileId::of(self.frame().zone, place);
        self.square().tiles.iter().find(|tile| tile.id == id).map(|tile| &**tile)
    }

    /// How far the crowd says that the map errs at a place (map metres): metres east and north, radians.
    #[must_use]
    pub fn mean_offset(&self, place: [f64; 2]) -> Pose2 {
        let tiles = &self.square().tiles;
        mean_offset(self.frame().zone, place, |id| {
            tiles.iter().find(|tile| tile.id == id).map(|tile| tile.datum).unwrap_or_default()
        })
    }

    /// Passes over the cell of a typical hit: how many surveys the map here amounts to. Most hits are those of the
    /// busiest street, though another may be what holds the pose: its tiles' passes are a bound, each tile counting for
    /// what it weighs, and not for how often it was driven through.
    #[must_use]
    pub fn typical_passes(&self) -> f64 {
        let tiles = &self.square().tiles;
        let sum = |[a, b]: [f64; 2], tile: &Arc<TileWeights>| [a + tile.passes[0], b + tile.passes[1]];
        let typical = mean(tiles.iter().fold([0.0; 2], sum));
        let (mut weight, mut variance) = (0.0, 0.0);
        for tile in tiles {
            let passes = if tile.datum.passes > 0 { f64::from(tile.datum.passes) } else { mean(tile.passes) };
            let hits_of_a_pass = tile.passes[1] / passes;
            weight += hits_of_a_pass;
            variance += hits_of_a_pass / passes;
        }
        if variance > 0.0 { typical.min(weight / variance) } else { typical }
    }
}

fn reset(image: &mut Vec<u8>, len: usize, keep: bool) {
    if !keep || image.len() != len {
        image.clear();
        image.resize(len, 0);
    }
}

/// Copies the part of a square image that lies on another one; `at` is where its first value goes.
fn paste(from: &[u8], from_side: i64, to: &mut [u8], to_side: i64, at: [i64; 2]) {
    let [x0, y0] = at;
    let (left, right) = (x0.max(0), (x0 + from_side).min(to_side));
    if left >= right {
        return;
    }
    let width = (right - left) as usize;
    for y in y0.max(0)..(y0 + from_side).min(to_side) {
        let source = ((y - y0) * from_side + left - x0) as usize;
        let target = (y * to_side + left) as usize;
        to[target..target + width].copy_from_slice(&from[source..source + width]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evidence::Cell;
    use crate::evidence::presence::ALWAYS;
    use crate::geo::{CELL_M, Zone};
    use crate::tile::Tile;

    #[test]
    fn every_cell_shows_its_tiles_weight() {
        let zone = Zone::from_epsg(32614).unwrap();
        let place = [600_010.0, 3_300_020.0];
        let id = TileId::of(zone, place);
        let cell = |i| Cell { hits: 1 + i % 7, passes: 2, presence: ALWAYS, ..Cell::default() };
        let cells = (0..2000).map(|i| (i * 131, cell(i)));
        let tile = Tile::from_cells(cells.collect()).unwrap();
        let weights = Arc::new(TileWeights::new(id, |at| (at == id).then_some(&tile)));
        let frame = Frame::around(zone, place, 50.0, 6.0);
        let mut view = MapView::default();
        view.show(frame, std::slice::from_ref(&weights));
        let first = id.first_cell();
        for (index, value) in weights.fine().iter().enumerate() {
            let (x, y) = (
                first.x + index as i64 % 512 - frame.origin.x,
                first.y + index as i64 / 512 - frame.origin.y,
            );
            let side = frame.side as i64;
            if (0..side).contains(&x) && (0..side).contains(&y) {
                assert_eq!(view.fine().image[(y * side + x) as usize], *value);
            }
        }
        let shown: u64 = view.fine().image.iter().map(|v| u64::from(*v)).sum();
        assert!(shown > 0 && (view.typical_passes() - 2.0).abs() < 1e-9);
        let [x, y] = frame.to_metres([0.0, 0.0]);
        assert!(view.tile_below([x - CELL_M, y]).is_none() && view.tile_below(place).is_some());
    }

    /// Catches: a map's error that is reckoned from the avenue where the vehicle is held by the lane's fronts.
    #[test]
    fn a_busy_street_does_not_speak_for_the_lane_beside_it() {
        let zone = Zone::from_epsg(32614).unwrap();
        let place = [600_010.0, 3_300_020.0];
        let driven = |x, passes| {
            let id = TileId { x, ..TileId::of(zone, place) };
            let cell = Cell { hits: 2 * passes, passes, presence: ALWAYS, ..Cell::default() };
            let tile = Tile::from_cells((0..2000).map(|i| (i * 131, cell)).collect()).unwrap();
            Arc::new(TileWeights::new(id, |at| (at == id).then_some(&tile)))
        };
        let x = TileId::of(zone, place).x;
        let mut view = MapView::default();
        view.show(Frame::around(zone, place, 50.0, 6.0), &[driven(x, 3), driven(x + 1, 200)]);
        assert!((5.8..6.0).contains(&view.typical_passes()), "{}", view.typical_passes());
    }
}
