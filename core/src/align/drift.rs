//! The odometry's drift as part of the answer.

use nalgebra::{Matrix3, SMatrix, SVector};

use super::refine::{MAX_STEP, MAX_STEPS, RefinedCandidate, STEP_PARTS, curvature, small};
use super::score::{ScoreField, Slope};
use super::thin::Thinner;
use super::{Prior, Search};
use crate::batch::Batch;
use crate::point::WeightedPoint;
use crate::pose::{Pose2, wrap_angle};

/// Seconds over which odometry is taken as rigid.
const SPAN_S: f64 = 1.0;
/// Degrees of freedom of the drift's prior, a Student-t: most odometry drifts little, some much.
const TAIL: f64 = 3.0;

/// The middle of the drift's prior as a fraction of the odometry's sigmas: they bound what may be, while most batches
/// drift less, and parked cars that differ from day to day would distort them. The covariance goes by the sigmas.
const CENTRE: f64 = 0.5;

type Vector6 = SVector<f64, 6>;
type Matrix6 = SMatrix<f64, 6, 6>;

/// What odometry may have drifted over a batch: one sigma.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriftPrior {
    /// Along each axis, metres a second.
    pub position_mps: f64,
    /// Radians a second.
    pub yaw_radps: f64,
    /// Independent returns count for this many detections: the scale between the score and the drift's prior.
    pub temperature: f64,
}

impl DriftPrior {
    /// Of the odometry that organised a batch. The prior's tail is heavy, so that worse odometry than was declared is
    /// estimated, too. Wider than needed lets parked cars, which differ from day to day, distort the batch.
    #[must_use]
    pub fn of(batch: &Batch) -> Self {
        Self {
            position_mps: batch.quality.velocity_sigma_mps(batch.mean_speed_mps()),
            yaw_radps: batch.quality.yaw_rate_sigma_radps(),
            temperature: 3.0,
        }
    }
}

impl DriftPrior {
    /// Covariance of the end pose by what of the drift is no straight line. A velocity's error that changes by its own
    /// sigma from the middle of a batch to the end bends the way into a parabola, whose end lies by a sixth of the
    /// drift beside the straight line through it; a yaw rate's bends it to the side, by a twelfth of the way it turns.
    fn bend(&self, duration_s: f64, travelled_m: f64, yaw_rad: f64) -> Matrix3<f64> {
        let along = (self.position_mps * duration_s / 6.0).powi(2);
        let aside = (self.yaw_radps * duration_s * travelled_m / 12.0).powi(2);
        let (s, c) = yaw_rad.sin_cos();
        let mut bend = Matrix3::from_diagonal(&[along + s * s * aside, along + c * c * aside, 0.0].into());
        bend[(0, 1)] = -s * c * aside;
        bend[(1, 0)] = bend[(0, 1)];
        bend
    }
}

/// A batch whose scans may move against each other, as odometry drifts.
#[derive(Default)]
pub struct DriftRefiner {
    /// Points relative to the body's position when it saw them, in the axes of the batch's frame.
    points: Vec<WeightedPoint>,
    spans: Vec<RigidSpan>,
    duration_s: f64,
    travelled_m: f64,
    thinner: Thinner,
    thinned: Vec<WeightedPoint>,
}

/// The points of a span of time, too short for odometry to drift within it.
struct RigidSpan {
    end: usize,
    /// The body's position then, ground metres in the batch's frame.
    body: [f64; 2],
    /// Fraction of the batch's duration before it, less a half: a drift that is zero in the middle
    /// of the batch hardly depends on the pose.
    phase: f64,
}

