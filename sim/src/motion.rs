//! When a vehicle is where: speeds, stops, smooth acceleration along a route.

use echofix_core::pose::Pose2;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::plane::Point;
use crate::rng::uniform;
use crate::route::{Path, Route};

/// How a vehicle is driven.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionParams {
    /// Slowest and fastest cruising speed, metres per second; drawn anew after each intersection.
    pub cruise_mps: (f64, f64),
    /// Acceleration and deceleration, metres per second squared.
    pub acceleration_mps2: f64,
    /// Sideways acceleration in curves at most, metres per second squared.
    pub lateral_mps2: f64,
    /// Chance of a stop at an intersection.
    pub stop_probability: f64,
    /// Shortest and longest stop, seconds.
    pub dwell_s: (f64, f64),
}

impl Default for MotionParams {
    /// Calm driving downtown: about 8 m/s while moving.
    fn default() -> Self {
        Self {
            cruise_mps: (8.0, 12.5),
            acceleration_mps2: 1.6,
            lateral_mps2: 2.0,
            stop_probability: 0.35,
            dwell_s: (2.0, 12.0),
        }
    }
}

/// The body's state at a time.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MotionState {
    /// Pose of the body's origin (the middle of the rear axle) in the city.
    pub pose: Pose2,
    /// Speed along the body's x axis, metres per second.
    pub speed_mps: f64,
    /// Radians per second, counter-clockwise.
    pub yaw_rate_radps: f64,
}

impl MotionState {
    /// Velocity in the city of a point fixed to the body, metres per second.
    #[must_use]
    pub fn velocity_of(&self, [x_m, y_m]: Point) -> Point {
        let (s, c) = self.pose.yaw_rad.sin_cos();
        let (forward, aside) = (self.speed_mps - self.yaw_rate_radps * y_m, self.yaw_rate_radps * x_m);
        [c * forward - s * aside, s * forward + c * aside]
    }
}

/// Spacing of the timetable, seconds.
const TICK_S: f64 = 0.02;
/// The speed is averaged over two windows of this many ticks, which bounds the jerk.
const SMOOTHING_TICKS: usize = 30;
/// Rest before and after the drive, seconds; longer than both windows together.
const REST_S: f64 = 1.5;

/// A route with its timetable.
#[derive(Debug, Clone)]
pub struct Motion<'a> {
    path: &'a Path,
    speed_mps: Vec<f64>,
    way_m: Vec<f64>,
}

impl<'a> Motion<'a> {
    /// Draws speeds and stops and works the timetable out.
    #[must_use]
    pub fn along(route: &'a Route, params: &MotionParams, rng: &mut ChaCha8Rng) -> Self {
        let path = route.path();
        let (limit_mps, dwell_s) = limits(route, params, rng);
        let speed_mps = smoothed(&smoothed(&timetable(path, &limit_mps, &dwell_s)));
        let mut way_m = vec![0.0];
        for pair in speed_mps.windows(2) {
            way_m.push(way_m[way_m.len() - 1] + 0.5 * TICK_S * (pair[0] + pair[1]));
        }
        Self { path, speed_mps, way_m }
    }

    /// From the start to the end, seconds.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        TICK_S * (self.speed_mps.len() - 1) as f64
    }

    /// The state at some time after the start; at rest after the end.
    #[must_use]
    pub fn at(&self, time_s: f64) -> MotionState {
        let tick = ((time_s / TICK_S) as usize).min(self.speed_mps.len() - 2);
        let rest_s = (time_s - tick as f64 * TICK_S).clamp(0.0, TICK_S);
        let (v0, v1) = (self.speed_mps[tick], self.speed_mps[tick + 1]);
        let change = rest_s * (v1 - v0) / TICK_S;
        let point = self.path.at(self.way_m[tick] + rest_s * (v0 + 0.5 * change));
        let speed_mps = v0 + change;
        MotionState { pose: point.pose, speed_mps, yaw_rate_radps: point.curvature_radpm * speed_mps }
    }
}

/// The speed that may not be exceeded at each point of the path, and how long is rested there.
fn limits(route: &Route, params: &MotionParams, rng: &mut ChaCha8Rng) -> (Vec<f64>, Vec<f64>) {
    let points = route.path().points();
    let mut dwell_s = vec![0.0; points.len()];
    let mut limit_mps = vec![0.0; points.len()];
    let mut stop_lines = route.stop_lines_m().iter().peekable();
    let mut cruise_mps = uniform(rng, params.cruise_mps);
    for (index, point) in points.iter().enumerate() {
        limit_mps[index] =
            cruise_mps.min((params.lateral_mps2 / point.curvature_radpm.abs().max(1e-6)).sqrt());
        if stop_lines.next_if(|way_m| **way_m <= point.way_m).is_some() {
            cruise_mps = uniform(rng, params.cruise_mps);
            let (stop, rest_s) = (rng.random_bool(params.stop_probability), uniform(rng, params.dwell_s));
            if stop {
                (limit_mps[index], dwell_s[index]) = (0.0, rest_s);
            }
        }
    }
    for end in [0, points.len() - 1] {
        (limit_mps[end], dwell_s[end]) = (0.0, REST_S);
    }
    accelerate(points.windows(2).map(|w| w[1].way_m - w[0].way_m).collect(), &mut limit_mps, params);
    (limit_mps, dwell_s)
}

