//! One UTM zone's projection.

use geodesy::authoring::Jacobian;
use geodesy::prelude::*;

use super::{Error, Zone};
use crate::point::MapPoint;
use crate::pose::{Pose2, wrap_angle};

/// A WGS-84 position in degrees.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct LatLon {
    /// Degrees north.
    pub lat_deg: f64,
    /// Degrees east, in [-180, 180].
    pub lon_deg: f64,
}

impl LatLon {
    /// A position whose longitude is brought into [-180, 180].
    #[must_use]
    pub fn wrapped(lat_deg: f64, lon_deg: f64) -> Self {
        let lon_deg =
            if lon_deg.abs() > 180.0 { (lon_deg + 180.0).rem_euclid(360.0) - 180.0 } else { lon_deg };
        Self { lat_deg, lon_deg }
    }
}

/// The plane of one UTM zone and its relation to the globe.
pub struct Grid {
    zone: Zone,
    context: Minimal,
    utm: OpHandle,
    ellipsoid: Ellipsoid,
}

impl Grid {
    /// Sets the projection of a zone up (some microseconds; hold it for a request, not for ever).
    ///
    /// # Errors
    /// When the projection library refuses, which a valid [`Zone`] gives no reason for.
    pub fn new(zone: Zone) -> Result<Self, Error> {
        let refused = |e: geodesy::Error| Error::Projection { epsg: zone.epsg(), reason: e.to_string() };
        let south = if zone.is_south() { " south" } else { "" };
        let mut context = Minimal::new();
        let utm = context.op(&format!("utm zone={}{south} ellps=WGS84", zone.number())).map_err(refused)?;
        let ellipsoid = Ellipsoid::named("WGS84").map_err(refused)?;
        Ok(Self { zone, context, utm, ellipsoid })
    }

    /// The grid a position belongs to.
    ///
    /// # Errors
    /// When the position is outside UTM.
    pub fn of(at: LatLon) -> Result<Self, Error> {
        Self::new(Zone::of(at)?)
    }

    /// The zone.
    #[must_use]
    pub fn zone(&self) -> Zone {
        self.zone
    }

    /// Where a position lies on the map, also beyond the zone's border.
    ///
    /// # Errors
    /// When the projection has no answer there.
    pub fn project(&self, at: LatLon) -> Result<MapPoint, Error> {
        let [x, y] =
            self.apply(Fwd, Coor2D::raw(self.unwound_lon(at).to_radians(), at.lat_deg.to_radians()))?;
        Ok(MapPoint::new(x, y))
    }

    /// The position of a point on the map.
    ///
    /// # Errors
    /// When the projection has no answer there.
    pub fn unproject(&self, point: MapPoint) -> Result<LatLon, Error> {
        let [lon, lat] = self.apply(Inv, Coor2D::raw(point.x_m, point.y_m))?;
        Ok(LatLon::wrapped(lat.to_degrees(), lon.to_degrees()))
    }

    /// Map metres per metre on the ground at a position (0.9996 on the central meridian).
    ///
    /// # Errors
    /// When the projection has no answer there.
    pub fn scale_factor(&self, at: LatLon) -> Result<f64, Error> {
        // Transverse Mercator is conformal: the scale is the same in every direction.
        Ok(self.jacobian(at)?.factors().meridional_scale)
    }

    /// Meridian convergence: the angle from true north to grid north, radians, positive clockwise
    /// (grid north east of true north), as tables publish it.
    ///
    /// # Errors
    /// When the projection has no answer there.
    pub fn convergence_rad(&self, at: LatLon) -> Result<f64, Error> {
        Ok(self.jacobian(at)?.factors().meridian_convergence.to_radians())
    }

