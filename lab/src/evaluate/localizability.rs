//! What the map alone expects of a fix, beside the fix.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::sync::Arc;

use echofix_core::align::Search;
use echofix_core::align::localizability::{Assessor, REACH_M};
use echofix_core::align::verdict::Integrity;
use echofix_core::point::MapPoint;
use echofix_core::window::MapSquare;
use echofix_server::locating::expected_word;
use serde_json::{Value, json};

use super::cells::{self, NET};
use super::condition::Condition;
use super::epoch::Epoch;
use super::groups::{of_method, usable};
use super::map::Movers;
use super::method::{MethodName, Windows};
use super::record::EpochRecord;
use super::simulated::is_scene;
use super::statistics::rank;
use super::world::EvaluationWorld;

/// Predicts fixes from the map, with the buffers of one thread.
pub struct Forecaster {
    windows: Arc<Windows>,
    assessor: Assessor,
}

impl Forecaster {
    /// Predicts from the prepared maps that the methods use, too.
    pub fn new(windows: &Arc<Windows>) -> Self {
        Self { windows: Arc::clone(windows), assessor: Assessor::default() }
    }

    /// Adds the prediction at the true position to an epoch's rows of the headline's condition.
    ///
    /// # Errors
    /// When the world has no such map.
    pub fn add(
        &mut self,
        world: &EvaluationWorld,
        epoch: &Epoch,
        base: &Condition,
        rows: &mut [EpochRecord],
    ) -> anyhow::Result<()> {
        let Some(truth) = world.truth.at(epoch.time_us) else { return Ok(()) };
        let map = world.map(base.contributors, Movers::Excluded)?;
        let (search, integrity) = (Search::default(), Integrity::default());
        let position = MapPoint::of(&truth);
        let square = MapSquare::around(map.zone(), position, search.extent_m, REACH_M);
        let tiles = self.windows.weights(map, square);
        let here = self.assessor.assess(square, &tiles, position, &search, &integrity);
        let noise = here.sigma_horizontal_m().powi(2) - 2.0 * here.map_m2;
        for row in rows.iter_mut().filter(|row| row.condition == *base) {
            row.forecast = expected_word(here.expected(&integrity));
            row.forecast_m = Some(noise.max(0.0).sqrt());
            row.forecast_weakest_m = Some(here.weakest_m());
            row.forecast_margin = Some(here.margin);
        }
        Ok(())
    }
}

/// Number of groups into which fixes are divided by their expected sigma, all of one size.
const BINS: usize = 5;

/// The section of the report.
#[must_use]
pub fn section(rows: &[EpochRecord], base: &Condition) -> String {
    let rows = forecast(rows, base);
    let streets: Vec<&EpochRecord> = rows.iter().copied().filter(|row| !is_scene(row.site_kind)).collect();
    let correlated = rank(&streets).map_or("-".to_owned(), |value| format!("{value:.2}"));
    [
        "## Localizability\n\nThe map alone predicts what a fix at the true position will be, from how well its structure fits itself when shifted. The tables compare this prediction with the fixes that were made. Towns, sorted by the expected sigma, a fifth of the fixes in each line. Both sides are without the map's own error, because it does not depend on the structure at a position:\n",
        &by_sigma(&streets),
        &format!("Rank correlation of expected sigma and realised error: {correlated}.\n"),
        "Scenes with many positions that look alike, and towns: what was expected, and what the fixes were.\n",
        &by_site_kind(&rows),
    ]
    .join("\n")
}

/// The figures as JSON.
#[must_use]
pub fn figures(rows: &[EpochRecord], base: &Condition) -> Value {
    let rows = forecast(rows, base);
    let streets: Vec<&EpochRecord> = rows.iter().copied().filter(|row| !is_scene(row.site_kind)).collect();
    let mistaken = |scene: bool| {
        let of = rows.iter().filter(|row| is_scene(row.site_kind) == scene);
        let usable = of.clone().filter(|row| row.forecast == "USABLE").count();
        json!({ "fixes": of.count(), "expected_usable": usable })
    };
    json!({ "rank_correlation": rank(&streets), "streets": mistaken(false), "scenes": mistaken(true) })
}

/// The service's fixes that have a prediction.
fn forecast<'a>(rows: &'a [EpochRecord], base: &Condition) -> Vec<&'a EpochRecord> {
    let predicted: Vec<&EpochRecord> =
        rows.iter().filter(|row| row.condition == *base && !row.forecast.is_empty()).collect();
    of_method(&predicted, MethodName::Echofix.word())
}

