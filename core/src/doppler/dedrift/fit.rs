//! The error of odometry's velocity, from what the radars see and how they may err.
//!
//! Detections of one radar are not independent: a mount that is turned by half a degree turns all of them, and at
//! 17 m/s looks like 0.15 m/s to the left in every scan. So each radar's own errors are unknowns, too, with priors:
//! they take what they can explain, and what is left says something of odometry.
//!
//! Nor are detections all that errs: of a radar with a thousand of them, odometry's noise from one estimate to the next is
//! most of what estimates scatter by. So the scatter is what they are weighed by. Priors count against it: weighed by the
//! detections alone, noise would find gains and turns that nobody's radar has.

use nalgebra::{DMatrix, DVector, SMatrix, SVector, Vector3};

use super::line::{EstimateSpan, SCALE, SIZE as LINE, VelocityError};
use super::{Estimate, OdometryBias};
use crate::doppler::ego::{EgoConfig, Equation};
use crate::odometry::BodyVelocity;

/// Numbers of one radar's errors: mount's yaw, azimuth's gain, radial speed's gain.
const RADAR: usize = 3;
/// Rounds of reweighting.
const ROUNDS: usize = 4;
/// Degrees of freedom of what an estimate may be off: a jump of odometry or a bus beside the vehicle spoils one.
const TAIL: f64 = 4.0;
/// Median of the squared sigmas of three numbers.
const MEDIAN: f64 = 2.366;
/// Estimates that scatter by more than some sigmas more than they should: that is no noise any more.
const MAX_SPREAD: f64 = 25.0;

/// What was fitted.
pub(super) struct Fitted {
    /// The error of odometry's velocity.
    pub line: VelocityError,
    /// Its covariance, the radars' own errors marginalised.
    pub covariance: SMatrix<f64, LINE, LINE>,
    /// Whether the error is one that odometry may have, and most estimates lie along it.
    pub agrees: bool,
}

/// An estimate's part of the equations: over its velocity and one radar's errors, by radar.
struct Part {
    design: SMatrix<f64, 3, LINE>,
    /// Over the line's own numbers.
    line: Option<(SMatrix<f64, LINE, LINE>, VelocityError)>,
    radars: Vec<(usize, SMatrix<f64, 6, 6>, SVector<f64, 6>)>,
}

/// Fits the line; `None` where the equations cannot be solved.
pub(super) fn fitted(
    estimates: &[(Estimate, BodyVelocity)],
    radars: usize,
    span: &EstimateSpan,
    ego: &EgoConfig,
    bias: &OdometryBias,
) -> Option<Fitted> {
    let parts: Vec<_> =
        estimates.iter().map(|(e, odometric)| Part::of(e, odometric, span, ego, bias)).collect();
    let prior = prior(radars, ego, bias);
    let slip = slip(estimates, span, ego);
    let (mut spread, mut weights) = (1.0, vec![1.0; parts.len()]);
    let mut solved = None;
    for _ in 0..ROUNDS {
        let (mut information, mut sum) = (DMatrix::from_diagonal(&prior), DVector::zeros(prior.len()));
        slip.add_to(1.0, &mut information, &mut sum);
        for (part, weight) in parts.iter().zip(&weights) {
            part.add_to(weight / spread, &mut information, &mut sum);
        }
        let cholesky = information.cholesky()?;
        let solution = cholesky.solve(&sum);
        let distances: Vec<_> = parts.iter().map(|part| part.distance(&solution)).collect();
        spread = (median(distances.clone()) / MEDIAN).clamp(1.0, MAX_SPREAD);
        for (distance, weight) in distances.iter().zip(&mut weights) {
            *weight = (TAIL + 3.0) / (TAIL + distance / spread).max(TAIL + 3.0);
        }
        solved = Some((cholesky.inverse(), solution));
    }
    let (covariance, solution) = solved?;
    let line = VelocityError::from_iterator(solution.iter().take(LINE).copied());
    let sigmas = line.iter().zip(prior.iter()).map(|(value, weight)| value * value * weight).sum::<f64>();
    let apart = weights.iter().filter(|weight| **weight < APART_WEIGHT).count();
    Some(Fitted {
        line,
        covariance: covariance.fixed_view::<LINE, LINE>(0, 0).into_owned(),
        agrees: sigmas <= MAX_SQUARED_SIGMAS && APART_SHARE * apart <= weights.len(),
    })
}

/// An error of seven numbers lies farther out once in a thousand.
const MAX_SQUARED_SIGMAS: f64 = 24.3;
/// An estimate of less weight lies apart from the line: some 5 sigma.
const APART_WEIGHT: f64 = 0.25;
/// One in so many estimates may lie apart.
const APART_SHARE: usize = 4;

fn prior(radars: usize, ego: &EgoConfig, bias: &OdometryBias) -> DVector<f64> {
    let axes = [bias.velocity_mps, bias.left_mps, bias.yaw_rate_radps];
    let own = [ego.mount_yaw_rad, ego.azimuth_gain, ego.speed_gain];
    let odometry = axes.iter().cycle().take(SCALE).chain([&bias.scale]);
    let sigmas = odometry.chain(own.iter().cycle().take(RADAR * radars));
    DVector::from_iterator(LINE + RADAR * radars, sigmas.map(|sigma| sigma.max(1e-9).powi(-2)))
}

