//! The report, experiment by experiment: text, tables and figures.

use echofix_core::align::verdict::Integrity;

use super::condition::{Condition, Experiment};
use super::groups::{Groups, methods, of_method};
use super::method::{MethodName, RISK};
use super::plots::{Curve, Panel};
use super::record::EpochRecord;
use super::run::EvaluationPlan;
use super::section::{Figure, Section, under};
use super::statistics::ccdf::ccdf;
use super::statistics::roc::roc;
use super::tables;
use super::{ablation, localizability, misses};

/// The section of an experiment in the report.
pub fn section(
    experiment: Experiment,
    rows: &[EpochRecord],
    plan: &EvaluationPlan,
    crowds: &[usize],
) -> Section {
    let base = plan.base;
    let all: Vec<&EpochRecord> = rows.iter().collect();
    let named = |names: &[MethodName]| -> Vec<&EpochRecord> {
        let words: Vec<_> = names.iter().map(|name| name.word()).collect();
        all.iter().copied().filter(|row| words.contains(&row.method)).collect()
    };
    let compared = named(&plan.methods);
    match experiment {
        Experiment::Headline => headline(&compared, base),
        Experiment::Ambiguity => ambiguity(&compared, base),
        Experiment::Localizability => {
            let text = localizability::section(rows, &base);
            Section { experiment, text, figures: Vec::new(), data: None }
        }
        Experiment::Ablation => ablation::section(&named(experiment.variants()), base),
        Experiment::Misses => misses::section(&all, base),
        _ => swept(experiment, &compared, &experiment.conditions(base, crowds)),
    }
}

fn by_method<'a>(rows: &[&'a EpochRecord]) -> Groups<'a> {
    methods(rows).into_iter().map(|name| (name.to_owned(), of_method(rows, name))).collect()
}

fn image(title: &str, file: &str) -> String {
    format!("![{title}](figures/{file})\n")
}

fn headline(rows: &[&EpochRecord], base: Condition) -> Section {
    let rows = under(rows, &base, false);
    let groups = by_method(&rows);
    let text = [
        "## Five-second batches\n\nThe paper prints 44 cm and 0.59 deg at 95 %. Its method refuses no fix, so that all of its fixes count as usable.\n",
        &tables::errors(&groups),
        &tables::integrity(&groups),
        &tables::covariance(&groups),
        &tables::costs(&groups),
        &image("How often an error is exceeded", "ccdf-headline.svg"),
        &format!("Horizontal errors against protection levels (risk {RISK}), usable fixes; below the diagonal a level is exceeded:\n"),
        &image("Stanford diagram", "stanford.svg"),
    ]
    .join("\n");
    // Of several methods with protection levels the last one is shown: variants come before the service's method.
    let leveled = groups.iter().rev().find(|(_, rows)| rows.iter().any(|r| r.protection_m().is_some()));
    let (name, leveled) = leveled.map_or(("", &rows), |(name, rows)| (name.as_str(), rows));
    let pairs = leveled.iter().filter(|r| r.usable).filter_map(|r| Some((r.error_m(), r.protection_m()?)));
    let figures = vec![
        ("ccdf-headline.svg", Figure::Ccdfs(panels("", &groups))),
        (
            "stanford.svg",
            Figure::Stanford(format!("{name}: errors, levels"), pairs.collect(), tables::ALERT_M),
        ),
    ];
    Section { experiment: Experiment::Headline, text, figures, data: None }
}

fn swept(experiment: Experiment, rows: &[&EpochRecord], conditions: &[Condition]) -> Section {
    let (title, words, file) = match experiment {
        Experiment::Batch => (
            "Batch length",
            "The paper reports that the medians are alike, and that batches shorter than 4 s exceed an alert limit of 50 cm with a probability above 0.05.\n",
            "ccdf-batch.svg",
        ),
        Experiment::Drift => (
            "Drift of the odometry",
            "Each line names the standard deviation of the drift after 5 s. The offset is what the paper measures: the error of the drifted trajectory as a whole, which starts without error. The newest pose is what a vehicle uses; its error contains the drift. For the quadratic drift of 40 cm and 1 deg, the paper prints 67 cm and 1.17 deg at 95 %.\n",
            "ccdf-drift.svg",
        ),
        _ => (
            "A crowd",
            "The maps of several contributors, who drove other routes at other times of the same day. The map's own error shrinks, because the errors of their poses average out. Fixes gain less: once the map is good to some centimetres, the 5 s of detections limit them.\n",
            "ccdf-crowd.svg",
        ),
    };
    let all: Vec<_> = conditions.iter().flat_map(|condition| under(rows, condition, true)).collect();
    let mut groups = Groups::new();
    let mut all_panels = Vec::new();
    for method in methods(&all) {
        let of = |condition: &Condition| {
            (condition.name(experiment), of_method(&under(rows, condition, true), method))
        };
        let lines: Groups<'_> = conditions.iter().map(of).collect();
        all_panels.extend(panels(&format!("{method}: "), &lines));
        groups.extend(lines.into_iter().map(|(name, rows)| (format!("{method}, {name}"), rows)));
    }
    let table = match experiment {
        Experiment::Drift => tables::drifted(&groups),
        _ => tables::sweep(&groups),
    };
    let count = groups.first().map_or(0, |(_, rows)| rows.len());
    let head = format!("## {title}\n\n{words}\n{count} fixes a line.\n");
    let text = [&head, &table, &image(title, file)].map(String::as_str).join("\n");
    Section { experiment, text, figures: vec![(file, Figure::Ccdfs(all_panels))], data: None }
}

