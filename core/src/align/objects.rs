//! Do the objects in view prefer one pose to another?
//!
//! Returns of one object are not independent: a parked car that stands half a metre from where the map has
//! one moves all of its returns alike, however many they are. What is independent are objects. So the points
//! of a batch are grouped by squares of about an object's size, and each square says by how much its points weigh more
//! at one pose than at the other: the logarithm of the ratio of the two weights. The statements are summed and divided
//! by the root of the sum of their squares.
//!
//! That is a self-normalised sum: where no pose is preferred, each statement is as often positive as negative, and
//! the sum then exceeds x with a probability of at most exp(-x^2 / 2), whatever the statements' sizes, their
//! distributions and their number (Efron, "Student's t-test under symmetry conditions", 1969). No property of
//! a sensor, of a density of returns or of a map enters. It holds for any statement that changes its sign with the two
//! poses. Ratios say whether there is something at a pose, rather than how much: along an even wall or a row of cars
//! weights differ from metre to metre by accident, and differences of them drown the few gaps and edges that tell where
//! one is. Nor can a large object outvote many small ones, a lorry that parks where another one was mapped.
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
/// An object that weighs less than this fraction of what the objects weigh on average hardly weighs anything: ratios of
/// less are accidents.
const HARDLY: f64 = 0.5;
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
    /// What each object's points weigh at the two poses, those that the map knows at both.
    weighed: Vec<[f32; 2]>,
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
        self.weighed.clear();
        self.weighed.resize(count as usize, [0.0; 2]);
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
        self.weighed.fill([0.0; 2]);
        let weights = self.here.iter().zip(&self.there);
        let (mut known, mut shared) = (0.0, 0.0);
        for ((point, object), (here, there)) in self.points.iter().zip(&self.of_point).zip(weights) {
            known += if *here > UNKNOWN { f64::from(point.vote) } else { 0.0 };
            if *here > UNKNOWN && *there > UNKNOWN {
                shared += f64::from(point.vote);
                let [at_first, at_second] = &mut self.weighed[*object as usize];
                *at_first += point.vote * here;
                *at_second += point.vote * there;
            }
        }
        let (sum, objects) = self_normalised(&self.weighed);
        Preference { sum, objects, shared: if known > 0.0 { shared / known } else { 0.0 } }
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

/// The self-normalised sum of what objects say that weigh so much at the two poses, and the number of those that say
/// anything.
fn self_normalised(weighed: &[[f32; 2]]) -> (f64, usize) {
    let telling =
        || weighed.iter().filter(|[here, there]| here - there != 0.0).map(|both| both.map(f64::from));
    let (total, objects) =
        telling().fold((0.0, 0), |(total, n), [here, there]| (total + here + there, n + 1));
    let hardly = HARDLY * 0.5 * total / objects.max(1) as f64;
    let (mut sum, mut squared) = (0.0, 0.0);
    for [here, there] in telling() {
        let statement = ((here + hardly) / (there + hardly)).ln();
        sum += statement;
        squared += statement * statement;
    }
    (if squared > 0.0 { sum / squared.sqrt() } else { 0.0 }, objects)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a verdict that depends on how many returns a radar has, or on how they are counted.
    #[test]
    fn what_objects_say_does_not_depend_on_the_unit_of_their_weights() {
        let weighed: Vec<[f32; 2]> = (0..40).map(|i| [(i * 7 % 11) as f32, (i * 5 % 9) as f32]).collect();
        let (sum, objects) = self_normalised(&weighed);
        let many: Vec<_> = weighed.iter().map(|both| both.map(|w| 32.0 * w)).collect();
        let (sum_of_many, objects_of_many) = self_normalised(&many);
        assert!((sum - sum_of_many).abs() < 1e-9 && objects == objects_of_many, "{sum} {sum_of_many}");
        let turned: Vec<_> = weighed.iter().map(|[here, there]| [*there, *here]).collect();
        assert!((sum + self_normalised(&turned).0).abs() < 1e-9);
        assert_eq!(self_normalised(&[[3.0, 3.0], [0.0, 0.0]]), (0.0, 0));
    }

    /// Catches: an even wall whose weights differ from metre to metre and drown its ends, and a lorry that outvotes a street.
    #[test]
    fn what_is_there_or_not_says_more_than_how_much_there_is() {
        let wall = |i: usize| if i.is_multiple_of(2) { [1000.0, 800.0] } else { [800.0, 1000.0] };
        let ends = [[600.0, 0.0]; 8];
        let weighed: Vec<_> = (0..300).map(wall).chain(ends).collect();
        let (sum, _) = self_normalised(&weighed);
        // Differences: 1.2; their roots: 0.8.
        assert!(sum > 1.8, "{sum}");
        let street: Vec<_> = [[0.0, 20_000.0]].into_iter().chain([[100.0, 20.0]; 40]).collect();
        assert!(self_normalised(&street).0 > 0.0);
    }
}
