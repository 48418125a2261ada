//! What contributes to a view, and what the view then shows.

use std::hash::Hasher;
use std::sync::Arc;

use echofix_core::geo::{Grid, TILE_M, TileId, Zone};
use echofix_core::point::MapPoint;
use siphasher::sip::SipHasher24;

use super::plane::{Plane, TILE_SHIFT};
use super::view::PixelGrid;
use super::{Layer, Overview, Spot, View};
use crate::http::error::Error;
use crate::locating::SPOTS_PER_SIDE;
use crate::store::{MapStore, TileInfo};

/// From this zoom on a view shows tiles, below it the overview's blocks.
pub const TILES_FROM: u8 = 10;
/// From this zoom on a view shows cells (at most some 2500 tiles lie under it), below it the
/// catalog's counts.
pub const CELLS_FROM: u8 = 14;
/// Occupied cells of a tile that shine brightest.
const FULL: f64 = 12_000.0;
/// Narrowest tile whose border is drawn, pixels.
const BORDERED: f64 = 8.0;

/// log2 of the cells along the side of the square that one expectation stands for.
pub const SPOT_SHIFT: u32 = TILE_SHIFT - SPOTS_PER_SIDE.trailing_zeros();
/// Tiles around one that what is expected of its fixes rests on.
const REACH: i32 = 2;

/// All that contributes to a view.
pub enum ViewContent {
    /// The whole map from far away.
    Far(Arc<Overview>),
    /// Tiles of one zone or of several.
    Near(Vec<ZonePart>),
}

/// A zone's part of a view.
pub struct ZonePart {
    zone: Zone,
    pixel_grid: PixelGrid,
    tiles: Vec<TileInfo>,
}

/// Adds a tile's evidence to a plane.
pub type Fetch<'a> = &'a dyn Fn(&mut Plane, &TileInfo) -> Result<(), Error>;

impl ViewContent {
    /// The tiles under a near view.
    ///
    /// # Errors
    /// When the store refuses.
    pub fn near(store: &dyn MapStore, layer: Layer, view: &View) -> Result<Self, Error> {
        let mapped = store.zones();
        let mut parts = Vec::new();
        for zone in zones_of(view).into_iter().filter(|zone| mapped.contains(zone)) {
            let pixel_grid = PixelGrid::new(view, &Grid::new(zone)?)?;
            let [low, high] = pixel_grid.bounds().map(|corner| TileId::of(zone, corner));
            // What is expected of fixes rests on the tiles around, which may lie beyond the view.
            let reach = if layer == Layer::Localizability { REACH } else { 0 };
            let (x, y) = (low.x - reach..=high.x + reach, low.y - reach..=high.y + reach);
            let tiles = store.catalog(zone, x, y)?;
            parts.push(ZonePart { zone, pixel_grid, tiles });
        }
        Ok(Self::Near(parts))
    }

    /// Names what the view shows of a map of some lineage, whose newest day says what of it has faded, and for the layer of expected
    /// fixes how these are `judged`: equal tags, equal pictures. Clients keep tags for long and send them to other builds of the
    /// service: they rest on names in addresses and on numbers, not on the code's own.
    pub fn tag(&self, layer: Layer, view: &View, (lineage, newest_day): (u64, u16), judged: &str) -> String {
        let mut hash = SipHasher24::new();
        let mut text = |text: &str| {
            hash.write(&(text.len() as u64).to_le_bytes());
            hash.write(text.as_bytes());
        };
        text(env!("CARGO_PKG_VERSION"));
        text(layer.name());
        if layer == Layer::Localizability {
            text(judged);
        }
        let mut put = |numbers: &[u64]| numbers.iter().for_each(|number| hash.write(&number.to_le_bytes()));
        let View { z, x, y, side } = *view;
        put(&[z.into(), x.into(), y.into(), side as u64, lineage, newest_day.into()]);
        match self {
            Self::Far(overview) => {
                for (rectangle, version, spot) in overview.seen_in(view) {
                    let corner = [rectangle.x0 as u64, rectangle.y0 as u64];
                    put(&[corner[0], corner[1], version, spot.level.into(), spot.day.into()]);
                }
            }
            Self::Near(parts) => {
                for tile in parts.iter().flat_map(|part| &part.tiles) {
                    let TileId { zone, y, x } = tile.id;
                    put(&[zone.epsg().into(), y as u64, x as u64, tile.version]);
                }
            }
        }
        format!("\"{:016x}\"", hash.finish())
    }