/// Lowers speeds until no acceleration or braking is harder than the parameters say.
fn accelerate(step_m: Vec<f64>, limit_mps: &mut [f64], params: &MotionParams) {
    let gain = |v: f64, ds: f64| (v * v + 2.0 * params.acceleration_mps2 * ds).sqrt();
    for (k, ds) in step_m.iter().enumerate() {
        limit_mps[k + 1] = limit_mps[k + 1].min(gain(limit_mps[k], *ds));
    }
    for (k, ds) in step_m.into_iter().enumerate().rev() {
        limit_mps[k] = limit_mps[k].min(gain(limit_mps[k + 1], ds));
    }
}

/// Speeds at every tick when the path is driven at the given speeds and rests.
fn timetable(path: &Path, limit_mps: &[f64], dwell_s: &[f64]) -> Vec<f64> {
    let points = path.points();
    let mut knots = vec![(0.0, 0.0)];
    let mut time_s = 0.0;
    for k in 0..points.len() {
        if k > 0 {
            let ds = points[k].way_m - points[k - 1].way_m;
            time_s += 2.0 * ds / (limit_mps[k] + limit_mps[k - 1]).max(1e-3);
            knots.push((time_s, limit_mps[k]));
        }
        if dwell_s[k] > 0.0 {
            time_s += dwell_s[k];
            knots.push((time_s, limit_mps[k]));
        }
    }
    let mut next = 1;
    let speed_at = |tick: usize| {
        let t = tick as f64 * TICK_S;
        while next + 1 < knots.len() && knots[next].0 < t {
            next += 1;
        }
        let ((t0, v0), (t1, v1)) = (knots[next - 1], knots[next]);
        v0 + (v1 - v0) * ((t - t0) / (t1 - t0)).clamp(0.0, 1.0)
    };
    (0..=(time_s / TICK_S).ceil() as usize).map(speed_at).collect()
}

/// The mean over a window around every tick; as nothing moves at the ends, the way stays as long.
fn smoothed(speed_mps: &[f64]) -> Vec<f64> {
    let half = SMOOTHING_TICKS / 2;
    let mut sums = vec![0.0];
    for v in speed_mps {
        sums.push(sums[sums.len() - 1] + v);
    }
    let mean = |k: usize| {
        let (from, to) = (k.saturating_sub(half), (k + half + 1).min(speed_mps.len()));
        (sums[to] - sums[from]) / (2 * half + 1) as f64
    };
    // Sums of many speeds leave rounding errors: rest is rest.
    (0..speed_mps.len()).map(mean).map(|v| if v < 1e-6 { 0.0 } else { v }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::city::{City, CityParams};
    use crate::rng::{Purpose, stream};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(12))]

        #[test]
        fn speed_stays_in_range_and_changes_smoothly(seed in any::<u64>()) {
            let city = City::generate(&CityParams::default()).unwrap();
            let route = Route::wander(&city, seed, 800.0);
            let mut rng = stream(seed, Purpose::Motion, 0, 0);
            let motion = Motion::along(&route, &MotionParams::default(), &mut rng);
            let states: Vec<_> = (0..(motion.duration_s() / 0.05) as usize).map(|k| motion.at(0.05 * k as f64)).collect();
            for pair in states.windows(2) {
                prop_assert!((0.0..=15.0).contains(&pair[0].speed_mps));
                prop_assert!((pair[1].speed_mps - pair[0].speed_mps).abs() < 0.05 * 1.7);
                prop_assert!((pair[1].yaw_rate_radps - pair[0].yaw_rate_radps).abs() < 0.2);
                let step_m = pair[0].pose.distance_m(&pair[1].pose);
                prop_assert!((step_m - 0.025 * (pair[0].speed_mps + pair[1].speed_mps)).abs() < 3e-3);
            }
            let end = motion.at(motion.duration_s()).pose;
            prop_assert!(end.distance_m(&route.path().at(route.length_m()).pose) < 0.5);
            prop_assert!(states.iter().any(|s| s.speed_mps > 8.0));
        }
    }

    #[test]
    fn a_lever_arm_adds_the_turn() {
        let state = MotionState {
            pose: Pose2::new(5.0, 5.0, std::f64::consts::FRAC_PI_2),
            speed_mps: 4.0,
            yaw_rate_radps: 0.5,
        };
        let [x, y] = state.velocity_of([3.0, 1.0]);
        assert!((x + 1.5).abs() < 1e-12 && (y - 3.5).abs() < 1e-12);
    }
}
