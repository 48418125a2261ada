//! What scans say of one radar, summed by stretches of time.
//!
//! Detections of one scan are not independent, nor are scans of one second: they see the same structure, and share
//! odometry's error. So the covariance comes from the stretches themselves (a delete-one jackknife): how much does the
//! solution move when one of them is left out?

use std::collections::VecDeque;

use nalgebra::SMatrix;

use super::CalibrationConfig;
use super::equation::ScanEquations;
use super::solution::{SIZE, Solution, Vector, prior_sigmas};

type Information = SMatrix<f64, SIZE, SIZE>;

/// Stretches below which their spread is not believed alone.
const FEW_STRETCHES: f64 = 10.0;

/// One stretch's normal equations.
#[derive(Debug, Clone)]
struct Stretch {
    number: i64,
    scans: usize,
    information: Information,
    sum: Vector,
}

/// The evidence of one radar.
#[derive(Debug, Clone)]
pub struct Evidence {
    prior: Information,
    alike: f64,
    stretch_s: f64,
    kept: usize,
    stretches: VecDeque<Stretch>,
}

impl Evidence {
    /// None yet.
    #[must_use]
    pub fn new(config: &CalibrationConfig) -> Self {
        let prior = Vector::from(prior_sigmas(&config.prior)).map(|sigma| sigma.powi(-2));
        Self {
            prior: Information::from_diagonal(&prior),
            alike: config.alike.max(1.0),
            stretch_s: config.stretch_s.max(0.1),
            kept: config.stretches.max(2),
            stretches: VecDeque::new(),
        }
    }

    /// Takes one scan's equations; the oldest stretch is forgotten when there are too many.
    pub fn add(&mut self, time_us: i64, equations: &ScanEquations) {
        let number = time_us.div_euclid((self.stretch_s * 1e6) as i64);
        if self.stretches.back().is_none_or(|last| last.number != number) {
            if self.stretches.len() == self.kept {
                self.stretches.pop_front();
            }
            let (information, sum) = (Information::zeros(), Vector::zeros());
            self.stretches.push_back(Stretch { number, scans: 0, information, sum });
        }
        if let Some(stretch) = self.stretches.back_mut() {
            stretch.scans += 1;
            stretch.information += equations.information / self.alike;
            stretch.sum += equations.sum / self.alike;
        }
    }

    /// Scans it rests on.
    #[must_use]
    pub fn scans(&self) -> usize {
        self.stretches.iter().map(|stretch| stretch.scans).sum()
    }

    /// Seconds of driving it rests on, in whole stretches.
    #[must_use]
    pub fn driven_s(&self) -> f64 {
        self.stretches.len() as f64 * self.stretch_s
    }

    /// The calibration that explains it best.
    #[must_use]
    pub fn solved(&self) -> Solution {
        let (information, sum) = self.total();
        Solution(solve(&information, &sum))
    }

    /// The solution's covariance.
    #[must_use]
    pub fn covariance(&self) -> SMatrix<f64, SIZE, SIZE> {
        let (information, sum) = self.total();
        let Some(inverse) = information.try_inverse() else { return Information::zeros() };
        let solution = inverse * sum;
        // What the prior leaves open stays open, and few stretches may agree by chance.
        let count = self.stretches.len() as f64;
        let chance = FEW_STRETCHES / (FEW_STRETCHES + count);
        let mut covariance = inverse * (self.prior + (information - self.prior) * chance) * inverse;
        for stretch in &self.stretches {
            let without = solve(&(information - stretch.information), &(sum - stretch.sum));
            let moved = without - solution;
            covariance += moved * moved.transpose();
        }
        covariance
    }

    fn total(&self) -> (Information, Vector) {
        let start = (self.prior, Vector::zeros());
        self.stretches
            .iter()
            .fold(start, |(information, sum), stretch| (information + stretch.information, sum + stretch.sum))
    }
}

fn solve(information: &Information, sum: &Vector) -> Vector {
    information.cholesky().map_or_else(Vector::zeros, |factor| factor.solve(sum))
}
