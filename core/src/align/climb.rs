//! Climbing a hill to its summit: below a cell, below a heading step, and with the odometry's drift
//! as part of the answer.

use nalgebra::{Matrix3, SMatrix, SVector};

use super::engine::Peak;
use super::score::{Field, Slope};
use super::thin::Thinner;
use super::{Prior, Search};
use crate::batch::Batch;
use crate::pose::{Pose2, wrap_angle};

/// Lengths that one step may have at most: metres, metres, radians.
const MAX_STEP: [f64; 3] = [0.3, 0.3, 0.015];
/// A step below this is the last one: metres, metres, radians.
const CONVERGED: [f64; 3] = [0.003, 0.003, 0.000_1];
/// Points that show the way.
const GUIDES: usize = 640;
const MAX_STEPS: usize = 8;
/// Seconds over which odometry is taken as rigid.
const STRETCH_S: f64 = 1.0;
/// Degrees of freedom of the drift's prior, a Student-t: most odometry drifts little, some much.
const TAIL: f64 = 3.0;

type Vector6 = SVector<f64, 6>;
type Matrix6 = SMatrix<f64, 6, 6>;

/// A summit.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Summit {
    /// Corrected pose minus prior: metres east and north, radians.
    pub correction: Pose2,
    /// Mean weight of the points there.
    pub score: f64,
    /// Negative second derivatives of the summed score over (east m, north m, yaw rad); the drift,
    /// if it was estimated, is marginalised out.
    pub information: Matrix3<f64>,
    /// True when the hill lay on the edge of the search.
    pub at_edge: bool,
}

impl Summit {
    /// Where there is no hill at all: the prior itself, which nothing holds.
    pub const NONE: Self = Self {
        correction: Pose2::IDENTITY,
        score: 0.0,
        information: Matrix3::new(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0),
        at_edge: false,
    };

    /// The foot of a hill: as high as it was found.
    #[must_use]
    pub fn foot(field: &Field, points: &[[f32; 3]], prior: &Prior, peak: &Peak) -> Self {
        let pose = prior.corrected(&peak.correction);
        let score = field.slope(points, &pose, prior.scale).value / points.len().max(1) as f64;
        Self { correction: peak.correction, score, information: Matrix3::zeros(), at_edge: peak.at_edge }
    }
}

/// Climbs a hill with rigid points, ground metres in the body's frame: most of the way with a part of
/// them, which shows it as well.
#[must_use]
pub fn climb(field: &Field, points: &[[f32; 3]], prior: &Prior, peak: &Peak) -> Summit {
    let from = [peak.correction.x_m, peak.correction.y_m, peak.correction.yaw_rad];
    let mut some = [[0.0_f32; 3]; GUIDES];
    let count = points.len().min(GUIDES);
    for (i, guide) in some[..count].iter_mut().enumerate() {
        *guide = points[i * points.len() / count];
    }
    let (foot, _) = ascend(field, &some[..count], prior, from);
    let (at, here) = ascend(field, points, prior, foot);
    Summit {
        correction: Pose2::new(at[0], at[1], wrap_angle(at[2])),
        score: here.value / points.len().max(1) as f64,
        information: -curvature(&here),
        at_edge: peak.at_edge,
    }
}

fn ascend(field: &Field, points: &[[f32; 3]], prior: &Prior, from: [f64; 3]) -> ([f64; 3], Slope) {
    let slope_at =
        |[x, y, yaw]: [f64; 3]| field.slope(points, &prior.corrected(&Pose2::new(x, y, yaw)), prior.scale);
    let (mut at, mut here) = (from, slope_at(from));
    for _ in 0..MAX_STEPS {
        let step = bounded(ascent(&here));
        // A step this small changes nothing: do not look where it leads.
        if small(step) {
            break;
        }
        let Some((next, slope)) = uphill(at, here.value, step, slope_at) else { break };
        (at, here) = (next, slope);
    }
    (at, here)
}

fn curvature(slope: &Slope) -> Matrix3<f64> {
    let [xx, xy, yy, xt, yt, tt] = slope.curvature;
    Matrix3::new(xx, xy, xt, xy, yy, yt, xt, yt, tt)
}

