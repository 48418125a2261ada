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

impl Default for DriftPrior {
    /// 10 cm and half a degree in 5 s: the drift that remains when radial speeds have corrected the odometry (see
    /// [`crate::doppler::dedrift`]). The prior's tail is heavy, so that worse odometry is estimated, too. With a
    /// wider middle parked cars, which differ from day to day, distort the batch.
    fn default() -> Self {
        Self { position_mps: 0.02, yaw_radps: 0.1_f64.to_radians(), temperature: 3.0 }
    }
}

/// A batch whose scans may move against each other, as odometry drifts.
#[derive(Default)]
pub struct DriftRefiner {
    /// Points relative to the body's position when it saw them, in the axes of the batch's frame.
    points: Vec<WeightedPoint>,
    spans: Vec<RigidSpan>,
    duration_s: f64,
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

    /// Refines a candidate further, over the pose and the drift. The answer is the pose at the reference time.
    #[must_use]
    pub fn refine(
        &self,
        field: &ScoreField,
        prior: &Prior,
        from: &RefinedCandidate,
        drift: &DriftPrior,
    ) -> RefinedCandidate {
        let sigma =
            [drift.position_mps, drift.position_mps, drift.yaw_radps].map(|s| s * self.duration_s.max(0.1));
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
            information: here.information_of_the_end(),
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

    /// The information about the pose at the end of the batch; zero where this is no maximum.
    fn information_of_the_end(&self) -> Matrix3<f64> {
        let Some(covariance) = (-self.curvature).cholesky().map(|c| c.inverse()) else {
            return Matrix3::zeros();
        };
        let block = |row: usize, column: usize| covariance.fixed_view::<3, 3>(row, column).into_owned();
        let end = block(0, 0) + (block(0, 3) + block(3, 0)) * 0.5 + block(3, 3) * 0.25;
        end.cholesky().map_or_else(Matrix3::zeros, |c| c.inverse())
    }
}