/// Rank correlation of expected sigma and realised error, over the usable fixes.
fn rank(rows: &[&EpochRecord]) -> Option<f64> {
    let pairs = rows.iter().filter(|row| row.usable).filter_map(|row| Some((row.forecast_m?, row.net_m?)));
    rank::correlation(&pairs.collect::<Vec<_>>())
}

fn by_sigma(rows: &[&EpochRecord]) -> String {
    let mut sorted: Vec<&EpochRecord> = rows.to_vec();
    sorted.sort_by(|a, b| a.forecast_m.unwrap_or_default().total_cmp(&b.forecast_m.unwrap_or_default()));
    let mut table = "| expected sigma, cm | fixes | realised error of usable fixes, cm | 95 % over expected sigma | usable | wrong by > 1 m |\n|---|---|---|---|---|---|\n".to_owned();
    for bin in sorted.chunks(sorted.len().div_ceil(BINS).max(1)) {
        let sigma = |row: &EpochRecord| row.forecast_m.unwrap_or_default();
        let (low, high) = (sigma(bin[0]), sigma(bin[bin.len() - 1]));
        let usable = usable(bin);
        let (p95, middle) = (cells::figures(&usable, NET), sigma(bin[bin.len() / 2]));
        let ratio = p95.get(1).map_or("-".to_owned(), |p95| format!("{:.1}", p95.value / middle));
        let _ = writeln!(
            table,
            "| {:.1} to {:.1} | {} | {} | {ratio} | {} | {} |",
            100.0 * low,
            100.0 * high,
            bin.len(),
            cells::cell(&usable, NET, 100.0, 1),
            cells::percent(bin, |row| row.usable),
            cells::percent(bin, EpochRecord::wrong),
        );
    }
    table
}

fn by_site_kind(rows: &[&EpochRecord]) -> String {
    let site_kinds: BTreeSet<&str> = rows.iter().map(|row| row.site_kind).collect();
    let mut table = "| town or scene | fixes | expected usable | expected ambiguous | expected too little | usable | wrong by > 1 m | wrong where usable was expected |\n|---|---|---|---|---|---|---|---|\n".to_owned();
    for site_kind in site_kinds {
        let here: Vec<&EpochRecord> = rows.iter().copied().filter(|row| row.site_kind == site_kind).collect();
        let expected = |word| cells::percent(&here, |row| row.forecast == word);
        let trusted: Vec<&EpochRecord> =
            here.iter().copied().filter(|row| row.forecast == "USABLE").collect();
        let _ = writeln!(
            table,
            "| {site_kind} | {} | {} | {} | {} | {} | {} | {} |",
            here.len(),
            expected("USABLE"),
            expected("AMBIGUOUS"),
            expected("TOO_LITTLE_STRUCTURE"),
            cells::percent(&here, |row| row.usable),
            cells::percent(&here, EpochRecord::wrong),
            cells::percent(&trusted, EpochRecord::wrong),
        );
    }
    table
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(site_kind: &'static str, forecast: &'static str, sigma_m: f64, error_m: f64) -> EpochRecord {
        let (net_m, forecast_m) = (Some(error_m), Some(sigma_m));
        let of = EpochRecord {
            site_kind,
            forecast,
            forecast_m,
            net_m,
            along_m: error_m,
            ..EpochRecord::default()
        };
        EpochRecord { usable: error_m < 1.0, method: MethodName::Echofix.word(), ..of }
    }

    /// Catches: groups that are not sorted by the expected sigma, and scenes that count as towns.
    #[test]
    fn what_was_expected_is_set_beside_what_came() {
        let base = Condition::default();
        let mut rows: Vec<EpochRecord> =
            (1..=10).map(|k| row("town", "USABLE", 0.01 * f64::from(k), 0.02 * f64::from(k))).collect();
        rows.reverse();
        rows.push(row("tunnel", "AMBIGUOUS", 0.9, 3.0));
        rows.push(EpochRecord { forecast: "", ..row("town", "", 0.5, 0.1) });
        let figures = figures(&rows, &base);
        assert!((figures["rank_correlation"].as_f64().unwrap() - 1.0).abs() < 1e-12);
        assert_eq!(figures["scenes"], json!({ "fixes": 1, "expected_usable": 0 }));
        assert_eq!(figures["streets"], json!({ "fixes": 10, "expected_usable": 10 }));
        let text = section(&rows, &base);
        let (first, last) = (text.find("| 1.0 to 2.0 | 2 |"), text.find("| 9.0 to 10.0 | 2 |"));
        assert!(first.is_some() && first < last, "{text}");
        assert!(text.contains("| tunnel | 1 |"), "{text}");
    }
}
