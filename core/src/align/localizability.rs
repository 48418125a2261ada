//! How well can a pose be distinguished from those around it, by the map alone?
//!
//! The map's own structure around a position is taken as a batch that was seen from there, and aligned with
//! the map it comes from. How sharply the score falls off around the true pose gives the covariance that a
//! fix there can have; how far the best candidate elsewhere stays below gives its margin.
//!
//! 1. Blocks of hits within reach are seen as often as a pass saw them: one vote a block, and no more of
//!    them than a batch has.
//! 2. They scatter as returns do. A map that is matched with itself to the centimetre would tell poses
//!    apart by accidents of the one drive it was made from, even along an even wall.
//! 3. Curvature at the true pose gives the covariance, at the temperature of [`Integrity`] and with the
//!    map's own error, as in [`super::answer`].
//! 4. The best candidate elsewhere gives the margin, in nats.
//!
//! What the next vehicle meets is worse than that: other cars are parked, odometry has drifted, structure is
//! hidden behind traffic. By how much was measured, and is part of the answer: [`SIGMA_FACTOR`],
//! [`SELF_MATCH_NATS`].

use std::sync::Arc;

use nalgebra::{Matrix3, SymmetricEigen};

use super::EngineKind;
use super::pipeline::Pipeline;
use super::verdict::Integrity;
use super::weights::TileWeights;
use super::{Prior, Search};
use crate::batch::Batch;
use crate::point::{MapPoint, WeightedPoint};
use crate::pose::Pose2;
use crate::window::MapSquare;

/// Half width of the search for other poses, metres: three sigmas of a prior of 2 m.
pub const REACH_M: f64 = 6.0;
/// Half width of the search in heading, radians: what looks alike does so in nearly the same heading.
const REACH_RAD: f64 = 0.06;
/// Points of a batch of 5 s that lie on mapped structure, at most: of 3200 in a town.
const MOST_POINTS: f64 = 1500.0;
/// Fraction of a pass's hits on a structure that count towards its being seen again. A larger one counts
/// every accident of the drive that made the map, and towns no longer differ from even walls.
const SEEN_AGAIN: f64 = 0.05;
/// Scatter of returns around the structure they come from, one sigma, metres.
const SCATTER_M: f64 = 0.3;
/// Realised error over the sigma of the self-match: 1.5 at the median and 1.6 at 95 % of the errors of usable
/// fixes in simulated towns, the map's own error apart (`echofix evaluate --only localizability`).
pub const SIGMA_FACTOR: f64 = 1.5;
/// By how much a self-match exceeds the best candidate elsewhere even where all poses look alike, nats: 4 to 20 in the
/// simulated scenes that are made to be mistaken, where fixes realise 0 to 5. In towns self-matches
/// have 46 and more, and fixes about as much.
pub const SELF_MATCH_NATS: f64 = 18.0;
/// Independent returns count for this many points of a thinned batch, where candidates are compared.
const SCORE_TEMPERATURE: f64 = 10.0;
/// Margin below which a fix will most likely be ambiguous, nats.
const LEAST_NATS: f64 = 12.0;
/// Fewer points are a few accidents: an open field has some 150, a street of parked cars 300.
const LEAST_POINTS: usize = 200;
/// Sigma where nothing determines a direction, metres; for the heading, in radians, [`UNHELD_RAD`].
pub const UNHELD_M: f64 = 10.0;
/// Sigma of the heading where nothing determines it, radians.
pub const UNHELD_RAD: f64 = 0.5;

/// What a fix at a position can be expected to be.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Localizability {
    /// Covariance of (east m, north m, yaw rad), the map's own error included.
    pub covariance: [[f64; 3]; 3],
    /// The map's own part of it along each axis, square metres.
    pub map_m2: f64,
    /// Log-likelihood by which a fix can be expected to exceed the best candidate elsewhere, nats; below 0 where
    /// they differ by less than by chance, infinite without any other.
    pub margin: f64,
    /// The best candidate elsewhere: metres east and north of the true pose, radians.
    pub rival: Option<Pose2>,
    /// Points that a batch can be expected to have on mapped structure.
    pub points: usize,
}