    /// A pose with yaw counter-clockwise from *grid* east, from a position and a heading
    /// counter-clockwise from *true* east.
    ///
    /// # Errors
    /// When the projection has no answer there.
    pub fn pose_from_geodetic(&self, at: LatLon, true_yaw_rad: f64) -> Result<Pose2, Error> {
        let MapPoint { x_m, y_m } = self.project(at)?;
        Ok(Pose2::new(x_m, y_m, wrap_angle(true_yaw_rad + self.convergence_rad(at)?)))
    }

    /// The position and the heading counter-clockwise from true east of a pose on the grid.
    ///
    /// # Errors
    /// When the projection has no answer there.
    pub fn pose_to_geodetic(&self, pose: &Pose2) -> Result<(LatLon, f64), Error> {
        let at = self.unproject(MapPoint::of(pose))?;
        Ok((at, wrap_angle(pose.yaw_rad - self.convergence_rad(at)?)))
    }

    /// A longitude on the same turn as the zone's central meridian, so that zone 60 reaches past
    /// the date line.
    fn unwound_lon(&self, at: LatLon) -> f64 {
        let central = f64::from(self.zone.number()) * 6.0 - 183.0;
        central + (at.lon_deg - central + 180.0).rem_euclid(360.0) - 180.0
    }

    fn apply(&self, direction: Direction, coordinate: Coor2D) -> Result<[f64; 2], Error> {
        let mut data = [coordinate];
        let refused = |reason: String| Error::Projection { epsg: self.zone.epsg(), reason };
        self.context.apply(self.utm, direction, &mut data).map_err(|e| refused(e.to_string()))?;
        let [a, b] = [data[0][0], data[0][1]];
        if a.is_finite() && b.is_finite() { Ok([a, b]) } else { Err(refused("no finite answer".into())) }
    }

