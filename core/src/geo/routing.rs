//! Where a request should go.

use std::fmt;
use std::hash::Hasher;
use std::str::FromStr;

use siphasher::sip::SipHasher24;

use super::{Error, LatLon, TileId, Zone};

/// Tiles along the side of a routing region.
const TILES: i32 = 128;

/// A square of the map of 6.55 km: requests of one should go to the same replica, where their tiles are warm. No more is
/// said of a place than that.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct RoutingRegion {
    epsg: u16,
    x: i32,
    y: i32,
}

impl RoutingRegion {
    /// The region of a position.
    ///
    /// # Errors
    /// When the position lies outside of UTM's latitudes.
    pub fn of(at: LatLon) -> Result<Self, Error> {
        let tile = TileId::at(at)?;
        Ok(Self::of_tile(tile))
    }

    /// The region of a tile.
    #[must_use]
    pub fn of_tile(tile: TileId) -> Self {
        Self { epsg: tile.zone.epsg(), x: tile.x.div_euclid(TILES), y: tile.y.div_euclid(TILES) }
    }

    /// The replica, by name, that keeps this region's tiles warm: the one with the highest weight of region and name
    /// (rendezvous hashing). Whoever has the same names comes to the same one, in whatever order they stand. A name that
    /// goes moves its own regions only, to all others alike; one that comes takes regions from all others alike.
    ///
    /// Where it stands in the list; `None` of an empty one.
    pub fn best_of(self, names: impl IntoIterator<Item = impl AsRef<str>>) -> Option<usize> {
        // A fixed function of region and name: services of different versions must agree on it.
        let mut region = SipHasher24::new();
        region.write(format!("{self} ").as_bytes());
        let weight = |name: &str| {
            let mut hasher = region;
            hasher.write(name.as_bytes());
            hasher.finish()
        };
        let weighed = names.into_iter().map(|name| weight(name.as_ref())).enumerate();
        weighed.max_by_key(|(_, weight)| *weight).map(|(at, _)| at)
    }
}

impl fmt::Display for RoutingRegion {
    /// As in the header `x-echofix-region`: zone, and squares east and north.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.epsg, self.x, self.y)
    }
}

/// A text that names no region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
#[error("expected the zone's EPSG number, and squares east and north, as 32614/94/511")]
pub struct NotARegion;

impl FromStr for RoutingRegion {
    type Err = NotARegion;

    fn from_str(text: &str) -> Result<Self, NotARegion> {
        let mut parts = text.splitn(3, '/');
        let mut next = || parts.next().ok_or(NotARegion);
        let epsg = next()?.parse().map_err(|_| NotARegion)?;
        let zone = Zone::from_epsg(epsg).map_err(|_| NotARegion)?;
        let (x, y) = (next()?.parse().map_err(|_| NotARegion)?, next()?.parse().map_err(|_| NotARegion)?);
        Ok(Self { epsg: zone.epsg(), x, y })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Where Austin lies among the names of the test: a change of the weights moves every region of a running fleet.
    const GOLDEN: usize = 3;
    const AUSTIN: LatLon = LatLon { lat_deg: 30.2672, lon_deg: -97.7431 };

    /// Catches a header that tells more of a place than some kilometres, or that differs within a street.
    #[test]
    fn a_region_is_some_kilometres_wide() {
        let region = |north: f64| {
            let at = LatLon { lat_deg: AUSTIN.lat_deg + north / 111_000.0, ..AUSTIN };
            RoutingRegion::of(at).unwrap()
        };
        assert_eq!(region(0.0).to_string(), "32614/94/511");
        let mut seen: Vec<_> = (0..1000).map(|i| region(f64::from(i) * 100.0)).collect();
        seen.dedup();
        assert!((15..=17).contains(&seen.len()), "{} regions over 100 km", seen.len());
        assert!(RoutingRegion::of(LatLon { lat_deg: 89.0, lon_deg: 0.0 }).is_err());
    }

    /// Catches a hash that changes with a version, an order of names that counts, replicas that get nothing, and a replica
    /// that goes and takes others' regions along.
    #[test]
    fn a_replica_that_goes_moves_its_own_regions_only() {
        let names = ["a:1", "b:1", "c:1", "d:1"];
        let regions = (0..4000).map(|i| RoutingRegion { epsg: 32614, x: i % 60, y: i / 60 });
        let mut counts = [0; 4];
        for region in regions {
            let before = region.best_of(names).unwrap();
            counts[before] += 1;
            let turned: Vec<_> = names.iter().rev().collect();
            assert_eq!(*turned[region.best_of(&turned).unwrap()], names[before]);
            let left = [names[0], names[1], names[3]];
            let after = left[region.best_of(left).unwrap()];
            assert!(after == names[before] || before == 2, "{region} went from {} to {after}", names[before]);
        }
        assert!(counts.iter().all(|count| (900..1100).contains(count)), "{counts:?}");
        assert_eq!(RoutingRegion::of(AUSTIN).unwrap().best_of(names), Some(GOLDEN));
        assert_eq!(RoutingRegion::of(AUSTIN).unwrap().best_of([""; 0]), None);
    }

    /// Catches a header that is read as another region than it was written for, and one that is taken although it is none.
    #[test]
    fn what_is_written_is_read() {
        for text in ["32614/94/511", "32733/-3/0"] {
            assert_eq!(text.parse::<RoutingRegion>().unwrap().to_string(), text);
        }
        for text in
            ["", "32614", "32614/94", "4326/1/1", "32614/94/511/1", "32614/x/1", "32614/99999999999/1"]
        {
            assert_eq!(text.parse::<RoutingRegion>(), Err(NotARegion), "{text}");
        }
    }
}