/// Panels with the horizontal and the heading errors of groups, each in its own colour.
fn panels(prefix: &str, groups: &Groups<'_>) -> Vec<Panel> {
    let curves = |error: fn(&EpochRecord) -> f64| -> Vec<Curve> {
        let curve = |(colour, (name, rows)): (usize, &(String, Vec<&EpochRecord>))| Curve {
            name: name.clone(),
            colour,
            points: ccdf(rows.iter().map(|row| error(row))),
        };
        groups.iter().enumerate().map(curve).collect()
    };
    vec![
        Panel {
            title: format!("{prefix}horizontal position"),
            x: "error, m",
            x_max: 1.5,
            curves: curves(EpochRecord::error_m),
        },
        Panel {
            title: format!("{prefix}heading"),
            x: "error, deg",
            x_max: 3.0,
            curves: curves(|row| row.yaw_deg.abs()),
        },
    ]
}

fn ambiguity(rows: &[&EpochRecord], base: Condition) -> Section {
    let all: Vec<&EpochRecord> = rows.iter().copied().filter(|r| r.condition == base).collect();
    let mut groups = Groups::new();
    for (method, rows) in by_method(&all) {
        let mut site_kinds: Vec<&str> = rows.iter().map(|r| r.site_kind).collect();
        site_kinds.sort_unstable();
        site_kinds.dedup();
        for site_kind in site_kinds {
            let here = rows.iter().copied().filter(|r| r.site_kind == site_kind).collect();
            groups.push((format!("{method}, {site_kind}"), here));
        }
    }
    let curves: Vec<(Curve, String)> = by_method(&all)
        .into_iter()
        .enumerate()
        .filter_map(|(k, (name, rows))| detector(k, &name, &rows))
        .collect();
    let needed = Integrity::default().min_margin;
    let words = format!(
        "## Ambiguity\n\nScenes with many positions that look alike: parked cars at equal distances and nothing else, facades of equal bays, the even walls of a tunnel, an open field. How well can a method detect answers that are wrong by more than a metre? `paper` does so by the score of the best alternative relative to the answer's. `echofix` does so by the margin, how clearly the objects in view prefer the answer to its strongest rival; a usable answer needs {needed} nats.\n"
    );
    let mut text = [&words[..], &tables::ambiguity(&groups)].join("\n");
    for (_, line) in &curves {
        text.push_str(line);
    }
    text.push('\n');
    text.push_str(&image("Receiver operating characteristic", "roc-ambiguity.svg"));
    let curves = curves.into_iter().map(|(curve, _)| curve).collect();
    let title = "Refusing ambiguous answers".to_owned();
    Section {
        experiment: Experiment::Ambiguity,
        text,
        figures: vec![("roc-ambiguity.svg", Figure::Rocs(title, curves))],
        data: None,
    }
}

/// How well a method's margins or relative scores detect wrong answers: a curve and a line of text.
fn detector(colour: usize, name: &str, rows: &[&EpochRecord]) -> Option<(Curve, String)> {
    let found = roc(rows.iter().map(|row| (row.doubt(), row.wrong())))?;
    let line = format!(
        "\n{name}: area under the curve {:.3} ({} wrong, {} right); refusing 5 % of the right answers finds {:.0} % of the wrong ones, refusing 20 % finds {:.0} %.\n",
        found.area,
        found.wrong,
        found.right,
        100.0 * found.detected_at(0.05),
        100.0 * found.detected_at(0.2),
    );
    Some((Curve { name: name.to_owned(), colour, points: found.points }, line))
}
