//! How often the fast search misses the exact maximum.

use std::collections::BTreeMap;
use std::fmt::Write as _;

use super::condition::{Condition, Experiment};
use super::method::MethodName;
use super::record::EpochRecord;
use super::section::Section;
use echofix_harness::percentiles::Percentiles;

/// Answers within this distance of each other came from the same candidate, metres.
const SAME_M: f64 = 0.1;

/// The answers of both searches to one request.
struct Pair<'a> {
    fast: &'a EpochRecord,
    exact: &'a EpochRecord,
}

impl Pair<'_> {
    fn apart_m(&self) -> f64 {
        (self.fast.along_m - self.exact.along_m).hypot(self.fast.cross_m - self.exact.cross_m)
    }

    fn missed(&self) -> bool {
        self.apart_m() > SAME_M
    }
}

/// The section of the report. Both searches had the same requests.
pub fn section(rows: &[&EpochRecord], base: Condition) -> Section {
    let pairs = pairs(rows, base);
    let mut by_site_kind: BTreeMap<&str, Vec<&Pair<'_>>> = BTreeMap::new();
    for pair in &pairs {
        by_site_kind.entry(pair.fast.site_kind).or_default().push(pair);
    }
    let columns = [
        "questions",
        "another candidate",
        "of them usable",
        "of those wrong by > 1 m",
        "usable by the exact search, lost by the fast one",
        "fast, ms 50 / 99 %",
        "exact, ms 50 / 99 %",
    ];
    let mut text = format!(
        "## Does the fast search find the maximum?\n\n`fast` examines the best candidates of a coarse image; `bounded` proves that it found the maximum. Answers more than {:.0} cm apart \
         came from different candidates.\n\n| | {} |\n|{}\n",
        100.0 * SAME_M,
        columns.join(" | "),
        "---|".repeat(columns.len() + 1)
    );
    for (site_kind, pairs) in &by_site_kind {
        let _ = writeln!(text, "| {site_kind} | {} |", line(pairs).join(" | "));
    }
    let all: Vec<_> = pairs.iter().collect();
    let _ = writeln!(text, "| all | {} |", line(&all).join(" | "));
    Section { experiment: Experiment::Misses, text, figures: Vec::new(), data: None }
}

fn line(pairs: &[&Pair<'_>]) -> [String; 7] {
    let missed: Vec<_> = pairs.iter().filter(|pair| pair.missed()).collect();
    let usable = missed.iter().filter(|pair| pair.fast.usable);
    let ms = |of: fn(&Pair<'_>) -> f64| {
        Percentiles::of(pairs.iter().map(|pair| of(pair)))
            .map_or_else(|| "-".to_owned(), |p| format!("{:.1} / {:.1}", p.p50, p.p99))
    };
    let lost = pairs.iter().filter(|pair| pair.exact.usable && !pair.fast.usable).count();
    [
        pairs.len().to_string(),
        missed.len().to_string(),
        usable.clone().count().to_string(),
        usable.filter(|pair| pair.fast.wrong()).count().to_string(),
        lost.to_string(),
        ms(|pair| pair.fast.ms),
        ms(|pair| pair.exact.ms),
    ]
}

fn pairs<'a>(rows: &[&'a EpochRecord], base: Condition) -> Vec<Pair<'a>> {
    let of = |name: MethodName| {
        let rows = rows.iter().copied().filter(move |r| r.method == name.word() && r.condition == base);
        rows.map(|row| ((&row.world, row.epoch, row.prior), row)).collect::<BTreeMap<_, _>>()
    };
    let (fast, exact) = (of(MethodName::Echofix), of(MethodName::Exact));
    let pair = |(question, exact)| Some(Pair { fast: fast.get(&question)?, exact });
    exact.into_iter().filter_map(pair).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn answers_to_one_question_are_compared() {
        let row = |method: MethodName, epoch: usize, along_m: f64, usable: bool| EpochRecord {
            site_kind: "town",
            method: method.word(),
            epoch,
            along_m,
            usable,
            ..EpochRecord::default()
        };
        let rows = [
            row(MethodName::Echofix, 0, 0.1, true),
            row(MethodName::Exact, 0, 0.15, true),
            row(MethodName::Echofix, 1, 3.0, true),
            row(MethodName::Exact, 1, 0.1, true),
            row(MethodName::Echofix, 2, 3.0, false),
            row(MethodName::Exact, 2, 0.1, true),
            row(MethodName::Exact, 3, 0.1, true),
        ];
        let shown = section(&rows.iter().collect::<Vec<_>>(), Condition::default()).text;
        assert!(shown.contains("| all | 3 | 2 | 1 | 1 | 1 |"), "{shown}");
    }
}
