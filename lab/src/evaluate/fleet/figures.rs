//! Figures of many answers. Batches are the independent units: every interval draws whole batches, each with all of its
//! questions.

use std::collections::BTreeSet;

use serde::Serialize;

use super::stanford::{Hits, hits};
use crate::evaluate::cells::{FRACTIONS, with_rule_of_three};
use crate::evaluate::statistics::bootstrap::{Estimate, fraction, mean, percentiles};
use crate::evaluate::trust::record::TrustRecord;
use crate::evaluate::trust::tally::Tally;

/// Figures of one drive, or of all together.
#[derive(Debug, Clone, Serialize)]
pub struct Figures {
    /// Name of the drive.
    pub drive: String,
    /// Counts.
    pub tally: Tally,
    /// Fraction of the questions with a usable answer.
    pub usable: Option<Estimate>,
    /// Batches with a usable answer.
    pub usable_batches: usize,
    /// Fraction of the usable answers that is wrong.
    pub wrong: Option<Estimate>,
    /// Fraction of the usable answers that is beyond any of its levels.
    pub beyond: Option<Estimate>,
    /// Mean squared errors in sigmas of the usable answers that are not wrong: along, across, heading.
    pub nees: [Option<Estimate>; 3],
    /// Errors of the usable answers.
    pub errors: Errors,
    /// Hits of the regions of the Stanford diagram.
    pub stanford: [Hits; 4],
}

/// Errors that 50, 95 and 99 % of the answers do not exceed.
#[derive(Debug, Clone, Serialize)]
pub struct Errors {
    /// Horizontal, metres.
    pub horizontal_m: Vec<Estimate>,
    /// Along the heading, metres.
    pub along_m: Vec<Estimate>,
    /// Across it, metres.
    pub cross_m: Vec<Estimate>,
    /// Of the heading, degrees.
    pub heading_deg: Vec<Estimate>,
}

impl Errors {
    fn of(rows: &[&TrustRecord]) -> Self {
        let errors = |error: fn(&TrustRecord) -> f64| {
            percentiles(rows.iter().map(|row| (error(row).abs(), cluster(row))), &FRACTIONS)
        };
        Self {
            horizontal_m: errors(TrustRecord::error_m),
            along_m: errors(|row| row.along_m),
            cross_m: errors(|row| row.cross_m),
            heading_deg: errors(|row| row.yaw_deg),
        }
    }
}

impl Figures {
    /// Of some questions.
    pub fn of(drive: &str, rows: &[&TrustRecord], alert_limit_m: f64) -> Self {
        let usable: Vec<_> = rows.iter().copied().filter(|row| row.usable()).collect();
        let right: Vec<_> = usable.iter().copied().filter(|row| !row.wrong()).collect();
        let nees = |axis: usize| mean(right.iter().map(|row| (row.nees()[axis], cluster(row))));
        Self {
            drive: drive.to_owned(),
            tally: Tally::of(rows.iter().copied()),
            usable: rate(rows, TrustRecord::usable),
            usable_batches: batches(&usable),
            wrong: rate(&usable, TrustRecord::wrong),
            beyond: rate(&usable, |row| row.beyond().contains(&true)),
            nees: [0, 1, 2].map(nees),
            errors: Errors::of(&usable),
            stanford: hits(&usable, alert_limit_m),
        }
    }
}

/// The batch of a question: its drive and its number.
fn cluster(row: &TrustRecord) -> (u64, usize) {
    (row.seed, row.batch)
}

fn batches(rows: &[&TrustRecord]) -> usize {
    rows.iter().map(|row| cluster(row)).collect::<BTreeSet<_>>().len()
}

/// The fraction of the rows that are hits. Where none is, the interval is that of the rule of three over the batches.
fn rate(rows: &[&TrustRecord], hit: impl Fn(&TrustRecord) -> bool) -> Option<Estimate> {
    let found = fraction(rows.iter().map(|row| (hit(row), cluster(row))))?;
    Some(with_rule_of_three(found, batches(rows)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(batch: usize, along_m: f64) -> TrustRecord {
        TrustRecord { batch, along_m, ..TrustRecord::example() }
    }

    /// Catches: intervals that shrink with the priors of a batch, which are not independent.
    #[test]
    fn more_priors_of_a_batch_are_no_more_evidence() {
        let figures = |priors: usize| {
            let rows: Vec<_> =
                (0..40).flat_map(|k| vec![row(k, if k % 2 == 0 { 0.1 } else { 0.2 }); priors]).collect();
            Figures::of("d", &rows.iter().collect::<Vec<_>>(), 1.0)
        };
        let (one, many) = (figures(1), figures(25));
        assert_eq!((many.tally.batches, many.tally.questions), (40, 1000));
        let (nees, of_many) = (one.nees[0].unwrap(), many.nees[0].unwrap());
        assert!((nees.value - 2.5).abs() < 1e-9 && nees.high - nees.low > 0.5, "{nees:?}");
        assert!((nees.high - of_many.high).abs() < 1e-9 && (nees.low - of_many.low).abs() < 1e-9);
        // None of 40 batches is wrong: up to 7.5 % may be.
        assert_eq!(one.wrong, many.wrong);
        assert!((many.wrong.unwrap().high - 0.075).abs() < 1e-12);
        assert!((many.errors.horizontal_m[1].value - 0.2).abs() < 1e-12);
    }

    /// Catches: wrong answers that are counted among all questions, errors that only the verdict hides.
    #[test]
    fn rates_are_of_the_usable_answers() {
        let lost = TrustRecord { verdict: "LOST", ..row(2, 9.0) };
        let rows = [row(0, 0.1), row(1, 2.0), lost];
        let figures = Figures::of("d", &rows.iter().collect::<Vec<_>>(), 1.0);
        assert!((figures.usable.unwrap().value - 2.0 / 3.0).abs() < 1e-12);
        assert!((figures.wrong.unwrap().value - 0.5).abs() < 1e-12);
        assert_eq!((figures.usable_batches, figures.tally.beyond), (2, [1, 0, 0]));
        assert!((figures.nees[0].unwrap().value - 1.0).abs() < 1e-9);
        assert_eq!(figures.stanford.map(|hits| hits.answers), [1, 0, 0, 1]);
        let nothing = Figures::of("d", &[], 1.0);
        assert!(nothing.usable.is_none() && nothing.errors.horizontal_m.is_empty());
    }
}
