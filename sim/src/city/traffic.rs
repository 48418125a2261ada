//! Vehicles that move: each stays in its lane along one line of streets and starts over at the end.

use std::f64::consts::TAU;

use echofix_core::pose::Pose2;
use echofix_core::time::DAY_US;

use super::CityParams;
use super::streets::{LANE_M, Network};
use super::vehicle::Car;
use crate::plane::{Point, add, direction, distance, left};
use crate::rng::{Purpose, poisson, stream, uniform};

/// A vehicle in motion.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Mover {
    /// Where it is and how large.
    pub vehicle: Car,
    /// Its velocity in the city, metres per second.
    pub velocity_mps: Point,
}

/// One vehicle's way through a day: a steady mean speed with stop and go on top.
#[derive(Debug, Clone, PartialEq)]
pub struct Traveller {
    lane: Lane,
    start_m: f64,
    speed_mps: f64,
    /// Amplitude of the stop and go, metres, and its angular rate, radians per second.
    wave_m: f64,
    wave_radps: f64,
    length_m: f64,
    width_m: f64,
}

impl Traveller {
    /// Where it is at a time.
    #[must_use]
    pub fn at(&self, time_us: i64) -> Mover {
        // Whole turns are dropped in integers: the epoch is long ago.
        let time_s = time_us.rem_euclid(DAY_US) as f64 * 1e-6;
        let phase = self.wave_radps * time_s;
        let way_m = self.start_m + self.speed_mps * time_s + self.wave_m * phase.sin();
        let speed_mps = self.speed_mps + self.wave_m * self.wave_radps * phase.cos();
        let (at, along) = self.lane.at(way_m.rem_euclid(self.lane.length_m()));
        let pose = Pose2::new(at[0], at[1], along[1].atan2(along[0]));
        Mover {
            vehicle: Car { pose, length_m: self.length_m, width_m: self.width_m },
            velocity_mps: [speed_mps * along[0], speed_mps * along[1]],
        }
    }
}

/// The right-hand lane along a line of streets.
#[derive(Debug, Clone, PartialEq)]
struct Lane {
    points: Vec<Point>,
    /// Length of the way up to each point, metres.
    way_m: Vec<f64>,
}

impl Lane {
    fn along(nodes: &[Point]) -> Self {
        let mut points = Vec::with_capacity(nodes.len());
        for k in 0..nodes.len() {
            let (before, after) = (nodes[k.saturating_sub(1)], nodes[(k + 1).min(nodes.len() - 1)]);
            points.push(add(nodes[k], -LANE_M, left(direction(before, after))));
        }
        let mut way_m = vec![0.0];
        for pair in points.windows(2) {
            way_m.push(way_m[way_m.len() - 1] + distance(pair[0], pair[1]));
        }
        Self { points, way_m }
    }

    fn length_m(&self) -> f64 {
        self.way_m[self.way_m.len() - 1]
    }

    /// Position and direction after some way, which must be at most the lane's length.
    fn at(&self, way_m: f64) -> (Point, Point) {
        let next = self.way_m.partition_point(|w| *w <= way_m).clamp(1, self.points.len() - 1);
        let along = direction(self.points[next - 1], self.points[next]);
        (add(self.points[next - 1], way_m - self.way_m[next - 1], along), along)
    }
}

/// The vehicles on the move on one day.
pub(super) fn travellers(network: &Network, params: &CityParams, day: u32) -> Vec<Traveller> {
    let mut rng = stream(params.seed, Purpose::Traffic, u64::from(day), 0);
    let mut all = Vec::new();
    for line in network.lines() {
        let mut nodes: Vec<Point> = line.iter().map(|node| network.nodes()[*node]).collect();
        for _ in 0..2 {
            let lane = Lane::along(&nodes);
            for _ in 0..poisson(&mut rng, 1e-3 * params.traffic_per_km * lane.length_m()) {
                let speed_mps = uniform(&mut rng, (4.0, 11.0));
                let wave_radps = TAU / uniform(&mut rng, (20.0, 60.0));
                all.push(Traveller {
                    lane: lane.clone(),
                    start_m: uniform(&mut rng, (0.0, lane.length_m())),
                    speed_mps,
                    wave_m: uniform(&mut rng, (0.0, 0.95)) * speed_mps / wave_radps,
                    wave_radps,
                    length_m: uniform(&mut rng, (3.9, 6.5)),
                    width_m: uniform(&mut rng, (1.7, 2.1)),
                });
            }
            nodes.reverse();
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn velocity_is_the_rate_of_the_position() {
        let params = CityParams::default();
        let network = Network::generate(&params);
        let all = travellers(&network, &params, 3);
        assert!(all.len() > 10, "{}", all.len());
        let mut checked = 0;
        for traveller in &all {
            let (before, after) = (traveller.at(1_700_000_000_000_000), traveller.at(1_700_000_000_010_000));
            let mid = traveller.at(1_700_000_000_005_000);
            for axis in 0..2 {
                let along = |m: &Mover| [m.vehicle.pose.x_m, m.vehicle.pose.y_m][axis];
                let rate = (along(&after) - along(&before)) / 0.01;
                // A traveller may pass a bend or start over in between.
                checked += usize::from((rate - mid.velocity_mps[axis]).abs() < 1e-3);
            }
        }
        assert!(checked >= 2 * all.len() - 4, "{checked} of {}", 2 * all.len());
    }

    #[test]
    fn traffic_changes_from_day_to_day() {
        let params = CityParams::default();
        let network = Network::generate(&params);
        assert_eq!(travellers(&network, &params, 1), travellers(&network, &params, 1));
        assert_ne!(travellers(&network, &params, 1), travellers(&network, &params, 2));
    }
}