/// The verdict that a fix at a position will most likely have.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, PartialOrd, Ord)]
pub enum Expected {
    /// It can be used.
    Usable,
    /// A second position looks alike.
    Ambiguous,
    /// Nothing determines it in some direction.
    TooLittleStructure,
}

impl Localizability {
    /// Where nothing stands.
    pub const NONE: Self = Self {
        covariance: [
            [UNHELD_M * UNHELD_M, 0.0, 0.0],
            [0.0, UNHELD_M * UNHELD_M, 0.0],
            [0.0, 0.0, UNHELD_RAD * UNHELD_RAD],
        ],
        map_m2: 0.0,
        margin: 0.0,
        rival: None,
        points: 0,
    };

    /// Sigma of the position along its weakest axis, metres.
    #[must_use]
    pub fn weakest_m(&self) -> f64 {
        self.axes().0.sqrt()
    }

    /// Sigma of the position along its strongest axis, metres.
    #[must_use]
    pub fn strongest_m(&self) -> f64 {
        self.axes().1.max(0.0).sqrt()
    }

    /// Direction of the weakest axis, radians from grid east, in (-pi / 2, pi / 2].
    #[must_use]
    pub fn weak_direction_rad(&self) -> f64 {
        let [[xx, xy, _], [_, yy, _], _] = self.covariance;
        0.5 * (2.0 * xy).atan2(xx - yy)
    }

    /// Sigma of the heading, radians.
    #[must_use]
    pub fn sigma_yaw_rad(&self) -> f64 {
        self.covariance[2][2].sqrt()
    }

    /// Expected distance of a fix from the truth, root mean square, metres.
    #[must_use]
    pub fn sigma_horizontal_m(&self) -> f64 {
        (self.covariance[0][0] + self.covariance[1][1]).sqrt()
    }

    /// The verdict that a fix will most likely have.
    #[must_use]
    pub fn expected(&self, integrity: &Integrity) -> Expected {
        if self.points < LEAST_POINTS || self.weakest_m() > integrity.max_sigma_m {
            Expected::TooLittleStructure
        } else if self.margin < LEAST_NATS {
            Expected::Ambiguous
        } else {
            Expected::Usable
        }
    }

    /// Eigenvalues of the position's covariance, the larger one first.
    fn axes(&self) -> (f64, f64) {
        let [[xx, xy, _], [_, yy, _], _] = self.covariance;
        let (mean, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
        (mean + half, mean - half)
    }
}

/// Assesses positions, with the buffers that one thread reuses from one to the next.
#[derive(Default)]
pub struct Assessor {
    pipeline: Pipeline,
    expected: Vec<WeightedPoint>,
}

impl Assessor {
    /// What a fix at a position can be expected to be, from the tiles that exist in a square around it: it
    /// must hold the search's extent and [`REACH_M`] in every direction.
    ///
    /// The same tiles give the same answer, to the bit.
    pub fn assess(
        &mut self,
        square: MapSquare,
        tiles: &[Arc<TileWeights>],
        position: MapPoint,
        search: &Search,
        integrity: &Integrity,
    ) -> Localizability {
        expected_points(tiles, position, search.extent_m, &mut self.expected);
        if self.expected.is_empty() {
            return Localizability::NONE;
        }
        self.pipeline.assemble(square, tiles);
        self.pipeline.set_points(self.expected.iter().copied());
        let prior = Prior {
            pose: Pose2::new(position.x_m, position.y_m, 0.0),
            sigma_position_m: REACH_M / search.sigmas,
            sigma_yaw_rad: REACH_RAD / search.sigmas,
            scale: 1.0,
        };
        // The engine that is asked counts the points only.
        let batch = Batch::default();
        let ranking = self.pipeline.rank(EngineKind::Fast.engine(), &batch, &prior, search, None);
        let (field, points) = (&ranking.field, ranking.question.thinned);
        let rival = ranking.best_beyond(&Pose2::IDENTITY);
        let margin = rival.map_or(f64::INFINITY, |rival| {
            let here = field.slope(points, &prior.pose, prior.scale).value;
            let above = here - rival.score * points.len() as f64;
            above / SCORE_TEMPERATURE - SELF_MATCH_NATS
        });
        let slope = field.sharpened().slope(points, &prior.pose, prior.scale);
        let [xx, xy, yy, xt, yt, tt] = slope.curvature.map(|c| -c / integrity.temperature);
        let mut covariance = bounded(Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt)) * SIGMA_FACTOR.powi(2);
        let map = integrity.map_variance(&ranking.map_error(&prior.pose, integrity.map_pose_m));
        for (axis, variance) in map.into_iter().enumerate() {
            covariance[(axis, axis)] += variance;
        }
        let rival = rival.map(|rival| rival.correction);
        Localizability { covariance: covariance.into(), map_m2: map[0], margin, rival, points: points.len() }
    }
}

