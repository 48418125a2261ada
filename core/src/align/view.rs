//! The weights around a prior, assembled from prepared tiles into one image.
//!
//! Assembling is copying rows: what a tile needs was computed once for its version.

use std::sync::Arc;

use super::packed::{CELLS, SQUARE};
use super::weights::{COARSE, KNOWN, TileWeights, mean};
use crate::datum::{MapVariance, mean_offset};
use crate::geo::TileId;
use crate::point::MapPoint;
use crate::pose::Pose2;
use crate::window::MapSquare;

/// Bytes beyond the last row, so that a strip that starts in the image can be read whole.
const PADDING: usize = 64;

/// One of a view's images.
#[derive(Clone, Copy)]
pub struct ImageView<'a> {
    /// Where it lies.
    pub square: MapSquare,
    /// Map cells along a pixel's side.
    pub cells: usize,
    /// Pixels along a side.
    pub side: usize,
    /// Row-major, and some zeros beyond the last row.
    pub weights: &'a [u8],
}

/// A square and the tiles in it: what was computed from them need not be computed again.
#[derive(Clone)]
pub struct WindowTiles {
    /// Where it lies.
    pub square: MapSquare,
    /// The tiles that exist in it.
    pub tiles: Vec<Arc<TileWeights>>,
}

impl WindowTiles {
    /// Overwrites the last record with this square and these tiles.
    pub fn record(slot: &mut Option<Self>, square: MapSquare, tiles: &[Arc<TileWeights>]) {
        let window = slot.get_or_insert_with(|| Self { square, tiles: Vec::new() });
        window.square = square;
        window.tiles.clear();
        window.tiles.extend_from_slice(tiles);
    }

    /// True when these are the same tiles of the same square.
    #[must_use]
    pub fn same_tiles(&self, square: MapSquare, tiles: &[Arc<TileWeights>]) -> bool {
        let same = |(a, b): (&Arc<_>, &Arc<_>)| Arc::ptr_eq(a, b);
        self.square == square && self.tiles.len() == tiles.len() && self.tiles.iter().zip(tiles).all(same)
    }
}

/// The map window as images of weights; reused from request to request.
#[derive(Default)]
pub struct MapView {
    window: Option<WindowTiles>,
    fine: Vec<u8>,
    coarse: Vec<u8>,
    known: Vec<u8>,
}

impl MapView {
    /// Copies the tiles of a square into its images; where no tile is given the map is empty.
    pub fn assemble(&mut self, square: MapSquare, tiles: &[Arc<TileWeights>]) {
        if self.window.as_ref().is_some_and(|window| window.same_tiles(square, tiles)) {
            return;
        }
        WindowTiles::record(&mut self.window, square, tiles);
        let (coarse_side, known_side) = (square.side / COARSE, square.side / KNOWN);
        reset(&mut self.fine, square.side * square.side + PADDING);
        reset(&mut self.coarse, coarse_side * coarse_side + PADDING);
        reset(&mut self.known, known_side * known_side);
        for tile in tiles {
            let first = tile.id.first_cell();
            let at = [first.x - square.origin.x, first.y - square.origin.y];
            let squares = at.map(|cells| cells.div_euclid(SQUARE as i64));
            tile.weights().each(|x, y, weights| {
                self.unpack([squares[0] + x as i64, squares[1] + y as i64], weights);
            });
            self.mark_known(tile, at.map(|cells| cells.div_euclid(KNOWN as i64)));
        }
    }

    /// Puts a square of weights in its place, given in squares: into the image, and their mean into the coarse one.
    fn unpack(&mut self, at: [i64; 2], weights: &[u8; CELLS]) {
        let side = self.square().side;
        let [Some(x), Some(y)] = at.map(|at| inside(at, side / SQUARE)) else { return };
        for (row, from) in weights.chunks_exact(SQUARE).enumerate() {
            self.fine[(y * SQUARE + row) * side + x * SQUARE..][..SQUARE].copy_from_slice(from);
        }
        self.coarse[y * (side / COARSE) + x] = mean(weights.iter().copied());
    }