    /// What the pixels show, row by row from the north-west.
    ///
    /// # Errors
    /// When the store refuses.
    pub fn spots(&self, layer: Layer, view: &View, fetch: Fetch) -> Result<Vec<Spot>, Error> {
        let mut spots = vec![Spot::NOTHING; view.side * view.side];
        match self {
            Self::Far(overview) => {
                for (at, _, spot) in overview.seen_in(view) {
                    for y in at.y0..at.y1 {
                        let row = y * view.side;
                        for here in &mut spots[row + at.x0..row + at.x1] {
                            here.raise(spot);
                        }
                    }
                }
            }
            Self::Near(parts) => {
                for part in parts.iter().filter(|part| !part.tiles.is_empty()) {
                    part.draw(layer, view, fetch, &mut spots)?;
                }
            }
        }
        Ok(spots)
    }
}

impl ZonePart {
    /// Draws the pixels that belong to the zone.
    fn draw(&self, layer: Layer, view: &View, fetch: Fetch, spots: &mut [Spot]) -> Result<(), Error> {
        let pixel_m = view.pixel_m();
        let plane = self.plane(layer, view, fetch)?;
        for (i, spot) in spots.iter_mut().enumerate() {
            let (px, py) = ((i % view.side) as f64 + 0.5, (i / view.side) as f64 + 0.5);
            let at = self.pixel_grid.at(px, py);
            let found = plane.sample(at, pixel_m);
            if found.level > 0 && Zone::of(view.at(px, py)) == Ok(self.zone) {
                *spot = if layer == Layer::Coverage { bordered(found, at, pixel_m) } else { found };
            }
        }
        Ok(())
    }

    fn plane(&self, layer: Layer, view: &View, fetch: Fetch) -> Result<Plane, Error> {
        let whole_tiles = layer == Layer::Coverage || view.z < CELLS_FROM;
        let finest = match layer {
            Layer::Coverage => TILE_SHIFT,
            Layer::Localizability => SPOT_SHIFT,
            _ => 0,
        };
        let [low, high] = self.pixel_grid.bounds();
        let [first, last] = [low, high].map(|corner| TileId::of(self.zone, corner));
        let mut plane = Plane::new(low, high, Plane::shift_for(view.pixel_m()).max(finest));
        let seen = |id: TileId| (first.x..=last.x).contains(&id.x) && (first.y..=last.y).contains(&id.y);
        for tile in self.tiles.iter().filter(|tile| seen(tile.id)) {
            if whole_tiles {
                let spot = Spot::of_count(tile.cells, FULL, tile.newest_day);
                plane.add(tile.id, TILE_SHIFT, std::iter::once((0, 0, spot)));
            } else {
                fetch(&mut plane, tile)?;
            }
        }
        Ok(plane)
    }
}

/// Lifts the pixels along a tile's border, once tiles are wide enough to tell apart.
fn bordered(spot: Spot, at: MapPoint, pixel_m: f64) -> Spot {
    let on_border = [at.x_m, at.y_m].iter().any(|m| m.rem_euclid(TILE_M) < pixel_m);
    let level = if on_border && TILE_M > BORDERED * pixel_m { 255 } else { spot.level };
    Spot { level, ..spot }
}

/// The zones the view's pixels belong to.
fn zones_of(view: &View) -> Vec<Zone> {
    // Borders run along meridians and parallels, so a zone is at least seen on a coarse grid or at
    // the rim; 4 pixels of a view that is 40 km wide are far less than a zone.
    let step = 4;
    let mut zones: Vec<Zone> = Vec::new();
    for row in (0..=view.side).step_by(step) {
        for column in (0..=view.side).step_by(step) {
            let (px, py) = (column as f64, row as f64);
            if let Ok(zone) = Zone::of(view.at(px, py))
                && !zones.contains(&zone)
            {
                zones.push(zone);
            }
        }
    }
    zones
}
