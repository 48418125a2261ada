//! Localizes a drive on a map of the crowd.

use std::sync::Arc;

use echofix_core::drive::Drive;
use indicatif::ProgressBar;
use serde::Serialize;

use crate::evaluate::condition::Condition;
use crate::evaluate::floor::Floor;
use crate::evaluate::map::RadarMap;
use crate::evaluate::method::{MethodName, Windows};
use crate::evaluate::record::EpochRecord;
use crate::evaluate::run::{EvaluationPlan, run};
use crate::evaluate::statistics::bootstrap::{Estimate, ratios};
use crate::evaluate::world::{EvaluationWorld, grid_of};
use echofix_harness::percentiles::Percentiles;

/// Memory for the prepared windows of one map, mebibytes.
const WINDOWS_MIB: u64 = 256;

/// Localizes a drive on a map at `most` epochs, evenly spread. Each call has the same epochs and priors.
///
/// # Errors
/// When the drive has no known poses.
pub fn fixes(
    map: &RadarMap,
    drive: &Drive,
    method: MethodName,
    most: usize,
) -> anyhow::Result<Vec<EpochRecord>> {
    let grid = grid_of(drive)?;
    let base = Condition { contributors: map.key.contributors, ..Condition::default() };
    let kind_and_name = (crate::evaluate::simulated::TOWN, drive.vehicle.clone());
    let floor = Floor::of(&grid, &[])?;
    let world =
        EvaluationWorld::with_maps(map.key.world, kind_and_name, drive.clone(), floor, [map.clone()])?;
    let plan = EvaluationPlan {
        every_s: 1.0,
        epochs: most,
        swept: most,
        base,
        priors: 1,
        seed: 1,
        methods: vec![method],
        variants: Vec::new(),
        forecasts: false,
    };
    // The cache identifies maps by their key, which is the same for all maps of the crowd: each map needs a new cache.
    let windows: Arc<Windows> = Windows::new(WINDOWS_MIB);
    run(&world, &[base], &plan, &windows, &ProgressBar::hidden())
}

/// A pair of errors, metres, and its town and block.
pub type ErrorPair = ((f64, f64), (usize, usize));

/// The errors of a town's fixes and of those to compare with, which had the same requests, where neither is wrong: a wrong answer
/// says nothing about a map's accuracy, and is much larger than the errors that do.
pub fn right_pairs(town: usize, fixes: &[EpochRecord], others: &[EpochRecord]) -> Vec<ErrorPair> {
    let right = fixes.iter().zip(others).filter(|(ours, other)| !ours.wrong() && !other.wrong());
    right.map(|(ours, other)| ((ours.error_m(), other.error_m()), (town, ours.block))).collect()
}

/// How the 95 % errors of fixes compare with those of others: the ratio over all towns, and in that town where it is largest.
pub fn ratio_p95(towns: &[Vec<ErrorPair>]) -> (Option<Estimate>, f64) {
    let ratio = |pairs: &[_]| ratios(pairs, 0.95).map(|[p95, _]| p95);
    let each = towns.iter().filter_map(|pairs| ratio(pairs)).map(|ratio| ratio.value);
    (ratio(&towns.concat()), each.fold(f64::NAN, f64::max))
}

/// A summary of many fixes.
#[derive(Debug, Clone, Copy, PartialEq, Default, Serialize)]
pub struct Summary {
    /// Number of fixes.
    pub fixes: usize,
    /// The 95 % percentile of the horizontal errors, metres.
    pub p95_m: f64,
    /// Fraction of the fixes that is wrong by more than a metre.
    pub wrong: f64,
    /// Fraction of the fixes that is usable.
    pub usable: f64,
    /// Fraction of the usable fixes that is wrong by more than a metre.
    pub wrong_usable: f64,
}

impl Summary {
    /// The summary of some fixes.
    pub fn of(rows: &[EpochRecord]) -> Self {
        let fraction = |hits: usize, of: usize| hits as f64 / of.max(1) as f64;
        let usable = rows.iter().filter(|row| row.usable);
        let wrong_usable = usable.clone().filter(|row| row.wrong()).count();
        let usable = usable.count();
        Self {
            fixes: rows.len(),
            p95_m: Percentiles::of(rows.iter().map(EpochRecord::error_m)).map_or(f64::NAN, |p| p.p95),
            wrong: fraction(rows.iter().filter(|row| row.wrong()).count(), rows.len()),
            usable: fraction(usable, rows.len()),
            wrong_usable: fraction(wrong_usable, usable),
        }
    }

    /// Cells of a table's line: 95 % error, wrong, usable, wrong of the usable.
    pub fn cells(&self) -> String {
        let Self { p95_m, wrong, usable, wrong_usable, .. } = self;
        let percent = |fraction: f64| format!("{:.1} %", 100.0 * fraction);
        format!(
            "{:.0} | {} | {} | {}",
            100.0 * p95_m,
            percent(*wrong),
            percent(*usable),
            percent(*wrong_usable)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn wrong_ones_are_counted_among_all_and_among_the_usable() {
        let row = |k: usize| EpochRecord {
            along_m: if k < 10 { 3.0 } else { 0.2 },
            usable: k.is_multiple_of(2),
            ..EpochRecord::default()
        };
        let rows: Vec<_> = (0..100).map(row).collect();
        let summary = Summary::of(&rows);
        assert_eq!(summary.cells(), "300 | 10.0 % | 50.0 % | 10.0 %");
        assert_eq!(Summary::of(&[]).fixes, 0);
    }
}