    /// Marks where the map has been; the tile's place is given in squares.
    fn mark_known(&mut self, tile: &TileWeights, [x0, y0]: [i64; 2]) {
        let side = self.square().side / KNOWN;
        for (y, squares) in (y0..).zip(tile.known()) {
            let (Some(y), mut left) = (inside(y, side), *squares) else { continue };
            while left != 0 {
                if let Some(x) = inside(x0 + i64::from(left.trailing_zeros()), side) {
                    self.known[y * side + x] = 1;
                }
                left &= left - 1;
            }
        }
    }

    /// The square and the tiles that were assembled.
    ///
    /// # Panics
    /// Before the first [`MapView::assemble`].
    #[must_use]
    pub fn window(&self) -> &WindowTiles {
        self.window.as_ref().expect("a view is assembled before it is read")
    }

    /// Where it lies.
    #[must_use]
    pub fn square(&self) -> MapSquare {
        self.window().square
    }

    /// Weights of cells.
    #[must_use]
    pub fn fine(&self) -> ImageView<'_> {
        let square = self.square();
        ImageView { square, cells: 1, side: square.side, weights: &self.fine }
    }

    /// Mean weights of [`COARSE`] x [`COARSE`] cells.
    #[must_use]
    pub fn coarse(&self) -> ImageView<'_> {
        let square = self.square();
        ImageView { square, cells: COARSE, side: square.side / COARSE, weights: &self.coarse }
    }

    /// For each square of [`KNOWN`] x [`KNOWN`] cells 1 where the map has been.
    #[must_use]
    pub fn known(&self) -> ImageView<'_> {
        let square = self.square();
        ImageView { square, cells: KNOWN, side: square.side / KNOWN, weights: &self.known }
    }

    /// The tile at a position, if the map has it.
    #[must_use]
    pub fn tile_at(&self, position: MapPoint) -> Option<&TileWeights> {
        let id = TileId::of(self.square().zone, position);
        self.window().tiles.iter().find(|tile| tile.id == id).map(|tile| &**tile)
    }

    /// The map's own offset at a position, by the tiles' data: metres east and north, radians.
    #[must_use]
    pub fn mean_offset(&self, position: MapPoint) -> Pose2 {
        let tiles = &self.window().tiles;
        mean_offset(self.square().zone, position, |id| {
            tiles.iter().find(|tile| tile.id == id).map(|tile| tile.datum).unwrap_or_default()
        })
    }

    /// How far the map may err as a whole under some positions: the mean over the tiles that they lie in, by what each tile's
    /// passes declared and how they scatter ([`crate::datum::Datum::variance`]). The errors of one pass are alike from
    /// tile to tile, so that many tiles do not average them out. A tile that knows of no passes counts as those over its
    /// cells, each of `pose_m` (metres).
    #[must_use]
    pub fn map_error(&self, positions: impl Iterator<Item = MapPoint>, pose_m: f64) -> MapVariance {
        let (zone, tiles) = (self.square().zone, &self.window().tiles);
        let variance = |tile: &TileWeights| {
            let position_m2 = pose_m * pose_m / tile.passes;
            tile.datum.variance().unwrap_or(MapVariance { position_m2, yaw_rad2: 0.0 })
        };
        let at = |position| tiles.iter().find(|tile| tile.id == TileId::of(zone, position));
        let under = MapVariance::mean(positions.filter_map(at).map(|tile| variance(tile)));
        // Nothing lies on the map: such an answer is not used, and gets what the window as a whole has.
        under
            .or_else(|| MapVariance::mean(tiles.iter().map(|tile| variance(tile))))
            .unwrap_or(MapVariance { position_m2: pose_m * pose_m, yaw_rad2: 0.0 })
    }
}

fn reset(image: &mut Vec<u8>, len: usize) {
    image.clear();
    image.resize(len, 0);
}

