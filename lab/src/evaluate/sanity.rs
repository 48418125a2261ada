//! Bounds that every sound run keeps. A broken method, map or simulator exceeds them.

use anyhow::ensure;
use echofix_sim::Scene;

use super::condition::Condition;
use super::groups::{methods, of_method};
use super::record::EpochRecord;
use super::simulated::is_scene;
use echofix_harness::percentiles::Percentiles;

/// Largest median error of a method with 5 s batches, metres: twice the usual one.
const MEDIAN_M: f64 = 0.35;
/// Largest median error of the heading, degrees: a little more than half a step of the search.
const MEDIAN_DEG: f64 = 0.5;
/// Largest fraction of wrong answers: several times the usual one.
const MOST_WRONG: f64 = 0.08;
/// Largest fraction of wrong answers among the usable ones of a method with a verdict.
const MOST_WRONG_USABLE: f64 = 0.02;
/// Largest fraction of the answers that a method with a verdict may call usable in an open field.
const MOST_USABLE_IN_A_FIELD: f64 = 0.1;
/// Smallest fraction of the answers that a method must call usable in a town.
const LEAST_USABLE: f64 = 0.3;

/// Checks the headline's fixes.
///
/// # Errors
/// Names the first figure that is out of bounds.
pub fn check(rows: &[EpochRecord], base: &Condition) -> anyhow::Result<()> {
    let all = rows;
    let rows: Vec<&EpochRecord> =
        rows.iter().filter(|r| !is_scene(r.site_kind) && r.condition == *base).collect();
    ensure!(!rows.is_empty(), "not a single fix was asked for");
    for method in methods(&rows) {
        let rows = of_method(&rows, method);
        let fraction = |hits: usize, of: usize| hits as f64 / of.max(1) as f64;
        let position = Percentiles::of(rows.iter().map(|r| r.error_m()));
        let heading = Percentiles::of(rows.iter().map(|r| r.yaw_deg.abs()));
        let (Some(position), Some(heading)) = (position, heading) else { continue };
        ensure!(position.p50 < MEDIAN_M, "{method}: the median error is {:.2} m", position.p50);
        ensure!(heading.p50 < MEDIAN_DEG, "{method}: the median heading error is {:.2} deg", heading.p50);
        let wrong = fraction(rows.iter().filter(|r| r.wrong()).count(), rows.len());
        ensure!(wrong < MOST_WRONG, "{method}: {:.1} % are wrong by a metre", 100.0 * wrong);
        let usable: Vec<_> = rows.iter().filter(|r| r.usable).collect();
        let available = fraction(usable.len(), rows.len());
        ensure!(available > LEAST_USABLE, "{method}: only {:.0} % are usable", 100.0 * available);
        if usable.len() < rows.len() {
            let wrong = fraction(usable.iter().filter(|r| r.wrong()).count(), usable.len());
            ensure!(
                wrong < MOST_WRONG_USABLE,
                "{method}: {:.1} % of the usable answers are wrong by a metre",
                100.0 * wrong
            );
            let field: Vec<_> =
                all.iter().filter(|r| r.method == method && r.site_kind == Scene::OpenField.name()).collect();
            let usable = fraction(field.iter().filter(|r| r.usable).count(), field.len());
            ensure!(usable < MOST_USABLE_IN_A_FIELD, "{method}: an open field is called usable");
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(wrong: usize, usable: bool) -> Vec<EpochRecord> {
        let row = |k| EpochRecord {
            method: "m",
            along_m: if k < wrong { 5.0 } else { 0.1 },
            usable: usable || k >= wrong + 3,
            ..EpochRecord::default()
        };
        (0..100).map(row).collect()
    }

    #[test]
    fn sound_runs_pass_and_broken_ones_say_why() {
        let base = Condition::default();
        assert!(check(&rows(2, true), &base).is_ok());
        assert!(check(&rows(7, false), &base).is_ok());
        let reason = |rows: &[EpochRecord]| check(rows, &base).unwrap_err().to_string();
        assert!(reason(&rows(20, true)).contains("20.0 % are wrong"));
        assert!(reason(&rows(60, true)).contains("median error is 5.00 m"));
        assert!(reason(&[]).contains("not a single fix"));
        let mut field = rows(2, false);
        field.push(EpochRecord {
            method: "m",
            site_kind: Scene::OpenField.name(),
            usable: true,
            ..EpochRecord::default()
        });
        assert!(reason(&field).contains("open field"));
        let mut few = rows(0, true);
        few[1..].iter_mut().for_each(|r| r.usable = false);
        assert!(reason(&few).contains("only 1 % are usable"));
    }
}
