//! Climbing a peak on the smoothed map: below a cell and below a heading step.

use nalgebra::Matrix3;

use super::peaks::Peak;
use super::{Prior, Surface};
use crate::geo::CELL_M;
use crate::pose::{Pose2, wrap_angle};
use crate::window::Frame;

/// Steps of the stencil that measures slope and curvature: metres, metres, radians.
const STENCIL: [f64; 3] = [0.08, 0.08, 0.003];
/// The longest step: metres, metres, radians.
const MAX_STEP: [f64; 3] = [0.25, 0.25, 0.01];
/// A step below this share of the stencil ends the climb.
const CONVERGED: f64 = 0.02;
const MAX_STEPS: usize = 12;

/// A climbed peak.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Refined {
    /// Corrected pose minus prior: metres east and north, radians.
    pub correction: Pose2,
    /// Mean weight of the points there.
    pub score: f64,
    /// Second derivatives of the score over (east, north, yaw): metres and radians.
    pub hessian: [[f64; 3]; 3],
    /// True when the peak it started from lay on the edge of the search.
    pub at_edge: bool,
}

/// The score of hypotheses: how well points lie on the surface.
pub struct Score<'a> {
    surface: &'a Surface,
    frame: Frame,
    points: &'a [[f64; 2]],
    prior: &'a Prior,
}

impl<'a> Score<'a> {
    /// The score of points (ground metres in the body's frame) around a prior.
    pub fn new(surface: &'a Surface, frame: Frame, points: &'a [[f64; 2]], prior: &'a Prior) -> Self {
        Self { surface, frame, points, prior }
    }

    /// Mean weight of the points when the prior is corrected by (metres east, metres north, radians).
    pub fn at(&self, [dx, dy, turn]: [f64; 3]) -> f64 {
        let pose = self.prior.pose;
        let [x0, y0] = self.frame.to_cells([pose.x_m + dx, pose.y_m + dy]);
        let (s, c) = (pose.yaw_rad + turn).sin_cos();
        let cells_per_metre = self.prior.scale / CELL_M;
        let (s, c) = (s * cells_per_metre, c * cells_per_metre);
        let weight =
            |[px, py]: &[f64; 2]| f64::from(self.surface.at(x0 + c * px - s * py, y0 + s * px + c * py));
        self.points.iter().map(weight).sum::<f64>() / self.points.len().max(1) as f64
    }

    /// Slope and curvature by central differences.
    fn derivatives(&self, at: [f64; 3], here: f64) -> ([f64; 3], [[f64; 3]; 3]) {
        let moved = |steps: [f64; 3]| self.at([0, 1, 2].map(|i| at[i] + steps[i] * STENCIL[i]));
        let unit = |i: usize, sign: f64| {
            let mut steps = [0.0; 3];
            steps[i] = sign;
            steps
        };
        let (mut slope, mut curvature) = ([0.0; 3], [[0.0; 3]; 3]);
        let mut ahead = [0.0; 3];
        for i in 0..3 {
            let (plus, minus) = (moved(unit(i, 1.0)), moved(unit(i, -1.0)));
            slope[i] = (plus - minus) / (2.0 * STENCIL[i]);
            curvature[i][i] = (plus + minus - 2.0 * here) / STENCIL[i].powi(2);
            ahead[i] = plus;
        }
        for (i, j) in [(0, 1), (0, 2), (1, 2)] {
            let both = |sign_j: f64| {
                let mut steps = unit(i, 1.0);
                steps[j] = sign_j;
                let mut opposite = unit(i, -1.0);
                opposite[j] = -sign_j;
                moved(steps) + moved(opposite)
            };
            let mixed = (both(1.0) - both(-1.0)) / (4.0 * STENCIL[i] * STENCIL[j]);
            curvature[i][j] = mixed;
            curvature[j][i] = mixed;
        }
        (slope, curvature)
    }
}

impl Peak {
    /// The peak climbed to the nearest maximum of the score: on a thinned score at first, for the
    /// way is long and any tenth of the points shows it, then valued on the full one.
    #[must_use]
    pub fn climbed(&self, thinned: &Score, full: &Score) -> Refined {
        let Refined { correction, hessian, .. } = climb(thinned, &self.correction, self.at_edge);
        let score = full.at([correction.x_m, correction.y_m, correction.yaw_rad]);
        Refined { correction, score, hessian, at_edge: self.at_edge }
    }
}

/// Climbs from a hypothesis to the nearest maximum of the score (Newton steps, held back where the
/// surface is not convex).
#[must_use]
pub fn climb(score: &Score, from: &Pose2, at_edge: bool) -> Refined {
    let mut at = [from.x_m, from.y_m, from.yaw_rad];
    let mut here = score.at(at);
    let (mut slope, mut hessian) = score.derivatives(at, here);
    for _ in 0..MAX_STEPS {
        let step = ascent(slope, hessian);
        let Some((next, value)) = line_search(score, at, here, step) else { break };
        let moved = [0, 1, 2].map(|i: usize| ((next[i] - at[i]) / STENCIL[i]).abs());
        (at, here) = (next, value);
        (slope, hessian) = score.derivatives(at, here);
        if moved.iter().all(|m| *m < CONVERGED) {
            break;
        }
    }
    Refined { correction: Pose2::new(at[0], at[1], wrap_angle(at[2])), score: here, hessian, at_edge }
}

/// A step uphill: Newton's where the curvature is that of a summit, else along the slope; never
/// longer than the longest step.
fn ascent(slope: [f64; 3], hessian: [[f64; 3]; 3]) -> [f64; 3] {
    let down = hessian.map(|row| row.map(|v| -v));
    let step = match inverse_of_positive(down) {
        Some(inverse) => inverse.map(|row| (0..3).map(|j| row[j] * slope[j]).sum()),
        None => [0, 1, 2].map(|i: usize| slope[i] * STENCIL[i].powi(2) * 10.0),
    };
    let excess = (0..3).map(|i| (step[i] / MAX_STEP[i]).abs()).fold(1.0, f64::max);
    step.map(|s| s / excess)
}

/// The first of the step, its half, its quarter, ... that leads uphill.
fn line_search(score: &Score, at: [f64; 3], here: f64, step: [f64; 3]) -> Option<([f64; 3], f64)> {
    [1.0, 0.5, 0.25, 0.125].into_iter().find_map(|share| {
        let next = [0, 1, 2].map(|i: usize| at[i] + share * step[i]);
        let value = score.at(next);
        (value > here).then_some((next, value))
    })
}

/// The inverse of a symmetric matrix if it is positive definite.
#[must_use]
pub fn inverse_of_positive(m: [[f64; 3]; 3]) -> Option<[[f64; 3]; 3]> {
    let inverse = Matrix3::from(m).cholesky()?.inverse();
    inverse.iter().all(|v| v.is_finite()).then(|| inverse.into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_inverse_inverts_and_refuses_what_is_not_positive() {
        let m = [[4.0, 1.0, 0.5], [1.0, 3.0, -0.2], [0.5, -0.2, 2.0]];
        let product = Matrix3::from(m) * Matrix3::from(inverse_of_positive(m).unwrap());
        assert!((product - Matrix3::identity()).norm() < 1e-12);
        assert!(inverse_of_positive([[1.0, 2.0, 0.0], [2.0, 1.0, 0.0], [0.0, 0.0, 1.0]]).is_none());
        assert!(inverse_of_positive([[f64::NAN; 3]; 3]).is_none());
    }
}
