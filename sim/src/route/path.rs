//! The line a vehicle's origin follows: lanes, joined by curves of continuous curvature.

use std::f64::consts::TAU;

use echofix_core::pose::{Pose2, wrap_angle};

use crate::city::{LANE_M, Network};
use crate::plane::{Point, add, cross, direction, distance, left};

/// From an intersection's centre to where curves begin and end, metres.
const TURN_M: f64 = 12.0;
/// Spacing of the samples, metres.
const STEP_M: f64 = 0.1;

/// A point of the path.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct PathPoint {
    /// Way from the start, ground metres.
    pub way_m: f64,
    /// Position in the city and direction of travel.
    pub pose: Pose2,
    /// Turn per metre, radians, positive to the left.
    pub curvature_radpm: f64,
}

/// A densely sampled smooth path.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Path {
    points: Vec<PathPoint>,
}

impl Path {
    /// The path through some nodes, and the way to where each intersection's curve begins, metres.
    pub(super) fn through(network: &Network, nodes: &[usize]) -> (Self, Vec<f64>) {
        let lanes: Vec<(Point, Point)> =
            nodes.windows(2).map(|w| lane(network.nodes()[w[0]], network.nodes()[w[1]])).collect();
        let mut path = Self::default();
        let mut stops_m = Vec::new();
        for (k, (from, to)) in lanes.iter().enumerate() {
            let along = direction(*from, *to);
            path.straight(*from, *to);
            if let Some((next_from, next_to)) = lanes.get(k + 1) {
                stops_m.push(path.length_m());
                path.curve(*to, along, *next_from, direction(*next_from, *next_to));
            }
        }
        (path, stops_m)
    }

    /// Length, ground metres.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        self.points.last().map_or(0.0, |p| p.way_m)
    }

    /// The samples, from the start to the end.
    #[must_use]
    pub fn points(&self) -> &[PathPoint] {
        &self.points
    }

    /// Ends the path at the last sample within `length_m`.
    pub(super) fn truncate(&mut self, length_m: f64) {
        let count = self.points.partition_point(|p| p.way_m <= length_m);
        self.points.truncate(count.max(2));
    }

    /// The point after some way; the ends go on for ever.
    #[must_use]
    pub fn at(&self, way_m: f64) -> PathPoint {
        let next = self.points.partition_point(|p| p.way_m <= way_m).clamp(1, self.points.len() - 1);
        let (a, b) = (self.points[next - 1], self.points[next]);
        let t = ((way_m - a.way_m) / (b.way_m - a.way_m)).clamp(0.0, 1.0);
        PathPoint {
            way_m,
            pose: a.pose.interpolate(&b.pose, t),
            curvature_radpm: a.curvature_radpm + t * (b.curvature_radpm - a.curvature_radpm),
        }
    }

    /// The path moved aside by a sine of the way, with the direction and the curvature of the moved line.
    pub(super) fn swaying(&self, amplitude_m: f64, wavelength_m: f64, phase_rad: f64) -> Self {
        let aside = |point: &PathPoint| {
            let phase = TAU * point.way_m / wavelength_m + phase_rad;
            point.pose.transform([0.0, amplitude_m * phase.sin()])
        };
        let at: Vec<Point> = self.points.iter().map(aside).collect();
        let yaw_rad = |k: usize| {
            let (from, to) = (at[k.saturating_sub(1)], at[(k + 1).min(at.len() - 1)]);
            (to[1] - from[1]).atan2(to[0] - from[0])
        };
        let mut path = Self::default();
        for k in 0..at.len() {
            let (before, after) = (k.saturating_sub(1), (k + 1).min(at.len() - 1));
            let turn_rad = wrap_angle(yaw_rad(after) - yaw_rad(before));
            path.push(at[k], yaw_rad(k), turn_rad / distance(at[before], at[after]).max(1e-6));
        }
        path
    }

    fn push(&mut self, at: Point, yaw_rad: f64, curvature_radpm: f64) {
        let pose = Pose2::new(at[0], at[1], wrap_angle(yaw_rad));
        let way_m = self.points.last().map_or(0.0, |p| p.way_m + p.pose.distance_m(&pose));
        // The end of a piece is the start of the next.
        if self.points.is_empty() || way_m > self.length_m() + 1e-6 {
            self.points.push(PathPoint { way_m, pose, curvature_radpm });
        }
    }

    fn straight(&mut self, from: Point, to: Point) {
        let (along, length_m) = (direction(from, to), distance(from, to));
        let count = (length_m / STEP_M).ceil();
        for k in 0..=count as usize {
            self.push(add(from, length_m * k as f64 / count, along), along[1].atan2(along[0]), 0.0);
        }
    }

    /// A quintic Bezier curve whose curvature is zero at both ends.
    fn curve(&mut self, from: Point, along: Point, to: Point, leaving: Point) {
        // About the flattest curve for a right angle.
        let reach = 0.22 * distance(from, to);
        let control = [
            from,
            add(from, reach, along),
            add(from, 2.0 * reach, along),
            add(to, -2.0 * reach, leaving),
            add(to, -reach, leaving),
            to,
        ];
        let count = (1.2 * distance(from, to) / STEP_M).ceil() as usize;
        for k in 0..=count {
            let (at, first, second) = bezier(&control, k as f64 / count as f64);
            let speed = first[0].hypot(first[1]);
            self.push(at, first[1].atan2(first[0]), cross(first, second) / speed.powi(3));
        }
    }
}

/// The right-hand lane between two nodes, without the part the intersections take.
fn lane(from: Point, to: Point) -> (Point, Point) {
    let along = direction(from, to);
    let aside = |p| add(p, -LANE_M, left(along));
    (add(aside(from), TURN_M, along), add(aside(to), -TURN_M, along))
}

/// Value and first two derivatives of a Bezier curve, by de Casteljau's construction.
fn bezier(control: &[Point; 6], t: f64) -> (Point, Point, Point) {
    let mut p = *control;
    let mut derivatives = [[0.0; 2]; 2];
    for level in (1..6).rev() {
        // At two levels above the point, the differences are the derivatives.
        if level == 1 {
            derivatives[0] = [0, 1].map(|axis| 5.0 * (p[1][axis] - p[0][axis]));
        }
        if level == 2 {
            derivatives[1] = [0, 1].map(|axis| 20.0 * (p[2][axis] - 2.0 * p[1][axis] + p[0][axis]));
        }
        for k in 0..level {
            p[k] = [0, 1].map(|axis| p[k][axis] + t * (p[k + 1][axis] - p[k][axis]));
        }
    }
    (p[0], derivatives[0], derivatives[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bezier_derivative_is_its_slope() {
        let control = [[0.0, 0.0], [1.0, 0.0], [2.0, 0.2], [3.0, 1.0], [3.2, 2.0], [3.0, 3.0]];
        let h = 1e-4;
        let (before, mid, after) =
            (bezier(&control, 0.4 - h), bezier(&control, 0.4), bezier(&control, 0.4 + h));
        for axis in 0..2 {
            let first = (after.0[axis] - before.0[axis]) / (2.0 * h);
            let second = (after.1[axis] - before.1[axis]) / (2.0 * h);
            assert!((first - mid.1[axis]).abs() < 1e-5 && (second - mid.2[axis]).abs() < 1e-4);
        }
    }
}