/// What a batch can be expected to hold, of a body at the position that heads east; a vote each.
fn expected_points(
    tiles: &[Arc<TileWeights>],
    position: MapPoint,
    reach_m: f64,
    out: &mut Vec<WeightedPoint>,
) {
    out.clear();
    let seen = |hits: f64| 1.0 - (-SEEN_AGAIN * hits).exp();
    let mut near = Vec::new();
    for tile in tiles {
        let corner = tile.id.origin();
        for block in &*tile.blocks {
            let at = corner.moved(block.east_m(), block.north_m());
            let (east_m, north_m) = (at.x_m - position.x_m, at.y_m - position.y_m);
            if east_m.hypot(north_m) <= reach_m {
                near.push((east_m, north_m, seen(block.hits())));
            }
        }
    }
    let all: f64 = near.iter().map(|(_, _, seen)| seen).sum();
    let fraction = (MOST_POINTS / all).min(1.0);
    // Every so often one is due: as many as expected, spread evenly, and the same each time.
    let mut due = 0.5;
    for (east_m, north_m, seen) in near {
        due += fraction * seen;
        if due >= 1.0 {
            due -= 1.0;
            let [dx, dy] = scatter(out.len());
            out.push(WeightedPoint::new((east_m + dx) as f32, (north_m + dy) as f32, 1.0));
        }
    }
}

/// A sequence of offsets that is normally distributed and has no chance in it.
fn scatter(number: usize) -> [f64; 2] {
    // The R2 sequence: the powers of the plastic number's inverse fill a square most evenly.
    const STEPS: [f64; 2] = [0.754_877_666_246_693, 0.569_840_290_998_053];
    let [u, v] = STEPS.map(|step| (0.5 + step * number as f64).fract());
    let (radius, turn) = (SCATTER_M * (-2.0 * (1.0 - u).ln()).sqrt(), std::f64::consts::TAU * v);
    [radius * turn.cos(), radius * turn.sin()]
}

/// The inverse of an information matrix over (east m, north m, yaw rad). Directions with hardly any
/// information, or that curve the wrong way, get the largest sigma.
fn bounded(information: Matrix3<f64>) -> Matrix3<f64> {
    let unit = Matrix3::from_diagonal(&[UNHELD_M, UNHELD_M, UNHELD_RAD].into());
    let SymmetricEigen { eigenvectors, eigenvalues } = SymmetricEigen::new(unit * information * unit);
    let variances = Matrix3::from_diagonal(&eigenvalues.map(|information| information.max(1.0).recip()));
    unit * eigenvectors * variances * eigenvectors.transpose() * unit
}

#[cfg(test)]
mod tests;
