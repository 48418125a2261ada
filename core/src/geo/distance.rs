//! Distances on the ground between near positions.

use super::LatLon;

/// Metres on the ground that a degree spans.
///
/// Every distance names the one it counts with: where drives are split was tuned with either, and a
/// drive that is split elsewhere gives other uploads.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MetresPerDegree {
    /// Of latitude.
    pub north: f64,
    /// Of longitude, on the equator.
    pub east: f64,
}

impl MetresPerDegree {
    /// A mean degree of latitude on WGS-84 and the equator's degree of longitude: distances are right to
    /// 0.51 % northwards and 0.34 % eastwards, the more accurate of the two.
    pub const WGS84: Self = Self { north: 111_132.0, east: 111_320.0 };
    /// The sphere of the Earth's mean radius: distances are right to 0.57 %.
    pub const SPHERE: Self = Self { north: 111_195.0, east: 111_195.0 };
}

/// Metres on the ground between two positions some kilometres apart at most, also across the date line.
/// The longitudes count at the latitude of `a`.
#[must_use]
pub fn ground_distance_m(a: LatLon, b: LatLon, per_degree: MetresPerDegree) -> f64 {
    let north_m = (b.lat_deg - a.lat_deg) * per_degree.north;
    let east_deg = (b.lon_deg - a.lon_deg + 540.0).rem_euclid(360.0) - 180.0;
    north_m.hypot(east_deg * per_degree.east * a.lat_deg.to_radians().cos())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geo::Grid;

    #[test]
    fn distances_are_as_accurate_as_they_say() {
        for lat_deg in [0.0, 30.0, 51.0, 70.0] {
            let a = LatLon { lat_deg, lon_deg: 9.0 };
            let grid = Grid::of(a).unwrap();
            for (north, east) in [(0.01, 0.0), (0.0, 0.01), (0.005, -0.008)] {
                let b = LatLon { lat_deg: lat_deg + north, lon_deg: a.lon_deg + east };
                let (from, to) = (grid.project(a).unwrap(), grid.project(b).unwrap());
                let expected = to.distance_m(from) / grid.scale_factor(a).unwrap();
                for (per_degree, accuracy) in
                    [(MetresPerDegree::WGS84, 5.1e-3), (MetresPerDegree::SPHERE, 5.7e-3)]
                {
                    let error = (ground_distance_m(a, b, per_degree) / expected - 1.0).abs();
                    assert!(error < accuracy, "{lat_deg} {north} {east}: {error}");
                }
            }
        }
    }

    #[test]
    fn the_date_line_is_no_distance() {
        let at = |lon_deg| LatLon { lat_deg: 0.0, lon_deg };
        let across = ground_distance_m(at(179.999), at(-179.999), MetresPerDegree::WGS84);
        assert!((across - 222.64).abs() < 0.01, "{across}");
    }
}
