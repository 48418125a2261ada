//! Ways through the town.

mod path;
mod tour;

pub use path::{Path, PathPoint};

use crate::city::City;

/// A way through the town, in the right-hand lane.
#[derive(Debug, Clone, PartialEq)]
pub struct Route {
    nodes: Vec<usize>,
    path: Path,
    stop_lines_m: Vec<f64>,
}

impl Route {
    /// A way along every street at least once.
    #[must_use]
    pub fn survey(city: &City, seed: u64) -> Self {
        Self::through(city, tour::survey(city.network(), seed))
    }

    /// A random walk of the given length, at least a few metres.
    #[must_use]
    pub fn wander(city: &City, seed: u64, length_m: f64) -> Self {
        // Every intersection shortens the way a little.
        let mut route = Self::through(city, tour::wander(city.network(), seed, 1.2 * length_m + 30.0));
        route.path.truncate(length_m);
        let length_m = route.path.length_m();
        route.stop_lines_m.retain(|way_m| *way_m < length_m);
        route
    }

    /// The way through some intersections, each joined to the next by a street.
    #[must_use]
    pub fn along(city: &City, nodes: &[usize]) -> Self {
        Self::through(city, nodes.to_vec())
    }

    /// The same way with further places to stop, so far apart: whether a vehicle stops there is the drive's to draw.
    #[must_use]
    pub fn with_stops(mut self, spacing_m: f64) -> Self {
        let count = (self.length_m() / spacing_m) as usize;
        self.stop_lines_m.extend((1..=count).map(|k| k as f64 * spacing_m));
        self.stop_lines_m.sort_by(f64::total_cmp);
        self
    }

    /// The same way, swaying about its line so many metres to either side over a wavelength, as drivers do. The body
    /// follows the swaying line as a bicycle does: it never slips sideways.
    #[must_use]
    pub fn swaying(mut self, amplitude_m: f64, wavelength_m: f64, phase_rad: f64) -> Self {
        self.path = self.path.swaying(amplitude_m, wavelength_m, phase_rad);
        self
    }

    fn through(city: &City, nodes: Vec<usize>) -> Self {
        let (path, stop_lines_m) = Path::through(city.network(), &nodes);
        Self { nodes, path, stop_lines_m }
    }

    /// The intersections visited, the first and last included; a wandering route may end between two.
    #[must_use]
    pub fn nodes(&self) -> &[usize] {
        &self.nodes
    }

    /// The line the vehicle's origin follows.
    #[must_use]
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Ways from the start to each intersection's stop line, metres.
    #[must_use]
    pub fn stop_lines_m(&self) -> &[f64] {
        &self.stop_lines_m
    }

    /// Length, ground metres.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.path.length_m()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::city::{CityParams, Street};
    use proptest::prelude::*;

    fn city() -> City {
        City::generate(&CityParams::default()).unwrap()
    }

    fn smooth(path: &Path) {
        for pair in path.points().windows(2) {
            let (step_m, turn) = (pair[1].way_m - pair[0].way_m, pair[0].pose.between(&pair[1].pose));
            assert!(step_m < 0.3, "{step_m}");
            assert!(turn.y_m.abs() < 0.01 && turn.x_m > 0.0, "{turn:?}");
            let curvature = 0.5 * (pair[0].curvature_radpm + pair[1].curvature_radpm);
            assert!((turn.yaw_rad - curvature * step_m).abs() < 2e-3, "{turn:?} {curvature}");
            assert!(curvature.abs() < 1.0 / 5.0, "tighter than a car turns: {curvature}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(16))]

        #[test]
        fn a_survey_covers_all_streets_without_turning_round(seed in any::<u64>()) {
            let city = city();
            let route = Route::survey(&city, seed);
            let network = city.network();
            let mut driven = vec![false; network.streets().len()];
            for pair in route.nodes().windows(2) {
                driven[network.between(pair[0], pair[1]).unwrap()] = true;
            }
            prop_assert!(driven.iter().all(|d| *d));
            prop_assert!(route.nodes().windows(3).all(|w| w[0] != w[2]));
            prop_assert!(route.length_m() < 2.0 * city.streets_m(), "{}", route.length_m());
            smooth(route.path());
        }

        #[test]
        fn a_wander_has_the_length_asked_for(seed in any::<u64>(), length_m in 50.0..3000.0_f64) {
            let route = Route::wander(&city(), seed, length_m);
            prop_assert!((route.length_m() - length_m).abs() < 0.5, "{}", route.length_m());
            smooth(route.path());
        }
    }

    #[test]
    fn routes_keep_to_the_streets() {
        let city = city();
        let route = Route::survey(&city, 5);
        let streets = city.network().streets();
        for point in route.path().points().iter().step_by(20) {
            let off = |s: &Street| {
                let frame =
                    echofix_core::pose::Pose2::new(s.a[0], s.a[1], (s.b[1] - s.a[1]).atan2(s.b[0] - s.a[0]));
                let [x, y] = frame.inverse().transform([point.pose.x_m, point.pose.y_m]);
                (x - x.clamp(0.0, s.length_m())).hypot(y) - s.kerb_m
            };
            assert!(streets.iter().map(off).fold(f64::MAX, f64::min) < -2.0);
        }
    }
}