impl DriftRefiner {
    /// Loads a batch's points within reach, thinned to one a block within each span of time. Those
    /// of one block share one vote: what is seen for longer is no more certain.
    pub fn load(&mut self, batch: &Batch, search: &Search, block_m: f32) {
        self.points.clear();
        self.spans.clear();
        self.duration_s = batch.sightings.iter().map(|s| s.age_s).fold(0.0, f64::max);
        self.travelled_m = batch.travelled_m;
        let reach_m = search.extent_m as f32;
        let mut rest = &batch.sightings[..];
        while let Some(first) = rest.first() {
            let count = rest.iter().take_while(|s| first.age_s - s.age_s < SPAN_S).count().max(1);
            let (span, after) = rest.split_at(count);
            rest = after;
            let end = rest.first().map_or(batch.points.len(), |s| s.first);
            let middle = &span[count / 2];
            self.thinner.thin(&batch.points[first.first..end], reach_m, block_m, &mut self.thinned);
            self.points.extend_from_slice(&self.thinned);
            let phase = if self.duration_s > 0.0 { 0.5 - middle.age_s / self.duration_s } else { 0.0 };
            let body = [middle.body.x_m, middle.body.y_m];
            self.spans.push(RigidSpan { end: self.points.len(), body, phase });
        }
        self.thinner.share_votes(&mut self.points, reach_m, block_m);
        let mut from = 0;
        for span in &self.spans {
            let [bx, by] = span.body.map(|v| v as f32);
            for point in &mut self.points[from..span.end] {
                point.x_m -= bx;
                point.y_m -= by;
            }
            from = span.end;
        }
    }

    /// Refines a candidate further, over the pose and the drift. The answer is the pose at the reference time. Its
    /// information is in units of the score, to be multiplied by `score_temperature`: see [`RefinedCandidate::covariance`].
    #[must_use]
    pub fn refine(
        &self,
        field: &ScoreField,
        prior: &Prior,
        from: &RefinedCandidate,
        drift: &DriftPrior,
        score_temperature: f64,
    ) -> RefinedCandidate {
        let sigma = [drift.position_mps, drift.position_mps, drift.yaw_radps]
            .map(|s| CENTRE * s * self.duration_s.max(0.1));
        let stiff = sigma.map(|s| drift.temperature / (s * s));
        let start = from.correction;
        let mut at = Vector6::from([start.x_m, start.y_m, start.yaw_rad, 0.0, 0.0, 0.0]);
        let mut here = self.landscape(field, prior, &at, stiff, drift.temperature);
        for _ in 0..MAX_STEPS {
            let Some(step) = here.step() else { break };
            let rigid = [step[0], step[1], step[2]];
            if small([0, 1, 2].map(|i: usize| step[i] + 0.5 * step[i + 3])) && small(rigid) {
                break;
            }
            let excess = rigid.iter().zip(MAX_STEP).map(|(s, most)| (s / most).abs()).fold(1.0, f64::max);
            let step = step / excess;
            let Some((next, landscape)) = STEP_PARTS.into_iter().find_map(|part| {
                let next = at + step * part;
                let landscape = self.landscape(field, prior, &next, stiff, drift.temperature);
                (landscape.value > here.value).then_some((next, landscape))
            }) else {
                break;
            };
            (at, here) = (next, landscape);
        }
        // The reference time is the end of the batch: half the drift beyond its middle.
        let end = [0, 1, 2].map(|i: usize| at[i] + 0.5 * at[i + 3]);
        RefinedCandidate {
            correction: Pose2::new(end[0], end[1], wrap_angle(end[2])),
            score: here.weight / self.points.len().max(1) as f64,
            information: here.information_of_the_end(stiff, drift.temperature / score_temperature),
            beyond: drift.bend(self.duration_s, self.travelled_m, prior.pose.yaw_rad + end[2]),
            at_edge: from.at_edge,
        }
    }

    fn landscape(
        &self,
        field: &ScoreField,
        prior: &Prior,
        at: &Vector6,
        stiff: [f64; 3],
        temperature: f64,
    ) -> Landscape {
        let middle = prior.corrected(&Pose2::new(at[0], at[1], at[2]));
        let (s, c) = middle.yaw_rad.sin_cos();
        let (s, c) = (s * prior.scale, c * prior.scale);
        let mut sum = Landscape::default();
        let mut first = 0;
        for span in &self.spans {
            let [bx, by] = span.body;
            let arm = [c * bx - s * by, s * bx + c * by];
            let pose = Pose2::new(
                middle.x_m + arm[0] + span.phase * at[3],
                middle.y_m + arm[1] + span.phase * at[4],
                middle.yaw_rad + span.phase * at[5],
            );
            let slope = field.slope(&self.points[first..span.end], &pose, prior.scale);
            sum.add(&slope, arm, span.phase);
            first = span.end;
        }
        let squared: f64 = (0..3).map(|i: usize| stiff[i] * at[i + 3] * at[i + 3]).sum::<f64>() / temperature;
        sum.value -= 0.5 * temperature * (TAIL + 3.0) * (squared / TAIL).ln_1p();
        let held = (TAIL + 3.0) / (TAIL + squared);
        sum.held = held;
        for i in 0..3 {
            sum.gradient[i + 3] -= held * stiff[i] * at[i + 3];
            sum.curvature[(i + 3, i + 3)] -= held * stiff[i];
        }
        sum
    }
}

