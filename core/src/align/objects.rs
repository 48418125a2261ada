//! Do the objects in view prefer one pose to another?
//!
//! Returns of one object are not independent: a parked car that stands half a metre from where the map has
//! one moves all of its returns alike, however many they are. What is independent are objects. So the points
//! of a batch are grouped by squares of about an object's size, each square says by how much its points weigh
//! more at one pose than at the other, and the statements' roots, with their signs, are summed and divided by the
//! root of the sum of their squares.
//!
//! That is a self-normalised sum: where no pose is preferred, each statement is as often positive as negative, and
//! the sum then exceeds x with a probability of at most exp(-x^2 / 2), whatever the statements' sizes, their
//! distributions and their number (Efron, "Student's t-test under symmetry conditions", 1969). No property of
//! a sensor, of a density of returns or of a map enters. It holds for any odd function of the statements; their roots let
//! many small objects outvote a large one, a lorry that parks where another one was mapped, and still count large ones
//! for more than what is hardly seen.
//!
//! What is clutter and what stands differ by how often they were seen: a point counts by the logarithm of the
//! number of its returns. Points where the map has not been, at either pose, say nothing.

use super::score::{ScoreField, UNKNOWN};
use crate::point::WeightedPoint;
use crate::pose::Pose2;

/// Side of a square, metres: about a parked car's width, a lamp post, a bay of a facade.
const OBJECT_M: f32 = 2.5;
/// What a point of a single return counts for: next to nothing, unless there are no others.
const SINGLE: f32 = 0.1;
/// Points that are asked, at most: those of most returns.
const MOST: usize = 1500;

/// The objects of a batch and what they weigh at a pose.
#[derive(Default)]
pub struct Objects {
    points: Vec<WeightedPoint>,
    /// The object of each point.
    of_point: Vec<u32>,
    /// For each square of the grid the number of its object, plus one.
    squares: Vec<u32>,
    /// Weights of the points at the pose that others are compared with.
    here: Vec<f32>,
    there: Vec<f32>,
    /// What each object says.
    statements: Vec<f32>,
    order: Vec<u32>,
}

/// How objects compare two poses.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Preference {
    /// The self-normalised sum, positive when the first pose is preferred; at most the root of the number of objects.
    pub sum: f64,
    /// Objects that say anything.
    pub objects: usize,
    /// Fraction of what the map knows at the first pose that it knows at the second one, too.
    pub shared: f64,
}

impl Preference {
    /// Minus the logarithm of the probability with which objects that prefer neither pose seem to prefer the first
    /// one so clearly, nats, at least; below 0 where they prefer the second one.
    #[must_use]
    pub fn nats(&self) -> f64 {
        0.5 * self.sum * self.sum.abs()
    }
}

impl Objects {
    /// Takes the points of a batch, each made of so many returns, none farther than `reach_m` from the body.
    pub fn group(
        &mut self,
        points: &[WeightedPoint],
        returns: impl ExactSizeIterator<Item = f32>,
        reach_m: f64,
    ) {
        self.points.clear();
        self.points.extend(
            points.iter().zip(returns).map(|(point, n)| WeightedPoint { vote: n.ln() + SINGLE, ..*point }),
        );
        self.thin_out();
        let half = (reach_m as f32 / OBJECT_M).ceil() + 1.0;
        let side = 2 * half as usize + 1;
        self.squares.clear();
        self.squares.resize(side * side, 0);
        self.of_point.clear();
        let index = |v: f32| ((v / OBJECT_M + half).max(0.0) as usize).min(side - 1);
        let mut count = 0;
        for point in &self.points {
            let square = &mut self.squares[index(point.y_m) * side + index(point.x_m)];
            if *square == 0 {
                count += 1;
                *square = count;
            }
            self.of_point.push(*square - 1);
        }
        self.statements.clear();
        self.statements.resize(count as usize, 0.0);
    }

    /// Leaves the points that count for most, in their order.
    fn thin_out(&mut self) {
        if self.points.len() <= MOST {
            return;
        }
        let Self { points, order, .. } = self;
        order.clear();
        order.extend(0..points.len() as u32);
        let by_vote = |i: &u32| (std::cmp::Reverse(points[*i as usize].vote.to_bits()), *i);
        order.select_nth_unstable_by_key(MOST, by_vote);
        order.truncate(MOST);
        order.sort_unstable();
        for (to, from) in order.iter().enumerate() {
            points[to] = points[*from as usize];
        }
        points.truncate(MOST);
    }

    /// Takes the pose that others are compared with.
    pub fn stand(&mut self, field: &ScoreField, pose: &Pose2, scale: f64) {
        field.weigh(self.points.iter(), pose, scale, &mut self.here);
    }

    /// By how much the objects prefer that pose to another one.
    pub fn preference(&mut self, field: &ScoreField, other: &Pose2, scale: f64) -> Preference {
        field.weigh(self.points.iter(), other, scale, &mut self.there);
        self.statements.fill(0.0);
        let weights = self.here.iter().zip(&self.there);
        let (mut known, mut shared) = (0.0, 0.0);
        for ((point, object), (here, there)) in self.points.iter().zip(&self.of_point).zip(weights) {
            known += if *here > UNKNOWN { f64::from(point.vote) } else { 0.0 };
            if *here > UNKNOWN && *there > UNKNOWN {
                shared += f64::from(point.vote);
                self.statements[*object as usize] += point.vote * (here - there);
            }
        }
        let (mut sum, mut squared, mut objects) = (0.0, 0.0, 0);
        for statement in self.statements.iter().map(|s| f64::from(*s)).filter(|s| *s != 0.0) {
            sum += statement.abs().sqrt().copysign(statement);
            squared += statement.abs();
            objects += 1;
        }
        Preference {
            sum: if squared > 0.0 { sum / squared.sqrt() } else { 0.0 },
            objects,
            shared: if known > 0.0 { shared / known } else { 0.0 },
        }
    }

    /// The fraction of the objects' points that lie where the map has been, each counted by its returns; 0
    /// without points.
    #[must_use]
    pub fn coverage(&self) -> f64 {
        let (mut known, mut all) = (0.0, 0.0);
        for (point, here) in self.points.iter().zip(&self.here) {
            all += f64::from(point.vote);
            known += if *here > UNKNOWN { f64::from(point.vote) } else { 0.0 };
        }
        if all > 0.0 { known / all } else { 0.0 }
    }
}
