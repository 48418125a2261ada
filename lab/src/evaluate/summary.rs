//! The figures as JSON.

use serde_json::{Value, json};

use super::condition::{Condition, Experiment};
use super::groups::{methods, of_method};
use super::localizability;
use super::record::EpochRecord;
use super::simulated::is_scene;
use echofix_harness::percentiles::Percentiles;

/// Figures by experiment, condition and method; then the tables of the experiments with their own towns.
pub fn of(
    rows: &[EpochRecord],
    experiments: &[Experiment],
    base: Condition,
    crowds: &[usize],
    tables: Vec<(Experiment, Value)>,
) -> Value {
    let mut all = Vec::new();
    for experiment in experiments {
        if *experiment == Experiment::Localizability {
            all.push(
                json!({ "experiment": experiment.word(), "figures": localizability::figures(rows, &base) }),
            );
            continue;
        }
        for condition in experiment.conditions(base, crowds) {
            let streets = *experiment == Experiment::Ambiguity;
            let of_all = |r: &&EpochRecord| {
                let everywhere = matches!(experiment, Experiment::Headline | Experiment::Ambiguity);
                r.condition == condition && is_scene(r.site_kind) == streets && (everywhere || r.swept)
            };
            let rows: Vec<&EpochRecord> = rows.iter().filter(of_all).collect();
            for method in methods(&rows) {
                let name = condition.name(*experiment);
                let experiment = experiment.word();
                let figures = figures(&of_method(&rows, method));
                all.push(json!({
                    "experiment": experiment, "condition": name, "method": method, "figures": figures,
                }));
            }
        }
    }
    let tables = tables.into_iter();
    all.extend(tables.map(|(experiment, lines)| json!({ "experiment": experiment.word(), "lines": lines })));
    Value::Array(all)
}

fn figures(rows: &[&EpochRecord]) -> Value {
    let of = |quantity: fn(&EpochRecord) -> f64| Percentiles::of(rows.iter().map(|r| quantity(r)));
    let count = |hit: fn(&EpochRecord) -> bool| rows.iter().filter(|r| hit(r)).count();
    json!({
        "fixes": rows.len(),
        "horizontal_m": of(EpochRecord::error_m),
        "along_m": of(|r| r.along_m.abs()),
        "cross_m": of(|r| r.cross_m.abs()),
        "heading_deg": of(|r| r.yaw_deg.abs()),
        "offset_m": of(|r| r.offset_m),
        "offset_deg": of(|r| r.offset_deg),
        "wrong": count(EpochRecord::wrong),
        "usable": count(|r| r.usable),
        "wrong_usable": count(|r| r.usable && r.wrong()),
        "beyond_protection_usable": count(|r| r.usable && r.beyond_protection()),
        "ms": of(|r| r.ms),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_come_by_condition_and_method() {
        let base = Condition::default();
        let row = |method, site_kind, along_m| EpochRecord {
            method,
            site_kind,
            along_m,
            usable: true,
            ..EpochRecord::default()
        };
        let rows = [row("a", "town", 2.0), row("b", "town", 0.1), row("a", "tunnel", 3.0)];
        let tables = vec![(Experiment::Upload, json!([1]))];
        let all = of(&rows, &[Experiment::Headline, Experiment::Ambiguity], base, &[1], tables);
        let wrong: Vec<_> = (0..3).map(|k| all[k]["figures"]["wrong_usable"].as_u64().unwrap()).collect();
        assert_eq!(wrong, [1, 0, 1]);
        assert_eq!((&all[2]["experiment"], &all[2]["method"]), (&json!("ambiguity"), &json!("a")));
        assert_eq!(all[3], json!({ "experiment": "upload", "lines": [1] }));
    }
}
