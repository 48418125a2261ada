//! Which tiles a vehicle wants.

use std::collections::{BTreeMap, BTreeSet};
use std::ops::RangeInclusive;

use echofix_core::geo::{self, Grid, LatLon, MetresPerDegree, TILE_M, TileId, ground_distance_m, zones_near};
use echofix_proto::v1::get_tiles_request::Selection;
use echofix_proto::v1::{self, GeodeticBox, GetTilesRequest, TileForm, TileList, TileVersion};

use super::name::Form;

/// Tiles that the service takes by id in one request.
const MAX_IDS: usize = 1_024;
/// Versions that the service takes in one request. An area with more tiles is refused anyway.
const MAX_HAVE: usize = 16_384;
/// Tiles this much beyond an area may still touch it, degrees of latitude.
const BESIDE_DEG: f64 = 0.001;

/// Which tiles are wanted.
#[derive(Debug, Clone, PartialEq)]
pub enum Want {
    /// All that touch an area. The service refuses areas with more than 4096 of them.
    Area(GeodeticBox),
    /// These, as far as there are any; as many as one likes.
    Tiles(BTreeSet<TileId>),
}

impl Want {
    /// All tiles within some metres of a route, which goes straight from point to point. Near a zone's border
    /// these are tiles of both zones.
    ///
    /// # Errors
    /// When a point is not on the map.
    pub fn along(route: &[LatLon], margin_m: f64) -> Result<Self, geo::Error> {
        let mut tiles = BTreeSet::new();
        let mut take = |at: LatLon| {
            for zone in zones_near(at, margin_m)? {
                tiles.extend(TileId::covering(zone, Grid::new(zone)?.project(at)?, margin_m));
            }
            Ok(())
        };
        if let Some(first) = route.first() {
            take(*first)?;
        }
        for leg in route.windows(2) {
            let (from, to) = (leg[0], leg[1]);
            let north_deg = to.lat_deg - from.lat_deg;
            let east_deg = (to.lon_deg - from.lon_deg + 540.0).rem_euclid(360.0) - 180.0;
            let length_m = ground_distance_m(from, to, MetresPerDegree::WGS84);
            let steps = (length_m / (TILE_M / 2.0)).ceil().max(1.0);
            for step in 1..=steps as u32 {
                let fraction = f64::from(step) / steps;
                take(LatLon::wrapped(
                    from.lat_deg + north_deg * fraction,
                    from.lon_deg + east_deg * fraction,
                ))?;
            }
        }
        Ok(Self::Tiles(tiles))
    }

    /// What to ask the service, given the versions that are there.
    pub(super) fn requests(&self, form: Form, have: &BTreeMap<TileId, u64>) -> Vec<GetTilesRequest> {
        let form = match form {
            Form::Tile => TileForm::Whole,
            Form::Layer => TileForm::Layer,
        } as i32;
        match self {
            Self::Area(area) => {
                let beside = Beside::new(area);
                let have = have.iter().filter(|(id, _)| beside.holds(**id));
                let have = have.take(MAX_HAVE).map(|(id, version)| version_message(*id, *version)).collect();
                vec![GetTilesRequest { selection: Some(Selection::Area(*area)), have, form }]
            }
            Self::Tiles(ids) => {
                let ids: Vec<TileId> = ids.iter().copied().collect();
                let request = |ids: &[TileId]| {
                    let held = ids.iter().filter_map(|id| Some(version_message(*id, *have.get(id)?)));
                    let list = TileList { ids: ids.iter().map(|id| message(*id)).collect() };
                    GetTilesRequest { selection: Some(Selection::Tiles(list)), have: held.collect(), form }
                };
                ids.chunks(MAX_IDS).map(request).collect()
            }
        }
    }
}

/// An area and what is near it.
struct Beside {
    /// Degrees.
    latitudes: RangeInclusive<f64>,
    west_deg: f64,
    /// Eastwards from there.
    width_deg: f64,
}

impl Beside {
    fn new(area: &GeodeticBox) -> Self {
        let (south_deg, north_deg) = (area.south_deg - BESIDE_DEG, area.north_deg + BESIDE_DEG);
        let widest = south_deg.abs().max(north_deg.abs()).min(89.0);
        let beside_deg = BESIDE_DEG / widest.to_radians().cos();
        let across = if area.west_deg <= area.east_deg { 0.0 } else { 360.0 };
        let width_deg = area.east_deg + across - area.west_deg + 2.0 * beside_deg;
        Self { latitudes: south_deg..=north_deg, west_deg: area.west_deg - beside_deg, width_deg }
    }