/// Newton's step where the score is a summit's, else one along the slope.
fn ascent(slope: &Slope) -> [f64; 3] {
    let gradient = nalgebra::Vector3::from(slope.gradient);
    if let Some(cholesky) = (-curvature(slope)).cholesky() {
        return cholesky.solve(&gradient).into();
    }
    // As long as half the longest step, in the metric of the longest steps.
    let scaled = [0, 1, 2].map(|i: usize| slope.gradient[i] * MAX_STEP[i]);
    let norm = scaled.iter().map(|v| v * v).sum::<f64>().sqrt().max(f64::MIN_POSITIVE);
    [0, 1, 2].map(|i: usize| 0.5 * MAX_STEP[i] * scaled[i] / norm)
}

fn bounded(step: [f64; 3]) -> [f64; 3] {
    let excess = step.iter().zip(MAX_STEP).map(|(s, most)| (s / most).abs()).fold(1.0, f64::max);
    step.map(|s| s / excess)
}

fn small(step: [f64; 3]) -> bool {
    step.iter().zip(CONVERGED).all(|(s, limit)| s.abs() < limit)
}

/// The first of the step, its half and its quarter that leads uphill.
fn uphill(
    at: [f64; 3],
    value: f64,
    step: [f64; 3],
    slope_at: impl Fn([f64; 3]) -> Slope,
) -> Option<([f64; 3], Slope)> {
    [1.0, 0.5, 0.25].into_iter().find_map(|share| {
        let next = [0, 1, 2].map(|i: usize| at[i] + share * step[i]);
        let slope = slope_at(next);
        (slope.value > value).then_some((next, slope))
    })
}

/// What odometry may have drifted over a batch: one sigma.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct DriftPrior {
    /// Along each axis, metres a second.
    pub position_mps: f64,
    /// Radians a second.
    pub yaw_radps: f64,
    /// Independent returns count for this many detections: what the drift's prior is weighed against.
    pub temperature: f64,
}

impl Default for DriftPrior {
    /// 10 cm and half a degree in 5 s: what is left when radial speeds have corrected the odometry (see
    /// [`crate::doppler::dedrift`]). The prior's tail is heavy, so that worse odometry is followed, too; a
    /// wider middle lets parked cars, which are never parked twice alike, pull the batch apart.
    fn default() -> Self {
        Self { position_mps: 0.02, yaw_radps: 0.1_f64.to_radians(), temperature: 3.0 }
    }
}

/// A batch whose scans may move against each other, as odometry drifts.
#[derive(Default)]
pub struct Flexible {
    /// Points relative to where the body was when it saw them, in the axes of the batch's frame.
    points: Vec<[f32; 3]>,
    stretches: Vec<Stretch>,
    duration_s: f64,
    thinner: Thinner,
    thinned: Vec<[f32; 3]>,
}

/// The points of a stretch of time, short enough for odometry not to drift within it.
struct Stretch {
    end: usize,
    /// Where the body was, ground metres in the batch's frame.
    body: [f64; 2],
    /// Share of the batch that had passed by then, less a half: a drift that is zero in the middle
    /// of the batch hardly depends on the pose.
    share: f64,
}

impl Flexible {
    /// Takes a batch's points within reach, thinned to one a block within each stretch of time. Those
    /// of one block share one vote: what is seen for long is no more certain.
    pub fn take(&mut self, batch: &Batch, search: &Search, block_m: f32) {
        self.points.clear();
        self.stretches.clear();
        self.duration_s = batch.sightings.iter().map(|s| s.age_s).fold(0.0, f64::max);
        let reach_m = search.extent_m as f32;
        let mut rest = &batch.sightings[..];
        while let Some(first) = rest.first() {
            let count = rest.iter().take_while(|s| first.age_s - s.age_s < STRETCH_S).count().max(1);
            let (stretch, after) = rest.split_at(count);
            rest = after;
            let end = rest.first().map_or(batch.points.len(), |s| s.first);
            let middle = &stretch[count / 2];
            self.thinner.thin(&batch.points[first.first..end], reach_m, block_m, &mut self.thinned);
            self.points.extend_from_slice(&self.thinned);
            let share = if self.duration_s > 0.0 { 0.5 - middle.age_s / self.duration_s } else { 0.0 };
            let body = [middle.body.x_m, middle.body.y_m];
            self.stretches.push(Stretch { end: self.points.len(), body, share });
        }
        self.thinner.share_votes(&mut self.points, reach_m, block_m);
        let mut from = 0;
        for stretch in &self.stretches {
            let [bx, by] = stretch.body.map(|v| v as f32);
            for point in &mut self.points[from..stretch.end] {
                *point = [point[0] - bx, point[1] - by, point[2]];
            }
            from = stretch.end;
        }
    }