/// An index, if it is one of so many.
fn inside(at: i64, count: usize) -> Option<usize> {
    usize::try_from(at).ok().filter(|at| *at < count)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::align::packed::tests::unpacked;
    use crate::evidence::Cell;
    use crate::evidence::presence::ALWAYS;
    use crate::geo::{CELL_M, TILE_M, Zone};
    use crate::tile::Tile;

    #[test]
    fn every_cell_has_its_tiles_weight() {
        let zone = Zone::from_epsg(32614).unwrap();
        let position = MapPoint::new(600_010.0, 3_300_020.0);
        let id = TileId::of(zone, position);
        let cell = |i| Cell { hits: 1 + i % 7, passes: 2, presence: ALWAYS, ..Cell::default() };
        let cells = (0..2000).map(|i| (i * 131, cell(i)));
        let tile = Tile::from_cells(cells.collect()).unwrap();
        let weights = Arc::new(TileWeights::new(id, |at| (at == id).then_some(&tile)));
        let square = MapSquare::around(zone, position, 50.0, 6.0);
        let mut view = MapView::default();
        view.assemble(square, std::slice::from_ref(&weights));
        let first = id.first_cell();
        for (index, value) in unpacked(weights.weights()).iter().enumerate() {
            let (x, y) = (
                first.x + index as i64 % 512 - square.origin.x,
                first.y + index as i64 / 512 - square.origin.y,
            );
            let side = square.side as i64;
            if (0..side).contains(&x) && (0..side).contains(&y) {
                assert_eq!(view.fine().weights[(y * side + x) as usize], *value);
            }
        }
        let total: u64 = view.fine().weights.iter().map(|v| u64::from(*v)).sum();
        assert!(
            total > 0 && (view.map_error([position].into_iter(), 0.08).position_m2 - 0.0032).abs() < 1e-9
        );
        assert!(
            view.tile_at(square.corner().moved(-CELL_M, 0.0)).is_none() && view.tile_at(position).is_some()
        );
    }

    /// Catches: means of other cells than a pixel's, or of some of them.
    #[test]
    fn a_coarse_pixel_is_the_mean_of_its_cells() {
        let zone = Zone::from_epsg(32614).unwrap();
        let position = MapPoint::new(600_010.0, 3_300_020.0);
        let id = TileId::of(zone, position);
        let cell = |i| Cell { hits: 1 + i % 7, passes: 2, presence: ALWAYS, ..Cell::default() };
        let tile = Tile::from_cells((0..2000).map(|i| (i * 131, cell(i))).collect()).unwrap();
        let mut view = MapView::default();
        let weights = Arc::new(TileWeights::packed(id, |at| (at == id).then_some(&tile)));
        view.assemble(MapSquare::around(zone, position, 50.0, 6.0), &[weights]);
        let (fine, coarse) = (view.fine(), view.coarse());
        for (i, mean) in coarse.weights[..coarse.side * coarse.side].iter().enumerate() {
            let at = [i % coarse.side, i / coarse.side].map(|along| along * COARSE);
            let rows = (at[1]..at[1] + COARSE).map(|y| &fine.weights[y * fine.side + at[0]..][..COARSE]);
            let sum: u32 = rows.flatten().copied().map(u32::from).sum();
            assert_eq!(u32::from(*mean), sum.div_ceil((COARSE * COARSE) as u32), "{at:?}");
        }
        assert!(coarse.weights.iter().any(|weight| *weight > 5));
    }

    /// Catches: a map's error computed from the avenue where the batch is aligned by the lane's fronts.
    #[test]
    fn a_busy_street_does_not_count_for_the_lane_beside_it() {
        let zone = Zone::from_epsg(32614).unwrap();
        let position = MapPoint::new(600_010.0, 3_300_020.0);
        let driven = |x, passes| {
            let id = TileId { x, ..TileId::of(zone, position) };
            let cell = Cell { hits: 2 * passes, passes, presence: ALWAYS, ..Cell::default() };
            let tile = Tile::from_cells((0..2000).map(|i| (i * 131, cell)).collect()).unwrap();
            Arc::new(TileWeights::new(id, |at| (at == id).then_some(&tile)))
        };
        let x = TileId::of(zone, position).x;
        let mut view = MapView::default();
        view.assemble(MapSquare::around(zone, position, 50.0, 6.0), &[driven(x, 3), driven(x + 1, 200)]);
        let sigma = |at: &[MapPoint]| view.map_error(at.iter().copied(), 0.08).position_m2.sqrt();
        let (lane, avenue) = (position, position.moved(TILE_M, 0.0));
        assert!((sigma(&[lane]) - 0.08 / 3_f64.sqrt()).abs() < 1e-6);
        assert!((sigma(&[avenue]) - 0.08 / 200_f64.sqrt()).abs() < 1e-6);
        assert!(sigma(&[lane, lane, avenue]) > 0.8 * sigma(&[lane]));
    }
}
