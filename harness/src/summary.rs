//! Figures of many fixes.

use std::collections::BTreeMap;

use serde::Serialize;

use crate::fix_record::FixRecord;
use crate::percentiles::Percentiles;
use crate::recording::LeftOut;
use crate::replay::ReplayedDrive;

/// Figures of many fixes.
#[derive(Debug, Clone, Serialize)]
pub struct FixSummary {
    /// Questions asked.
    pub asked: usize,
    /// Times at which the vehicle had nothing to ask with, by the reason.
    pub not_asked: BTreeMap<String, usize>,
    /// Detections that the vehicle's gates left out.
    pub left_out: LeftOut,
    /// Answers and refusals, by their status or reason.
    pub outcomes: BTreeMap<String, usize>,
    /// Fraction of the questions with a usable answer.
    pub usable_share: f64,
    /// Horizontal error of usable answers, metres.
    pub error_m: Option<Percentiles>,
    /// Heading error of usable answers, degrees.
    pub error_yaw_deg: Option<Percentiles>,
    /// Horizontal error of all answers, usable or not, metres.
    pub error_all_m: Option<Percentiles>,
    /// Heading error of all answers, usable or not, degrees.
    pub error_yaw_all_deg: Option<Percentiles>,
    /// Usable answers whose error exceeded a valid protection level: along, across, or of the heading.
    pub beyond_protection: usize,
    /// Mean squared error of usable answers over its variance, along the heading: 1 where the covariance is honest.
    pub nees_along: Option<f64>,
    /// The same across it.
    pub nees_cross: Option<f64>,
    /// The same of the heading.
    pub nees_yaw: Option<f64>,
    /// Milliseconds the service computed a fix.
    pub server_ms: Option<Percentiles>,
    /// Kilobytes of a request.
    pub request_kb: Option<Percentiles>,
}

impl ReplayedDrive {
    /// Its figures.
    pub fn summary(&self) -> FixSummary {
        let usable = || self.fixes.iter().filter(|f| f.usable);
        let mut outcomes = BTreeMap::new();
        for fix in &self.fixes {
            *outcomes.entry(fix.outcome.clone()).or_default() += 1;
        }
        let yaw = |f: &FixRecord| f.error_yaw_deg.map(f64::abs);
        let mean = |of: fn(&FixRecord) -> Option<f64>| {
            let values: Vec<f64> = usable().filter_map(of).collect();
            (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
        };
        FixSummary {
            asked: self.fixes.len(),
            not_asked: self.not_asked.clone(),
            left_out: self.left_out,
            outcomes,
            usable_share: usable().count() as f64 / self.fixes.len().max(1) as f64,
            error_m: Percentiles::of(usable().filter_map(FixRecord::error_m)),
            error_yaw_deg: Percentiles::of(usable().filter_map(yaw)),
            error_all_m: Percentiles::of(self.fixes.iter().filter_map(FixRecord::error_m)),
            error_yaw_all_deg: Percentiles::of(self.fixes.iter().filter_map(yaw)),
            beyond_protection: usable().filter(|fix| fix.is_beyond_protection()).count(),
            nees_along: mean(|fix| fix.nees_along),
            nees_cross: mean(|fix| fix.nees_cross),
            nees_yaw: mean(|fix| fix.nees_yaw),
            server_ms: Percentiles::of(self.fixes.iter().filter_map(|f| f.server_ms)),
            request_kb: Percentiles::of(self.fixes.iter().map(|f| f.request_bytes as f64 / 1e3)),
        }
    }
}
