//! Where a request should go.

use std::fmt;

use super::{Error, LatLon, TileId};

/// Tiles along the side of a routing region.
const TILES: i32 = 128;

/// A square of the map of 6.55 km: requests of one should go to the same replica, where their tiles are warm. No more is
/// said of a place than that.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
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
        Ok(Self { epsg: tile.zone.epsg(), x: tile.x.div_euclid(TILES), y: tile.y.div_euclid(TILES) })
    }
}

impl fmt::Display for RoutingRegion {
    /// As in the header `x-echofix-region`: zone, and squares east and north.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}/{}/{}", self.epsg, self.x, self.y)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

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
}
