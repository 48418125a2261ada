//! The tiles that touch an area between two parallels and two meridians.

use std::collections::BTreeMap;
use std::ops::RangeInclusive;

use echofix_core::geo::{self, Grid, LatLon, TILE_M, TileId, Zone};
use echofix_core::point::MapPoint;
use echofix_proto::v1::GeodeticBox;
use tonic::Status;

use super::super::invalid_field::{InvalidField, require};
use super::{MAX_AREA, status};
use crate::store::{MapStore, TileInfo};

/// A zone's map reaches at most this far from its central meridian, degrees (32V does).
const REACH_DEG: f64 = 9.0;
/// Points along a side, to catch how a parallel bends on the grid.
const SIDE: u32 = 8;

pub(super) fn tiles(store: &dyn MapStore, area: &GeodeticBox) -> Result<Vec<TileInfo>, Status> {
    let boxes = checked(area).map_err(|violation| status::invalid(&violation))?;
    let mut all: Vec<TileInfo> = Vec::new();
    for zone in store.zones() {
        // Parts that meet have tiles in common.
        let mut found = BTreeMap::new();
        for part in boxes.iter().flat_map(|part| clip(part, zone)) {
            // The box is checked: a projection that fails has nothing stored there.
            let Ok((grid, x, y)) = block(zone, &part) else { continue };
            let infos = store.catalog(zone, x, y).map_err(|error| status::store(&error))?;
            let touching = infos.into_iter().filter(|info| touches(&grid, info.id, &part));
            found.extend(touching.map(|info| (info.id, info)));
            if all.len() + found.len() > MAX_AREA {
                let rule = format!("touches more than {MAX_AREA} tiles; ask for a smaller area");
                return Err(status::invalid(&InvalidField::new("area", rule)));
            }
        }
        all.extend(found.into_values());
    }
    Ok(all)
}

/// Sound limits; two boxes when the area crosses the date line.
fn checked(area: &GeodeticBox) -> Result<Vec<GeodeticBox>, InvalidField> {
    let GeodeticBox { south_deg, west_deg, north_deg, east_deg } = *area;
    for (name, degrees, most) in [
        ("south_deg", south_deg, 90.0),
        ("north_deg", north_deg, 90.0),
        ("west_deg", west_deg, 180.0),
        ("east_deg", east_deg, 180.0),
    ] {
        require(
            degrees.abs() <= most,
            &format!("area.{name}"),
            &format!("must lie within -{most} and {most}"),
        )?;
    }
    require(south_deg <= north_deg, "area.north_deg", "lies south of `south_deg`")?;
    if west_deg <= east_deg {
        return Ok(vec![*area]);
    }
    Ok(vec![GeodeticBox { east_deg: 180.0, ..*area }, GeodeticBox { west_deg: -180.0, ..*area }])
}

/// The parts of a box that a zone can hold: two where the box comes to it from either side.
fn clip(area: &GeodeticBox, zone: Zone) -> impl Iterator<Item = GeodeticBox> {
    let central = f64::from(zone.number()) * 6.0 - 183.0;
    // Zones 1 and 60 reach over the date line: their meridians count on from either side.
    let area = *area;
    let clipped = [-360.0, 0.0, 360.0].into_iter().map(move |turn| GeodeticBox {
        south_deg: area.south_deg.max(-80.5),
        north_deg: area.north_deg.min(84.5),
        west_deg: (area.west_deg + turn).max(central - REACH_DEG),
        east_deg: (area.east_deg + turn).min(central + REACH_DEG),
    });
    clipped.filter(|part| part.south_deg <= part.north_deg && part.west_deg <= part.east_deg)
}

type TileBlock = (Grid, RangeInclusive<i32>, RangeInclusive<i32>);

/// The block of tiles around a box.
fn block(zone: Zone, area: &GeodeticBox) -> Result<TileBlock, geo::Error> {
    let grid = Grid::new(zone)?;
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    let step = |from: f64, to: f64, i: u32| from + (to - from) * f64::from(i) / f64::from(SIDE);
    for (i, j) in (0..=SIDE).flat_map(|i| (0..=SIDE).map(move |j| (i, j))) {
        let lat_deg = step(area.south_deg, area.north_deg, i);
        let at = LatLon { lat_deg, lon_deg: step(area.west_deg, area.east_deg, j) };
        let point = <[f64; 2]>::from(grid.project(at)?);
        for axis in [0, 1] {
            low[axis] = low[axis].min(point[axis]);
            high[axis] = high[axis].max(point[axis]);
        }
    }
    // Between the points a large box bulges a little: one tile in a hundred is enough.
    let margin = [0, 1].map(|axis| TILE_M + 0.01 * (high[axis] - low[axis]));
    let low = TileId::of(zone, MapPoint::new(low[0] - margin[0], low[1] - margin[1]));
    let high = TileId::of(zone, MapPoint::new(high[0] + margin[0], high[1] + margin[1]));
    Ok((grid, low.x..=high.x, low.y..=high.y))
}