/// The score over (east, north, yaw) of the batch's middle and the drift of the same from its
/// beginning to its end.
#[derive(Default)]
struct Landscape {
    /// Score and prior of the drift.
    value: f64,
    /// Score alone.
    weight: f64,
    gradient: Vector6,
    curvature: Matrix6,
    /// Factor on the drift's stiffness in the curvature.
    held: f64,
}

impl Landscape {
    /// Adds a span whose body is at `arm` (map metres) from the batch's; `phase` is that of [`RigidSpan`].
    fn add(&mut self, slope: &Slope, arm: [f64; 2], phase: f64) {
        self.value += slope.value;
        self.weight += slope.value;
        let (g, h) = (nalgebra::Vector3::from(slope.gradient), curvature(slope));
        // The scan's pose by the batch's: turning the batch swings the arm.
        let swing = Matrix3::new(1.0, 0.0, -arm[1], 0.0, 1.0, arm[0], 0.0, 0.0, 1.0);
        let mut rigid = swing.transpose() * h * swing;
        rigid[(2, 2)] -= g[0] * arm[0] + g[1] * arm[1];
        let cross = swing.transpose() * h * phase;
        let mut add = |row: usize, column: usize, block: &Matrix3<f64>| {
            let mut view = self.curvature.fixed_view_mut::<3, 3>(row, column);
            view += block;
        };
        add(0, 0, &rigid);
        add(0, 3, &cross);
        add(3, 0, &cross.transpose());
        add(3, 3, &(h * phase * phase));
        let mut gradient = self.gradient.fixed_view_mut::<3, 1>(0, 0);
        gradient += swing.transpose() * g;
        let mut gradient = self.gradient.fixed_view_mut::<3, 1>(3, 0);
        gradient += g * phase;
    }

    /// Newton's step, where the score curves down in every direction.
    fn step(&self) -> Option<Vector6> {
        (-self.curvature).cholesky().map(|c| c.solve(&self.gradient))
    }

    /// The information about the pose at the end of the batch; zero where this is no maximum. The error of the
    /// drift's estimate is the score's, and what its prior takes off a drift as large as the odometry's sigmas. The prior's
    /// stiffness is the `hotter` one of the two temperatures times that of the score.
    fn information_of_the_end(&self, stiff: [f64; 3], hotter: f64) -> Matrix3<f64> {
        let Some(inverse) = (-self.curvature).cholesky().map(|c| c.inverse()) else {
            return Matrix3::zeros();
        };
        let mut spread = -self.curvature;
        for i in 0..3 {
            let held = self.held * stiff[i];
            spread[(i + 3, i + 3)] += hotter * held * held / (CENTRE * CENTRE * stiff[i]) - held;
        }
        let covariance = inverse * spread * inverse;
        let block = |row: usize, column: usize| covariance.fixed_view::<3, 3>(row, column).into_owned();
        let end = block(0, 0) + (block(0, 3) + block(3, 0)) * 0.5 + block(3, 3) * 0.25;
        end.cholesky().map_or_else(Matrix3::zeros, |c| c.inverse())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Catches: a covariance that takes the prior's pull for less than it is: the drift's stiffness is in units of another
    /// temperature than the score's.
    #[test]
    fn where_the_score_says_nothing_of_the_drift_the_answer_errs_by_half_of_it() {
        let (drift_m, drift_temperature, score_temperature) = (0.4, 3.0, 2.0);
        let stiff = [drift_temperature / (CENTRE * drift_m).powi(2); 3];
        let held = 1.7;
        let curvature = |i: usize| if i < 3 { -1e9 } else { -held * stiff[i - 3] };
        let landscape = Landscape {
            held,
            curvature: Matrix6::from_diagonal(&Vector6::from_iterator((0..6).map(curvature))),
            ..Landscape::default()
        };
        let information = landscape.information_of_the_end(stiff, drift_temperature / score_temperature);
        let variance = score_temperature / information[(0, 0)];
        assert!((variance.sqrt() - 0.5 * drift_m).abs() < 1e-4, "{variance}");
    }
}
