//! A plane that touches the globe.

use echofix_core::geo::LatLon;
use echofix_core::pose::{Pose2, wrap_angle};

/// Semi-major axis of WGS-84, metres.
const A: f64 = 6_378_137.0;
/// First eccentricity of WGS-84, squared.
const E2: f64 = 6.694_379_990_141_316e-3;

/// East and north on the tangent plane at a point of the ellipsoid, metres.
#[derive(Debug, Clone, Copy)]
pub(super) struct LocalFrame {
    origin: LatLon,
}

impl LocalFrame {
    pub(super) fn at(origin: LatLon) -> Self {
        Self { origin }
    }

    /// The position and true heading of a pose of the plane.
    pub(super) fn to_geodetic(self, pose: &Pose2) -> (LatLon, f64) {
        let (sin_lat, cos_lat) = self.origin.lat_deg.to_radians().sin_cos();
        let (sin_lon, cos_lon) = self.origin.lon_deg.to_radians().sin_cos();
        let [x0, y0, z0] = ecef(self.origin);
        let (east, north) = (pose.x_m, pose.y_m);
        let at = geodetic([
            x0 - sin_lon * east - sin_lat * cos_lon * north,
            y0 + cos_lon * east - sin_lat * sin_lon * north,
            z0 + cos_lat * north,
        ]);
        // Meridians converge: east of the origin true north leans to the west of the plane's.
        let turned =
            wrap_angle((at.lon_deg - self.origin.lon_deg).to_radians()) * at.lat_deg.to_radians().sin();
        (at, wrap_angle(pose.yaw_rad - turned))
    }
}

/// Earth-centred metres of a point of the ellipsoid.
fn ecef(at: LatLon) -> [f64; 3] {
    let (sin_lat, cos_lat) = at.lat_deg.to_radians().sin_cos();
    let (sin_lon, cos_lon) = at.lon_deg.to_radians().sin_cos();
    let n = A / (1.0 - E2 * sin_lat * sin_lat).sqrt();
    [n * cos_lat * cos_lon, n * cos_lat * sin_lon, n * (1.0 - E2) * sin_lat]
}

/// The position below a point near the ellipsoid (Bowring 1976: exact to nanometres there).
fn geodetic([x, y, z]: [f64; 3]) -> LatLon {
    let b = A * (1.0 - E2).sqrt();
    let p = x.hypot(y);
    let (sin_u, cos_u) = (z * A).atan2(p * b).sin_cos();
    let second_e2 = E2 / (1.0 - E2);
    let lat = (z + second_e2 * b * sin_u.powi(3)).atan2(p - E2 * A * cos_u.powi(3));
    LatLon::wrapped(lat.to_degrees(), y.atan2(x).to_degrees())
}

#[cfg(test)]
mod tests {
    use super::*;
    use echofix_core::geo::Grid;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn agrees_with_utm_on_places_and_headings(
            lat_deg in -70.0..70.0_f64, lon_deg in -180.0..180.0_f64,
            east in -800.0..800.0, north in -800.0..800.0, yaw in -3.0..3.0,
        ) {
            let origin = LatLon { lat_deg, lon_deg };
            let (at, yaw_there) = LocalFrame::at(origin).to_geodetic(&Pose2::new(east, north, yaw));
            // The same way laid out on the grid, whose metres and north differ.
            let grid = Grid::of(origin).unwrap();
            let scale = grid.scale_factor(origin).unwrap();
            let start = grid.pose_from_geodetic(origin, 0.0).unwrap();
            let end = start.compose(&Pose2::new(scale * east, scale * north, yaw));
            let (expected, expected_yaw) = grid.pose_to_geodetic(&end).unwrap();
            let (there, expected) = (grid.project(at).unwrap(), grid.project(expected).unwrap());
            prop_assert!(there.distance_m(expected) < 0.02, "{there:?} {expected:?}");
            prop_assert!(wrap_angle(yaw_there - expected_yaw).abs() < 2e-5);
        }
    }
}
