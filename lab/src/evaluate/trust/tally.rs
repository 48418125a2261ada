//! Figures of many questions.

use std::collections::{BTreeMap, BTreeSet};

use echofix_harness::percentiles::percentile;
use serde::Serialize;

use super::record::TrustRecord;

/// Figures of some questions.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Tally {
    /// Batches that were asked with.
    pub batches: usize,
    /// Questions: batches times priors.
    pub questions: usize,
    /// Usable answers.
    pub usable: usize,
    /// Usable answers that are wrong.
    pub wrong: usize,
    /// Batches with such an answer.
    pub wrong_batches: usize,
    /// Usable answers beyond their level: along, across, heading.
    pub beyond: [usize; 3],
    /// Usable answers beyond any level.
    pub beyond_any: usize,
    /// Mean squared error in sigmas of the usable answers that are not wrong: along, across, heading.
    pub nees: [f64; 3],
    /// Half of the errors of the usable answers are below, metres.
    pub p50_m: f64,
    /// 95 % of them are below, metres.
    pub p95_m: f64,
    /// 95 % of the heading's errors are below, degrees.
    pub p95_deg: f64,
    /// Answers by verdict.
    pub verdicts: BTreeMap<&'static str, usize>,
}

impl Tally {
    /// Of some questions.
    pub fn of<'a>(rows: impl IntoIterator<Item = &'a TrustRecord>) -> Self {
        let rows: Vec<_> = rows.into_iter().collect();
        let batch = |row: &TrustRecord| (row.family, row.seed, row.case.clone(), row.batch);
        let batches =
            |rows: &mut dyn Iterator<Item = &TrustRecord>| rows.map(batch).collect::<BTreeSet<_>>().len();
        let usable: Vec<_> = rows.iter().copied().filter(|row| row.usable()).collect();
        let right: Vec<_> = usable.iter().copied().filter(|row| row.on_map && !row.wrong()).collect();
        let on_map = || usable.iter().filter(|row| row.on_map);
        let mean = |axis: usize| right.iter().map(|row| row.nees()[axis]).sum::<f64>() / right.len() as f64;
        let beyond = |axis: usize| usable.iter().filter(|row| row.beyond()[axis]).count();
        let quantile = |values: &mut dyn Iterator<Item = f64>, fraction| {
            percentile(values, fraction).unwrap_or(f64::NAN)
        };
        let mut verdicts = BTreeMap::new();
        for row in &rows {
            *verdicts.entry(row.verdict).or_default() += 1;
        }
        Self {
            batches: batches(&mut rows.iter().copied()),
            questions: rows.len(),
            usable: usable.len(),
            wrong: rows.iter().filter(|row| row.wrong()).count(),
            wrong_batches: batches(&mut rows.iter().copied().filter(|row| row.wrong())),
            beyond: [0, 1, 2].map(beyond),
            beyond_any: usable.iter().filter(|row| row.beyond().contains(&true)).count(),
            nees: [0, 1, 2].map(mean),
            p50_m: quantile(&mut on_map().map(|row| row.error_m()), 0.5),
            p95_m: quantile(&mut on_map().map(|row| row.error_m()), 0.95),
            p95_deg: quantile(&mut on_map().map(|row| row.yaw_deg.abs()), 0.95),
            verdicts,
        }
    }

    /// Fraction of the answers that is usable.
    pub fn usable_rate(&self) -> f64 {
        self.usable as f64 / self.questions.max(1) as f64
    }

    /// Fraction of the questions whose answer is usable and wrong.
    pub fn wrong_rate(&self) -> f64 {
        self.wrong as f64 / self.questions.max(1) as f64
    }

    /// Fraction of the usable answers that is beyond a level.
    pub fn beyond_rate(&self) -> f64 {
        self.beyond_any as f64 / self.usable.max(1) as f64
    }

    /// The axis whose squared errors in sigmas are farthest from 1, by ratio: its mean.
    pub fn worst_nees(&self) -> f64 {
        let ratio = |nees: f64| if nees > 0.0 { nees.ln().abs() } else { 0.0 };
        self.nees
            .into_iter()
            .filter(|nees| nees.is_finite())
            .max_by(|a, b| ratio(*a).total_cmp(&ratio(*b)))
            .unwrap_or(f64::NAN)
    }
}

/// The tallies of one case, family by family.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct CaseTally {
    /// How was asked.
    pub case: String,
    /// All families together.
    pub all: Tally,
    /// Each family's.
    pub families: BTreeMap<&'static str, Tally>,
}

impl CaseTally {
    /// Of the questions of a case.
    pub fn of(case: &str, rows: &[TrustRecord]) -> Self {
        let rows: Vec<_> = rows.iter().filter(|row| row.case == case).collect();
        let mut families: BTreeMap<&'static str, Vec<&TrustRecord>> = BTreeMap::new();
        for row in &rows {
            families.entry(row.family).or_default().push(row);
        }
        let families = families.into_iter().map(|(family, rows)| (family, Tally::of(rows))).collect();
        Self { case: case.to_owned(), all: Tally::of(rows), families }
    }

    /// The mean over families of a figure, those left out where it is not a number.
    pub fn mean(&self, figure: impl Fn(&Tally) -> f64) -> f64 {
        let values: Vec<_> = self.families.values().map(figure).filter(|v| v.is_finite()).collect();
        values.iter().sum::<f64>() / values.len() as f64
    }

    /// The family with the largest figure, and the figure.
    pub fn worst(&self, figure: impl Fn(&Tally) -> f64) -> Option<(&'static str, f64)> {
        let figures = self.families.iter().map(|(family, tally)| (*family, figure(tally)));
        figures.filter(|(_, figure)| figure.is_finite()).max_by(|a, b| a.1.total_cmp(&b.1))
    }
}

#[cfg(test)]
mod tests {
    use super::super::record::USABLE;
    use super::*;

    fn row(family: &'static str, batch: usize, along_m: f64) -> TrustRecord {
        let verdict = if along_m < 5.0 { USABLE } else { "LOST" };
        TrustRecord { family, case: "right".to_owned(), batch, along_m, verdict, ..TrustRecord::example() }
    }

    /// Catches: priors of one batch counted as so many batches.
    #[test]
    fn batches_and_questions_are_counted_apart() {
        let rows = [row("a", 0, 0.1), row("a", 0, 2.0), row("a", 1, 9.0), row("b", 0, 0.2)];
        let tally = CaseTally::of("right", &rows);
        let Tally { batches, questions, usable, wrong, wrong_batches, beyond, .. } = tally.all;
        assert_eq!((batches, questions, usable, wrong, wrong_batches), (3, 4, 3, 1, 1));
        assert_eq!(beyond, [1, 0, 0]);
        assert!((tally.all.nees[0] - 2.5).abs() < 1e-9);
        assert_eq!(tally.worst(Tally::wrong_rate).unwrap().0, "a");
        assert!((tally.mean(Tally::usable_rate) - 5.0 / 6.0).abs() < 1e-9);
        assert_eq!(tally.all.verdicts, BTreeMap::from([("LOST", 1), (USABLE, 3)]));
    }
}
