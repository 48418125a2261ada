//! Where the roads and the vehicles are: a made-up continent, by a seed.
//!
//! Assumed, not measured: cities whose sizes fall with their rank, each a bell around its middle, over an even countryside.

use std::collections::HashSet;

use echofix_core::geo::{LatLon, RoutingRegion};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// South, north, west and east of a continent, degrees.
pub(super) const CONTINENT: [f64; 4] = [37.0, 59.0, -9.0, 29.0];
/// Kilometres along the side of a routing region.
const SIDE_KM: f64 = 6.5536;
const CITIES: usize = 300;
/// Of the roads, and of the vehicles, this share lies in cities.
const ROADS_IN_CITIES: f64 = 0.3;
const VEHICLES_IN_CITIES: f64 = 0.65;

/// One routing region.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Region {
    pub id: RoutingRegion,
    /// Hours that its clocks are ahead of UTC, by the sun.
    pub hours_east: f64,
    /// Of all roads.
    pub road_share: f64,
    /// Of all vehicles, at a time of the day that is the same everywhere.
    pub vehicle_share: f64,
    /// Does it lie within the largest city?
    pub in_largest_city: bool,
}

/// The regions of a land between degrees, in the order of their ids.
pub(super) fn regions(seed: u64, land: [f64; 4]) -> Vec<Region> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let [south, north, west, east] = land;
    let cities: Vec<_> = (1..=CITIES)
        .map(|rank| {
            let at = LatLon {
                lat_deg: rng.random_range(south + 1.0..north - 1.0),
                lon_deg: rng.random_range(west + 1.0..east - 1.0),
            };
            let people = 1.0 / rank as f64;
            (at, people, 16.0 * people.powf(0.4))
        })
        .collect();
    let mut regions = lattice(land);
    let mut in_cities = vec![0.0; regions.len()];
    for (rank, (at, people, radius_km)) in cities.iter().enumerate() {
        for ((middle, region), density) in regions.iter_mut().zip(&mut in_cities) {
            let away_km = distance_km(*at, *middle);
            if away_km < 4.0 * radius_km {
                *density += people / radius_km.powi(2) * (-0.5 * (away_km / radius_km).powi(2)).exp();
            }
            region.in_largest_city |= rank == 0 && away_km < 1.5 * radius_km;
        }
    }
    let all: f64 = in_cities.iter().sum();
    let even = 1.0 / regions.len() as f64;
    let mut regions: Vec<_> = regions
        .into_iter()
        .zip(in_cities)
        .map(|((_, region), density)| Region {
            road_share: (1.0 - ROADS_IN_CITIES) * even + ROADS_IN_CITIES * density / all,
            vehicle_share: (1.0 - VEHICLES_IN_CITIES) * even + VEHICLES_IN_CITIES * density / all,
            ..region
        })
        .collect();
    regions.sort_by_key(|region| region.id);
    regions
}

/// The regions of a lattice of places that is as fine as they are; each once.
fn lattice([south, north, west, east]: [f64; 4]) -> Vec<(LatLon, Region)> {
    let (mut seen, mut regions) = (HashSet::new(), Vec::new());
    let rows = ((north - south) / (SIDE_KM / 111.2)) as usize;
    for row in 0..rows {
        let lat_deg = south + row as f64 * SIDE_KM / 111.2;
        let step = SIDE_KM / 111.2 / lat_deg.to_radians().cos();
        for column in 0..((east - west) / step) as usize {
            let lon_deg = west + column as f64 * step;
            let at = LatLon { lat_deg, lon_deg };
            if let Some(id) = RoutingRegion::of(at).ok().filter(|id| seen.insert(*id)) {
                let hours_east = lon_deg / 15.0;
                let empty =
                    Region { id, hours_east, road_share: 0.0, vehicle_share: 0.0, in_largest_city: false };
                regions.push((at, empty));
            }
        }
    }
    regions
}

fn distance_km(a: LatLon, b: LatLon) -> f64 {
    let north = (a.lat_deg - b.lat_deg) * 111.2;
    let east = (a.lon_deg - b.lon_deg) * 111.2 * a.lat_deg.to_radians().cos();
    north.hypot(east)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: shares that are not of one whole, and a seed that does not decide.
    #[test]
    fn shares_make_a_whole_and_a_seed_decides() {
        let land = [44.0, 49.0, 5.0, 15.0];
        let one = regions(7, land);
        assert!((8_000..14_000).contains(&one.len()), "{}", one.len());
        for share in [|r: &Region| r.road_share, |r: &Region| r.vehicle_share] {
            assert!((one.iter().map(share).sum::<f64>() - 1.0).abs() < 1e-9);
        }
        assert_eq!(one, regions(7, land));
        assert!(one != regions(8, land));
        assert!(one.iter().filter(|region| region.in_largest_city).count() > 10);
    }
}