fn median(mut values: Vec<f64>) -> f64 {
    let middle = values.len() / 2;
    if values.is_empty() { 0.0 } else { *values.select_nth_unstable_by(middle, f64::total_cmp).1 }
}

/// A tyre that holds a metre per second squared to the side slips by so many radians.
const SLIP_RAD_PER_MPS2: f64 = 0.01;

/// That the rear axle hardly slides, as one equation: it errs alike all the time, by the axis of the body that is not
/// the direction of travel, and in bends by the slip of the tyres.
fn slip(estimates: &[(Estimate, BodyVelocity)], span: &EstimateSpan, ego: &EgoConfig) -> Part {
    let (mut information, mut sum) = (SMatrix::zeros(), VelocityError::zeros());
    for (estimate, v) in estimates {
        let turned_rad = ego.mount_yaw_rad.hypot(SLIP_RAD_PER_MPS2 * v.forward_mps * v.yaw_rate_radps);
        let weight = ego.sigma_left_mps.hypot(turned_rad * v.forward_mps).powi(-2) / estimates.len() as f64;
        let row = span.design(estimate.time_us, v).row(1).transpose();
        information += row * row.transpose() * weight;
        sum -= row * v.left_mps * weight;
    }
    Part { design: SMatrix::zeros(), radars: Vec::new(), line: Some((information, sum)) }
}

impl Part {
    fn of(
        estimate: &Estimate,
        odometric: &BodyVelocity,
        span: &EstimateSpan,
        ego: &EgoConfig,
        bias: &OdometryBias,
    ) -> Self {
        let v = Vector3::new(odometric.forward_mps, odometric.left_mps, odometric.yaw_rate_radps);
        let own = &estimate.standing.velocity.velocity;
        let own = Vector3::new(own.forward_mps, own.left_mps, own.yaw_rate_radps);
        let equations = &estimate.standing.equations;
        // The residuals show errors larger than stated; smaller ones are luck.
        let squares: f64 = equations.iter().map(|e| (e.residual(&own) / ego.sigma_mps).powi(2)).sum();
        let spread = (squares / equations.len().saturating_sub(3).max(1) as f64).max(1.0);
        let weight = 1.0 / (ego.sigma_mps.powi(2) * spread * bias.alike);
        let mut radars: Vec<(usize, SMatrix<f64, 6, 6>, SVector<f64, 6>)> = Vec::new();
        for Equation { sensor, row, turning, azimuth_rad, towards_mps } in equations {
            let turned = -turning.dot(&v);
            let all =
                SVector::<f64, 6>::from([row.x, row.y, row.z, turned, azimuth_rad * turned, row.dot(&v)]);
            let index = radars.iter().position(|(s, ..)| s == sensor).unwrap_or_else(|| {
                radars.push((*sensor, SMatrix::zeros(), SVector::zeros()));
                radars.len() - 1
            });
            let (_, information, sum) = &mut radars[index];
            *information += weight * all * all.transpose();
            *sum += weight * (towards_mps - row.dot(&v)) * all;
        }
        Self { design: span.design(estimate.time_us, odometric), line: None, radars }
    }

    /// Adds its equations, spread over the line's numbers and the radars'.
    fn add_to(&self, weight: f64, information: &mut DMatrix<f64>, sum: &mut DVector<f64>) {
        if let Some((part, right)) = &self.line {
            let mut view = information.fixed_view_mut::<LINE, LINE>(0, 0);
            view += part * weight;
            let mut view = sum.fixed_view_mut::<LINE, 1>(0, 0);
            view += right * weight;
        }
        for (sensor, part, right) in &self.radars {
            let at = LINE + RADAR * sensor;
            let (rows, own) = (part.fixed_view::<3, 3>(0, 0), part.fixed_view::<3, 3>(3, 3));
            let cross = self.design.transpose() * part.fixed_view::<3, 3>(0, 3) * weight;
            let mut view = information.fixed_view_mut::<LINE, LINE>(0, 0);
            view += self.design.transpose() * rows * self.design * weight;
            let mut view = information.fixed_view_mut::<3, 3>(at, at);
            view += own * weight;
            let mut view = information.fixed_view_mut::<LINE, 3>(0, at);
            view += cross;
            let mut view = information.fixed_view_mut::<3, LINE>(at, 0);
            view += cross.transpose();
            let mut view = sum.fixed_view_mut::<LINE, 1>(0, 0);
            view += self.design.transpose() * right.fixed_view::<3, 1>(0, 0) * weight;
            let mut view = sum.fixed_view_mut::<3, 1>(at, 0);
            view += right.fixed_view::<3, 1>(3, 0) * weight;
        }
    }

    /// How far its velocity lies from a solution, squared sigmas of three numbers.
    fn distance(&self, solution: &DVector<f64>) -> f64 {
        let line = self.design * VelocityError::from_iterator(solution.iter().take(LINE).copied());
        let (mut information, mut sum) = (nalgebra::Matrix3::identity() * 1e-3, Vector3::zeros());
        for (sensor, part, right) in &self.radars {
            let own = solution.fixed_view::<3, 1>(LINE + RADAR * sensor, 0);
            let rows = part.fixed_view::<3, 3>(0, 0);
            information += rows;
            sum += right.fixed_view::<3, 1>(0, 0) - rows * line - part.fixed_view::<3, 3>(0, 3) * own;
        }
        information.cholesky().map_or(0.0, |c| sum.dot(&c.solve(&sum)))
    }
}
