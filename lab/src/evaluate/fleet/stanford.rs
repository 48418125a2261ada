//! The Stanford diagram: errors against protection levels.

use std::collections::BTreeSet;

use serde::Serialize;

use crate::evaluate::trust::record::TrustRecord;

/// A region of the diagram. Every usable answer lies in one.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Region {
    /// The level bounds the error, and the alert limit allows the level.
    Nominal,
    /// The level bounds the error, and exceeds the alert limit: the vehicle must not use the answer.
    Unavailable,
    /// The error exceeds the level, and the alert limit does not let that become a hazard.
    Misleading,
    /// The alert limit allows the level, and the error exceeds the alert limit.
    Hazardous,
}

impl Region {
    /// All regions, from harmless to harmful.
    pub const ALL: [Self; 4] = [Self::Nominal, Self::Unavailable, Self::Misleading, Self::Hazardous];

    /// Of an error and a level, metres.
    pub fn of(error_m: f64, level_m: f64, alert_limit_m: f64) -> Self {
        let available = level_m <= alert_limit_m;
        match (available, error_m > level_m) {
            (true, true) if error_m > alert_limit_m => Self::Hazardous,
            (_, true) => Self::Misleading,
            (true, false) => Self::Nominal,
            (false, false) => Self::Unavailable,
        }
    }
}

/// The answers that hit a region.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
pub struct Hits {
    /// The region.
    pub region: Region,
    /// Usable answers.
    pub answers: usize,
    /// Batches they are to.
    pub batches: usize,
}

/// The hits of each region, in the order of [`Region::ALL`].
pub fn hits(usable: &[&TrustRecord], alert_limit_m: f64) -> [Hits; 4] {
    Region::ALL.map(|region| {
        let here = |row: &&&TrustRecord| Region::of(row.error_m(), row.level_m(), alert_limit_m) == region;
        let here: Vec<_> = usable.iter().filter(here).collect();
        let batches: BTreeSet<_> = here.iter().map(|row| (row.seed, row.batch)).collect();
        Hits { region, answers: here.len(), batches: batches.len() }
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::evaluate::trust::record::USABLE;

    /// Catches: regions that overlap, and an error beyond the level that an unavailable answer hides.
    #[test]
    fn every_pair_lies_in_the_region_that_the_diagram_shows() {
        let of = |error_m, level_m| Region::of(error_m, level_m, 1.0);
        assert_eq!([of(0.2, 0.5), of(0.5, 0.5), of(1.0, 1.0)], [Region::Nominal; 3]);
        assert_eq!([of(0.2, 1.1), of(1.2, 1.3)], [Region::Unavailable; 2]);
        assert_eq!([of(0.6, 0.5), of(1.0, 0.5), of(1.5, 1.3)], [Region::Misleading; 3]);
        assert_eq!(of(1.1, 1.0), Region::Hazardous);
        // A level that nothing bounds is not one to use.
        assert_eq!([of(0.2, f64::INFINITY), of(0.2, f64::NAN)], [Region::Unavailable; 2]);
    }

    /// Catches: priors of one batch counted as so many batches.
    #[test]
    fn hits_are_counted_by_answer_and_by_batch() {
        let row = |batch: usize, along_m: f64| TrustRecord {
            batch,
            along_m,
            verdict: USABLE,
            level_along_m: 0.5,
            ..TrustRecord::default()
        };
        let rows = [row(0, 0.1), row(0, 0.2), row(1, 0.6), row(1, 3.0)];
        let hits = hits(&rows.iter().collect::<Vec<_>>(), 1.0);
        assert_eq!(hits.map(|hits| (hits.answers, hits.batches)), [(2, 1), (0, 0), (1, 1), (1, 1)]);
    }
}