    fn jacobian(&self, at: LatLon) -> Result<Jacobian, Error> {
        let point = Coor2D::raw(self.unwound_lon(at).to_radians(), at.lat_deg.to_radians());
        let to_degrees = 1_f64.to_degrees();
        Jacobian::new(&self.context, self.utm, [to_degrees, 1.0], [false, false], self.ellipsoid, point)
            .map_err(|e| Error::Projection { epsg: self.zone.epsg(), reason: e.to_string() })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn agrees_with_published_values() {
        // Reference: PROJ 9.5.1, `Proj("EPSG:<zone>")` and its `get_factors`, which implement
        // IOGP Guidance Note 7-2, method 9807. Columns: latitude, longitude, EPSG, easting,
        // northing, scale factor, convergence in degrees.
        #[rustfmt::skip]
        let published = [
            (55.0, 12.0, 32632, 691_875.632_1, 6_098_907.825_1, 1.000_051_680_9, 2.458_199_9),
            (30.2672, -97.7431, 32614, 620_903.830_1, 3_349_062.364_1, 0.999_780_338_2, 0.633_596_4),
            (-33.8688, 151.2093, 32756, 334_368.633_6, 6_250_948.345_4, 0.999_938_200_5, 0.998_171_9),
            (55.8924, -3.3217, 32630, 479_880.604_9, 6_194_150.870_8, 0.999_604_964_9, -0.266_364_0),
            (60.39, 5.32, 32632, 297_230.220_2, 6_700_510.175_3, 1.000_103_855_0, -3.200_503_1),
        ];
        for (lat_deg, lon_deg, epsg, easting, northing, scale, convergence_deg) in published {
            let at = LatLon { lat_deg, lon_deg };
            let grid = Grid::new(Zone::from_epsg(epsg).unwrap()).unwrap();
            let MapPoint { x_m: x, y_m: y } = grid.project(at).unwrap();
            assert!((x - easting).abs() < 5e-4 && (y - northing).abs() < 5e-4, "{at:?}: {x} {y}");
            let k = grid.scale_factor(at).unwrap();
            assert!((k - scale).abs() < 1e-8, "{at:?}: {k}");
            let c = grid.convergence_rad(at).unwrap().to_degrees();
            assert!((c - convergence_deg).abs() < 1e-6, "{at:?}: {c}");
        }
    }

    #[test]
    fn convergence_is_positive_east_of_the_central_meridian_in_the_north() {
        let grid = Grid::of(LatLon { lat_deg: 30.0, lon_deg: -97.0 }).unwrap();
        let east = LatLon { lat_deg: 30.0, lon_deg: -97.0 };
        let west = LatLon { lat_deg: 30.0, lon_deg: -101.0 };
        assert!(grid.convergence_rad(east).unwrap() > 0.0);
        assert!(grid.convergence_rad(west).unwrap() < 0.0);
        // First order: (lon - lon0) sin(lat).
        let expected = 2_f64.to_radians() * 30_f64.to_radians().sin();
        assert!((grid.convergence_rad(east).unwrap() - expected).abs() < 2e-5);
    }

    #[test]
    fn a_heading_along_the_meridian_follows_grid_convergence() {
        // Two positions 100 m apart due north: on the grid the way between them must have the
        // yaw that the converted heading of true north has.
        let a = LatLon { lat_deg: 60.0, lon_deg: 8.5 };
        let b = LatLon { lat_deg: 60.0 + 100.0 / 111_412.0, lon_deg: 8.5 };
        let grid = Grid::new(Zone::from_epsg(32632).unwrap()).unwrap();
        let (pa, pb) = (grid.project(a).unwrap(), grid.project(b).unwrap());
        let along = (pb.y_m - pa.y_m).atan2(pb.x_m - pa.x_m);
        let pose = grid.pose_from_geodetic(a, std::f64::consts::FRAC_PI_2).unwrap();
        assert!((pose.yaw_rad - along).abs() < 1e-6, "{} {along}", pose.yaw_rad);
    }

    #[test]
    fn zone_60_reaches_past_the_date_line() {
        let grid = Grid::new(Zone::from_epsg(32660).unwrap()).unwrap();
        let west = grid.project(LatLon { lat_deg: 10.0, lon_deg: 179.999 }).unwrap();
        let east = grid.project(LatLon { lat_deg: 10.0, lon_deg: -179.999 }).unwrap();
        assert!((east.x_m - west.x_m - 219.3).abs() < 1.0, "{west:?} {east:?}");
        assert!(grid.unproject(east).unwrap().lon_deg < -179.0);
    }

    proptest! {
        #[test]
        fn projecting_and_back_is_the_identity(lat_deg in -79.9..83.9_f64, lon_deg in -180.0..180.0_f64) {
            let at = LatLon { lat_deg, lon_deg };
            let grid = Grid::of(at).unwrap();
            let back = grid.unproject(grid.project(at).unwrap()).unwrap();
            prop_assert!((back.lat_deg - lat_deg).abs() < 1e-9);
            prop_assert!((back.lon_deg - lon_deg).abs() < 1e-9);
        }

        #[test]
        fn two_zones_agree_on_distance_and_direction(lat_deg in -70.0..70.0_f64, dx in -100.0..100.0, dy in -100.0..100.0) {
            // The same sensor-metre vector laid out in two zones at their border ends at one position.
            let at = LatLon { lat_deg, lon_deg: 6.0 };
            let land = |epsg: u32| {
                let south = if lat_deg < 0.0 { 100 } else { 0 };
                let grid = Grid::new(Zone::from_epsg(epsg + south).unwrap()).unwrap();
                let pose = grid.pose_from_geodetic(at, 0.7).unwrap();
                let k = grid.scale_factor(at).unwrap();
                grid.unproject(pose.transform([k * dx, k * dy]).into()).unwrap()
            };
            let (a, b) = (land(32631), land(32632));
            prop_assert!((a.lat_deg - b.lat_deg).abs() < 2e-8, "{a:?} {b:?}");
            prop_assert!((a.lon_deg - b.lon_deg).abs() < 5e-8, "{a:?} {b:?}");
        }
    }
}