/// Does the tile lie in the box, even with a corner?
fn touches(grid: &Grid, id: TileId, area: &GeodeticBox) -> bool {
    let corner = id.origin();
    let corners =
        [corner, corner.moved(TILE_M, 0.0), corner.moved(0.0, TILE_M), corner.moved(TILE_M, TILE_M)];
    let Ok(corners) = corners.into_iter().map(|at| grid.unproject(at)).collect::<Result<Vec<_>, _>>() else {
        return false;
    };
    let middle_lon = f64::midpoint(area.west_deg, area.east_deg);
    // On the same turn as the box.
    let lon = |at: &LatLon| middle_lon + (at.lon_deg - middle_lon + 180.0).rem_euclid(360.0) - 180.0;
    let span = |of: &dyn Fn(&LatLon) -> f64| {
        corners.iter().map(of).fold((f64::INFINITY, f64::NEG_INFINITY), |(a, b), v| (a.min(v), b.max(v)))
    };
    let (south, north) = span(&|at| at.lat_deg);
    let (west, east) = span(&lon);
    south <= area.north_deg && north >= area.south_deg && west <= area.east_deg && east >= area.west_deg
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::http::testing::FakeStore;
    use echofix_core::geo::zones_near;
    use proptest::prelude::*;

    /// Tonga, Adak, Apia, Taveuni, Chukotka, Suva, Munich, the Norwegian exception and Svalbard.
    const PLACES: [(f64, f64); 11] = [
        (-21.14, -175.2),
        (51.88, -176.66),
        (-13.83, -171.76),
        (-16.8, 179.98),
        (-16.8, -179.98),
        (66.0, -170.0),
        (65.0, 179.9),
        (-18.14, 178.44),
        (48.14, 11.58),
        (60.4, 5.3),
        (78.2, 15.6),
    ];

    fn asked(store: &FakeStore, [west_deg, south_deg, east_deg, north_deg]: [f64; 4]) -> Vec<TileId> {
        let area = GeodeticBox { south_deg, west_deg, north_deg, east_deg };
        let mut ids: Vec<_> = tiles(store, &area).unwrap().into_iter().map(|info| info.id).collect();
        ids.sort_unstable();
        ids
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]
        /// Catches: a box of the whole globe, or one across the date line, that leaves out what zones 1 and 60 hold, and a tile
        /// that is named twice.
        #[test]
        fn a_box_around_a_place_names_its_tiles_once(
            place in 0..PLACES.len(), west in 0.001..20.0_f64, east in 0.001..20.0_f64, high in 0.001..1.0_f64,
        ) {
            let (lat_deg, lon_deg) = PLACES[place];
            let at = LatLon { lat_deg, lon_deg };
            let tile = |zone| TileId::of(zone, Grid::new(zone).unwrap().project(at).unwrap());
            let mut ids: Vec<_> = zones_near(at, 512.0).unwrap().into_iter().map(tile).collect();
            ids.sort_unstable();
            let cells: &[(u32, u32)] = &[(7, 3)];
            let store = FakeStore::with_tiles(&ids.iter().map(|id| (*id, cells)).collect::<Vec<_>>());
            let wrapped = |lon: f64| (lon + 180.0).rem_euclid(360.0) - 180.0;
            let (south, north) = (lat_deg - high, (lat_deg + high).min(90.0));
            for [w, e] in [[-180.0, 180.0], [wrapped(lon_deg - west), wrapped(lon_deg + east)]] {
                prop_assert_eq!(&asked(&store, [w, south, e, north]), &ids, "{} to {}", w, e);
            }
            let opposite = [wrapped(lon_deg + 170.0), south, wrapped(lon_deg - 170.0), north];
            prop_assert_eq!(asked(&store, opposite), []);
        }
    }
}
