//! Where the town lies on the globe.

use echofix_core::geo::{Grid, LatLon, Zone};
use echofix_core::point::MapPoint;
use echofix_core::pose::Pose2;

use crate::error::Error;
use crate::plane::Point;

/// The pose of the city's own plane on the UTM grid.
///
/// The city is laid out in ground metres around its origin, x towards grid east and y towards grid
/// north, because that is what sensors and odometry measure. Map metres are ground metres times
/// the grid's point scale factor at the origin.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Site {
    origin: LatLon,
    zone: Zone,
    origin_on_map: MapPoint,
    scale: f64,
}

impl Site {
    /// Sets a city's origin.
    ///
    /// # Errors
    /// When the origin is not covered by UTM.
    pub fn new(origin: LatLon) -> Result<Self, Error> {
        let grid = Grid::of(origin)?;
        Ok(Self {
            origin,
            zone: grid.zone(),
            origin_on_map: grid.project(origin)?,
            scale: grid.scale_factor(origin)?,
        })
    }

    /// The city's origin on the globe.
    #[must_use]
    pub fn origin(&self) -> LatLon {
        self.origin
    }

    /// The UTM zone whose grid the city is aligned with.
    #[must_use]
    pub fn zone(&self) -> Zone {
        self.zone
    }

    /// Map metres per ground metre.
    #[must_use]
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// Where a position in the city, ground metres, lies on the map.
    #[must_use]
    pub fn to_map(&self, [x_m, y_m]: Point) -> MapPoint {
        self.origin_on_map.moved(self.scale * x_m, self.scale * y_m)
    }

    /// The position in the city, ground metres, of a point on the map.
    #[must_use]
    pub fn from_map(&self, point: MapPoint) -> Point {
        let origin = self.origin_on_map;
        [(point.x_m - origin.x_m) / self.scale, (point.y_m - origin.y_m) / self.scale]
    }

    /// A city pose on the UTM plane: map metres, yaw counter-clockwise from grid east.
    #[must_use]
    pub fn pose_to_map(&self, pose: &Pose2) -> Pose2 {
        let MapPoint { x_m, y_m } = self.to_map([pose.x_m, pose.y_m]);
        Pose2::new(x_m, y_m, pose.yaw_rad)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const AUSTIN: LatLon = LatLon { lat_deg: 30.2672, lon_deg: -97.7431 };

    #[test]
    fn ground_metres_are_metres_on_the_globe() {
        let site = Site::new(AUSTIN).unwrap();
        let grid = Grid::new(site.zone()).unwrap();
        let south = grid.unproject(site.to_map([0.0, -500.0])).unwrap();
        let north = grid.unproject(site.to_map([0.0, 500.0])).unwrap();
        // WGS-84's radius of curvature along the meridian; the grid is turned by the convergence.
        let (a_m, e2): (f64, f64) = (6_378_137.0, 0.006_694_379_990_14);
        let sin2 = AUSTIN.lat_deg.to_radians().sin().powi(2);
        let meridian_m = a_m * (1.0 - e2) / (1.0 - e2 * sin2).powf(1.5);
        let turn = grid.convergence_rad(AUSTIN).unwrap();
        let expected_deg = (1000.0 * turn.cos() / meridian_m).to_degrees();
        assert!((north.lat_deg - south.lat_deg - expected_deg).abs() < 1e-8);
    }

    proptest! {
        #[test]
        fn to_the_map_and_back(x in -500.0..500.0_f64, y in -500.0..500.0_f64) {
            let site = Site::new(AUSTIN).unwrap();
            let back = site.from_map(site.to_map([x, y]));
            prop_assert!((back[0] - x).abs() < 1e-6 && (back[1] - y).abs() < 1e-6);
        }
    }
}