    /// Climbs on from a rigid summit. The answer is the pose at the reference time.
    #[must_use]
    pub fn climb(&self, field: &Field, prior: &Prior, from: &Summit, drift: &DriftPrior) -> Summit {
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
            let Some((next, landscape)) = [1.0, 0.5, 0.25].into_iter().find_map(|share| {
                let next = at + step * share;
                let landscape = self.landscape(field, prior, &next, stiff, drift.temperature);
                (landscape.value > here.value).then_some((next, landscape))
            }) else {
                break;
            };
            (at, here) = (next, landscape);
        }
        // The reference time is the end of the batch: half the drift beyond its middle.
        let end = [0, 1, 2].map(|i: usize| at[i] + 0.5 * at[i + 3]);
        Summit {
            correction: Pose2::new(end[0], end[1], wrap_angle(end[2])),
            score: here.weight / self.points.len().max(1) as f64,
            information: here.information_of_the_end(),
            at_edge: from.at_edge,
        }
    }

    fn landscape(
        &self,
        field: &Field,
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
        for stretch in &self.stretches {
            let [bx, by] = stretch.body;
            let arm = [c * bx - s * by, s * bx + c * by];
            let pose = Pose2::new(
                middle.x_m + arm[0] + stretch.share * at[3],
                middle.y_m + arm[1] + stretch.share * at[4],
                middle.yaw_rad + stretch.share * at[5],
            );
            let slope = field.slope(&self.points[first..stretch.end], &pose, prior.scale);
            sum.add(&slope, arm, stretch.share);
            first = stretch.end;
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
    /// Adds a scan whose body is at `arm` (map metres) from the batch's.
    fn add(&mut self, slope: &Slope, arm: [f64; 2], share: f64) {
        self.value += slope.value;
        self.weight += slope.value;
        let (g, h) = (nalgebra::Vector3::from(slope.gradient), curvature(slope));
        // The scan's pose by the batch's: turning the batch swings the arm.
        let swing = Matrix3::new(1.0, 0.0, -arm[1], 0.0, 1.0, arm[0], 0.0, 0.0, 1.0);
        let mut rigid = swing.transpose() * h * swing;
        rigid[(2, 2)] -= g[0] * arm[0] + g[1] * arm[1];
        let cross = swing.transpose() * h * share;
        let mut add = |row: usize, column: usize, block: &Matrix3<f64>| {
            let mut view = self.curvature.fixed_view_mut::<3, 3>(row, column);
            view += block;
        };
        add(0, 0, &rigid);
        add(0, 3, &cross);
        add(3, 0, &cross.transpose());
        add(3, 3, &(h * share * share));
        let mut gradient = self.gradient.fixed_view_mut::<3, 1>(0, 0);
        gradient += swing.transpose() * g;
        let mut gradient = self.gradient.fixed_view_mut::<3, 1>(3, 0);
        gradient += g * share;
    }

    /// Newton's step, if this is a summit's.
    fn step(&self) -> Option<Vector6> {
        (-self.curvature).cholesky().map(|c| c.solve(&self.gradient))
    }

    /// The information about the pose at the end of the batch; zero where there is no summit.
    fn information_of_the_end(&self) -> Matrix3<f64> {
        let Some(covariance) = (-self.curvature).cholesky().map(|c| c.inverse()) else {
            return Matrix3::zeros();
        };
        let block = |row: usize, column: usize| covariance.fixed_view::<3, 3>(row, column).into_owned();
        let end = block(0, 0) + (block(0, 3) + block(3, 0)) * 0.5 + block(3, 3) * 0.25;
        end.cholesky().map_or_else(Matrix3::zeros, |c| c.inverse())
    }
}