    fn holds(&self, id: TileId) -> bool {
        let middle = Grid::new(id.zone).and_then(|grid| grid.unproject(id.centre()));
        middle.is_ok_and(|at| {
            self.latitudes.contains(&at.lat_deg)
                && (at.lon_deg - self.west_deg).rem_euclid(360.0) <= self.width_deg
        })
    }
}

fn version_message(id: TileId, version: u64) -> TileVersion {
    TileVersion { tile: Some(message(id)), version }
}

fn message(id: TileId) -> v1::TileId {
    v1::TileId { epsg: u32::from(id.zone.epsg()), x: id.x, y: id.y }
}

#[cfg(test)]
mod tests {
    use super::*;

    const HERE: LatLon = LatLon { lat_deg: 30.0, lon_deg: -97.0 };

    fn tile_at(at: LatLon) -> TileId {
        let grid = Grid::of(at).unwrap();
        TileId::of(grid.zone(), grid.project(at).unwrap())
    }

    /// Breaks when a route's tiles have holes between its points, or lack its sides.
    #[test]
    fn a_route_wants_every_tile_beside_it() {
        let there = LatLon { lat_deg: 30.02, lon_deg: -96.98 };
        let Want::Tiles(tiles) = Want::along(&[HERE, there], 60.0).unwrap() else { panic!("tiles") };
        for step in 0..=1000 {
            let fraction = f64::from(step) / 1000.0;
            for beside in [-5e-4, 0.0, 5e-4] {
                let at =
                    LatLon { lat_deg: 30.0 + 0.02 * fraction + beside, lon_deg: -97.0 + 0.02 * fraction };
                assert!(tiles.contains(&tile_at(at)), "{at:?}");
            }
        }
        assert!(tiles.len() < 500, "{}", tiles.len());
        assert_eq!(Want::along(&[], 60.0).unwrap(), Want::Tiles(BTreeSet::new()));
        assert!(Want::along(&[LatLon { lat_deg: 89.0, ..HERE }], 60.0).is_err());
        // A zone's border.
        let Want::Tiles(tiles) = Want::along(&[LatLon { lon_deg: -96.0, ..HERE }], 60.0).unwrap() else {
            panic!("tiles")
        };
        assert_eq!(tiles.iter().map(|id| id.zone.number()).collect::<BTreeSet<_>>(), [14, 15].into());
    }

    /// Breaks when the request names tiles that nobody asked about, does not name those at the area's edge, or
    /// asked for more ids than it takes.
    #[test]
    fn requests_say_what_is_there_of_what_is_wanted() {
        let far = LatLon { lat_deg: 31.0, ..HERE };
        let have: BTreeMap<TileId, u64> = [(tile_at(HERE), 4), (tile_at(far), 5)].into();
        let edges = |south_deg: f64, west_deg: f64| GeodeticBox {
            south_deg,
            west_deg,
            north_deg: south_deg + 0.1,
            east_deg: west_deg + 0.1,
        };
        for area in [edges(29.9, -97.1), edges(29.9, -97.0), edges(30.0, -97.1), edges(30.0001, -96.9999)] {
            let requests = Want::Area(area).requests(Form::Tile, &have);
            assert_eq!(requests.len(), 1);
            assert_eq!(requests[0].have, [version_message(tile_at(HERE), 4)], "{area:?}");
        }
        let across = GeodeticBox { south_deg: 29.0, north_deg: 32.0, west_deg: 170.0, east_deg: -96.0 };
        assert_eq!(Want::Area(across).requests(Form::Tile, &have)[0].have.len(), 2);

        let id = tile_at(HERE);
        let many: BTreeSet<TileId> = (0..2500).map(|x| TileId { x: id.x + x, ..id }).collect();
        let requests = Want::Tiles(many).requests(Form::Tile, &have);
        let held: Vec<usize> = requests.iter().map(|request| request.have.len()).collect();
        assert_eq!(held, [1, 0, 0]);
    }
}
