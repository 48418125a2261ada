//! UTM zones.

use super::{Error, LatLon};

/// A WGS-84 UTM zone of one hemisphere, an EPSG code operators know.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Zone {
    number: u8,
    south: bool,
}

impl Zone {
    /// The zone a position belongs to, with the exceptions of Norway and Svalbard.
    ///
    /// # Errors
    /// When the position is not on the globe or outside UTM's latitudes.
    pub fn of(at: LatLon) -> Result<Self, Error> {
        let LatLon { lat_deg, lon_deg } = at;
        if !(lat_deg.abs() <= 90.0 && lon_deg.abs() <= 180.0) {
            return Err(Error::NotAPosition { lat_deg, lon_deg });
        }
        if !(-80.0..=84.0).contains(&lat_deg) {
            return Err(Error::OutsideUtm { lat_deg });
        }
        let regular = ((lon_deg + 180.0) / 6.0).floor() as u8 % 60 + 1;
        let number = match (lat_deg, lon_deg) {
            (56.0..64.0, 3.0..12.0) => 32,
            (72.0..=84.0, 0.0..9.0) => 31,
            (72.0..=84.0, 9.0..21.0) => 33,
            (72.0..=84.0, 21.0..33.0) => 35,
            (72.0..=84.0, 33.0..42.0) => 37,
            _ => regular,
        };
        Ok(Self { number, south: lat_deg < 0.0 })
    }

    /// The zone of an EPSG code (32601-32660 north, 32701-32760 south).
    ///
    /// # Errors
    /// When the code is another one.
    pub fn from_epsg(epsg: u32) -> Result<Self, Error> {
        match epsg {
            32601..=32660 => Ok(Self { number: (epsg - 32600) as u8, south: false }),
            32701..=32760 => Ok(Self { number: (epsg - 32700) as u8, south: true }),
            _ => Err(Error::NotUtm { epsg }),
        }
    }

    /// The EPSG code.
    #[must_use]
    pub fn epsg(self) -> u16 {
        if self.south { 32700 + u16::from(self.number) } else { 32600 + u16::from(self.number) }
    }

    /// 1 to 60.
    #[must_use]
    pub fn number(self) -> u8 {
        self.number
    }

    /// True on the southern hemisphere (false northing of 10 000 km).
    #[must_use]
    pub fn is_south(self) -> bool {
        self.south
    }
}

/// The zones whose map holds a position: its own first, then each zone whose area comes within
/// `margin_m`. Two at a border, up to four where borders cross.
///
/// # Errors
/// When the position itself is outside UTM.
pub fn zones_near(at: LatLon, margin_m: f64) -> Result<Vec<Zone>, Error> {
    // A degree of latitude is 111 km, one of longitude shrinks with the cosine.
    let dlat = margin_m / 110_574.0;
    let dlon = margin_m / (111_320.0 * at.lat_deg.to_radians().cos()).max(1.0);
    let mut zones = vec![Zone::of(at)?];
    for north in [-1.0, 0.0, 1.0] {
        for east in [-1.0, 0.0, 1.0] {
            let near = LatLon::wrapped(at.lat_deg + north * dlat, at.lon_deg + east * dlon);
            if let Ok(zone) = Zone::of(near)
                && !zones.contains(&zone)
            {
                zones.push(zone);
            }
        }
    }
    Ok(zones)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn zone(lat_deg: f64, lon_deg: f64) -> u16 {
        Zone::of(LatLon { lat_deg, lon_deg }).unwrap().epsg()
    }

    #[test]
    fn zones_follow_the_standard_and_its_exceptions() {
        assert_eq!(zone(30.27, -97.74), 32614, "Austin");
        assert_eq!(zone(-33.87, 151.21), 32756, "Sydney");
        assert_eq!(zone(60.39, 5.32), 32632, "Bergen belongs to 32V");
        assert_eq!(zone(78.22, 15.65), 32633, "Longyearbyen");
        assert_eq!(zone(0.0, 180.0), 32601, "the date line belongs to zone 1");
        assert_eq!(zone(0.0, -180.0), 32601);
    }

    #[test]
    fn borders_belong_to_both_sides_within_the_margin() {
        let epsgs = |lat_deg, lon_deg, margin_m| -> Vec<u16> {
            let at = LatLon { lat_deg, lon_deg };
            zones_near(at, margin_m).unwrap().into_iter().map(Zone::epsg).collect()
        };
        assert_eq!(epsgs(51.0, 6.001, 500.0), [32632, 32631]);
        assert_eq!(epsgs(51.0, 5.999, 500.0), [32631, 32632]);
        assert_eq!(epsgs(51.0, 6.1, 500.0), [32632]);
        assert_eq!(epsgs(0.001, 100.0, 500.0), [32647, 32747]);
        assert_eq!(epsgs(10.0, 179.999, 500.0), [32660, 32601]);
        let mut corner = epsgs(0.001, 102.001, 500.0);
        corner.sort_unstable();
        assert_eq!(corner, [32647, 32648, 32747, 32748]);
    }

    #[test]
    fn nonsense_is_refused() {
        let at = |lat_deg, lon_deg| Zone::of(LatLon { lat_deg, lon_deg });
        assert!(matches!(at(f64::NAN, 0.0), Err(Error::NotAPosition { .. })));
        assert!(matches!(at(0.0, 181.0), Err(Error::NotAPosition { .. })));
        assert!(matches!(at(85.0, 0.0), Err(Error::OutsideUtm { .. })));
        assert!(matches!(Zone::from_epsg(4326), Err(Error::NotUtm { epsg: 4326 })));
        assert_eq!(Zone::from_epsg(32733).unwrap().epsg(), 32733);
    }
}
